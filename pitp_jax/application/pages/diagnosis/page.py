"""Write the page of a diagnosis: its first screen, the answers as cards, figures, candidates and recordings."""

from collections.abc import Mapping
from dataclasses import replace

from ....common.numbers import figure, interval, of_range, percent
from ....common.page import Card, Page, Section, Table
from ....common.picture import Picture
from ....method.diagnose import rules
from ....method.diagnose.diagnosis import Diagnosis
from ....method.diagnose.words import NEXT_CSV, causes, errors, named, numbers_of, summary, worst
from ....method.model.units import units_of
from .figures import by_closed_fraction, figures, fraction_closed, has_several, scaling


def report(d: Diagnosis, drawn: Mapping[str, Picture] | None = None) -> Page:
    """Return the page of a diagnosis: verdict, location, cause and reduction of the gap, figures, tables.

    Args:
        d: the diagnosis.
        drawn: its figures, where they are drawn already.
    """
    drawn = figures(d) if drawn is None else drawn
    sections = [
        [_how_far(d)] if d.verdict == "no_gap" else [_where(d), _which(d), _how_far(d)],
        Section("The gap at a glance", [[drawn[name] for name in ("gap", "ranking") if name in drawn]]),
        Section("Where it lies", [[drawn[name] for name in ("where", "shares", "force") if name in drawn]]),
        *_next(d, drawn),
        Section("Parts of the gap", [] if d.verdict == "no_gap" else [budget_table(d.budget)]),
        Section("All candidates", [ranking(d)]),
        Section("Recordings", [_records(d), [f"Note: {line}{'' if line[-1:] in '.?' else '.'}" for line in d.notes]]),
        _reading(),
    ]
    return replace(summary(d), rest=sections)


def _where(d: Diagnosis) -> Card:
    row = max(d.where["frequency"], key=lambda row: row["share"])
    of_gap = percent(d.where["records"].get(worst(d).name, 0.0))
    lines = [f"{percent(row['share'])} of the error.", f"Worst recording: {worst(d).name}, {of_gap} of the error."]
    return Card("Where", " to ".join(map(figure, row["band_hz"])) + " Hz", lines)


def _which(d: Diagnosis) -> Card:
    scored = [r for r in d.ranking if r.effect not in d.effects and r.closed_fraction is not None]
    nearest = [
        f"{r.effect} alone: closes {fraction_closed(r.closed_fraction)}, error {of_range(r.heldout)} of range"
        for r in by_closed_fraction(scored)[:3]
    ]
    if d.effects and d.equivalent:
        nearest.insert(0, f"These recordings do not separate {d.effects[0]} from {named(d.equivalent)}.")
    return Card("Which", named(d.effects) if d.effects else "No single cause is certain", nearest)


def _how_far(d: Diagnosis) -> Card:
    g = d.gap
    own = g.floor_from if g.noise_floor is None else f"{of_range(g.noise_floor)} of range ({g.floor_from})"
    lines = [f"The model's own error: {own}."]
    if g.before != g.unrefitted:
        lines.append(f"Model as given: {of_range(g.unrefitted)}; refitted without any effect: {of_range(g.before)}.")
    if d.verdict == "no_gap":
        return Card("How far", f"{of_range(g.before)} of range", ["There is no gap to close.", *lines])
    return Card("How far", f"{of_range(g.before)} → {of_range(g.after)}", lines)


def budget_table(budget: dict) -> Table:
    """Return the table of the gap's energy by cause."""
    rows = []
    for name, part in causes(budget):
        ends = interval(*part["ci95"]) if "ci95" in part else ""  # beside a simulator without one
        rows.append((name, percent(part["share"]), ends, part.get("probability")))
    header = ("part", "of the gap's energy", "95 % interval", "P")
    return Table(header, rows, "The largest part first.")


def _next(d: Diagnosis, drawn: Mapping[str, Picture]) -> list[Section]:
    e = d.next_experiment
    if e is None:
        return []
    text = (
        f"Play {e}, within the "
        f"{units_of(d.model).input_word}s and slews already played ({NEXT_CSV}). The predicted outputs differ by "
        f"{figure(e.difference, 2)} times the noise."
    )
    return [Section("The next experiment", [text, [drawn["next_experiment"]]])]


def ranking(d: Diagnosis) -> Table:
    """Return the table of all candidates, for the page and the terminal."""
    rows = []
    if has_several(d):
        rows.append((" + ".join(d.handed_back), "together", "", None, d.gap.after, _closed(d.gap)))
    ranked = by_closed_fraction(d.ranking)
    reported = {(p.effect, p.form) for p in d.parts if p.effect in d.effects}
    for r in ranked:
        tied = " (tied)" if r.effect in d.equivalent else ""
        parameters = "; ".join(numbers_of(d, r, " = "))
        rows.append((f"{r.effect}{tied}", r.form, parameters, r.train, r.heldout, _closed(r)))
    bold = [True] * (len(rows) - len(ranked)) + [(r.effect, r.form) in reported for r in ranked]
    header = ("effect", "form", "parameters", "fitted, error %", "held out, error %", "closed (95 % interval)")
    note = (
        "Each effect alone, in its best form; the largest closed fraction first. Errors in % of a recording's range. "
        "Bold: reported, in this form."
    )
    return Table(header, rows, note, bold, (0, 1, 2))


def _closed(row) -> str:
    """Return the closed fraction of the gap, or of one candidate, with its interval, as text."""
    text, ci = percent(row.closed_fraction), row.ci95
    return text if ci is None else f"{text} ({interval(*ci)})"


def _records(d: Diagnosis) -> Table:
    scale, unit = scaling(units_of(d.model).output)
    rows, of_gap = [], d.where["records"]
    for t in sorted(d.traces, key=lambda t: -of_gap.get(t.name, 0.0)):
        before, after = errors(t)
        numbers = (float(t.time[-1] - t.time[0]), scale * t.span, before, after if d.handed_back else None)
        rows.append((t.name, str(len(t.time)), *numbers, percent(of_gap.get(t.name))))
    header = (
        "recording", "samples", "length (s)", f"range ({unit})", "as given, error %", "handed back, error %",
        "of the error",
    )  # fmt: skip
    if d.verdict == "no_gap":  # nothing follows, and fractions of noise have no meaning
        return Table(header[:5], [row[:5] for row in rows])
    note = "The largest part of the error first. The model handed back was fitted to all of these recordings."
    return Table(header, rows, note)


def _reading() -> Section:
    method = (
        "Sets of up to four effects of the catalogue were added to the model and fitted to free runs. A set is judged "
        "by its error on held-out recordings; each recording counts by the logarithm of its mean square error. P is "
        "the fraction of bootstrap draws (of recordings, and of parts within them) in which it is better."
    )
    verdicts = (
        f"“No gap” means that the error is at most {rules.OWN:g} times the model's error on its own recordings. An "
        f"effect is reported if its set is better than the best set without it with P of at least {rules.SURE:g}, if "
        f"the set is better than a black-box model, and if the effect makes up at least {percent(rules.LISTED)} of "
        f"the reduction. With fewer than {rules.EXCITATIONS} kinds of excitation, the best rival must leave at least "
        f"{rules.TWICE:g} times the error. Otherwise the verdict is “unknown”, and the ranking names no cause. P "
        "compares effects of the catalogue; it is not the probability that the effect is the true cause."
    )
    return Section("How to read this", [method, verdicts])

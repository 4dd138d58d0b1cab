"""Write the page of a diagnosis: its first screen, the answers as cards, figures, candidates and recordings."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ....common.numbers import figure, interval, of_range, percent
from ....common.page import Card, Page, Section, Table
from ....common.picture import Picture
from ....method.diagnose import rules
from ....method.diagnose.diagnosis import Diagnosis
from ....method.diagnose.words import NEXT_CSV, errors, named, numbers_of, summary, worst
from ....method.model.units import units_of
from .figures import by_closed_fraction, figures, fraction_closed, refitted, scaling


def report(d: Diagnosis, drawn: Mapping[str, Picture] | None = None) -> Page:
    """Return the page of a diagnosis: verdict, location, cause and reduction of the gap, figures, tables.

    Args:
        d: the diagnosis.
        drawn: its figures, where they are drawn already.
    """
    drawn = figures(d) if drawn is None else drawn
    sections = [
        [_where(d), _which(d), _how_far(d)],
        Section("The gap at a glance", [[drawn[name] for name in ("gap", "ranking") if name in drawn]]),
        Section("Where it lies", [[drawn[name] for name in ("where", "shares", "force") if name in drawn]]),
        *_next(d, drawn),
        Section("Parts of the gap", [budget_table(d.budget)]),
        Section("All candidates", [ranking(d)]),
        Section("Recordings", [_records(d), [f"Note: {line}{'' if line[-1:] in '.?' else '.'}" for line in d.notes]]),
        _reading(),
    ]
    return replace(summary(d), rest=sections)


def _where(d: Diagnosis) -> Card:
    if d.verdict == "no_gap":
        return Card("Where", "Nowhere", ["The remaining error is noise in every recording."])
    band = max(d.where["frequency"], key=lambda row: row["share"])["band_hz"]
    side = "held-out recording" if d.heldout else "recording"
    of_gap = percent(d.where["records"].get(worst(d).name, 0.0))
    line = f"Worst {side}: {worst(d).name}, {of_gap} of the gap."
    return Card("Where", f"{figure(band[0])} to {figure(band[1])} Hz", [line])


def _which(d: Diagnosis) -> Card:
    if d.verdict == "no_gap":
        return Card("Which", "None", ["No effect reduces the error below the model's own error."])
    scored = [r for r in d.ranking if r.effect not in d.effects and r.closed_fraction is not None]
    nearest = [
        f"{r.effect}: closes {fraction_closed(r.closed_fraction)}, error {of_range(r.heldout)} of range"
        for r in by_closed_fraction(scored)[:3]
    ]
    if d.equivalent:
        nearest.insert(0, f"These recordings do not separate {d.effects[0]} from {named(d.equivalent)}.")
    return Card("Which", named(d.effects) if d.effects else "No single cause is certain", nearest)


def _how_far(d: Diagnosis) -> Card:
    g = d.gap
    floor = "not known" if g.noise_floor is None else f"{of_range(g.noise_floor)} of range"
    lines = [f"The model's own error: {floor} ({g.floor_from})."]
    if refitted(d):
        lines.append(f"Model as given: {of_range(g.unrefitted)}; refitted without any effect: {of_range(g.before)}.")
    if d.verdict == "no_gap":
        return Card("How far", f"{of_range(g.before)} of range", ["There is no gap to close.", *lines])
    scale, unit = scaling(units_of(d.model).output)
    held = [t for t in d.traces if t.heldout] or d.traces
    before, after = (
        scale * np.sqrt(np.mean([np.nanmean((run - t.measured) ** 2) for t, run in runs]))
        for runs in ([(t, t.nominal) for t in held], [(t, t.augmented) for t in held])
    )
    lines.append(f"In {unit}, rms: {figure(float(before), 2)} → {figure(float(after), 2)}.")
    if d.heldout:
        lines.append("Every recording was predicted by a fit that did not use it.")
    return Card("How far", f"{of_range(g.before)} → {of_range(g.after)}", lines)


def budget_table(budget: dict) -> Table:
    """Return the table of the gap's energy by cause."""
    words = {
        "nuisance": "sensor offsets and initial states",
        "parameters": "changed coefficients",
        "simulator": "the model of the simulator",
        "unnamed": "predictable from the input, no single cause certain",
        "unexplainable": "not predictable from the input",
    }
    parts = [*budget.get("effects", {}).items(), *((text, budget[key]) for key, text in words.items() if key in budget)]
    rows = []
    for name, part in sorted(parts, key=lambda item: -item[1]["share"]):
        ends = interval(*part["ci95"]) if part.get("ci95") else ""
        rows.append((name, percent(part["share"]), ends, part.get("probability")))
    header = ("part", "of the gap's energy", "95 % interval", "P")
    return Table(header, rows, "The largest part first.")


def _next(d: Diagnosis, drawn: Mapping[str, Picture]) -> list[Section]:
    e = d.next_experiment
    if e is None:
        return []
    seconds = figure(float(e.time[-1] - e.time[0]), 2)
    text = (
        f"To separate {' from '.join(e.separates)}, play this: {e.excitation}, for {seconds} s, within the "
        f"{units_of(d.model).input_word}s and slews already played ({NEXT_CSV}). The predicted outputs differ by "
        f"{figure(e.difference, 2)} times the noise."
    )
    return [Section("The next experiment", [text, [drawn["next_experiment"]]])]


def ranking(d: Diagnosis) -> Table:
    """Return the table of all candidates, for the page and the terminal."""
    rows = []
    if len(d.effects) > 1:
        rows.append((" + ".join(d.effects), "together", "", None, d.gap.after, _closed(d.gap)))
    ranked = by_closed_fraction(d.ranking)
    for r in ranked:
        tied = " (tied)" if r.effect in d.equivalent else ""
        parameters = "; ".join(numbers_of(d, r, " = "))
        rows.append((f"{r.effect}{tied}", r.form, parameters, r.train, r.heldout, _closed(r)))
    bold = [True] * (len(rows) - len(ranked)) + [r.effect in d.effects for r in ranked]
    header = ("effect", "form", "parameters", "fitted, error %", "held out, error %", "closed (95 % interval)")
    note = (
        "Each effect alone, in its best form; the largest closed fraction first. Errors in % of a recording's range. "
        "Bold: reported."
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
        used, seconds = "held out" if t.heldout else "fitted", float(t.time[-1] - t.time[0])
        numbers = (seconds, scale * t.span, before, after)
        rows.append((t.name, used, str(len(t.time)), *numbers, percent(of_gap.get(t.name))))
    header = (
        "recording", "used", "samples", "length (s)", f"range ({unit})", "model, error %", "after, error %",
        "of the gap",
    )  # fmt: skip
    if d.verdict == "no_gap":  # nothing follows, and fractions of noise have no meaning
        return Table(header[:6], [row[:6] for row in rows], "", text=(0, 1))
    return Table(header, rows, "The largest part of the gap first.", text=(0, 1))


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

"""Write the report: one page whose first screen shows where the gap lies, its cause, and its reduction."""

import numpy as np
from matplotlib.figure import Figure

from ....common.numbers import figure, interval, number, percent
from ....method.diagnose import rules
from ....method.diagnose.diagnosis import Diagnosis
from ....method.diagnose.gap import Gap
from ....method.diagnose.result import Ranked
from ....method.model.units import units_of
from .. import html
from ..html import tag
from .answers import NEXT_CSV, budget_bar, cards, headline, next_step, verdict_text
from .figures import figures
from .gap_figure import errors, output_unit, worst
from .which import parameter_lines
from .words import certainty, numbers_of, result_line


def report(diagnosis: Diagnosis, drawn: dict[str, Figure] | None = None) -> str:
    """Write a self-contained HTML page: verdict, location, cause and reduction of the gap, figures, tables.

    Args:
        diagnosis: result of `diagnose`.
        drawn: its `figures`, which are reduced in size; None draws them.
    """
    drawn = figures(diagnosis) if drawn is None else drawn
    parts = [
        *_first(diagnosis),
        *_pictures(diagnosis, drawn),
        *_next(diagnosis, drawn),
        tag("h2", "All candidates"),
        *_ranking(diagnosis),
        tag("h2", "Recordings"),
        *_records(diagnosis),
        *_reading(diagnosis),
    ]
    return html.page(headline(diagnosis), parts)


def first_screen(diagnosis: Diagnosis) -> str:
    """Return the result, its parts, the verdict and the three cards as HTML, without the page around them."""
    return "".join(_first(diagnosis))


def _first(d: Diagnosis) -> list[str]:
    verdict = [tag("p", f"{headline(d)}. {verdict_text(d)}", "lead"), tag("p", next_step(d), "lead")]
    return [
        tag("p", "Diagnosis: a model beside recordings of the real actuator", "soft"),
        tag("h1", result_line(d), d.verdict),
        *_parts(d),
        *verdict,
        budget_bar(d),
        f'<div class="cards">{"".join(cards(d))}</div>',
    ]


def _parts(d: Diagnosis) -> list[str]:
    """Return an HTML table of the effects in the returned model, with parameters and certainty."""
    if not len(d.parts):
        return []
    header = ("part", "form", "values (95 % interval)", "of the reduction", "P", "certainty")
    rows = []
    for p in d.parts:
        values = "; ".join(numbers_of(d, p, " = "))
        share, sure = percent(p.fraction) if p.fraction else "", number(p.probability, 2)
        rows.append(("named" if p.effect in d.effects else "", (p.effect, p.form, values, share, sure, certainty(p))))
    return [html.table(header, rows, {1: "left", 2: "long", 5: "long"})]


def _pictures(d: Diagnosis, drawn: dict[str, Figure]) -> list[str]:
    """Return all figures except that of the next experiment as HTML, under their headings."""
    shown = {name: html.picture(name, drawn[name], caption) for name, caption in _captions(d).items() if name in drawn}
    rooms = {"The gap at a glance": ("gap", "ranking"), "Where it lies": ("where", "shares", "force")}
    parts = []
    for heading, names in rooms.items():
        there = "".join(shown[name] for name in names if name in shown)
        parts += [tag("h2", heading), f'<div class="figures">{there}</div>'] if there else []
    return parts


def _captions(d: Diagnosis) -> dict[str, str]:
    name, units = worst(d).name, units_of(d.model)
    side = "held out" if d.heldout else "no recording was held out"
    return {
        "gap": f"{name} ({side}), the part with the largest error. Below: model minus measurement.",
        "where": "Fraction of the missing force by frequency and amplitude of the input. Outlined: clearly above "
        "average.",
        "shares": "Fraction of the model's error by recording (dark: held out), by the frequency of the error, and by "
        "part of a recording.",
        "force": "Fraction of the missing force (the equation's residual along the measured motion) by "
        f"{units.output_word}, {units.velocity_word} and {units.input_word}.",
        "ranking": f"Fraction of the {'held-out ' if d.heldout else ''}gap that each effect closes by itself, with "
        "its 95 % interval. At 100 % only the model's own error remains. Blue: reported; orange: tied with it.",
    }


def _next(d: Diagnosis, drawn: dict[str, Figure]) -> list[str]:
    e = d.next_experiment
    if e is None:
        return []
    a, b = e.separates
    seconds = figure(float(e.time[-1] - e.time[0]), 2)
    text = (
        f"To separate {a} from {b}, play this: {e.excitation}, for {seconds} s, within the "
        f"{units_of(d.model).input_word}s and slews already played ({NEXT_CSV}). The predicted outputs differ by "
        f"{figure(e.difference, 2)} times the noise."
    )
    shown = html.picture("next", drawn["next_experiment"], f"To play: {e.excitation}.")
    return [tag("h2", "The next experiment"), tag("p", text), f'<div class="figures">{shown}</div>']


def _ranking(d: Diagnosis) -> list[str]:
    header = ("effect", "form", "parameters", "fitted, error %", "held out, error %", "closed (95 % interval)")
    rows = []
    if len(d.effects) > 1:
        rows.append(("named", (" + ".join(d.effects), "together", "", "", figure(d.gap.after), _closed(d.gap))))
    for r in d.ranking:
        tied = " (tied)" if r.effect in d.equivalent else ""
        css = "named" if r.effect in d.effects else ""
        figures_ = (figure(r.train), figure(r.heldout), _closed(r))
        rows.append((css, (f"{r.effect}{tied}", r.form, "; ".join(parameter_lines(d, r)), *figures_)))
    note = "Each effect alone, in its best form. Errors in % of a recording's range."
    return [tag("p", note, "soft"), html.table(header, rows, {1: "left", 2: "long"})]


def _closed(row: Gap | Ranked) -> str:
    """Return the closed fraction of the gap, or of one candidate, with its interval, as text."""
    text, ci = percent(row.closed_fraction), row.ci95
    return text if ci is None else f"{text} ({interval(*ci)})"


def _records(d: Diagnosis) -> list[str]:
    scale, unit = output_unit(d)
    header = (
        "recording",
        "used",
        "samples",
        "length (s)",
        f"range ({unit})",
        "model, error %",
        "after, error %",
        "of the gap",
    )
    columns = 6 if d.verdict == "no_gap" else 8  # nothing follows, and fractions of noise have no meaning
    rows = []
    for t in d.traces:
        before, after = errors(t)
        span = float(np.nanmax(t.measured) - np.nanmin(t.measured)) if np.isfinite(t.measured).any() else float("nan")
        rows.append(
            ("", (
                t.name, "held out" if t.heldout else "fitted", str(len(t.time)), figure(float(t.time[-1] - t.time[0])),
                figure(scale * span), figure(before), figure(after), percent(d.where["records"].get(t.name)),
            )[:columns])
        )  # fmt: skip
    notes = [tag("p", f"Note: {line}{'' if line[-1:] in '.?' else '.'}", "soft") for line in d.notes]
    return [html.table(header[:columns], rows, {1: "left"}), *_pieces(d), *notes]


def _pieces(d: Diagnosis) -> list[str]:
    """Return an HTML table of the pieces that the search used; empty if it used all samples."""
    if d.pieces is None:
        return []
    rows = [("", (p.record, f"{p.from_s:.6g}", f"{p.to_s:.6g}")) for p in d.pieces]
    return [
        tag("p", "The search worked on these pieces:", "soft"),
        html.table(("recording", "from (s)", "to (s)"), rows, {}),
    ]


def _reading(d: Diagnosis) -> list[str]:
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
    return [tag("h2", "How to read this"), tag("p", method), tag("p", verdicts)]

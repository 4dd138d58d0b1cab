"""The report: one page whose first screen answers where the gap lies, which effect causes it, how far it shrinks."""

import numpy as np

from ..._report import html
from ..._report.html import tag
from ..._report.numbers import figure, interval, percent
from .. import verdict as rule
from ..diagnosis import Diagnosis
from ..result import Gap, Ranked
from .answers import NEXT_CSV, cards, headline, next_step, verdict_text
from .figures import figures
from .gap_figure import left, output_unit, worst
from .which import parameter_lines


def report(diagnosis: Diagnosis) -> str:
    """A self-contained HTML page: verdict, where, which, how far; then figures, tables, and how to read them.

    Args:
        diagnosis: what `diagnose` found.
    """
    parts = [
        tag("p", "Diagnosis: a model beside recordings of the real actuator", "soft"),
        tag("h1", headline(diagnosis), diagnosis.verdict),
        tag("p", verdict_text(diagnosis), "lead"),
        tag("p", next_step(diagnosis), "lead"),
        f'<div class="cards">{"".join(cards(diagnosis))}</div>',
        *_pictures(diagnosis),
        *_next(diagnosis),
        tag("h2", "All candidates"),
        *_ranking(diagnosis),
        tag("h2", "Recordings"),
        *_records(diagnosis),
        *_reading(diagnosis),
    ]
    return html.page(headline(diagnosis), parts)


def _pictures(d: Diagnosis) -> list[str]:
    """The figures but the next experiment's, under their headings."""
    drawn = figures(d)
    shown = {name: html.picture(name, drawn[name], caption) for name, caption in _captions(d).items() if name in drawn}
    rooms = {"The gap at a glance": ("gap", "ranking", "term"), "Where it lies": ("where", "shares", "force")}
    parts = []
    for heading, names in rooms.items():
        there = "".join(shown[name] for name in names if name in shown)
        parts += [tag("h2", heading), f'<div class="figures">{there}</div>'] if there else []
    return parts


def _captions(d: Diagnosis) -> dict[str, str]:
    name = worst(d).name
    side = "held out: no fit saw it" if d.heldout else "no recording was held out"
    return {
        "gap": f"{name} ({side}), the stretch where the model is furthest off; below, model less measurement.",
        "term": "The force that the records held out lack (dots) and the equation found for it (line: its mean), in % "
        "of the largest force of the film.",
        "where": "Share of the missing force by drive frequency and amplitude; outlined where it stands out.",
        "shares": "Share of the model's error by recording (held-out ones darker), by the error's own frequency, and "
        "by part of a recording.",
        "force": "Share of the missing force (what the equation lacks along the measured motion) by displacement, "
        "velocity and voltage.",
        "ranking": f"Share of the {'held-out ' if d.heldout else ''}gap each effect closes by itself, with its 95 % "
        "interval: 100 % leaves only noise. Blue: named; orange: tied with it; pale: only screened, not fitted on "
        "whole recordings.",
    }


def _next(d: Diagnosis) -> list[str]:
    e = d.next_experiment
    if e is None:
        return []
    a, b = e.separates
    seconds = figure(float(e.time[-1] - e.time[0]), 2)
    text = (
        f"To tell {a} from {b}, play this: {e.excitation}, for {seconds} s, within the voltages and slews already "
        f"played ({NEXT_CSV}). The two predict outputs that differ by {figure(e.difference, 2)} times the noise."
    )
    drawn = html.picture("next", figures(d)["next_experiment"], f"Voltage to play: {e.excitation}.")
    return [tag("h2", "The next experiment"), tag("p", text), f'<div class="figures">{drawn}</div>']


def _ranking(d: Diagnosis) -> list[str]:
    header = ("effect", "form", "parameters", "fitted, error %", "held out, error %", "closed (95 % interval)")
    rows = []
    if len(d.effects) > 1:
        rows.append(("named", (" + ".join(d.effects), "together", "", "", figure(d.gap.after), _closed(d.gap))))
    for r in d.ranking:
        tied = " (tied)" if r.effect in d.equivalent else ""
        css = "named" if r.effect in d.effects else "pale" if r.screened else ""
        form = f"{r.form}{', screened' if r.screened else ''}"
        figures_ = (figure(r.train), figure(r.heldout), _closed(r))
        rows.append((css, (f"{r.effect}{tied}", form, "; ".join(parameter_lines(d, r)), *figures_)))
    note = (
        "Each effect by itself, in its best form; errors in % of a recording's range. Those marked screened were left "
        "out of the fit on whole recordings: their figures are first estimates."
    )
    return [tag("p", note, "soft"), html.table(header, rows, {1: "left", 2: "long"})]


def _closed(row: Gap | Ranked) -> str:
    """Closed fraction and interval of the gap or of one candidate."""
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
    columns = 6 if d.verdict == "no_gap" else 8  # nothing comes after, and shares of noise say nothing
    rows = []
    for t in d.traces:
        before, after = left(t)
        span = float(np.nanmax(t.measured) - np.nanmin(t.measured)) if np.isfinite(t.measured).any() else float("nan")
        rows.append(
            ("", (
                t.name, "held out" if t.heldout else "fitted", str(len(t.time)), figure(float(t.time[-1] - t.time[0])),
                figure(scale * span), figure(before), figure(after), percent(d.where["records"].get(t.name)),
            )[:columns])
        )  # fmt: skip
    return [html.table(header[:columns], rows, {1: "left"}), *(tag("p", f"Note: {line}.", "soft") for line in d.notes)]


def _reading(d: Diagnosis) -> list[str]:
    method = (
        "Every effect of the catalogue was added to the model and fitted to the free run of the fitted recordings; it "
        "is judged by how much smaller the error becomes on other recordings, which no fit saw. Closed is the share of "
        "the error above the sensor's noise that this takes away."
    )
    verdicts = (  # the numbers of `verdict`
        f"“No gap” means that the error is within {rule.GAP:g} times the noise, beside each recording's own zero, or "
        f"within {rule.DOUBT:g} times where no effect closes {percent(rule.ENOUGH)} of it, since the noise is an "
        f"estimate itself. A name is given where at least {percent(rule.HALF)} of the gap is closed, "
        f"{percent(rule.ENOUGH)} where more than {rule.LITTLE:g} times the noise is left, {percent(rule.MOST)} above "
        f"{rule.MUCH:g} times the noise or {rule.LARGE:g} % of range, and never where more than {rule.TOO_LARGE:g} % "
        f"of range is left, where zeros alone do as much or more than {rule.TIES} other names do as well. Else the "
        "verdict is “unknown”: no name is given, and none should be read off the ranking."
    )
    return [tag("h2", "How to read this"), tag("p", method), tag("p", verdicts)]

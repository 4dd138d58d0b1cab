"""Write the page of a plan: the recordings to play in order, the purpose of each, and when to stop."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...common.numbers import figure
from ...common.units import column_name
from ..plan.drives import Planned
from ..plan.planning import REACHED, Plan
from ..plan.strokes import LEAST_DAMPING
from . import html
from .html import tag
from .lines import DRIVE, finish, line, own_axes, volts


def page(plan: Plan, model: str = "") -> str:
    """Write the plan as a self-contained HTML page.

    Args:
        plan: result of `plan`.
        model: file of its model; empty for a first session.
    """
    title = headline(plan, bool(model))
    parts = [
        tag("p", f"Plan of recordings{f' for {model}' if model else ': a first session'}", "soft"),
        tag("h1", title),
        tag("p", _lead(plan), "lead"),
        f'<div class="cards">{"".join(_cards(plan))}</div>',
        *([tag("h2", "What to play"), _table(plan), _pictures(plan)] if plan.recordings else []),
        tag("h2", "How to read this"),
        *(tag("p", text) for text in _reading(plan)),
    ]
    return html.page(title, parts)


def headline(plan: Plan, modelled: bool) -> str:
    """Write the plan in one line: how many recordings, and how long; or that no more are worthwhile."""
    if plan.stop:
        return "Stop: another recording would not lower the error noticeably"
    what = "more recordings" if modelled else "recordings"
    return f"{len(plan.recordings)} {what}, {figure(plan.seconds)} s of input"


def _lead(plan: Plan) -> str:
    if not plan.expected:
        rest = f"0 {plan.limits.units.input.unit}"
        return f"Play the files in the order of their numbers, small ones first. Each starts and ends at {rest}."
    before, after = plan.expected[0], plan.expected[-1]
    if not plan.recordings:
        return f"On inputs not recorded yet, the expected error of the model is {figure(before, 2)} % of range."
    return (
        f"On inputs not recorded yet, the expected error of the model is {figure(before, 2)} % of range now and "
        f"{figure(after, 2)} % after these recordings (noise not counted)."
    )


def _cards(plan: Plan) -> list[str]:
    x = plan.limits
    rests = sum(r.rest for r in plan.recordings)
    drive, stroke = x.units.input, x.units.limit
    low, high, slew = (figure(float(drive.shown(v))) for v in (x.low, x.high, x.slew))
    far = "" if x.farthest == np.inf else f"Stroke at most {figure(stroke.shown(x.farthest))} {stroke.unit}."
    cards = [
        html.card("Limits", f"{low} to {high} {drive.unit}", tag("p", f"At most {slew} {drive.rate}. {far}")),
        html.card("Band", f"{figure(x.band[0])} to {figure(x.band[1])} Hz", tag("p", f"{figure(x.rate)} samples/s.")),
    ]
    if plan.recordings:
        lines = tag("p", f"{figure(rests)} s of rest at 0 {drive.unit} between them.") + html.bullets(plan.notes)
        cards.append(html.card("Time", f"{figure(plan.seconds + rests)} s in all", lines))
    return cards


def _table(plan: Plan) -> str:
    drive, stroke = plan.limits.units.input, plan.limits.units.limit
    header = (
        "recording", "kind", "length (s)", "rest (s)", f"largest ({drive.unit})", f"steepest ({drive.rate})",
        f"stroke ({stroke.unit})", f"with half the damping ({stroke.unit})",
        "play only if no earlier stroke exceeded", "purpose",
    )  # fmt: skip
    rows = []
    for r in plan.recordings:
        inputs = (float(drive.shown(np.abs(r.voltage).max())), drive.shown(r.slew))
        numbers = (r.seconds, r.rest, *inputs, stroke.shown(r.stroke), stroke.shown(r.stroke_half_damped))
        bound = "–" if r.go_on == np.inf else f"{figure(stroke.shown(r.go_on))} {stroke.unit}"
        rows.append(("", (r.name, r.kind, *(figure(v) for v in numbers), bound, r.purpose)))
    return html.telling_table(header, rows, {1: "left", 9: "long"})


def _pictures(plan: Plan) -> str:
    unit, rows = plan.limits.units.input.unit, enumerate(plan.recordings)
    drawn = (html.picture(f"drive{k}", _drawn(r, unit), f"{r.name}: {r.kind}") for k, r in rows)
    return f'<div class="figures">{"".join(drawn)}</div>'


def _drawn(recording: Planned, unit: str) -> Figure:
    ax: Axes = own_axes(None, 1, (5.0, 1.5))[0]
    voltage, label = volts(recording.voltage, unit)
    line(ax, recording.time, voltage, color=DRIVE, lw=0.8)
    finish(np.array([ax]), "time (s)", [label])
    return ax.figure  # pyright: ignore[reportReturnType]


def _reading(plan: Plan) -> list[str]:
    drive = plan.limits.units.input.unit
    texts = [
        f"Every file holds time_s and {column_name('voltage', drive)} at the rate above, starts and ends at 0 {drive}, "
        f"and keeps the slew limit between its samples. Record the {plan.limits.units.output_word} with it, and let "
        f"the actuator rest at 0 {drive} between two files."
    ]
    if any(r.go_on < np.inf for r in plan.recordings):
        texts.append(
            "A stroke grows with the square of the voltage, and more near a resonance. The limits in the table hold "
            f"for every resonance with a damping ratio of {LEAST_DAMPING:g} or more. {REACHED}"
        )
    if plan.expected:
        texts.append(
            "The expected error is that of free runs under inputs that cover frequency, amplitude and bias. It "
            "follows from the model's sensitivity to its trained parameters and from its residual on its recordings "
            "(Laplace approximation). Recordings are chosen one by one, each time the one that lowers this error "
            "most. The plan ends when the next one would lower the measured error by less than 1 %."
        )
    return texts

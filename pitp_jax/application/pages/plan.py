"""Write the page of a plan: the recordings to play in order, the purpose of each, and when to stop."""

import numpy as np

from ...common.numbers import figure, finite
from ...common.page import Card, Page, Section, Table
from ...common.picture import Picture
from ...common.units import column_name
from ..plan.planning import REACHED, Plan
from ..plan.strokes import LEAST_DAMPING
from .drawing import DRIVE, signals, volts


def page(plan: Plan, model: str = "") -> Page:
    """Return the page of a plan.

    Args:
        plan: result of `plan`.
        model: file of its model; empty for a first session.
    """
    unit = plan.limits.units.input.unit
    drawn = []
    for k, r in enumerate(plan.recordings):
        voltage, label = volts(r.voltage, unit)
        drawn.append(Picture(f"drive{k}", signals(r.time, [(label, voltage, DRIVE)]), f"{r.name}: {r.kind}"))
    kind = f"Plan of recordings{f' for {model}' if model else ': a first session'}"
    rest = [Section("What to play", [table(plan), drawn]), Section("How to read this", _reading(plan))]
    return Page(headline(plan, bool(model)), kind, [_lead(plan), _cards(plan)], rest)


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
    text = f"On inputs not recorded yet, the expected error of the model is {figure(before, 2)} % of range"
    if not plan.recordings:
        return f"{text}."
    return f"{text} now and {figure(after, 2)} % after these recordings (noise not counted)."


def _cards(plan: Plan) -> list[Card]:
    x = plan.limits
    rests = sum(r.rest for r in plan.recordings)
    drive, stroke = x.units.input, x.units.limit
    low, high, slew = (figure(float(drive.shown(v))) for v in (x.low, x.high, x.slew))
    far = "" if x.farthest == np.inf else f" Stroke at most {figure(stroke.shown(x.farthest))} {stroke.unit}."
    cards = [
        Card("Limits", f"{low} to {high} {drive.unit}", [f"At most {slew} {drive.rate}.{far}"]),
        Card("Band", f"{figure(x.band[0])} to {figure(x.band[1])} Hz", [f"{figure(x.rate)} samples/s."]),
    ]
    if plan.recordings:
        lines = [f"{figure(rests)} s of rest at 0 {drive.unit} between them.", *plan.notes]
        cards.append(Card("Time", f"{figure(plan.seconds + rests)} s in all", lines))
    return cards


def table(plan: Plan) -> Table:
    """Return the recordings to play, for the page and the terminal."""
    drive, stroke = plan.limits.units.input, plan.limits.units.limit
    header = (
        "recording", "kind", "length (s)", "rest (s)", f"largest ({drive.unit})", f"steepest ({drive.rate})",
        f"stroke ({stroke.unit})", f"with half the damping ({stroke.unit})",
        f"play only if no earlier stroke exceeded ({stroke.unit})", "purpose",
    )  # fmt: skip
    rows = []
    for r in plan.recordings:
        inputs = (float(drive.shown(np.abs(r.voltage).max())), float(drive.shown(r.slew)))
        strokes = (float(stroke.shown(r.stroke)), float(stroke.shown(r.stroke_half_damped)))
        bound = finite(stroke.shown(r.go_on))
        rows.append((r.name, r.kind, r.seconds, r.rest, *inputs, *strokes, bound, r.purpose))
    return Table(header, rows, "In the order to play.", text=(0, 1, 9), omitted=("–", "", "0"))


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

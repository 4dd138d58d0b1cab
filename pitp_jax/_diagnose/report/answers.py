"""The first screen of a report: the verdict, and where the gap lies, which effect causes it, how far it shrinks."""

import numpy as np

from ..._report import html
from ..._report.html import tag
from ..._report.numbers import figure, interval, of_range, percent
from ..diagnosis import Diagnosis
from ..result import GAP
from ..verdict import ENOUGH, HELPS
from .formatting import gathers, named, plain_words
from .gap_figure import output_unit, outside_line, refitted, time_spent, worst
from .which import crowd, share_closed, which

NEXT_CSV = "next_experiment.csv"


def headline(d: Diagnosis) -> str:
    """The verdict in one line."""
    if d.verdict == "explained":
        if d.effects == ("parameter_change",):
            return "The model's own coefficients have changed; nothing is missing from it"
        return f"The gap is explained by {named(d.effects)}{''.join(f', or by {name}' for name in d.equivalent)}"
    if crowd(d):
        alike = "explain the gap alike" if (d.gap.closed_fraction or 0) >= ENOUGH else "help alike, and too little"
        return f"Unknown: {len(d.equivalent) + 1} effects {alike}"
    if d.verdict == "unknown":
        return "Unknown: there is a gap, and no effect in the catalogue explains it"
    return "No gap once the model's coefficients are refitted" if _moved(d) else "No gap: the error is sensor noise"


def verdict_text(d: Diagnosis) -> str:
    """What the verdict means, in one or two sentences."""
    if d.verdict == "no_gap":
        if _moved(d):
            return f"As given, the model was off by {of_range(d.gap.unrefitted)} of range; refitted, {_error_left(d)}."
        return f"On {_judged_on(d)}, {_error_left(d)}. There is no effect to add."
    if d.verdict == "explained":
        what = "; ".join(plain_words(name) for name in d.effects)
        return f"{what[:1].upper()}{what[1:]}. {_far(d)}"
    if crowd(d):
        return f"These data cannot tell them apart. {_far(d)} The experiment below separates two of them."
    line = outside_line(d)
    if line:
        return (
            f"In every recording, whatever its drive, at least {percent(line[1])} of the error is one oscillation at "
            f"{figure(line[0])} Hz: something disturbs the rig from outside (vibration, pick-up, a supply)."
        )
    if (d.gap.closed_fraction or 0) < HELPS:
        return (
            f"No candidate reduces the error on {_judged_on(d)}: either something disturbs the rig "
            "from outside, or the cause has a form the catalogue does not hold."
        )
    return (
        f"The best candidate helps and leaves too much: the cause, or a part of it, is not in the catalogue. {_far(d)}"
    )


def next_step(d: Diagnosis) -> str:
    """What to do about it, in one sentence."""
    if d.verdict == "no_gap":
        if any("rezero" in note for note in d.notes):
            return "Next: rezero the sensor before a recording, or give each a second of rest at 0 V."
        return "Next: predict and invert with this model; more recordings teach it nothing." if not _moved(d) else (
            "Next: predict and invert with the refitted model."
        )  # fmt: skip
    if d.next_experiment is not None:
        return f"Next: play and record {NEXT_CSV}, which tells {named(d.next_experiment.separates)} apart."
    if d.verdict == "explained":
        return "Next: predict and invert with model_augmented, or mend the rig and diagnose again."
    if outside_line(d):
        return "Next: find what hums at that frequency; no model of the actuator will."
    return f"Next: look at {worst(d).name}, where most of it is, then record a drive of another kind beside it."


def _moved(d: Diagnosis) -> bool:
    """Whether a refit alone closed a gap."""
    return refitted(d) and d.gap.unrefitted > GAP * (d.gap.noise_floor or d.gap.before)


def _error_left(d: Diagnosis) -> str:
    g = d.gap
    if g.noise_floor is None:
        return f"it is off by {of_range(g.before)} of range"
    return f"it is off by {of_range(g.before)} of range, of which the sensor's noise alone is {of_range(g.noise_floor)}"


def _far(d: Diagnosis) -> str:
    adding = "Adding it" if len(d.effects) == 1 else "Adding both" if d.effects else "The best candidate"
    adding = "Refitting them" if d.effects == ("parameter_change",) else adding
    before, after = of_range(d.gap.before), of_range(d.gap.after)
    return f"{adding} takes the error on {_judged_on(d)} from {before} to {after} of range."


def _judged_on(d: Diagnosis) -> str:
    return "recordings the fit never saw" if d.heldout else "the recordings it was fitted on"


def _where(d: Diagnosis) -> str:
    if d.verdict == "no_gap":
        return html.card("Where", "Nowhere", tag("p", "What the model leaves over is noise in every recording."))
    share = d.where["records"].get(worst(d).name, 0.0)
    unit = d.model.origin.displacement_unit
    loud = max(d.where["frequency"], key=lambda row: row["share"])
    big = f"{figure(loud['band_hz'][0])} to {figure(loud['band_hz'][1])} Hz"
    facts = gathers(d.where, time_spent(d), unit)[:2]
    side = "held-out recording" if d.heldout else "recording"
    worst_line = f"Worst {side}: {worst(d).name}, {percent(share)} of the gap."
    return html.card("Where", big, tag("p", d.where["summary"]), html.bullets([*facts, worst_line]))


def _how_far(d: Diagnosis) -> str:
    g = d.gap
    floor = "not known" if g.noise_floor is None else f"{of_range(g.noise_floor)} of range"
    lines = [f"Noise floor: {floor} ({g.floor_from})."]
    if refitted(d):
        lines.insert(0, f"Model as given: {of_range(g.unrefitted)}; refitted without any effect: {of_range(g.before)}.")
    if g.closed_fraction is not None:
        ci = ""
        if g.ci95 and g.closed_fraction >= 0.005:
            ci = f" (95 % interval {interval(*g.ci95)})"
        lines.insert(0, f"{share_closed(g.closed_fraction)} of the closable gap is closed{ci}.".capitalize())
    if d.verdict == "no_gap":
        big = f"{of_range(g.unrefitted)} → {of_range(g.before)}" if _moved(d) else f"{of_range(g.before)} of range"
        lines.insert(0, "Nothing left to close.")
    else:
        big = f"{of_range(g.before)} → {of_range(g.after)}"
        lines.append(_in_units(d))
    lines.append(
        f"Judged on {named(list(d.heldout))}, which no fit saw." if d.heldout else "No recording was held out."
    )
    return html.card("How far", big, *(tag("p", line) for line in lines))


def _in_units(d: Diagnosis) -> str:
    """The error in the output's own unit, rms over the held-out recordings."""
    scale, unit = output_unit(d)
    held = [t for t in d.traces if t.heldout] or d.traces
    before, after = (
        scale * np.sqrt(np.mean([np.nanmean((getattr(t, which) - t.measured) ** 2) for t in held]))
        for which in ("nominal", "augmented")
    )
    return f"In {unit}, rms: {figure(float(before), 2)} → {figure(float(after), 2)}."


def cards(d: Diagnosis) -> tuple[str, str, str]:
    """Where, which, how far, as HTML."""
    return _where(d), which(d), _how_far(d)

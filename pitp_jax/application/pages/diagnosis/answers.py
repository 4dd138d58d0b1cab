"""Write the first screen of a report: verdict, budget, and where the gap lies, its cause and its reduction."""

import numpy as np

from ....common.numbers import figure, interval, of_range, percent
from ....method.diagnose.diagnosis import Diagnosis
from ....method.model.encoder import ConstantEncoder
from ....method.model.units import units_of
from .. import html
from ..html import tag
from .formatting import gathers, named, plain_words
from .gap_figure import output_unit, refitted, time_spent, worst
from .which import fraction_closed, which

NEXT_CSV = "next_experiment.csv"


_HELPS = 0.1  # of the gap: a smaller reduction is reported as nothing


def headline(d: Diagnosis) -> str:
    """Describe the verdict of a diagnosis in one line."""
    if d.effects == ("parameter_change",):
        return "The model's own coefficients have changed; no effect is missing"
    if d.effects:
        said = f"explained by {named(d.effects)}{''.join(f', or by {name}' for name in d.equivalent)}"
        return f"The gap is {'partly ' if d.verdict == 'partly' else ''}{said}"
    if d.verdict == "unknown":
        return "Unknown: there is a gap, and no single cause is certain"
    return "No gap: the error is the model's own"


def verdict_text(d: Diagnosis) -> str:
    """Explain the verdict of a diagnosis in one or two sentences."""
    if d.verdict == "no_gap":
        return f"On {_records_used(d)}, {_error_without(d)}. There is no effect to add."
    if d.effects:
        what = "; ".join(plain_words(name, units_of(d.model)) for name in d.effects)
        more = (
            " Another part of the error can be predicted from the input, but no single cause is certain."
            if d.verdict == "partly"
            else ""
        )
        return f"{what[:1].upper()}{what[1:]}. {_far(d)}{more}"
    tone = d.where.get("tone")
    if tone:
        return (
            f"In every recording, at least {percent(tone['share'])} of the error is one oscillation at "
            f"{figure(tone['hz'])} Hz, for every input. Something disturbs the rig from outside (vibration, electrical "
            "interference, a supply)."
        )
    if (d.gap.closed_fraction or 0) < _HELPS:
        return (
            f"No candidate reduces the error on {_records_used(d)}: either something disturbs the rig from outside, "
            "or the cause is not in the catalogue."
        )
    return f"{d.reason} {_far(d)}"


def budget_bar(d: Diagnosis) -> str:
    """Draw the energy of the gap as one HTML bar that adds up to 100 %, with a label for each part."""
    b = d.budget
    if not b:
        return ""
    parts = [
        ("sensor offset and initial state", b["nuisance"], "#b9cfe0"),
        ("changed coefficients of the model", b["parameters"], "#6a9fc9"),
    ]
    parts += [(name, row, "#0072b2") for name, row in b["effects"].items()]
    parts += [
        ("predictable from the input, no single cause certain", b["unnamed"], "#e69f00"),
        ("not predictable", b["unexplainable"], "#999999"),
    ]
    bar, rows = [], []
    for label, row, color in parts:
        width = 100 * max(row["share"], 0.0)
        if width >= 0.5:
            bar.append(f'<span style="display:inline-block;height:1.6em;width:{width:.1f}%;background:{color}"></span>')
            low, high = row["ci95"]
            sure = row.get("probability")
            p = f", P {sure:.2f}" if sure is not None else ""
            rows.append(f"{label}: {percent(row['share'])} ({percent(low)} to {percent(high)}{p})")
    if not bar:
        return ""
    return f'<div style="white-space:nowrap;overflow:hidden">{"".join(bar)}</div>' + tag(
        "p", "Energy of the gap: " + "; ".join(rows) + ".", "soft"
    )


def next_step(d: Diagnosis) -> str:
    """Recommend the next step after a diagnosis, in one sentence."""
    if d.verdict == "no_gap":
        if isinstance(d.model.encoder, ConstantEncoder):
            return "Next: predict and invert with this model; if its error is too large, train it with `pitp fit`."
        return "Next: predict and invert with this model; more recordings would not improve it."
    if d.next_experiment is not None:
        return f"Next: play and record {NEXT_CSV}, which separates {named(d.next_experiment.separates)}."
    if d.effects:
        return "Next: predict and invert with model_augmented, or repair the rig and diagnose again."
    if d.where.get("tone"):
        return "Next: find the source of this oscillation; no model of the actuator can predict it."
    return f"Next: check {worst(d).name}, which holds most of the gap, then record an input of another kind."


def _error_without(d: Diagnosis) -> str:
    g = d.gap
    if g.noise_floor is None:
        return f"the error is {of_range(g.before)} of range"
    return f"the error is {of_range(g.before)} of range, and {of_range(g.noise_floor)} on the model's own recordings"


def _far(d: Diagnosis) -> str:
    adding = "Adding it" if len(d.effects) == 1 else "Adding them" if d.effects else "The best candidate"
    adding = "Refitting them" if d.effects == ("parameter_change",) else adding
    before, after = of_range(d.gap.before), of_range(d.gap.after)
    return f"{adding} reduces the error on {_records_used(d)} from {before} to {after} of range."


def _records_used(d: Diagnosis) -> str:
    return "held-out recordings" if d.heldout else "the recordings it was fitted on"


def _where(d: Diagnosis) -> str:
    if d.verdict == "no_gap":
        return html.card("Where", "Nowhere", tag("p", "The remaining error is noise in every recording."))
    share = d.where["records"].get(worst(d).name, 0.0)
    loud = max(d.where["frequency"], key=lambda row: row["share"])
    big = f"{figure(loud['band_hz'][0])} to {figure(loud['band_hz'][1])} Hz"
    facts = gathers(d.where, time_spent(d), units_of(d.model))[:2]
    side = "held-out recording" if d.heldout else "recording"
    worst_line = f"Worst {side}: {worst(d).name}, {percent(share)} of the gap."
    return html.card("Where", big, tag("p", d.where["summary"]), html.bullets([*facts, worst_line]))


def _how_far(d: Diagnosis) -> str:
    g = d.gap
    floor = "not known" if g.noise_floor is None else f"{of_range(g.noise_floor)} of range"
    lines = [f"The model's own error: {floor} ({g.floor_from})."]
    lines += [f"Handed back: the model with {named(d.handed_back)}."] if d.handed_back else []
    if refitted(d):
        lines.insert(0, f"Model as given: {of_range(g.unrefitted)}; refitted without any effect: {of_range(g.before)}.")
    if g.closed_fraction is not None:
        ci = ""
        if g.ci95 and g.closed_fraction >= 0.005:
            ci = f" (95 % interval {interval(*g.ci95)})"
        lines.insert(0, f"{fraction_closed(g.closed_fraction)} of the closable gap is closed{ci}.".capitalize())
    if d.verdict == "no_gap":
        big = f"{of_range(g.before)} of range"
        lines.insert(0, "There is no gap to close.")
    else:
        big = f"{of_range(g.before)} → {of_range(g.after)}"
        lines.append(_in_units(d))
    lines.append(
        "Every recording was predicted by a fit that did not use it."
        if d.heldout
        else "Judged on left-out parts of the recordings."
    )
    return html.card("How far", big, *(tag("p", line) for line in lines))


def _in_units(d: Diagnosis) -> str:
    """Describe the error before and after in the output's own unit, rms over the held-out recordings."""
    scale, unit = output_unit(d)
    held = [t for t in d.traces if t.heldout] or d.traces
    before, after = (
        scale * np.sqrt(np.mean([np.nanmean((getattr(t, which) - t.measured) ** 2) for t in held]))
        for which in ("nominal", "augmented")
    )
    return f"In {unit}, rms: {figure(float(before), 2)} → {figure(float(after), 2)}."


def cards(d: Diagnosis) -> tuple[str, str, str]:
    """Return the cards "where", "which" and "how far" of a diagnosis as HTML."""
    return _where(d), which(d), _how_far(d)

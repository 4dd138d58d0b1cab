"""Write warnings about a target and its planned voltage, one line each, with extent and remedy.

Corners: x^(n-1) jumps by 30 % of its range in one sample. Rounding them by a Gaussian, x * g_s, costs 100 rms(x * g_s -
x) / range; the smallest width s without a remaining corner is reported with that error.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ...common.metrics import e_rms_percent
from ...common.quantity import Units
from ..model.coverage import untrained_words
from ..model.fitted import Fitted
from ..model.model import Model
from ..signal.excited import Beyond
from ..signal.target import Target
from ..simulate.prediction import outside_words
from .limits import Limits
from .motion import Motion
from .self_check import Checked, Played
from .voltage import Planned

_JUMP = 0.3  # a change of x^(n-1) in one sample by this fraction of its range is a corner
_WORTH_A_LINE = 0.01  # fraction of the target
_FAR = 0.1  # of the largest voltage: a target that starts beyond it is reported
_WIDTHS = 12  # doublings of the rounding, from one sample on


@dataclass(frozen=True)
class Steps:
    """The results of all steps of a feedforward, from the target to the checked voltage.

    Attributes:
        fitted: the given model.
        given, sampled: the target as given, and on the model's clock.
        motion, limits: with the lead-in.
        cut, best: eq. 13 clipped at the limits, and the voltage to play.
        checked: its self-check.
        outside: fraction of the target's samples outside the trained region.
        unseen: its energy at frequencies and amplitudes that the model was not trained with.
    """

    fitted: Fitted
    given: Target
    sampled: Target
    motion: Motion
    limits: Limits
    cut: Planned
    best: Played
    checked: Checked
    outside: float
    unseen: Beyond


def advice(steps: Steps) -> tuple[str, ...]:
    """Return all warnings about a target and its planned voltage, in the order of the steps."""
    motion, limits, units = steps.motion, steps.limits, steps.limits.units
    own, checked = motion.target, steps.checked
    lines = ()
    if steps.sampled is not steps.given:
        lines += (
            f"the target is sampled every {steps.given.dt:.4g} s, coarser than the model's {steps.fitted.model.dt:.4g} "
            "s, and was interpolated by a cubic spline",
        )
    lines += on_target(motion, units)
    if any(e.name == "stiffness_drift" for e in motion.model.effects):
        lines += (
            f"the stiffness drifts, so this voltage is for {motion.age:.4g} s after the start of the session (the "
            "target's clock)",
        )
    if steps.outside > _WORTH_A_LINE:
        lines += (
            f"{100 * steps.outside:.0f} % of the target lies outside the trained region: "
            f"{outside_words(motion.model, steps.cut.features[own], steps.sampled.time)}; expect larger errors there",
        )
    lines += tuple(filter(None, [untrained_words(steps.fitted, "output", steps.unseen)]))
    lines += on_start(float(steps.best.voltage[own.start]), own.start * motion.dt, limits)
    lines += on_reach(steps.cut.infeasible[own].mean(), steps.cut.voltage[own], steps.cut.saturated[own], limits)
    lines += on_stroke(motion.wanted, checked.stroke, limits)
    if np.isnan(checked.percent):
        lines += (
            "the target is constant, so there is no error in % of range; the model's motion differs from it by "
            f"{units.output.text(checked.missed, 2)}",
        )
    return lines + on_smoothing(motion, checked, units)


def roughness(wanted: np.ndarray, dt: float, model: Model) -> float:
    """Return the fraction of samples where x^(n-1) jumps by over 30 % of its range, at corners and noise."""
    # the force follows x^(n): where x^(n-1) jumps, it is an impulse that no voltage can produce
    x = wanted
    for _ in range(model.order - 1):
        x = np.diff(x) / dt
    jumps = np.abs(np.diff(x))
    return float((jumps > _JUMP * max(np.ptp(x), 1e-300)).mean())


def rounding(wanted: np.ndarray, dt: float, model: Model) -> tuple[float, float] | None:
    """Return width (s) of the narrowest Gaussian that removes all corners, and the error it adds (% of range)."""
    for width in 2.0 ** np.arange(_WIDTHS):
        if 8 * width > len(wanted):  # such a filter would return a mean, not a motion
            break
        round_ = gaussian_filter1d(wanted, width, mode="nearest")
        if roughness(round_, dt, model) == 0:
            return width * dt, e_rms_percent(round_, wanted)
    return None


def on_target(motion: Motion, units: Units) -> tuple[str, ...]:
    """Return the warnings about a target before a voltage is planned."""
    model, warnings = motion.model, ()
    if motion.dt > 1.01 * model.dt:  # 1 %: the clock of a file is rounded
        warnings += (
            f"the target is sampled every {motion.dt:g} s, coarser than the model's {model.dt:g} s: "
            "resample it to a higher rate to keep its shape between samples",
        )
    smooth = motion.displacement[motion.target]
    rough = roughness(smooth, motion.dt, model)
    if rough > 0:
        cost = rounding(smooth, motion.dt, model)
        how = "" if cost is None else f" (a Gaussian of {1e3 * cost[0]:.3g} ms changes it by {cost[1]:.2g} % of range)"
        warnings += (
            f"{100 * rough:.2g} % of the target is not smooth enough (derivative {model.order - 1} jumps): "
            f"round the corners or filter it{how}",
        )
    if not motion.slew_kept:
        warnings += (
            "the slew limit does not allow the target's initial state, so its start is cut off; let the "
            "target start at rest",
        )
    if not motion.reached:
        warnings += (
            f"no {units.input_word} within the limits moves the actuator into the target's initial state, so the "
            f"motion starts with an error; let the target start at rest, or raise {units.max_input}",
        )
    return warnings


def on_start(voltage: float, seconds: float, limits: Limits) -> tuple[str, ...]:
    """Return a warning if the target's first sample needs a voltage far from the start voltage."""
    if abs(voltage - limits.ends) <= _FAR * limits.high:
        return ()
    shown = limits.units.input
    return (
        f"the target's first sample needs {shown.text(voltage)}: a lead-in of {seconds:.3g} s from "
        f"{shown.text(limits.ends)} was added",
    )


def on_smoothing(motion: Motion, checked: Checked, units: Units) -> tuple[str, ...]:
    """Return a line on the smoothing of a target that has corners or noise."""
    if roughness(motion.displacement[motion.target], motion.dt, motion.model) == 0 or not checked.percent > 0:
        return ()
    return (
        f"the target's corners and noise are smoothed: the model's motion differs from the target by "
        f"{units.output.text(checked.missed, 2)} (rms), {checked.percent:.2g} % of its range",
    )


def on_reach(infeasible: float, voltage: np.ndarray, saturated: np.ndarray, limits: Limits) -> tuple[str, ...]:
    """Return warnings if over 1 % of the target needs a force that no voltage gives, or is clipped by a limit.

    Args:
        infeasible: fraction of the target's samples that need such a force.
        voltage: within the limits, V.
        saturated: True where it differs from the requested one.
        limits: only those that clip over 1 % of the target are named.
    """
    lines = ()
    if infeasible > _WORTH_A_LINE:
        lines += (
            f"{100 * infeasible:.0f} % of the target needs a force that no {limits.units.input_word} produces; lower "
            "its frequency or amplitude, or shift its mean in the direction in which the actuator extends",
        )
    if saturated.mean() > _WORTH_A_LINE:
        shown, near = limits.units.input, 1e-6 * (limits.high - limits.low)
        below, above = voltage <= limits.low + near, voltage >= limits.high - near
        by = {
            f"the lower limit {shown.text(limits.low)}": below,
            shown.text(limits.high): above,
            limits.slew_text: ~below & ~above,
        }
        met = [name for name, where in by.items() if (saturated & where).mean() > _WORTH_A_LINE / len(by)]
        lines += (
            f"{100 * saturated.mean():.0f} % of the target's {limits.units.input_word} is clipped by "
            f"{' and '.join(met)}; ask for a smaller motion, or raise the limit if the rig allows it",
        )
    return lines


def on_stroke(wanted: np.ndarray, reached: float, limits: Limits) -> tuple[str, ...]:
    """Return warnings if the target or the simulated motion exceeds the displacement limit."""
    if not np.isfinite(limits.farthest):
        return ()
    shown, lines = limits.units.limit, ()
    most, beyond = shown.text(limits.farthest), float((np.abs(wanted) > limits.farthest).mean())
    if beyond > 0:
        lines += (
            f"{100 * beyond:.2g} % of the target lies beyond {limits.units.max_output} {most}; the plan stays within "
            "this limit",
        )
    if reached > limits.farthest:
        lines += (
            f"the model's motion reaches {shown.text(reached)}, beyond {limits.units.max_output} {most}; ask for a "
            "slower or smaller motion",
        )
    return lines

"""Plan a feedforward: the voltage with which the model follows a target as closely as the limits allow.

    target -> motion on its clock -> lead-in within the limits -> voltage -> self-check

Each stage is a function from one value to the next, in the file of that name. The voltage rises smoothly from zero
volts (or from the voltage that holds the actuator) and returns there exactly. Every limit is kept; the part of the
target beyond them is reported.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...common.errors import BadInput, refuse_traced
from ...common.shown import Shown
from ..model.coordinate import Zero
from ..model.coverage import untrained
from ..model.fitted import Fitted, fitted_of
from ..model.model import Model
from ..model.units import units_of
from ..signal.record import Record
from ..signal.target import Target
from ..simulate.prediction import outside_fraction
from .advice import Steps, advice
from .lead_in import led_in
from .limits import Limits, limits_of
from .motion import Motion, wanted_motion
from .self_check import check
from .target import at_rate_of_model, without_rounding
from .voltage import best_voltage, equation_voltage

_SHOTS = 6  # simulations of the plan, each of which moves the reference by the last error
_MOST, _FEW = 0.5, 0.1  # fractions of a target that no voltage can reach: of the target, and of its negative


@dataclass(frozen=True, repr=False)
class Feedforward(Shown):
    """A voltage to play, with warnings and the error of the model's own simulation.

    Attributes:
        time: s, shape (M,) as all arrays here: the target's clock, with the ramps before and after it.
        voltage: V, within the limits.
        infeasible: True where the target needs a force that no voltage produces (F < 0, by eq. 13).
        saturated: True where the voltage that the model asks for exceeds a voltage or slew limit and was cut to it.
        target: True on the samples of the given target, False on the ramps before and after it.
        wanted: the given target there, base unit (m); nan on the ramps.
        outside_training_share: the larger of two fractions: of the target's samples, outside the trained region; of
            its energy, at frequencies and amplitudes that the model was not trained with.
        self_check_e_rms_percent: the model's own rollout of the voltage against the target (eq. 15); a check of the
            inversion, not a prediction of tracking. nan for a constant target: `warnings` has its error.
        equation_e_rms_percent: the same for eq. 13 clipped at the limits, before shooting.
        warnings: one line each.
        limits: the applied limits, in words.
    """

    time: np.ndarray
    voltage: np.ndarray
    infeasible: np.ndarray
    saturated: np.ndarray
    target: np.ndarray
    wanted: np.ndarray
    outside_training_share: float
    self_check_e_rms_percent: float
    equation_e_rms_percent: float
    warnings: tuple[str, ...]
    limits: str = ""


def feedforward(
    model: Model | Fitted,
    target: Target,
    *,
    max_voltage: float | None = None,
    max_slew: float | None = None,
    max_displacement: float | None = None,
    zero: Zero = "rest",
    start_input: float = 0.0,
    shots: int = _SHOTS,
    resample: bool = True,
) -> Feedforward:
    """Find the voltage with which the model follows a target displacement, as closely as the limits allow.

    Args:
        model: identified or trained.
        target: wanted displacement in base units; its clock is the session's, on which a drift depends.
        max_voltage: V; default the largest voltage of the training records. A higher value causes a warning.
        max_slew: V/s; default the largest slew of the training records.
        max_displacement: m from the displacement at 0 V in both directions, to protect the membrane; default none.
        zero: where the target is 0: "rest", at 0 V, growing as the actuator extends (the coordinate of every model;
            behind a linear input it has the sensor's sign); "sensor", the sensor's own readings; or what the target
            is at 0 V, in its base unit.
        start_input: V at the first and the last sample, which holds the actuator in place.
        shots: shooting iterations on the rollout after eq. 13; 0 uses eq. 13 alone, clipped at the limits.
        resample: interpolate a target coarser than the model's step by a cubic spline.

    Returns:
        the voltage on its own clock, the clipped samples, and the model's own tracking error.

    Raises:
        BadInput: a limit that is not positive, a start beyond it, a target of fewer samples than the model's order
            needs, or one on the side that the actuator cannot reach while its negative is reachable.

    Examples:
        >>> plan = pitp.feedforward(model, target, shots=0)
        >>> plan.self_check_e_rms_percent < 1
        True
    """
    if not isinstance(target, Target | Record):
        raise BadInput(f"a {type(target).__name__} is not a target; give pitp.Target(time, displacement)")
    refuse_traced("feedforward", "inverse", model)
    fitted, units = fitted_of(model), units_of(model)
    limits, warnings = limits_of(fitted.model, max_voltage, max_slew, max_displacement, start_input, units)
    sampled = at_rate_of_model(target, fitted.model.dt) if resample else target
    smooth = without_rounding(sampled, fitted.model.order + 3)
    wanted = wanted_motion(fitted.model, sampled, smooth, zero, start_input)
    motion = led_in(wanted, limits)
    cut = equation_voltage(motion, limits)
    if cut.infeasible[motion.target].mean() > _MOST:
        _refuse_other_side(wanted, limits, float(cut.infeasible[motion.target].mean()), zero)
    best = best_voltage(motion, limits, cut, shots)
    checked = check(motion, cut, best)
    outside = outside_fraction(motion.model, cut.features[motion.target])
    unseen = untrained(fitted, "output", motion.wanted, motion.dt)
    steps = Steps(fitted, target, sampled, motion, limits, cut, best, checked, outside, unseen)
    return _plan(steps, (*warnings, *advice(steps)))


def _plan(steps: Steps, warnings: tuple[str, ...]) -> Feedforward:
    """Build the feedforward on the target's clock, with the error of the model's own simulation."""
    motion, count = steps.motion, len(steps.best.voltage)
    first, last = motion.target.start, motion.target.stop
    inside = np.zeros(count, bool)
    inside[motion.target] = True
    ramp = np.zeros(count - last, bool)
    return Feedforward(
        time=steps.sampled.time[0] + (np.arange(count) - first) * motion.dt,
        voltage=steps.best.voltage,
        infeasible=np.append(steps.cut.infeasible, ramp),
        saturated=np.append(steps.cut.saturated, ramp),
        target=inside,
        wanted=np.concatenate([np.full(first, np.nan), steps.sampled.displacement, np.full(len(ramp), np.nan)]),
        outside_training_share=max(steps.outside, steps.unseen.fraction),
        self_check_e_rms_percent=steps.checked.percent,
        equation_e_rms_percent=steps.checked.equation_percent,
        warnings=warnings,
        limits=steps.limits.text,
    )


def _refuse_other_side(wanted: Motion, limits: Limits, fraction: float, zero: Zero) -> None:
    """Refuse a target whose negative is reachable: its sign or the sensor offset is wrong.

    Raises:
        BadInput: the negative is reachable.
    """
    negative = replace(wanted, displacement=-wanted.displacement, wanted=-wanted.wanted)
    motion = led_in(negative, limits)
    if equation_voltage(motion, limits).infeasible[motion.target].mean() < _FEW:
        other = "leave out --zero sensor if it is measured from the position at 0 V"
        if zero != "sensor":
            other = "give --zero sensor if it holds sensor readings"
        raise BadInput(
            f"{100 * fraction:.0f} % of the target lies on the side that this actuator cannot reach, but its negative "
            f"can be reached; change the sign of the target, or {other}"
        )

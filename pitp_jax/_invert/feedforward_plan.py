"""Feedforward: the voltage with which the model follows a target, by eq. 13 and shooting, or the nearest motion.

    u = inverse(target), corrected by the rollout's error   where no limit is active
    min |target - rollout(u)|^2 over the u within the limits        otherwise                  (`course`)

The voltage rises smoothly from zero volts (or from the voltage that holds the actuator) and returns there exactly.
Every limit is kept; the part of the target beyond them is reported.
"""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from .._errors import BadInput, refuse_traced
from .._model.coordinate import Zero, to_model
from .._model.coverage import target_beyond, target_words
from .._model.fitted import Fitted, fitted_of
from .._model.model import Model
from .._model.units import units_of
from .._record.reading import Target
from .._record.record import Record
from .._shown import Shown
from .._simulate.batched_rollout import fast_rollout
from .._simulate.decoder import rest_state, still_state
from .._simulate.prediction import at_rate, outside_fraction, outside_words
from .advice import on_reach, on_smoothing, on_start, on_stroke, on_target
from .course import Course
from .limits import limits_of
from .target_path import at_rate_of_model, extend, settling

_SHOTS = 6
_MOST, _FEW = 0.5, 0.1  # fractions of a target that no voltage can reach: of the target, and of its negative
_WAITS = 100_000  # samples until a machine stands still


@dataclass(frozen=True, repr=False)
class Feedforward(Shown):
    """A voltage to play, and how far it can be trusted.

    Attributes:
        time: s, shape (M,): the target's clock, with the ramps before and after it.
        voltage: V, within the limits.
        infeasible: True where the target needs a force that no voltage produces (F < 0, by eq. 13).
        saturated: True where it exceeds a voltage or slew limit.
        target: True on the target's own samples.
        wanted: the given target there; nan before and after.
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
    model = fitted.model
    limits, warnings = limits_of(model, max_voltage, max_slew, max_displacement, start_input, units)
    given = target
    if resample:
        target = at_rate_of_model(target, model.dt)
    if target is not given:
        warnings += (
            f"the target is sampled every {given.dt:.4g} s, coarser than the model's {model.dt:.4g} s, and was "
            "interpolated by a cubic spline",
        )
    model = at_rate(model, target.dt)
    wanted = np.asarray(to_model(model, target.displacement, zero))
    start, stands = standing(model, start_input, target.dt)
    path = extend(wanted, target.dt, model, limits, stands)
    warnings += on_target(model, target, wanted, path, units)
    first, last = path.target.start, path.target.stop
    # the session's clock at the first sample played, before which the actuator was at rest
    age = max(model.domain.age(target.time[0] - first * target.dt), 0.0)
    start = rest_state(model, age) if start is None else start
    if any(e.name == "stiffness_drift" for e in model.effects):
        warnings += (
            f"the stiffness drifts, so this voltage is for {age:.4g} s after the start of the session (the "
            "target's clock)",
        )
    course = Course(model, path, limits, target.dt, age, start)
    cut = course.plan(path.displacement)
    if cut.infeasible[first:last].mean() > _MOST:
        _refuse_other_side(course, -wanted, stands, float(cut.infeasible[first:last].mean()), zero)
    best = course.best(cut, shots)
    outside = outside_fraction(model, cut.features[first:last])
    if outside > 0.01:
        warnings += (
            f"{100 * outside:.0f} % of the target lies outside the trained region: "
            f"{outside_words(model, cut.features[first:last], target.time)}; expect larger errors there",
        )
    unseen = target_beyond(fitted, wanted, target.dt)
    warnings += tuple(filter(None, [target_words(fitted, unseen)]))
    inside = np.zeros(len(best.voltage), bool)
    inside[first:last] = True
    ramp = np.zeros(len(inside) - last, bool)
    infeasible, saturated = np.append(cut.infeasible, ramp), np.append(cut.saturated, ramp)
    warnings += on_start(float(best.voltage[first]), first * target.dt, limits)
    warnings += on_reach(infeasible[inside].mean(), saturated[inside].mean(), limits)
    warnings += on_stroke(wanted, float(np.abs(best.reading).max()), limits)
    error = course.error(best)
    if np.isnan(error):
        warnings += (
            f"the target is constant, so there is no error in % of range; the model's motion differs from it by "
            f"{units.output.text(course.missed(best), 2)}",
        )
    warnings += on_smoothing(model, wanted, target.dt, error, course.missed(best), units)
    return Feedforward(
        time=target.time[0] + (np.arange(len(best.voltage)) - first) * target.dt,
        voltage=best.voltage,
        infeasible=infeasible,
        saturated=saturated,
        target=inside,
        wanted=np.concatenate([np.full(first, np.nan), target.displacement, np.full(len(ramp), np.nan)]),
        outside_training_share=max(outside, unseen.fraction),
        self_check_e_rms_percent=error,
        equation_e_rms_percent=course.error(cut),
        warnings=warnings,
        limits=limits.text,
    )


def _refuse_other_side(course: Course, negative: np.ndarray, stands: float, fraction: float, zero: Zero) -> None:
    """Refuse a target whose negative is reachable: its sign or its offset is wrong.

    Raises:
        BadInput: the negative is reachable.
    """
    path = extend(negative, course.dt, course.model, course.limits, stands)
    turned = replace(course, path=path).plan(path.displacement)
    if turned.infeasible[path.target].mean() < _FEW:
        other = "leave out --zero sensor if it is measured from the position at 0 V"
        if zero != "sensor":
            other = "give --zero sensor if it holds sensor readings"
        raise BadInput(
            f"{100 * fraction:.0f} % of the target lies on the side that this actuator cannot reach, but its negative "
            f"can be reached; change the sign of the target, or {other}"
        )


def standing(model: Model, voltage: float, dt: float):
    """Return the scaled state and the displacement (m) of the model settled at a voltage; (None, 0) at 0 V."""
    if voltage == 0:
        return None, 0.0
    kind = model.coefficients.dtype
    level = float(model.input_map.force(np.asarray(voltage))) / float(model.physical_coefficients[0])
    level /= float(model.scales.state[0])
    # start at the nominal's own level; encoder and effects change it, so the model runs until it stands still
    begun = still_state(model, jnp.asarray(level, kind), jnp.asarray(voltage, kind), 0.0)
    count = int(np.clip(settling(model)[0] / dt, 64, _WAITS))
    state = fast_rollout(model, jnp.full((1, count), voltage, kind), dt, begun[None])[0, -1]
    return state, float(state[0]) * float(model.scales.state[0])

"""Feedforward: the voltage that makes the model follow a target, eq. 13 and then shooting.

    r_0 = target,   u_k = inverse(r_k) within the limits,   r_{k+1} = r_k + target - rollout(u_k)

Eq. 13 inverts the continuous equation; the decoder holds its tokens over a step, so a few iterations move the
reference until the rollout meets the target. A smooth way leads up from zero volts and back down.
"""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from .._errors import BadInput
from .._metrics import e_rms_percent, rmse
from .._model.model import Model
from .._numerics.spline_derivative import fast_derivatives
from .._record.reading import Target
from .._simulate import ports
from .._simulate.decoder import film_voltage, rest_state
from .._simulate.parallel_in_time import rollout_by_size
from .._simulate.prediction import at_rate, outside_share
from .equation import invert_path, scaled_equation
from .target_path import Path, extend, limit_slew, rough_share

_BIPOLAR = 0.1  # of the largest voltage
_SHOTS = 6
_ROUNDING = 1e-6  # of the largest force


@dataclass(frozen=True)
class Feedforward:
    """A voltage to play, and how far it can be trusted.

    Attributes:
        time: s, shape (M,): the target's clock, with the ramps before and after it.
        voltage: V, within the limits.
        infeasible: True where the model asks for a force no voltage makes (F < 0).
        saturated: True where a voltage or slew limit cut the voltage.
        target: True on the target's own samples.
        outside_training_share: share of target samples outside the trained region.
        self_check_e_rms_percent: the model's own rollout of the voltage against the target (eq. 15); a check of
            the inversion, not a prediction of tracking. nan for a target that holds one value: `warnings` says by how
            much that is missed.
        equation_e_rms_percent: the same for eq. 13 alone, before shooting.
        warnings: one line each.
    """

    time: np.ndarray
    voltage: np.ndarray
    infeasible: np.ndarray
    saturated: np.ndarray
    target: np.ndarray
    outside_training_share: float
    self_check_e_rms_percent: float
    equation_e_rms_percent: float
    warnings: tuple[str, ...]


def feedforward(
    model: Model,
    target: Target,
    *,
    max_voltage: float | None = None,
    max_slew: float | None = None,
    shots: int = _SHOTS,
) -> Feedforward:
    """The voltage that makes the model follow a target displacement.

    Args:
        model: identified or trained.
        target: wanted displacement in rig coordinates, base unit; its clock is the session's, which a drift reads.
        max_voltage: V; default the largest voltage of the training records. A higher one warns.
        max_slew: V/s; default the largest slew of the training records.
        shots: shooting iterations on the rollout after eq. 13; 0 plays eq. 13 alone.

    Raises:
        BadInput: a limit that is not positive, or a target of fewer samples than the model's order needs.
    """
    limits, warnings = _limits(model, max_voltage, max_slew)
    model = at_rate(model, target.dt)
    wanted = model.output.to_model(target.displacement)
    path = extend(wanted, target.dt, model, limits)
    warnings += _advice(model, target, wanted, path)
    first, last = path.target.start, path.target.stop
    age = max(model.provenance.age(target.time[0] - first * target.dt), 0.0)
    if any(e.name == "stiffness_drift" for e in model.effects):
        warnings += (f"the actuator drifts: this is for {age:.4g} s into its session, as the target's clock says",)
    best = _shoot(model, path, limits, target.dt, shots, age)
    voltage, saturated = best.voltage, best.saturated
    infeasible = np.append(_infeasible(model, best.force, target.dt), np.zeros(len(voltage) - len(best.force), bool))
    share = outside_share(model, best.features[first:last])
    if share > 0.01:
        warnings += (
            f"{100 * share:.0f} % of the target lies outside the region the model was trained in: "
            "expect more error there",
        )
    inside = np.zeros(len(voltage), bool)
    inside[first:last] = True
    warnings += _out_of_reach(infeasible[inside].mean(), saturated[inside].mean(), limits)
    if np.isnan(best.error):
        warnings += (
            f"the target holds one value, eq. 15 has no range: the model's rollout is {best.left:.2g} m off it",
        )
    return Feedforward(
        time=target.time[0] + (np.arange(len(voltage)) - first) * target.dt,
        voltage=voltage,
        infeasible=infeasible,
        saturated=saturated,
        target=inside,
        outside_training_share=share,
        self_check_e_rms_percent=best.error,
        equation_e_rms_percent=best.equation_error,
        warnings=warnings,
    )


def _infeasible(model: Model, force: np.ndarray, dt: float) -> np.ndarray:
    """Where no voltage makes this scaled force, or no effect of the drive lets it pass."""
    # an actuator at rest asks for a force of zero, give or take a bit
    slack = _ROUNDING * np.abs(force[np.isfinite(force)]).max(initial=0.0)
    never = np.asarray(model.input_map.infeasible(jnp.asarray(force + slack)))
    if model.effects:
        film = film_voltage(model, jnp.asarray(force))
        never = never | np.asarray(ports.beyond(model, film, dt))
    return never


@dataclass(frozen=True)
class Limits:
    """Voltage range (V) and slew (V/s) a feedforward must keep."""

    low: float
    high: float
    slew: float


def _limits(model: Model, max_voltage, max_slew) -> tuple[Limits, tuple[str, ...]]:
    low, high = model.provenance.voltage_range
    warnings: tuple[str, ...] = ()
    if bool(model.input_map.infeasible(jnp.asarray(-1.0))):  # squared: what was played below zero counts as well
        if high <= 0 > low:
            warnings += (
                "trained on negative voltages alone, this one is positive: play its negative, the square is the same",
            )
        low, high = 0.0, max(high, -low)
    trained_high, trained_slew = high, model.provenance.slew
    for name, value in (("max-voltage", max_voltage), ("max-slew", max_slew)):
        if value is not None and not value > 0:
            raise BadInput(f"--{name} must be positive, got {value}")
    if max_voltage == np.inf:
        raise BadInput("--max-voltage must be finite: give the amplifier's limit")
    if max_voltage is not None:
        bipolar = -low > _BIPOLAR * high  # beyond the noise of a reading of zero volts
        high, low = max_voltage, -max_voltage if bipolar else max(low, -max_voltage)
        if max_voltage > 1.0001 * trained_high:
            warnings += (f"--max-voltage {max_voltage:g} V is above the {trained_high:g} V the model was trained on",)
    return Limits(min(low, 0.0), max(high, 0.0), trained_slew if max_slew is None else max_slew), warnings


def _advice(model: Model, target: Target, wanted: np.ndarray, path: Path) -> tuple[str, ...]:
    warnings = ()
    if target.dt > 1.01 * model.provenance.dt:
        warnings += (
            f"the target is sampled every {target.dt:g} s, coarser than the model's {model.provenance.dt:g} s: "
            "resample it finer to keep its shape between samples",
        )
    rough = rough_share(wanted, target.dt, model)
    if rough > 0:
        warnings += (
            f"{100 * rough:.2g} % of the target is not smooth enough (derivative {model.order - 1} jumps): "
            "round the corners or filter it",
        )
    if not path.slew_kept:
        warnings += ("the target's first state is out of reach within the slew limit, its start is cut: begin at rest",)
    if not path.reached:
        warnings += (
            "no voltage within the limits swings the actuator into the target's first state: "
            "it begins with an error; let it start at rest, or raise --max-voltage",
        )
    return warnings


def _out_of_reach(infeasible: float, saturated: float, limits: Limits) -> tuple[str, ...]:
    """A line each where more than a hundredth of the target is not played as asked."""
    lines = ()
    if infeasible > 0.01:
        lines += (
            f"{100 * infeasible:.0f} % of the target needs negative force, or more than the drive passes: "
            "raise its mean, lower its frequency or ask for less",
        )
    if saturated > 0.01:
        lines += (
            f"{100 * saturated:.0f} % of the target's voltage is cut, by {_span(limits)} or {limits.slew:.3g} V/s: "
            "ask for less, or raise the limit if the rig allows it",
        )
    return lines


def _span(limits: Limits) -> str:
    """The range in words; from zero volts on only its end."""
    return f"{limits.high:g} V" if limits.low == 0 else f"{limits.low:g} to {limits.high:g} V"


@dataclass(frozen=True)
class _Shot:
    """One pass: the voltage with its ramp down, the plan (force, features) up to the target's end, and what it leaves.

    `left`: rmse of the rollout on the target's own samples, m; `error`: the same by eq. 15, nan without a range.
    """

    voltage: np.ndarray
    saturated: np.ndarray
    force: np.ndarray
    features: np.ndarray
    left: float
    error: float
    equation_error: float


def _shoot(model: Model, path: Path, limits: Limits, dt: float, shots: int, age: float) -> _Shot:
    """Eq. 13, then move the reference by what the rollout missed, as long as that helps."""
    scale = model.scales.state[0]
    dtype = model.coefficients.dtype
    wanted = path.displacement
    reference, best = wanted.copy(), None
    for _ in range(max(shots, 0) + 1):
        motion = reference
        if model.effects:
            motion = np.asarray(ports.moves(model, jnp.asarray(reference / scale), dt), np.float64) * scale
        equation = scaled_equation(model, fast_derivatives(motion, dt, model.order))
        force, voltage, features = invert_path(model, equation, dt, jnp.asarray(age, dtype))
        u, saturated = limit_slew(np.asarray(voltage, np.float64), limits, dt)
        states = rollout_by_size(model, jnp.asarray(u[None], dtype), dt, rest_state(model, age)[None])[0]
        x = np.asarray(ports.readings(model, states), np.float64) * scale
        left = rmse(x[path.target], wanted[path.target])
        if best is not None and not left < best.left:
            break
        error = e_rms_percent(x[path.target], wanted[path.target])
        first = error if best is None else best.equation_error
        best = _Shot(u, saturated, np.asarray(force), np.asarray(features), left, error, first)
        missed = np.where(saturated | ~np.isfinite(x), 0.0, wanted - x)
        reference = reference + missed
    assert best is not None  # the first pass always sets it
    tail, cut = path.ramp_down(best.voltage[-1], limits, dt)
    return replace(best, voltage=np.append(best.voltage, tail), saturated=np.append(best.saturated, cut))

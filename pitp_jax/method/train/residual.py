"""Compute the equation's residual along a recording, and the training loss, as pure functions (paper, eq. 12).

    r = sigma_off + sum_i sigma_i X_i - F / F_max        X, F: displacement and force, both low-passed with zero phase
    L = mean w Huber(r) + mean penalty                   w: as `dataset.spread_weights`, 0 where the filter settles

The filter is the Butterworth filter of `preprocess`, of order 4, run forward and backward, as a product of spectra:

    |H(f)|^2 = 1 / (1 + (tan(pi f dt) / tan(pi f_c dt))^8),   f_c = min(2 f_max, 0.4 / dt),   99 % of |F|^2 below f_max
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..model.coordinate import Zero
from ..model.fitted import Fitted, model_of
from ..model.model import Model
from ..model.programs import jit, signal
from ..signal.preprocess import BUTTERWORTH_ORDER, ENERGY_FRACTION, SETTLING
from ..simulate import ports
from ..simulate.along import equation_of, features_of, motion_along
from ..simulate.decoder import scaled_force
from .dataset import spread_weights
from .equation_error import balance
from .settings import PRESETS


def residual(
    model: Model | Fitted,
    voltage: Float[np.ndarray | Array, " time"],
    displacement: Float[np.ndarray | Array, " time"],
    *,
    cutoff_hz: float | None = None,
    zero: Zero = "rest",
) -> Float[Array, " time"]:
    """Compute the residual of the equation of motion along a recording, divided by the model's unit of force.

    Memories and the states of effects follow the measured motion. Both ends, where the filter has not settled, count
    in `residual_loss` with weight 0.

    Args:
        model: any.
        voltage: shape (time,), V, at the model's own sampling interval.
        displacement: shape (time,), m, without missing values: 0 at 0 V, growing as the actuator extends (behind a
            linear input with the sensor's sign).
        cutoff_hz: cut-off of the low-pass filter; None is the training's: twice the band of the force.
        zero: where the displacement is 0: "rest", at 0 V; "sensor", the sensor's own readings; or its value at 0 V.

    Returns:
        residual, shape (time,): the force that the motion requires minus that of the voltage.

    Examples:
        >>> u = 500.0 * (1 - jnp.cos(jnp.linspace(0.0, 12.0, 400)))
        >>> r = pitp.residual(model, u, pitp.free_run(model, u))
        >>> bool(jnp.abs(r[100:-100]).max() < 0.02)
        True
    """
    model = model_of(model)
    u, x = signal(model, voltage, "voltage"), signal(model, displacement, "displacement")
    return _measured(model, u, x, model.dt, cutoff_hz, zero)[0]


def residual_loss(
    model: Model | Fitted,
    voltage: Float[np.ndarray | Array, " time"],
    displacement: Float[np.ndarray | Array, " time"],
    *,
    box: tuple[float, float] = (-jnp.inf, jnp.inf),
    width: float = PRESETS["default"].huber,
    penalty: tuple[float, float] = PRESETS["default"].penalty,
    cutoff_hz: float | None = None,
    zero: Zero = "rest",
) -> Float[Array, ""]:
    """Compute the training loss over a recording: Huber loss plus penalties outside the box (eq. 12).

    Args:
        model, voltage, displacement, cutoff_hz, zero: as of `residual`.
        box: lowest and highest factor on the nominal tokens without a penalty; default no penalty.
        width: of Huber's quadratic part, in units of the model's force.
        penalty: alpha and beta, the costs of a unit above and below the box.

    Returns:
        the loss, a scalar.

    Examples:
        >>> u = 500.0 * (1 - jnp.cos(jnp.linspace(0.0, 12.0, 400)))
        >>> x = pitp.free_run(model, u)
        >>> bool(pitp.residual_loss(model, u, x) < pitp.residual_loss(model, u, 1.1 * x))
        True
    """
    model = model_of(model)
    u, x = signal(model, voltage, "voltage"), signal(model, displacement, "displacement")
    return _loss(model, u, x, model.dt, cutoff_hz, zero, box, width, penalty)


@jit
def _loss(model: Model, voltage, displacement, dt, cutoff_hz, zero: Zero, box, width, penalty) -> Float[Array, ""]:
    difference, tokens, equation, valid = _measured(model, voltage, displacement, dt, cutoff_hz, zero)
    weight = jnp.where(valid, spread_weights(equation[:, :-1], valid=valid, xp=jnp), 0.0)
    return balance(model, difference, tokens, weight, box, width=width, penalty=penalty)[0]


@jit
def _measured(model: Model, voltage, displacement, dt, cutoff_hz, zero: Zero):
    """Compute residual, coefficients, scaled [x, ..., x^(n)], and True where the filter has settled."""
    dtype = model.coefficients.dtype
    x = motion_along(model, displacement, dt, zero)
    force = scaled_force(model, ports.filmed(model, voltage, dt, voltage[0] == 0)).astype(dtype)
    cutoff = _cutoff(force, dt) if cutoff_hz is None else jnp.asarray(cutoff_hz, dtype)
    equation = equation_of(model, _low_passed(x, cutoff, dt), dt)
    features = features_of(model, equation, dt)
    tokens, _ = model.tokens_from(model.encoder.over()(list(features.T)))
    needed = ports.required(model, equation, features, dt)
    edge, at = SETTLING / (2 * jnp.pi * cutoff * dt), jnp.arange(len(x))
    valid = (at >= edge) & (at < len(x) - edge)
    return needed - _low_passed(force, cutoff, dt), tokens, equation, valid


def _cutoff(force: Float[Array, " time"], dt) -> Float[Array, ""]:
    """Compute the cut-off frequency of the training's low-pass filter for a force, Hz."""
    energy = jnp.abs(jnp.fft.rfft(force - force.mean())) ** 2
    below = jnp.cumsum(energy) / jnp.maximum(energy.sum(), jnp.finfo(force.dtype).tiny)
    first = jnp.maximum(jnp.argmax(below >= ENERGY_FRACTION), 1)
    return jax.lax.stop_gradient(jnp.minimum(2.0 * first / (len(force) * dt), 0.4 / dt).astype(force.dtype))


def _low_passed(values: Float[Array, " time"], cutoff: Float[Array, ""], dt) -> Float[Array, " time"]:
    """Filter a series with zero phase; before and after it, its point reflections are appended."""
    count = len(values)
    before, after = 2 * values[0] - values[:0:-1], 2 * values[-1] - values[-2::-1]
    spectrum = jnp.fft.rfft(jnp.concatenate([before, values, after]))
    angle = jnp.pi * jnp.arange(len(spectrum), dtype=values.dtype) / (3 * count - 2)
    ratio = jnp.tan(jnp.minimum(angle, 1.57)) / jnp.tan(jnp.pi * cutoff * dt)
    passes = 1 / (1 + ratio ** (2 * BUTTERWORTH_ORDER))
    return jnp.fft.irfft(spectrum * passes, 3 * count - 2)[count - 1 : 2 * count - 1]

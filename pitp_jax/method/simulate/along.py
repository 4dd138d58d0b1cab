"""Evaluate a model along a given motion: its derivatives, memories and coefficients (tokens).

X_i = x^(i) / scale_i,   m = memory(x),   sigma = tokens(S, m)        x by the coordinate of `method.model.coordinate`

Each signal is one recording; the caller vmaps.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..model.coordinate import Zero, sign, to_model
from ..model.fitted import Fitted, model_of
from ..model.memory import ElapsedTime
from ..model.model import Model
from ..model.programs import jit, signal
from ..numerics.path_derivative import path_derivatives
from . import ports


def motion_along(model: Model, displacement: Float[Array, " time"], dt, zero: Zero) -> Float[Array, " time"]:
    """Compute the scaled displacement x of a reading or displacement (m), without the effects of the sensor."""
    x = (to_model(model, displacement, zero) / model.scales.state[0]).astype(displacement.dtype)
    return ports.moves(model, x, dt) if model.effects else x


def equation_of(model: Model, x: Float[Array, " time"], dt) -> Float[Array, "time tokens"]:
    """Compute the scaled derivatives [x, ..., x^(n)] of a scaled displacement x, shape (time, n + 1)."""
    steps = jnp.asarray(model.scales.rates, x.dtype) * dt
    units = jnp.concatenate([jnp.ones(1, x.dtype), jnp.cumprod(1 / steps)])  # a power of dt alone would underflow
    return path_derivatives(x, model.order) * units.astype(x.dtype)


def features_of(model: Model, equation: Float[Array, "time tokens"], dt) -> Float[Array, "time features"]:
    """Compute the encoder's features from scaled [x, ..., x^(n)]; before the start x was constant at x(0)."""
    x = equation[:, 0]
    return jnp.concatenate([equation[:, :-1], model.memory.trajectory(x, dt, model.memory.initial(x[0]))], -1)


def memory_along(
    model: Model | Fitted, displacement: Float[np.ndarray | Array, " time"], *, zero: Zero = "rest"
) -> Float[Array, "time memory"]:
    """Compute the model's memory states along a displacement (m), shape (time, memories).

    Args:
        model: any.
        displacement: shape (time,), m, without missing values; held at its first value before.
        zero: where the displacement is 0: "rest", at 0 V; "sensor", the sensor's own readings; or its value at 0 V.

    Returns:
        one column per memory, m (the elapsed time of the paper's preset: s).

    Examples:
        >>> pitp.memory_along(model, jnp.zeros(64)).shape
        (64, 0)
    """
    model = model_of(model)
    return _memory_along(model, signal(model, displacement, "displacement"), model.dt, zero)


@jit
def _memory_along(model: Model, displacement: Float[Array, " time"], dt, zero: Zero) -> Float[Array, "time memory"]:
    x = motion_along(model, displacement, dt, zero)
    memory = model.memory.trajectory(x, dt, model.memory.initial(x[0]))
    memories = model.memory
    unit = memories.horizon if isinstance(memories, ElapsedTime) else sign(model) * model.scales.state[0]
    return (memory * unit).astype(x.dtype)


def tokens_along(
    model: Model | Fitted, displacement: Float[np.ndarray | Array, " time"], *, zero: Zero = "rest"
) -> Float[Array, "time tokens"]:
    """Compute the coefficients sigma_0 ... sigma_n along a displacement (m), shape (time, n + 1).

    Args:
        model: any; effects are not part of the tokens.
        displacement: shape (time,), m, without missing values and without noise: it is differentiated.
        zero: where the displacement is 0: "rest", at 0 V; "sensor", the sensor's own readings; or its value at 0 V.

    Returns:
        tokens in the units of the coefficients, V^2 s^i / m (behind a linear input V s^i / m).

    Examples:
        >>> tokens = pitp.tokens_along(model, jnp.linspace(0.0, 1e-3, 64))
        >>> bool(jnp.allclose(tokens, model.physical_coefficients, rtol=1e-5))
        True
    """
    model = model_of(model)
    return _tokens_along(model, signal(model, displacement, "displacement"), model.dt, zero)


@jit
def _tokens_along(model: Model, displacement: Float[Array, " time"], dt, zero: Zero) -> Float[Array, "time tokens"]:
    features = features_of(model, equation_of(model, motion_along(model, displacement, dt, zero), dt), dt)
    tokens, _ = model.tokens_from(model.encoder.over()(list(features.T)))
    units = model.scales.force / jnp.asarray(model.scales.state, features.dtype)
    return (jnp.stack(tokens, -1) * units).astype(features.dtype)

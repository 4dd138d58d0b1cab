"""Simulate a model under a voltage, as a pure function of one recording for tracing, gradients and batches.

y = s scale_0 reading(rollout(u)),    s: sign of the displacement's coordinate (`method.model.coordinate`)

Each signal is one recording; the caller vmaps.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..model.coordinate import from_model
from ..model.fitted import Fitted, model_of
from ..model.model import Model
from ..model.programs import jit, signal
from . import ports
from .batched_rollout import fast_rollout
from .decoder import rest_state


def free_run(
    model: Model | Fitted,
    voltage: Float[np.ndarray | Array, " time"],
    state: Float[np.ndarray | Array, " state"] | None = None,
) -> Float[Array, " time"]:
    """Compute the displacement (m) under a voltage (V), sampled at the model's own sampling interval.

    Args:
        model: any: identified, trained, with effects.
        voltage: shape (time,), V.
        state: initial state, scaled, shape (n + K,) with K numbers of memories and effects, as `rest_state` returns it;
            None starts at rest at 0 V.

    Returns:
        displacement, shape (time,), m (SI unit of the model's recordings): 0 at 0 V, growing as the actuator extends
        (behind a linear input with the sensor's sign). Not finite from where the run diverges.

    Raises:
        BadInput: a voltage that is not one series of numbers.

    Examples:
        >>> x = pitp.free_run(model, 1000.0 * jnp.ones(200))
        >>> slope = jax.grad(lambda u: pitp.free_run(model, u)[-1])(1000.0 * jnp.ones(200))
        >>> x.shape, slope.shape
        ((200,), (200,))
    """
    model = model_of(model)
    return _free_run(model, signal(model, voltage, "voltage"), model.dt, state)


@jit
def _free_run(model: Model, voltage: Float[Array, " time"], dt, state) -> Float[Array, " time"]:
    dtype = model.coefficients.dtype
    start = rest_state(model) if state is None else jnp.asarray(state, dtype)
    readings = ports.readings(model, fast_rollout(model, voltage[None], dt, start[None])[0])
    return from_model(model, readings * model.scales.state[0]).astype(dtype)

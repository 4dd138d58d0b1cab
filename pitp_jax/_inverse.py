"""Inverse: the drive voltage along a motion (paper, eq. 13).

    F(t) = sigma_off + sum_i sigma_i(S, m) x^(i),    V = sqrt(max(F, 0)),    u = V + tau V'   (a map over instants)

Memories follow x alone, so they are known along a motion. The closed form inverts the continuous equation; for
consecutive states of the decoder see `discrete_inverse`, for a voltage to play `feedforward`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._model import augment
from ._model.model import Model
from ._residual import equation_force

_HUGE = 1e3  # of the training force: what stands for a force no field makes


def equation_inverse(
    model: Model, equation: Float[Array, "time tokens"], memory: Float[Array, "time memory"]
) -> Float[Array, " time"]:
    """Eq. 13 before the root: the scaled force each instant needs, from scaled [x, ..., x^(n)] and memories."""
    features = jnp.concatenate([equation[:, :-1], memory], -1)
    return jax.vmap(lambda f, x: equation_force(model, f, x)[0])(features, equation)


@eqx.filter_jit
def invert_path(model: Model, equation: Float[Array, "time tokens"], dt: float, age: float | Float[Array, ""] = 0.0):
    """Scaled force, voltage before limits (V) and features along a path that starts at rest; vmap for a batch.

    `age`: of the session at its first sample, s, which effects of the slow time read.
    """
    start = model.memory.initial(jnp.zeros((), equation.dtype))
    memory = model.memory.trajectory(equation[:, 0], dt, start)
    features = jnp.concatenate([equation[:, :-1], memory], -1)
    if model.effects:
        force = augment.required(model, equation, features, dt, age)
        force = jnp.where(jnp.isnan(force), jnp.inf, force)  # beyond what saturates: without end, to its own side
    else:
        force = equation_inverse(model, equation, memory)
    film = model.input_map.voltage(jnp.clip(force, -_HUGE, _HUGE) * model.scales.force)
    return force, augment.played(model, film, dt), features

"""Eq. 13 along a path at the speed of its arithmetic: rows instead of instants, filters instead of one long spline.

    F(t) = sigma_off + sum_i sigma_i(S, m) x^(i),    V = map^-1(F),    u = drive^-1(V)

The numbers of `_inverse.invert_path` to rounding. 120,000 samples at order 2 with five memories on two shared cores:
network and inverse 3 ms instead of 8-24, from displacement 9 instead of 80-100.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._inverse import invert_path
from ._model.model import Model
from ._model.rows import force_rows
from ._spline_filter import fast_derivatives


@eqx.filter_jit
def force_and_voltage(
    model: Model, equation: Float[Array, "time tokens"], dt: float, start: Float[Array, " memory"]
) -> tuple[Float[Array, " time"], Float[Array, " time"], Float[Array, "time memory"]]:
    """Scaled force, drive voltage before limits (V) and memories along scaled [x, ..., x^(n)].

    Args:
        model: without effects.
        equation: one row per sample.
        dt: sampling interval, s.
        start: the memories at the first sample.
    """
    memory = model.memory.trajectory(equation[:, 0], dt, start)
    rows = list(equation.T)
    force = force_rows(model, [*rows[:-1], *memory.T], rows)
    film = model.input_map.voltage(force * model.scales.force)
    return force, model.drive.lead(film, dt), memory


@eqx.filter_jit
def invert_along(model: Model, equation: Float[Array, "time tokens"], dt: float, age: float | Float[Array, ""] = 0.0):
    """Scaled force, voltage before limits (V) and features along a path that starts at rest, as `invert_path`."""
    if model.effects:
        return invert_path(model, equation, dt, age)
    start = model.memory.initial(jnp.zeros((), equation.dtype))
    force, voltage, memory = force_and_voltage(model, equation, dt, start)
    return force, voltage, jnp.concatenate([equation[:, :-1], memory], -1)


def invert_displacement(model: Model, displacement: Float[np.ndarray, " time"], dt: float) -> Float[Array, " time"]:
    """Drive voltage before limits (V) for a displacement from rest (model coordinates, m): eq. 13, end to end."""
    equation = scaled_equation(model, fast_derivatives(displacement, dt, model.order))
    return invert_along(model, equation, dt)[1]


def scaled_equation(model: Model, derivatives: Float[np.ndarray, "time tokens"]) -> Float[Array, "time tokens"]:
    """[x, ..., x^(n)] in the model's units and precision."""
    return jnp.asarray(derivatives / np.asarray(model.scales.state), model.coefficients.dtype)

"""Invert the equation of motion: compute the voltage for a wanted motion (paper, eq. 13).

    F(t) = sigma_off + sum_i sigma_i(S, m) x^(i),    V = sqrt(max(F, 0)),    u = drive^-1(V)   (e.g. V + tau V')

Memories follow x alone, so they are known along a motion. The closed form inverts the continuous equation; for
consecutive states of the decoder see `discrete`, for a voltage to play `feedforward_plan`. Every quantity is an array
over time (`method.model.rows`), not a function of one instant mapped over them.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..model.equation import equation_force
from ..model.model import Model
from ..model.programs import jit
from ..simulate import ports
from ..simulate.decoder import film_voltage

_ROUNDING = 1e-6  # of the model's unit of force
HUGE = 1e3  # of the training force: replaces an infeasible force


def force_along(model: Model, equation: Float[Array, "time tokens"], memory: Float[Array, "time memory"]):
    """Compute the scaled force that a motion needs, from scaled [x, ..., x^(n)] and memories at each instant."""
    rows = list(equation.T)
    return equation_force(model, model.encoder.over()([*rows[:-1], *memory.T]), rows)[0]


@jit
def force_and_voltage(
    model: Model, equation: Float[Array, "time tokens"], dt: float, start: Float[Array, " memory"]
) -> tuple[Float[Array, " time"], Float[Array, " time"], Float[Array, "time memory"]]:
    """Compute scaled force, voltage before limits (V) and memories for a wanted motion, scaled [x, ..., x^(n)].

    Args:
        model: without effects.
        equation: one row per sample.
        dt: sampling interval, s.
        start: the memories at the first sample.
    """
    memory = model.memory.trajectory(equation[:, 0], dt, start)
    force = force_along(model, equation, memory)
    return force, model.drive.lead(film_voltage(model, force), dt), memory


@jit
def invert_path(model: Model, equation: Float[Array, "time tokens"], dt: float, age: float | Float[Array, ""] = 0.0):
    """Compute scaled force, voltage before limits (V) and features for a wanted motion that starts at rest.

    `age`: of the session at its first sample, s, for effects that depend on it.
    """
    start = model.memory.initial(jnp.zeros((), equation.dtype))
    if not model.effects:
        force, voltage, memory = force_and_voltage(model, equation, dt, start)
        return force, voltage, jnp.concatenate([equation[:, :-1], memory], -1)
    features = jnp.concatenate([equation[:, :-1], model.memory.trajectory(equation[:, 0], dt, start)], -1)
    force = ports.required(model, equation, features, dt, age)
    force = jnp.where(jnp.isnan(force), jnp.inf, force)  # a force beyond saturation is infinite, with its own sign
    film = film_voltage(model, jnp.clip(force, -HUGE, HUGE))
    return force, ports.played(model, film, dt), features


def tolerance(model: Model) -> Float[Array, ""]:
    """Return the scaled force that moves the settled actuator by the sensor's noise; below it no force is missed."""
    return jnp.maximum(model.coefficients[0] * (model.domain.noise / model.scales.state[0]), _ROUNDING)


@jit
def unreachable(model: Model, force: Float[Array, " time"], dt: float) -> Bool[Array, " time"]:
    """Return True where no voltage gives this scaled force, or where an effect on the voltage excludes it."""
    never = model.input_map.infeasible(force + tolerance(model))
    return never | ports.beyond(model, film_voltage(model, force), dt) if model.effects else never


def scaled_equation(model: Model, derivatives: Float[np.ndarray, "time tokens"]) -> Float[Array, "time tokens"]:
    """Convert the derivatives [x, ..., x^(n)] (m/s^i) to the model's scaled units and precision."""
    return jnp.asarray(derivatives / model.scales.state, model.coefficients.dtype)

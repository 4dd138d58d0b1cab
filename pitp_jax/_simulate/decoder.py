"""Decoder: the model rolled out from a voltage (paper, eq. 7).

    tokens frozen over a step of size h:   x^(n) = (F - sigma_off - sum_{i<n} sigma_i x^(i)) / sigma_n,   RK4
    read where the state drifts to by h/2: x^(i) + h/2 x^(i+1) for i < n-1, memories likewise, x^(n-1) as it is

The voltage between samples is squared inside every stage (`_numerics.intersample`): on a healthy roll record zoh left
three times the noise floor of foh. With frozen tokens a step is affine in the forces of its stages. Order 4
for constant tokens. Tokens read at a step's beginning (the paper) make a hard spring pump energy, explicit Euler's
w^2 h^2 / 2 a step: an encoder fitted to the equation error of the roll diverged. Half a step on costs nothing and is
order 2 against the continuous-token ODE, but for what depends on x^(n-1) (order 1).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._effects.base import Instant
from .._model.model import Model
from .._model.programs import jit
from .._numerics.intersample import between
from . import ports

UNROLLED = 4  # substeps written out one by one; 50 of them took minutes to compile


def scaled_force(model: Model, voltage: Float[Array, "..."]) -> Float[Array, "..."]:
    """Force over force_scale."""
    return model.input_map.force(voltage) / jnp.asarray(model.scales.force, voltage.dtype)


def film_voltage(model: Model, force: Float[Array, "..."]) -> Float[Array, "..."]:
    """The film voltage (V) behind a scaled force."""
    return model.input_map.voltage(force * jnp.asarray(model.scales.force, force.dtype))


def stage_voltages(model: Model, film: Float[Array, " time"]) -> Float[Array, "time stages"]:
    """Film voltage at the beginning, middle and end of every substep of every sample: 2 substeps + 1 stages."""
    return between(film, model.hold, np.arange(2 * model.substeps + 1) / (2 * model.substeps), jnp)


def increment(
    model: Model, state: Float[Array, " state"], logits: Float[Array, " logits"], forces: tuple, h: float
) -> Float[Array, " state"]:
    """What one RK4 step of length h (s) adds under these logits; `state` is S then memory, scaled."""
    return _runge_kutta(model, state, *model.tokens_from(logits), forces, h)


def _runge_kutta(model: Model, state, tokens, offset, forces: tuple, h: float):
    """What one RK4 step of length h (s) adds under these tokens; `state` is S then memory, scaled."""
    n = model.order
    rates = jnp.asarray(model.scales.rates, state.dtype)
    first, middle, last = forces

    def slope(s, force):
        highest = (force - offset - tokens[:n] @ s[:n]) / tokens[n]
        memory = model.memory.rate(s[n:], s[0])
        return jnp.concatenate([rates * jnp.append(s[1:n], highest), memory])

    k1 = slope(state, first)
    k2 = slope(state + h / 2 * k1, middle)
    k3 = slope(state + h / 2 * k2, middle)
    k4 = slope(state + h * k3, last)
    return h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def midpoint(model: Model, state: Float[Array, " state"], h: float) -> Float[Array, " state"]:
    """What is known of the state half a step on, whatever the force: all but x^(n-1) has drifted."""
    n = model.order
    rates = jnp.asarray(model.scales.rates, state.dtype)
    still = jnp.zeros((1,), state.dtype)
    return state + h / 2 * jnp.concatenate([rates[: n - 1] * state[1:n], still, model.memory.rate(state[n:], state[0])])


def frozen_increment(model: Model, state: Float[Array, " state"], forces: tuple, h: float) -> Float[Array, " state"]:
    """What one step adds, tokens read at the drifted midpoint."""
    return increment(model, state, model.encoder(midpoint(model, state, h)), forces, h)


def step(model: Model, state: Float[Array, " state"], stages: Float[Array, " stages"], dt: float):
    """Advance one sample along its stage voltages: `substeps` RK4 steps, tokens read anew at each."""
    h, count = dt / model.substeps, model.substeps
    if count > UNROLLED:
        threes = stages[2 * np.arange(count)[:, None] + np.arange(3)]
        return jax.lax.scan(lambda s, volts: (substep(model, s, volts, h), None), state, threes)[0]
    for k in range(count):
        state = substep(model, state, stages[2 * k : 2 * k + 3], h)
    return state


def substep(model: Model, state: Float[Array, " state"], volts: Float[Array, "3"], h: float, logits=None):
    """One RK4 step of length h (s) along three stage voltages, under the encoder's logits or others.

    Every effect's force is frozen beside the tokens, and its states are moved on after the step.
    """
    size = model.order + model.memory.size
    core, seen = state[:size], midpoint(model, state[:size], h)
    logits = model.encoder(seen) if logits is None else logits
    if not model.effects:
        return core + increment(model, core, logits, tuple(scaled_force(model, volts)), h)
    films, parts = ports.films(model, ports.split(model, state[size:]), tuple(volts), h)
    forces = ports.coupled(model, tuple(scaled_force(model, v) for v in films), seen[0])
    now = Instant(seen[: model.order], model.coefficients, jnp.asarray(model.scales.rates, state.dtype), forces[1], h)
    tokens, offset = ports.acted(model, parts, now, *model.tokens_from(logits))
    after = core + _runge_kutta(model, core, tokens, offset, forces, h)
    return jnp.concatenate([after, *ports.moved(model, parts, core[0], after[0], h)])


def rest_state(model: Model, age: float | Float[Array, ""] = 0.0) -> Float[Array, " state"]:
    """The scaled state of an actuator that has been at rest for ever, at an age of the session in s."""
    zero = jnp.zeros((), model.coefficients.dtype)
    return settled_state(model, jnp.zeros(model.order, zero.dtype), zero, zero, age)


def settled_state(model: Model, state: Float[Array, " order"], level, voltage, age) -> Float[Array, " state"]:
    """S, with memory and effects as after a long time at scaled displacement `level` under a voltage."""
    return jnp.concatenate([state, model.memory.initial(level), ports.initial(model, level, voltage, age)])


def rollout(
    model: Model, voltage: Float[Array, " time"], dt: float, start: Float[Array, " state"]
) -> Float[Array, "time state"]:
    """Scaled states at every sample under a drive voltage u, row 0 = `start`; for one record, vmap for more.

    A start at x = 0 without motion is rest: the film is uncharged. Any other start has it settled at u(0).
    """
    rest, voltage = ~jnp.any(start[: model.order]), jnp.asarray(voltage, start.dtype)
    dt = float(dt) if isinstance(dt, np.generic) else dt  # a float64 of numpy's would make one of everything
    voltage = model.drive.film(ports.delayed(model, voltage, dt, rest), dt, rest)

    def advance(state, stages):
        return step(model, state, stages, dt), state

    return jax.lax.scan(advance, start, stage_voltages(model, voltage))[1]


@jit
def rollout_batch(
    model: Model, voltage: Float[Array, "records time"], dt: float, start: Float[Array, "records state"]
) -> Float[Array, "records time state"]:
    """The same for records side by side, compiled."""
    return eqx.filter_vmap(rollout, in_axes=(None, 0, None, 0))(model, voltage, dt, start)

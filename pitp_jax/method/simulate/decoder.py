"""Simulate a model under a voltage by Runge-Kutta steps (the paper's decoder, eq. 7).

    tokens frozen over a step of size h:   x^(n) = (F - sigma_off - sum_{i<n} sigma_i x^(i)) / sigma_n,   RK4
    tokens read at the state drifted by h/2: x^(i) + h/2 x^(i+1) for i < n-1, memories likewise, x^(n-1) as it is

The voltage between samples is squared inside every stage (`numerics.intersample`). With frozen tokens a step is affine
in the forces of its stages. Order 4 for constant tokens. Tokens read at a step's beginning (the paper) add energy to a
hard spring, w^2 h^2 / 2 a step as in explicit Euler. Reading them half a step later costs nothing and has order 2 for
the continuous-token ODE, except for the dependence on x^(n-1) (order 1). Figures: docs/decisions/decoder.md.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..effects.effect import Instant
from ..model.fitted import Fitted, model_of
from ..model.model import Model
from ..model.programs import jit
from ..model.rows import Rows
from ..numerics.intersample import between
from . import ports

State = TypeVar("State", list[Array], Array)
UNROLLED = 4  # substeps written out one by one; 50 of them took minutes to compile


def scaled_force(model: Model, voltage: Float[Array, "..."]) -> Float[Array, "..."]:
    """Convert a voltage to the scaled force (the force over `force_scale`)."""
    return model.input_map.force(voltage) / jnp.asarray(model.scales.force, voltage.dtype)


def film_voltage(model: Model, force: Float[Array, "..."]) -> Float[Array, "..."]:
    """Convert a scaled force to the film voltage (V) that gives it."""
    return model.input_map.voltage(force * jnp.asarray(model.scales.force, force.dtype))


def stage_fractions(model: Model) -> Float[np.ndarray, " stages"]:
    """Return the times at which a step needs the voltage, as fractions of a sample: 2 substeps + 1, from 0 to 1."""
    return np.arange(2 * model.substeps + 1) / (2 * model.substeps)


def stage_voltages(model: Model, film: Float[Array, " time"]) -> Float[Array, "time stages"]:
    """Interpolate the film voltage at start, middle and end of every substep, shape (time, 2 substeps + 1)."""
    return between(film, model.hold, stage_fractions(model), jnp)


class Motion(NamedTuple):
    """Constants of a simulation: the factors in dX_i/dt = rates_i X_{i+1} (1/s), and the memories' derivative."""

    rates: list[Array]
    memory: Callable[[Rows, Array], list[Array]]


def motion_of(model: Model) -> Motion:
    """Return the constants of a simulation in the model's precision; float64 would promote every step."""
    return Motion(list(jnp.asarray(model.scales.rates, model.coefficients.dtype)), model.memory.rate())


def held(tokens: Rows, offset: Array, together: bool = True) -> list[Array]:
    """Return the values that stay constant over a time step: sigma_0 ... sigma_{n-1}, 1 / sigma_n, offset token.

    The reciprocal is stored because a division in every stage would cost a kernel.

    `together`: computed once and kept; otherwise XLA fuses them into every row of the new state and repeats them.
    """
    rows = [*tokens[:-1], 1 / tokens[-1], offset]
    return list(jax.lax.optimization_barrier(jnp.stack(rows))) if together else rows


def runge_kutta(motion: Motion, state: State, frozen: Rows, forces: Rows, h: float) -> State:
    """Compute the change of the state over a Runge-Kutta step of h (s), with the constant values of `held`.

    `state`: S then memory, scaled, as rows (kernels of their own, for a scan) or as one array (to differentiate).
    """
    (rates, memory), n = motion, len(motion.rates)
    *tokens, reciprocal, offset = frozen

    def slope(state, force) -> Any:  # of the state's kind
        s, highest = list(state), force - offset  # x^(n) sigma_n, after subtraction of the lower terms
        for token, row in zip(tokens, s, strict=False):
            highest = highest - token * row
        upper = [*s[1:n], highest * reciprocal]
        rows = [r * row for r, row in zip(rates, upper, strict=True)] + memory(s[n:], s[0])
        return rows if isinstance(state, list) else jnp.stack(rows)

    # the classical tableau: 1/6, 2/6, 2/6, 1/6; both middle stages use the force at h/2
    k1 = slope(state, forces[0])
    k2 = slope(moved(state, h / 2, k1), forces[1])
    k3 = slope(moved(state, h / 2, k2), forces[1])
    k4 = slope(moved(state, h, k3), forces[2])
    return jax.tree.map(lambda a, b, c, d: h / 6 * (a + 2 * b + 2 * c + d), k1, k2, k3, k4)


def moved(state: State, by: float, slope: State) -> State:
    """Return the state plus `by` (s) times its rate of change."""
    return jax.tree.map(lambda a, b: a + by * b, state, slope)


def midpoint(motion: Motion, state: Rows, h: float) -> list[Array]:
    """Return the state half a time step later, except x^(n-1), whose change depends on the force."""
    n, still, half = len(motion.rates), state[len(motion.rates) - 1], [h / 2 * rate for rate in motion.rates]
    # Not h/2 (rate x'), which k2 contains too: the shared value would become a kernel, 3 to 10 ms per 10,000 steps.
    drifted = [x + by * v for x, by, v in zip(state[: n - 1], half, state[1:n], strict=False)]
    return [*drifted, still, *moved(list(state[n:]), h / 2, motion.memory(state[n:], state[0]))]


def frozen_increment(model: Model, state: Float[Array, " state"], forces: tuple, h: float) -> Float[Array, " state"]:
    """Compute the change of the state over a time step, with coefficients (tokens) of the predicted midpoint."""
    constant = motion_of(model)
    seen = jnp.stack(midpoint(constant, list(state), h))
    return runge_kutta(constant, state, held(*model.tokens_from(model.encoder(seen)), False), forces, h)


def along(one: Callable, state, stages: Float[Array, "stages *shape"]):
    """Advance one sample: apply `one`(state, three stage values) for every substep."""
    count = len(stages) // 2
    if count > UNROLLED:  # a loop, because hundreds of substeps written out take minutes to compile
        threes = stages[2 * np.arange(count)[:, None] + np.arange(3)]
        return jax.lax.scan(lambda s, three: (one(s, three), None), state, threes)[0]
    for k in range(count):
        state = one(state, stages[2 * k : 2 * k + 3])
    return state


def step(model: Model, state: Float[Array, " state"], stages: Float[Array, " stages"], dt: float):
    """Advance the state by one sample along its stage voltages, in `substeps` Runge-Kutta steps."""
    return along(lambda s, volts: substep(model, s, volts, dt / model.substeps), state, stages)


def substep(model: Model, state: Float[Array, " state"], volts: Float[Array, "3"], h: float, logits=None):
    """Advance the state by one Runge-Kutta step of h (s), along its three stage voltages.

    Every effect's force is frozen with the tokens, and its states advance after the step.
    """
    n, size = model.order, model.order + model.memory.size
    core, constant = list(state[:size]), motion_of(model)
    seen = jnp.stack(midpoint(constant, core, h))
    tokens, offset = model.tokens_from(model.encoder(seen) if logits is None else logits)
    if not model.effects:
        return state + runge_kutta(constant, state, held(tokens, offset, False), scaled_force(model, volts), h)
    films, parts = ports.films(model, ports.split(model, state[size:]), tuple(volts), h)
    forces = ports.coupled(model, tuple(scaled_force(model, v) for v in films), seen[0])
    rates = jnp.asarray(model.scales.rates, state.dtype)
    # effects use the force at the middle of the step, as they use the drifted state
    now = Instant(seen[:n], model.coefficients, rates, forces[1], h, jnp.stack(tokens), offset)
    now = ports.acted(model, parts, now)
    after = moved(core, 1.0, runge_kutta(constant, core, held(list(now.tokens), now.offset), forces, h))
    return jnp.concatenate([jnp.stack(after), *ports.moved(model, parts, core[0], after[0], h)])


def rest_state(model: Model | Fitted, age: float | Float[Array, ""] = 0.0) -> Float[Array, " state"]:
    """Return the scaled state of an actuator at rest, at this time since the session started (s).

    Args:
        model: any.
        age: of the session at the first sample, s.

    Returns:
        state, then memory, then effects' states; scaled.

    Examples:
        >>> pitp.rest_state(model).shape
        (2,)
    """
    model = model_of(model)
    zero = jnp.zeros((), model.coefficients.dtype)
    return still_state(model, zero, zero, age)


def at_rest(model: Model, start: Float[Array, "*records state"]) -> Bool[Array, "*records"]:
    """Return True for initial states at rest (S = 0); their film is uncharged, otherwise it is charged to u(0)."""
    return ~jnp.any(start[..., : model.order], axis=-1)


def still_state(model: Model, x, voltage, age) -> Float[Array, " state"]:
    """Return the state in equilibrium at scaled displacement x, after a long time at a voltage."""
    return settled_state(model, jnp.zeros(model.order, x.dtype).at[0].set(x), x, voltage, age)


def settled_state(model: Model, state: Float[Array, " order"], level, voltage, age) -> Float[Array, " state"]:
    """Append to S the memory and effect states after a long time at scaled displacement `level` and a voltage."""
    return jnp.concatenate([state, model.memory.initial(level), ports.initial(model, level, voltage, age)])


def rollout(
    model: Model | Fitted, voltage: Float[Array, " time"], dt: float, start: Float[Array, " state"]
) -> Float[Array, "time state"]:
    """Simulate one record; return the scaled states at every sample of a voltage u, the first one = `start`.

    A start at x = 0 without motion is rest: the film is uncharged. For any other start the film is settled at u(0).

    Args:
        model: any.
        voltage: V, shape (T,).
        dt: sampling interval, s; steps are the model's `substeps` a sample.
        start: scaled, as returned by `rest_state`.

    Returns:
        scaled states (state, memory, effects), shape (T, n + K).

    Examples:
        >>> states = rollout(model, jnp.ones(64), 1e-3, pitp.rest_state(model))
        >>> states.shape
        (64, 2)
    """
    model = model_of(model)
    rest, voltage = at_rest(model, start), jnp.asarray(voltage, start.dtype)
    dt = float(dt) if isinstance(dt, np.generic) else dt  # a NumPy float64 would promote everything to float64
    voltage = model.drive.film(ports.delayed(model, voltage, dt, rest), dt, rest)

    def advance(state, stages):
        return step(model, state, stages, dt), state

    return jax.lax.scan(advance, start, stage_voltages(model, voltage))[1]


@jit
def rollout_batch(
    model: Model, voltage: Float[Array, "records time"], dt: float, start: Float[Array, "records state"]
) -> Float[Array, "records time state"]:
    """Simulate several records side by side, as one compiled program."""
    return eqx.filter_vmap(rollout, in_axes=(None, 0, None, 0))(model, voltage, dt, start)

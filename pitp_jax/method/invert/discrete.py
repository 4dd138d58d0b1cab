"""Invert the simulation: find the voltages that lead from each of its states to the next.

With frozen tokens a step is affine in its stage forces:  s_{t+1} - s_t = p(s_t) + sum_j g_j(s_t) F_j.

    zoh:  one force a step; the row of x^(n-1) gives it at once.
    foh:  F_j come from u_t and u_{t+1}. The row of x^(n-1) fixes about (F_t + F_{t+1})/2 to eps/(w dt), but not
          the alternating mode; the row of x^(n-2) fixes that mode, to eps/(w dt)^2. All u are solved for at once by
          Gauss-Newton on both rows, each weighted by its rounding error: a tridiagonal system a step. A recursion
          u_t -> u_{t+1} through the first row alone would be marginally stable.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...common.errors import BadInput, refuse_if
from ..model.fitted import Fitted, model_of
from ..model.model import Model
from ..model.programs import jit
from ..numerics.intersample import between
from ..simulate import ports
from ..simulate.decoder import film_voltage, frozen_increment, scaled_force, stage_fractions, step


@jit
def discrete_inverse(
    model: Model | Fitted,
    states: Float[Array, "time state"],
    dt: float,
    first: Float[Array, ""] | None = None,
    sweeps: int = 20,
) -> Float[Array, " time-1"]:
    """Compute the voltage (V) of every time step between the states of a simulation, shape (time - 1,).

    Args:
        model: the one whose `rollout` gave the states.
        states: scaled displacement, its n - 1 derivatives and K memories, as `rollout` returns them, shape (T, n + K).
        dt: sampling interval, s.
        first: u_0 in V if known (foh of order 1 without memory needs it, because its only row does not fix the
            voltage error that changes its sign at every sample).
        sweeps: Gauss-Newton iterations (foh).

    Returns:
        Voltage behind the electrode's lag: the input if the model has no lag (otherwise see `drive.undo`).
        zoh: V_0 ... V_{T-2} held over each step; foh: V_0 ... V_{T-2}, the last sample's voltage left out.

    Raises:
        BadInput: the model has effects (use `feedforward`), takes substeps (coefficients change inside a sample; invert
            on the substep grid instead), or its voltage is band-limited (one sample then acts on sixteen steps).

    Examples:
        >>> from pitp_jax.method.simulate.decoder import rollout
        >>> u = jnp.linspace(0.0, 1000.0, 50)
        >>> states = rollout(model, u, 1e-3, pitp.rest_state(model))
        >>> bool(jnp.allclose(pitp.discrete_inverse(model, states, 1e-3)[5:], u[5:-1], rtol=0.05))
        True
    """
    model = model_of(model)
    refuse_if(
        (model.effects, "discrete_inverse does not support effects; use feedforward"),
        (model.hold == "bandlimited", "discrete_inverse needs a model with hold foh or zoh"),
        (
            model.substeps != 1,
            "discrete_inverse needs a model with substeps = 1; give the states on the finer grid of the substeps",
        ),
    )
    rows, unit = _rows(model), _unit(model, states.dtype)

    def change(state, now, later):
        volts = between(unit * jnp.stack([now, later]), model.hold, stage_fractions(model), jnp)[0]
        return frozen_increment(model, state, tuple(scaled_force(model, volts)), dt)[rows]

    moved = jnp.diff(states, axis=0)[:, rows]  # exact for neighbouring states, so no rounding is added
    zero, one = jnp.zeros((), states.dtype), jnp.ones((), states.dtype)
    free, pushed = (jax.vmap(lambda s, v=v: change(s, v, v)[0])(states[:-1]) for v in (zero, one))
    force = (moved[:, 0] - free) / (pushed - free)
    if model.hold == "zoh":
        return film_voltage(model, force)
    start = film_voltage(model, jnp.append(force, force[-1:])) / unit + 1e-3  # where a square's slope is not zero
    known = None if first is None else first / unit
    return (_solved(model, change, states[:-1], moved, start, sweeps, known) * unit)[:-1]


def _rows(model: Model) -> Array:
    """Return the places of x^(n-1) and x^(n-2) in a state: together they fix all voltages."""
    n = model.order
    # at order 1 there is no x^(n-2): the first memory, a lag of x, shows the alternating mode instead
    return jnp.array([n - 1, *([n - 2] if n > 1 else [n] if model.memory.size else [])])


def _unit(model: Model, dtype) -> Array:
    return model.input_map.voltage(jnp.asarray(model.scales.force, dtype))


def _solved(
    model: Model, change: Callable, states, target, start: Float[Array, " time"], sweeps: int, known=None
) -> Float[Array, " time"]:
    """Solve by Gauss-Newton for all voltages v with change(s_t, v_t, v_{t+1}) = target_t.

    Args:
        model: whose input map the voltages go through.
        change: rows of one step.
        states, target: at every step, shapes (T - 1, state) and (T - 1, rows).
        start: over `_unit`.
        sweeps: iterations.
        known: the first voltage, or None.
    """
    one, square = jnp.ones((), start.dtype), model.input_map.one_sided
    gain = jax.jvp(lambda v: change(states[0], v, v), (one,), (one,))[1] / (1.0 + square)
    weight = (gain / gain[0]) ** 2  # all rows have the same rounding error

    def sweep(v, _):
        each = states, v[:-1], v[1:]
        missed = (target - jax.vmap(change)(*each)) / gain
        by_now, by_later = (j / gain for j in jax.vmap(jax.jacfwd(change, (1, 2)))(*each))
        pull = (0.0, 0.0) if known is None else (1.0, known - v[0])
        v = v + _move([(missed[:, k], by_now[:, k], by_later[:, k], weight[k]) for k in range(len(gain))], *pull)
        return jnp.abs(v) if square else v, None  # the positive one of the two roots

    return jax.lax.scan(sweep, start, None, length=sweeps)[0]


def _move(equations: list, anchor, pull) -> Float[Array, " time"]:
    """Solve for the Gauss-Newton step of all voltages, from residual, derivatives and weight of every step.

    `anchor`, `pull`: weight and weighted error of the first voltage, if it is known.
    """
    count, dtype = len(equations[0][0]), equations[0][0].dtype
    # 1e-9 on the diagonal: where a square has no slope (u = 0) a voltage stays unchanged
    diagonal, beside, right = jnp.full(count + 1, 1e-9, dtype), jnp.zeros(count, dtype), jnp.zeros(count + 1, dtype)
    for missed, by_now, by_later, weight in equations:
        diagonal = diagonal.at[:-1].add(weight * by_now**2).at[1:].add(weight * by_later**2)
        beside = beside + weight * by_now * by_later
        right = right.at[:-1].add(weight * by_now * missed).at[1:].add(weight * by_later * missed)
    diagonal, right, pad = diagonal.at[0].add(anchor), right.at[0].add(pull), jnp.zeros(1, dtype)
    sides = jnp.concatenate([pad, beside]), jnp.concatenate([beside, pad])
    return jax.lax.linalg.tridiagonal_solve(sides[0], diagonal, sides[1], right[:, None])[:, 0]


def along_motion(
    model: Model, force: Float[Array, " time"], features: Float[Array, "time features"], dt, sweeps: int = 5
) -> Float[Array, " time"]:
    """Compute the film voltage (V) whose simulation steps lead from each instant of a motion to the next.

        s_{t+1} = step(s_t, V_t, V_{t+1})       rows x^(n-1) and x^(n-2), each over what a force moves it by

    It works for any model: steps are differentiated with substeps and effects.

    Args:
        model: the caller applies the effects between voltage and film.
        force: scaled, by eq. 13: the start of the iteration.
        features: S and memories along the motion, scaled.
        dt: sampling interval, s.
        sweeps: Gauss-Newton iterations.

    Raises:
        BadInput: a band-limited voltage, of which a sample acts on sixteen steps.
    """
    if model.hold == "bandlimited":
        raise BadInput("kind 'discrete' needs a model with hold 'foh' or 'zoh'; give kind='closed_form'")
    model = replace(model, effects=tuple(e for e in model.effects if e.port != "IN"))
    states = jnp.concatenate([features, *ports.along(model, features[:, 0], dt)], -1)
    rows, unit = _rows(model), _unit(model, states.dtype)

    def after(state, now, later):
        stages = between(unit * jnp.stack([now, later]), model.hold, stage_fractions(model), jnp)[0]
        return step(model, state, stages, dt)[rows]

    return _solved(model, after, states[:-1], states[1:, rows], film_voltage(model, force) / unit, sweeps) * unit

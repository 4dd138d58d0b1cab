"""The same ODE for general solvers: tokens read at every instant, the film voltage linear between samples.

    S' = [x', ..., x^(n)],  x^(n) = (F(t) - sigma_off(S, m) - sum_{i<n} sigma_i(S, m) x^(i)) / sigma_n(S, m)

A solver's error is its rms miss over the range, against diffrax at 1e-9 in float64. The peer is the fastest whose error
is no more than the package's at one step a sample, or 1e-6 where that is less (float32 shows no difference below);
looser settings, to ten times that, are timed as well. All give the states at every sample.
"""

from functools import partial

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pitp_jax.method.model.model import Model
from pitp_jax.method.model.programs import jit
from pitp_jax.method.simulate.decoder import rest_state, scaled_force
from pitp_jax.method.simulate.decoder import step as decoder_step

from .machine import floor, operations
from .sizes import size

_STEPS = 1 << 17
EQUAL, LOOSE = 1e-6, 1e-5  # of the range


def slope(model: Model, dt: float, t, state, film):
    """Ds/dt at time t (s) of one record."""
    n, place = model.order, jnp.clip(t / dt, 0, len(film) - 1)
    k = jnp.minimum(place.astype(jnp.int32), len(film) - 2)
    share = place - k
    force = scaled_force(model, film[k] * (1 - share) + film[k + 1] * share)
    tokens, offset = model.tokens(state)
    highest = (force - offset - tokens[:n] @ state[:n]) / tokens[n]
    rates = jnp.asarray(model.scales.rates, state.dtype)
    memory = jnp.array(model.memory.rate()(state[n:], state[0]))
    return jnp.concatenate([rates * jnp.append(state[1:n], highest), memory])


@jit
def solve(model: Model, films, start, dt: float, solver, controller, step: float | None):
    """States (records, time, state) by diffrax; `step`: first (adaptive: None) or constant step, s."""

    def one(film, state):
        times = jnp.arange(len(film), dtype=film.dtype) * dt
        term = diffrax.ODETerm(lambda t, s, args: slope(model, dt, t, s, args))
        found = diffrax.diffeqsolve(
            term, solver, times[0], times[-1], step, state, args=film, saveat=diffrax.SaveAt(ts=times),
            stepsize_controller=controller, max_steps=_STEPS, throw=False,
        )  # fmt: skip
        return found.ys

    return jax.vmap(one)(films, start)


def rollout_floor(model, records: int, steps: int) -> dict:
    """At full matrix rate, which a step of a few hundred operations that wait for each other cannot have."""
    volts, start = jnp.zeros(2 * model.substeps + 1), rest_state(model)
    one = operations(lambda s, v: decoder_step(model, s, v, 1e-3), start, volts)
    return floor(one * records * steps, 4 * records * steps * (1 + start.size))


def films(model: Model, voltage, dt: float):
    """Film voltages of records that start at rest."""
    return jax.vmap(lambda u: model.drive.film(u, dt, jnp.array(True)))(voltage)


def reference(model: Model, film, start, dt: float) -> np.ndarray:
    """Diffrax, Dopri8 in float64 at 1e-9."""
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda a: a.astype(jnp.float64) if eqx.is_inexact_array(a) else a, model)
        controller = diffrax.PIDController(rtol=1e-9, atol=1e-9)
        arrays = jnp.asarray(np.asarray(film, np.float64)), jnp.asarray(np.asarray(start, np.float64))
        return np.asarray(solve(wide, *arrays, dt, diffrax.Dopri8(), controller, None))[..., 0]


def error(states, truth) -> float:
    """Largest rms miss of a record's displacement over its range."""
    x = np.asarray(states, np.float64)[..., 0]
    return float(np.max(np.sqrt(np.mean((x - truth) ** 2, -1)) / np.ptp(truth, axis=-1)))


def candidates(dt: float) -> dict:
    """Diffrax as one would set it: constant steps and adaptive ones."""
    constant = {
        f"diffrax Tsit5, step {k} samples": (diffrax.Tsit5(), diffrax.ConstantStepSize(), k * dt)
        for k in size((1, 2, 3, 4, 5, 7, 10, 20), (1,))
    }
    adaptive = {
        f"diffrax Tsit5, rtol {r:g}": (diffrax.Tsit5(), diffrax.PIDController(rtol=r, atol=r), None)
        for r in size((1e-4, 1e-5, 1e-6), (1e-6,))
    }
    return constant | adaptive


def diffrax_ways(model: Model, film, start, truth, dt: float) -> tuple[dict, dict]:
    """Ways of diffrax within the loose limit, and the error of every one tried, on the first records."""
    errors, ways = {}, {}
    for name, (solver, controller, step) in candidates(dt).items():
        options = (dt, solver, controller, step)
        errors[name] = error(solve(model, film[: len(truth)], start[: len(truth)], *options), truth)
        if errors[name] <= LOOSE:
            ways[name] = partial(solve, model, film, start, *options)
    return ways, errors

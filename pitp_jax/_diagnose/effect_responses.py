"""One pass over a record: the force of every form along the measured motion, and the nominal's response to it.

    g_j(t) = G [ f_j(x, x', z_j; p) ](t),    z_j' = h_j(z_j, x; p),    G = 1 / sum_i a_i s^i

Lanes are grid points; each holds every form at once, since no state feeds back. What is not a force (sensor effects)
acts on the nominal's free run instead. Compiled once per set of forms, order and input map.
"""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.linalg import expm
from scipy.signal import lfilter

from .._effects.effect import Effect, Instant
from .._model.model import Model


class Filter(NamedTuple):
    """X_{k+1} = A X_k + B f_k + C f_{k+1}: the nominal driven by a scaled force linear between samples."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray


def nominal_filter(model: Model, dt: float) -> Filter:
    """The identified coefficients, exactly discretised for a force linear between samples."""
    n, rates = model.order, np.asarray(model.scales.rates)
    coefficients = np.asarray(model.coefficients, np.float64)
    a = np.diag(rates[:-1], 1)
    a[-1] = -rates[-1] * coefficients[:-1] / coefficients[-1]
    b = np.zeros((n, 1))
    b[-1] = rates[-1] / coefficients[-1]
    block = np.zeros((n + 2, n + 2))
    block[:n, :n], block[:n, n], block[n, n + 1] = a * dt, b[:, 0] * dt, 1.0
    e = expm(block)
    return Filter(e[:n, :n], e[:n, n] - e[:n, n + 1], e[:n, n + 1])


def responses(model: Model, dt: float, forces: np.ndarray) -> np.ndarray:
    """X_0 of the nominal under scaled forces (T, columns), from rest."""
    f = nominal_filter(model, dt)
    poly, n = np.poly(f.a), model.order
    state, markov = f.a @ f.c + f.b, [f.c[0]]
    for _ in range(n):
        markov.append(state[0])
        state = f.a @ state
    taps = [sum(poly[j] * markov[k - j] for j in range(k + 1)) for k in range(n + 1)]
    return np.asarray(lfilter(taps, poly, forces, axis=0))


class Columns(NamedTuple):
    """What every lane reads at one sample, per record."""

    motion: np.ndarray  # (T, n + 1)
    tokens: np.ndarray  # (T, n + 1)
    offset: np.ndarray  # (T,)
    voltage: np.ndarray  # (T,)
    run: np.ndarray  # (T,) scaled displacement of the nominal's free run


class Nominal(NamedTuple):
    """What of the nominal a pass needs, as arrays: no recompilation between cases."""

    coefficients: np.ndarray
    rates: np.ndarray
    force: np.float32
    blunt: np.float32
    filter: Filter
    dt: np.float32


@lru_cache(maxsize=4)
def _compiled_for(types: tuple, order: int, input_map: type):
    effects = tuple(row.neutral() for row in types)
    begin, advance = _passes(effects, order, input_map())
    return jax.jit(begin), jax.jit(advance)


def compiled(model: Model, effects):
    """One compiled pass per set of forms, order and input map."""
    return _compiled_for(tuple(e.spec for e in effects), model.order, type(model.input_map))


def _passes(effects, n: int, input_map):
    """(begin, advance): the carry at a record's first sample, and the carry a chunk of samples later."""
    unravel = ravel_pytree(effects)[1]

    def lane_start(row, start):
        x, voltage, age, reached = start
        found = [(e, e.start(voltage if e.port == "IN" else x, age)) for e in unravel(row)]
        return [e.resumed(z, reached) for e, z in found]

    def lane(row, states, now, then, late, nominal):
        """Forces of all forms at this sample (filtered later), direct output columns, and the next states."""
        base = input_map.force(now.voltage) / nominal.force
        frozen = now.tokens, now.offset
        instant = Instant(
            now.motion[:n], nominal.coefficients, nominal.rates, base, nominal.blunt, *frozen, last=now.motion[n]
        )
        found = [
            _felt(e, z, instant, (now, then, late), nominal, input_map)
            for e, z in zip(unravel(row), states, strict=True)
        ]
        force, direct, after = zip(*found, strict=True)
        return jnp.stack(force), jnp.stack(direct), list(after)

    lanes = jax.vmap(lane, (0, 0, None, None, 0, None))

    def begin(rows, first, late, start, nominal):
        """The filter stands where one step under a force that was always f_0 leads to rest: f sets in at once."""
        states = jax.vmap(lane_start, (0, None))(rows, start)
        force = lanes(rows, states, first, first, late, nominal)[0]
        f = nominal.filter
        before = -jnp.linalg.solve(f.a, f.b + f.c)[:, None, None] * force[None]
        return states, before, force

    def advance(rows, carry, now, then, late, nominal):
        filt = nominal.filter

        def sample(carry, item):
            states, y, before = carry
            here, there, delayed = item
            force, direct, states = lanes(rows, states, here, there, delayed, nominal)
            y = jnp.tensordot(filt.a, y, 1) + filt.b[:, None, None] * before + filt.c[:, None, None] * force
            return (states, y, force), y[0] + direct

        return jax.lax.scan(sample, carry, (now, then, late))

    return begin, advance


def _felt(e: Effect, z, instant: Instant, samples, nominal: Nominal, input_map):
    """One form: its force (filtered later), its direct share of the output, and its next states.

    `samples`: the columns at this sample, those at the next, and the delayed voltage at this one.
    """
    (now, then, late), none = samples, jnp.zeros(())

    def lost(volts):
        return instant.force - input_map.force(volts) / nominal.force

    if e.delays:
        return lost(late), none, z
    if e.port == "IN":
        return lost(e.apply(now.voltage, z)), none, e.advance(z, now.voltage, then.voltage, nominal.dt)
    if e.port == "SQ":
        return instant.force - e.apply(instant.force, now.motion[0]), none, z
    if e.port == "OUT":
        return none, now.run - e.apply(now.run, z), e.advance(z, now.run, then.run, nominal.dt)
    after = e.act(z, instant)
    force = (after.tokens - now.tokens) @ now.motion + after.offset - now.offset
    return force, none, e.advance(z, now.motion[0], then.motion[0], nominal.dt)

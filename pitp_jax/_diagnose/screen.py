"""Screening: every form of every effect at a grid of its parameters, in one pass over the records.

    e(t) = G [ f(x, x', z; p) ](t) + noise,    G = 1 / sum_i a_i s^i  (the nominal),   z' = h(z, x; p)

With the *measured* motion in f no rollout is needed: the effect's states have no feedback, G is a linear filter, and
lanes (grid points) hold every form at once. What each form explains follows by least squares on its strength (and, in
a refit, on the nominal's coefficients, whose columns are -G[a_i x^(i)]). Noise enters f only through the measured x,
0.3 % of range; the few forms that are left go on to whole rollouts (`fit`).
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.linalg import expm
from scipy.signal import lfilter

from .._effects.base import (
    AbstractCouplingEffect,
    AbstractDriveEffect,
    AbstractEffect,
    AbstractForceEffect,
    AbstractSensorEffect,
    Known,
    Start,
)
from .._effects.drive import Delay
from .._model.model import Model
from .case import Case, Series

POINTS, LANES = 20, 24  # grid points of a form besides its starts, and in all
CHUNK, TARGETS = 2500, 8  # samples of a compiled pass; e and nuisance columns


@dataclass(frozen=True)
class Screened:
    """What one form explains at its best grid point.

    Attributes:
        effect: the form.
        values: its parameters there, strength regressed.
        start: bounds that go with them.
        train, heldout: mean squared error in (1 %)^2, pooled over records.
        points: all grid points as (train, values), best first.
    """

    effect: type[AbstractEffect]
    values: tuple[float, ...]
    start: Start
    train: float
    heldout: float
    points: tuple


def grid(effect: type[AbstractEffect], starts: list[Start], count: int = POINTS) -> list[tuple[tuple[float, ...], Start]]:
    """Active parameter vectors: the strength as in the starts where it is linear, everything else spread out."""
    if not starts:
        return []
    free = [k for k, p in enumerate(effect.PARAMETERS) if p.neutral is None]
    first = starts[0]
    if not free:  # one number that may act nonlinearly
        p = effect.PARAMETERS[0]
        values = [s.values[0] for s in starts]
        if not p.positive:
            spread = [v * f for v in values for f in (0.3, 1.0, 2.5)]
        else:
            low, high = max(first.low[0], min(values) / 12), min(first.high[0], max(values) * 8)
            spread = np.geomspace(low, high, 12).tolist()
        spread = [float(np.clip(v, first.low[0], first.high[0])) for v in spread]
        return [((v, *first.values[1:]), first) for v in spread]
    axes = []
    for k in range(len(effect.PARAMETERS)):
        wide = first.high[k] > first.low[k] and k in free
        if not wide:
            axes.append(sorted({s.values[k] for s in starts}) if k in free else [first.values[k]])
        else:
            axes.append(np.geomspace(first.low[k], first.high[k], 14)[1:-1].tolist())
    many = int(np.prod([len(a) for a in axes]))
    while many > count:
        widest = int(np.argmax([len(a) for a in axes]))
        keep = np.unique(np.round(np.linspace(0, len(axes[widest]) - 1, len(axes[widest]) - 1)).astype(int))
        axes[widest] = [axes[widest][i] for i in keep]
        many = int(np.prod([len(a) for a in axes]))
    points = [tuple(float(v) for v in p) for p in np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(axes))]
    return ([(s.values, s) for s in starts] + [(p, first) for p in points])[:LANES]


class _Filter(NamedTuple):
    """X_{k+1} = A X_k + B f_k + C f_{k+1}: the nominal driven by a scaled force linear between samples."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray


def nominal_filter(model: Model, dt: float) -> _Filter:
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
    return _Filter(e[:n, :n], e[:n, n] - e[:n, n + 1], e[:n, n + 1])


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
    targets: np.ndarray  # (T, 1 + Q): e, then nuisance columns
    weight: np.ndarray  # (T,)


def nuisance(case: Case, series: Series, refit: bool) -> np.ndarray:
    """Columns -G[a_i x^(i)] of the nominal's coefficients (refit), shape (T, Q)."""
    if not refit:
        return np.zeros((len(series.error), 0))
    a = np.asarray(case.model.coefficients, np.float64)
    return responses(case.model, case.dt, -a * series.motion)


def screen(
    case: Case, catalogue, *, refit: bool, extra: list[np.ndarray] | None = None, skip: tuple[str, ...] = ()
) -> list[Screened]:
    """Every form of `catalogue` at its grid, best first by the error on fitted records.

    `extra`: per record columns (T, Q) that may be regressed along (the effects already found). `skip`: names left out.
    The same catalogue compiles once, whatever is skipped.
    """
    catalogue = tuple(c for c in catalogue if c.starts(case.surroundings))
    grids = [grid(c, c.starts(case.surroundings)) for c in catalogue]
    rows = np.zeros((LANES, sum(len(c.PARAMETERS) for c in catalogue)), np.float32)
    first = 0
    for c, g in zip(catalogue, grids, strict=True):
        for k in range(LANES):
            rows[k, first : first + len(c.PARAMETERS)] = g[min(k, len(g) - 1)][0]
        first += len(c.PARAMETERS)
    shared = [
        np.concatenate([nuisance(case, s, refit), *([extra[k]] if extra else [])], -1)
        for k, s in enumerate(case.series)
    ]
    sums = _sums(case, tuple(c.neutral() for c in catalogue), rows, shared)
    kept = [k for k, c in enumerate(catalogue) if c.name not in skip]
    return _ranked(case, catalogue, grids, kept, sums, shared)


def _sums(case: Case, effects, rows, shared) -> list[tuple[np.ndarray, np.ndarray]]:
    """Per record: sum w g g (lanes, forms) and sum w g (e, c) (lanes, forms, 1 + Q)."""
    begin, advance = _compiled(case.model, effects)
    model, delays = case.model, [k for k, e in enumerate(effects) if isinstance(e, Delay)]
    filt = jax.tree.map(lambda v: np.asarray(v, np.float32), nominal_filter(model, case.dt))
    a = model.physical_coefficients
    nominal = Nominal(
        np.asarray(model.coefficients), np.asarray(model.scales.rates, np.float32), np.float32(model.scales.force),
        np.float32(0.1 / (a[0] / a[-1]) ** (1 / model.order)), filt, np.float32(case.dt),
    )  # fmt: skip

    def one(s: Series, c: np.ndarray):
        targets = np.zeros((len(s.error), TARGETS))
        targets[:, : 1 + c.shape[1]] = np.concatenate([s.error[:, None], c], -1)
        columns = Columns(*(
            v.astype(np.float32) for v in (s.motion, s.tokens, s.offset, s.voltage, s.run, targets, s.weight)
        ))  # fmt: skip
        late = _delayed(columns.voltage, rows, effects, delays, s.rest, case.dt)
        start = (0.0 if s.rest else s.motion[0, 0], 0.0 if s.rest else s.voltage[0], s.age)
        carry = begin(rows, jax.tree.map(lambda v: v[0], columns), late[0], np.asarray(start, np.float32), nominal)
        for first in range(0, len(s.error), CHUNK):
            now, then = (jax.tree.map(lambda v, k=k: _window(v, first + k, CHUNK), columns) for k in (0, 1))
            now = now._replace(weight=np.where(first + np.arange(CHUNK) < len(s.error), now.weight, 0.0).astype(np.float32))
            carry = advance(rows, carry, now, then, _window(late, first, CHUNK), nominal)
        gg, ge = (np.asarray(v, np.float64) for v in carry[-2:])
        return gg, ge[..., : 1 + c.shape[1]]

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(one, case.series, shared))


def _window(values: np.ndarray, first: int, count: int) -> np.ndarray:
    """Samples first ... first + count, the last one repeated beyond the end."""
    return values[np.minimum(np.arange(first, first + count), len(values) - 1)]


def _delayed(voltage, rows, effects, delays, rest, dt) -> np.ndarray:
    """The voltage of every lane behind its delay, (T, lanes)."""
    late = np.repeat(voltage[:, None], len(rows), 1)
    if delays:
        first = sum(len(e.PARAMETERS) for e in effects[: delays[0]])
        place = np.arange(len(voltage))
        for k, time in enumerate(rows[:, first]):
            late[:, k] = np.interp(place - time / dt, place, voltage, left=0.0 if rest else voltage[0])
    return late


class Nominal(NamedTuple):
    """What of the nominal a pass needs, as arrays: no recompilation between cases."""

    coefficients: np.ndarray
    rates: np.ndarray
    force: np.ndarray
    blunt: np.ndarray
    filter: _Filter
    dt: np.ndarray


@lru_cache(maxsize=4)
def _compiled_for(types: tuple, order: int, input_map: type):
    effects = tuple(t.neutral() for t in types)
    begin, advance = _passes(effects, order, input_map())
    return jax.jit(begin), jax.jit(advance)


def _compiled(model: Model, effects):
    """One compiled pass per set of forms, order and input map."""
    return _compiled_for(tuple(type(e) for e in effects), model.order, type(model.input_map))


def _passes(effects, n: int, input_map):
    """(begin, advance): the carry at a record's first sample, and the carry a chunk of samples later."""
    unravel = ravel_pytree(effects)[1]

    def lane_start(row, start):
        x, voltage, age = start
        states = []
        for e in unravel(row):
            if isinstance(e, AbstractDriveEffect):
                states.append(e.initial(voltage))
            elif isinstance(e, AbstractForceEffect):
                states.append(e.initial(x, age))
            elif isinstance(e, AbstractSensorEffect):
                states.append(e.initial(x))
            else:
                states.append(jnp.zeros((0,)))
        return states

    def lane(row, states, now, then, late, nominal):
        """Forces of all forms at this sample (filtered later), direct output columns, and the next states."""
        force, direct, after, dt = [], [], [], nominal.dt

        def force_of(volts):
            return input_map.force(volts) / nominal.force

        base = force_of(now.voltage)
        instant = Known(now.motion[:n], nominal.coefficients, nominal.rates, base, nominal.blunt, now.motion[n])
        for e, z in zip(unravel(row), states, strict=True):
            f, g = jnp.zeros(()), jnp.zeros(())
            if isinstance(e, AbstractDriveEffect):
                f = base - force_of(e.film(z, now.voltage))
                z = e.advance(z, now.voltage, then.voltage, dt)
            elif isinstance(e, Delay):
                f = base - force_of(late)
            elif isinstance(e, AbstractCouplingEffect):
                f = base - e.couple(base, now.motion[0])
            elif isinstance(e, AbstractForceEffect):
                tokens, offset = e.act(z, instant, now.tokens, now.offset)
                f = (tokens - now.tokens) @ now.motion + offset - now.offset
                z = e.advance(z, now.motion[0], then.motion[0], dt)
            elif isinstance(e, AbstractSensorEffect):
                g = now.run - e.reading(z, now.run)
                z = e.advance(z, now.run, then.run, dt)
            force.append(f)
            direct.append(g)
            after.append(z)
        return jnp.stack(force), jnp.stack(direct), after

    lanes = jax.vmap(lane, (0, 0, None, None, 0, None))

    def begin(rows, first, late, start, nominal):
        """The filter stands where one step under a force that was always f_0 leads to rest: f sets in at once."""
        states = jax.vmap(lane_start, (0, None))(rows, start)
        force = lanes(rows, states, first, first, late, nominal)[0]
        f = nominal.filter
        before = -jnp.linalg.solve(f.a, f.b + f.c)[:, None, None] * force[None]
        zero = jnp.zeros(force.shape)
        return states, before, force, zero, jnp.zeros((*force.shape, first.targets.shape[-1]))

    def advance(rows, carry, now, then, late, nominal):
        filt = nominal.filter

        def sample(carry, item):
            states, y, before, gg, ge = carry
            here, there, delayed = item
            force, direct, states = lanes(rows, states, here, there, delayed, nominal)
            y = jnp.tensordot(filt.a, y, 1) + filt.b[:, None, None] * before + filt.c[:, None, None] * force
            g = y[0] + direct
            gg = gg + here.weight * g * g
            ge = ge + here.weight * g[..., None] * here.targets
            return (states, y, force, gg, ge), None

        return jax.lax.scan(sample, carry, (now, then, late))[0]

    return begin, advance


def _ranked(case: Case, catalogue, grids, kept, sums, shared) -> list[Screened]:
    """Regress every form's strength on the fitted records; the error it leaves there and on the held-out ones."""
    q = shared[0].shape[-1]
    squares = []
    for s, c in zip(case.series, shared, strict=True):
        block = np.concatenate([s.error[:, None], c], -1)
        squares.append((block * s.weight[:, None]).T @ block)
    fitted = np.array([s.fitted for s in case.series])
    found = []
    for j in kept:
        form, points, rows = catalogue[j], grids[j], []
        for k, (values, start) in enumerate(points):
            per = [_gram(squares[r], sums[r][0][k, j], sums[r][1][k, j]) for r in range(len(sums))]
            fit = sum(p for p, f in zip(per, fitted, strict=True) if f) / fitted.sum()
            held = sum(p for p, f in zip(per, fitted, strict=True) if not f) / max((~fitted).sum(), 1)
            solution = _solve(fit, form, q)
            v = np.concatenate([[1.0], -solution])
            rows.append((float(v @ fit @ v), float(v @ held @ v), _scaled(form, values, start, solution[-1]), start))
        rows.sort(key=lambda r: r[0] if np.isfinite(r[0]) else np.inf)
        best = rows[0]
        found.append(Screened(form, best[2], best[3], best[0], best[1], tuple((r[0], r[2]) for r in rows)))
    return sorted(found, key=lambda s: s.train)


def _gram(square: np.ndarray, gg: float, ge: np.ndarray) -> np.ndarray:
    """Gram matrix of (e, c, g)."""
    size = len(square) + 1
    out = np.zeros((size, size))
    out[:-1, :-1], out[-1, -1] = square, gg
    out[:-1, -1] = out[-1, :-1] = ge
    return out


def _solve(gram: np.ndarray, form, q: int) -> np.ndarray:
    """Least squares of e on (c, g), the strength within what its sign and linearity allow."""
    h, b = gram[1:, 1:], gram[1:, 0]
    scale = np.sqrt(np.maximum(np.diag(h), 1e-30))
    solution = np.linalg.lstsq(h / np.outer(scale, scale), b / scale, rcond=1e-12)[0] / scale
    strength = form.PARAMETERS[0]
    linear = any(p.neutral is None for p in form.PARAMETERS) or not strength.positive
    low, high = (0.0, 30.0) if linear else (0.0, 1.6)
    if not strength.positive:
        low, high = -5.0, 5.0
    s = float(np.clip(solution[-1], low, high))
    if s != solution[-1]:
        rest = np.linalg.lstsq(h[:q, :q], b[:q] - s * h[:q, -1], rcond=1e-12)[0] if q else np.zeros(0)
        solution = np.append(rest, s)
    return solution


def _scaled(form, values, start: Start, strength: float) -> tuple[float, ...]:
    """The grid point with its strength regressed, inside its bounds."""
    first = values[0] * (strength if strength != 0 else 0.05)
    low, high = start.low[0], start.high[0]
    return (float(np.clip(first, low, high)), *values[1:])

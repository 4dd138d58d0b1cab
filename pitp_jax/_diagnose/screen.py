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
CHUNK = 2500  # samples of a compiled pass


@dataclass(frozen=True)
class Screened:
    """What one form, or two together, explain at their best grid points.

    Attributes:
        forms: one or two.
        values: their parameters there, strengths regressed.
        starts: bounds that go with them.
        train, heldout: mean squared error in (1 %)^2, pooled over records.
    """

    forms: tuple[type[AbstractEffect], ...]
    values: tuple[tuple[float, ...], ...]
    starts: tuple[Start, ...]
    train: float
    heldout: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return tuple(f.name for f in self.forms)


def grid(
    effect: type[AbstractEffect], starts: list[Start], count: int = POINTS
) -> list[tuple[tuple[float, ...], Start]]:
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
    points = [
        tuple(float(v) for v in p) for p in np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(axes))
    ]
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


def nuisance(case: Case, series: Series, refit: bool) -> np.ndarray:
    """Columns -G[a_i x^(i)] of the nominal's coefficients (refit), shape (T, Q)."""
    if not refit:
        return np.zeros((len(series.error), 0))
    a = np.asarray(case.model.coefficients, np.float64)
    return responses(case.model, case.dt, -a * series.motion)


@dataclass(frozen=True)
class Screening:
    """Gram matrices of (e, nuisance columns, one column per form and grid point) on both sides of the split.

    Attributes:
        points: (form, parameters, start) of every column.
        fitted, heldout: means over records, shape (1 + Q + M, 1 + Q + M).
        nuisance: Q.
    """

    points: tuple
    fitted: np.ndarray
    heldout: np.ndarray
    nuisance: int


def screen(case: Case, catalogue, *, refit: bool) -> Screening:
    """Every form of `catalogue` at its grid."""
    catalogue = tuple(c for c in catalogue if c.starts(case.surroundings))
    grids = [grid(c, c.starts(case.surroundings)) for c in catalogue]
    rows = np.zeros((LANES, sum(len(c.PARAMETERS) for c in catalogue)), np.float32)
    first = 0
    for c, g in zip(catalogue, grids, strict=True):
        for k in range(LANES):
            rows[k, first : first + len(c.PARAMETERS)] = g[min(k, len(g) - 1)][0]
        first += len(c.PARAMETERS)
    which = [(k, j) for j, g in enumerate(grids) for k in range(len(g))]
    points = tuple((catalogue[j], *grids[j][k]) for k, j in which)
    grams = _grams(case, tuple(c.neutral() for c in catalogue), rows, np.array(which).T, refit)
    fitted = np.array([s.fitted for s in case.series])
    inside = sum(g for g, f in zip(grams, fitted, strict=True) if f) / fitted.sum()
    outside = sum(g for g, f in zip(grams, fitted, strict=True) if not f) / max((~fitted).sum(), 1)
    return Screening(points, inside, outside if (~fitted).any() else inside, len(inside) - 1 - len(points))


def _grams(case: Case, effects, rows, which, refit: bool) -> list[np.ndarray]:
    """Per record the weighted Gram matrix of its columns, thinned to two dozen samples a natural period."""
    begin, advance = _compiled(case.model, effects)
    model, delays = case.model, [k for k, e in enumerate(effects) if isinstance(e, Delay)]
    filt = jax.tree.map(lambda v: np.asarray(v, np.float32), nominal_filter(model, case.dt))
    a = model.physical_coefficients
    nominal = Nominal(
        np.asarray(model.coefficients), np.asarray(model.scales.rates, np.float32), np.float32(model.scales.force),
        np.float32(0.1 / (a[0] / a[-1]) ** (1 / model.order)), filt, np.float32(case.dt),
    )  # fmt: skip
    thin = int(np.clip(2 * np.pi / case.surroundings.omega / case.dt / 24, 1, 20))

    def one(s: Series) -> np.ndarray:
        columns = Columns(*(v.astype(np.float32) for v in (s.motion, s.tokens, s.offset, s.voltage, s.run)))
        late = _delayed(columns.voltage, rows, effects, delays, s.rest, case.dt)
        start = (0.0 if s.rest else s.motion[0, 0], 0.0 if s.rest else s.voltage[0], s.age)
        carry = begin(rows, jax.tree.map(lambda v: v[0], columns), late[0], np.asarray(start, np.float32), nominal)
        found = []
        for first in range(0, len(s.error), CHUNK):
            now, then = (Columns(*(_window(v, first + k, CHUNK) for v in columns)) for k in (0, 1))
            carry, g = advance(rows, carry, now, then, _window(late, first, CHUNK), nominal)
            found.append(np.asarray(g)[-first % thin :: thin][:, which[0], which[1]])
        known = np.concatenate([s.error[:, None], nuisance(case, s, refit)], -1)[::thin]
        g = np.concatenate(found)[: len(known)]
        block = np.concatenate([known.astype(np.float32), g], -1) * np.sqrt(thin * s.weight[::thin, None]).astype(
            np.float32
        )
        return (block.T @ block).astype(np.float64)

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(one, case.series))


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
    force: np.float32
    blunt: np.float32
    filter: _Filter
    dt: np.float32


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


def _limits(form) -> tuple[float, float]:
    """What a column's factor may be: a strength of either sign, a linear one, or one the grid must come close to."""
    strength = form.PARAMETERS[0]
    if not strength.positive:
        return -5.0, 5.0
    return (0.0, 30.0) if strength.linear else (0.7, 1.4)


def _projected(gram: np.ndarray, q: int) -> np.ndarray:
    """The Gram matrix with the nuisance columns regressed out of everything: (e, M columns)."""
    keep = np.r_[0, np.arange(1 + q, len(gram))]
    if q == 0:
        return gram
    inner = np.linalg.pinv(gram[1 : 1 + q, 1 : 1 + q], rcond=1e-12)
    across = gram[np.ix_(keep, np.arange(1, 1 + q))]
    return gram[np.ix_(keep, keep)] - across @ inner @ across.T


def singles(found: Screening) -> list[Screened]:
    """Every form at its best grid point, best first by the error on fitted records."""
    g = _projected(found.fitted, found.nuisance)
    limits = np.array([_limits(p[0]) for p in found.points])
    strength = np.clip(g[0, 1:] / np.maximum(np.diag(g)[1:], 1e-30), *limits.T)
    train = g[0, 0] - 2 * strength * g[0, 1:] + strength**2 * np.diag(g)[1:]
    best: dict = {}
    for m in np.argsort(train):
        form = found.points[m][0]
        if form not in best:
            best[form] = _told(found, [m], [strength[m]])
    return sorted(best.values(), key=lambda s: s.train)


def pairs(found: Screening, count: int) -> list[Screened]:
    """The best pairs of different names, one per pair of names: all grid points against all, in closed form."""
    g = _projected(found.fitted, found.nuisance)
    low, high = np.array([_limits(p[0]) for p in found.points]).T
    b, h = g[0, 1:], g[1:, 1:]
    d = np.maximum(np.diag(h), 1e-30)
    determinant = np.maximum(np.outer(d, d) - h**2, 1e-9 * np.outer(d, d))
    first = (np.outer(b, d) - b[None] * h) / determinant  # strength of the row's column beside the column's
    left = g[0, 0] - first * b[:, None] - first.T * b[None]
    names = np.array([p[0].name for p in found.points])
    bad = (first < low[:, None]) | (first > high[:, None])
    left[bad | bad.T | (names[:, None] == names[None])] = np.inf
    left[np.tril_indices(len(left))] = np.inf
    best: dict = {}
    for flat in np.argsort(left, axis=None)[:200_000]:
        i, j = np.unravel_index(flat, left.shape)
        if not np.isfinite(left[i, j]) or len(best) >= count:
            break
        key = frozenset((names[i], names[j]))
        if key not in best:
            best[key] = _told(found, [i, j], [first[i, j], first[j, i]])
    return list(best.values())


def _told(found: Screening, columns, strengths) -> Screened:
    """The chosen columns with their strengths, and what they leave on either side."""
    q = found.nuisance
    v = np.zeros(len(found.fitted))
    v[0] = 1.0
    v[1 + q + np.asarray(columns)] = -np.asarray(strengths)
    if q:
        v[1 : 1 + q] = -np.linalg.lstsq(found.fitted[1 : 1 + q, 1 : 1 + q], found.fitted[1 : 1 + q] @ v, rcond=1e-12)[0]
    points = [found.points[m] for m in columns]
    return Screened(
        tuple(p[0] for p in points),
        tuple(_scaled(p[0], p[1], p[2], s) for p, s in zip(points, strengths, strict=True)),
        tuple(p[2] for p in points),
        float(v @ found.fitted @ v),
        float(v @ found.heldout @ v),
    )


def _scaled(form, values, start: Start, strength: float) -> tuple[float, ...]:
    """The grid point with its strength regressed, inside its bounds; as it is where the effect is not linear in it.

    A clip moved by its factor once left the voltages played, and with them every slope.
    """
    if not form.PARAMETERS[0].linear:
        return tuple(values)
    first = values[0] * (strength if strength != 0 else 0.05)
    return (float(np.clip(first, start.low[0], start.high[0])), *values[1:])

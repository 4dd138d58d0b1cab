"""Screening: every form of every effect at a grid of its parameters, in one pass over the records.

    e(t) = G [ f(x, x', z; p) ](t) + noise,    G = 1 / sum_i a_i s^i  (the nominal),   z' = h(z, x; p)

With the *measured* motion in f no rollout is needed: the effect's states have no feedback, G is a linear filter, and
lanes (grid points) hold every form at once. What each form explains follows by least squares on its strength (and, in
a refit, on the nominal's coefficients, whose columns are -G[a_i x^(i)]). Noise enters f only through the measured x,
0.3 % of range; the few forms that are left go on to whole rollouts (`fit`).
"""

from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np

from .._effects.spec import EffectSpec, Start
from .case import Case, Series
from .effect_responses import Columns, Nominal, compiled, nominal_filter, responses
from .regress import Screening

POINTS, LANES = 20, 24  # grid points of a form besides its starts, and in all
CHUNK = 2500  # samples of a compiled pass


def grid(effect: EffectSpec, starts: list[Start], count: int = POINTS) -> list[tuple[tuple[float, ...], Start]]:
    """Active parameter vectors: the strength as in the starts where it is linear, everything else spread out."""
    if not starts:
        return []
    free = [k for k, p in enumerate(effect.parameters) if p.off is None]
    first = starts[0]
    if not free:  # one number that may act nonlinearly
        p = effect.parameters[0]
        values = [s.values[0] for s in starts]
        if not p.positive:
            spread = [v * f for v in values for f in (0.3, 1.0, 2.5)]
        else:
            low, high = max(first.low[0], min(values) / 12), min(first.high[0], max(values) * 8)
            spread = np.geomspace(low, high, 12).tolist()
        spread = [float(np.clip(v, first.low[0], first.high[0])) for v in spread]
        return [((v, *first.values[1:]), first) for v in spread]
    axes = []
    for k in range(len(effect.parameters)):
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


def nuisance(case: Case, series: Series, refit: bool) -> np.ndarray:
    """Columns -G[a_i x^(i)] of the nominal's coefficients (refit), shape (T, Q)."""
    if not refit:
        return np.zeros((len(series.error), 0))
    a = np.asarray(case.model.coefficients, np.float64)
    return responses(case.model, case.dt, -a * series.motion)


def screen(case: Case, catalogue, factors: np.ndarray, *, refit: bool) -> Screening:
    """Every form of `catalogue` at its grid; `factors` are those of the case's nominal on the given one."""
    catalogue = tuple(c for c in catalogue if c.start(case.surroundings))
    grids = [grid(c, c.start(case.surroundings)) for c in catalogue]
    rows = np.zeros((LANES, sum(len(c.parameters) for c in catalogue)), np.float32)
    first = 0
    for c, g in zip(catalogue, grids, strict=True):
        for k in range(LANES):
            rows[k, first : first + len(c.parameters)] = g[min(k, len(g) - 1)][0]
        first += len(c.parameters)
    which = [(k, j) for j, g in enumerate(grids) for k in range(len(g))]
    points = tuple((catalogue[j], *grids[j][k]) for k, j in which)
    grams = _grams(case, tuple(c.neutral() for c in catalogue), rows, np.array(which).T, refit)
    fitted = np.array([s.fitted for s in case.series])
    inside = sum(g for g, f in zip(grams, fitted, strict=True) if f) / fitted.sum()
    outside = sum(g for g, f in zip(grams, fitted, strict=True) if not f) / max((~fitted).sum(), 1)
    return Screening(points, inside, outside if (~fitted).any() else inside, len(inside) - 1 - len(points), factors)


def _grams(case: Case, effects, rows, which, refit: bool) -> list[np.ndarray]:
    """Per record the weighted Gram matrix of its columns, thinned to two dozen samples a natural period."""
    begin, advance = compiled(case.model, effects)
    model, delays = case.model, [k for k, e in enumerate(effects) if e.delays]
    filt = jax.tree.map(lambda v: np.asarray(v, np.float32), nominal_filter(model, case.dt))
    nominal = Nominal(
        np.asarray(model.coefficients), np.asarray(model.scales.rates, np.float32), np.float32(model.scales.force),
        np.float32(0.1 / model.natural_frequency), filt, np.float32(case.dt),
    )  # fmt: skip
    thin = int(np.clip(2 * np.pi / case.surroundings.omega / case.dt / 24, 1, 20))

    def one(s: Series) -> np.ndarray:
        columns = Columns(*(v.astype(np.float32) for v in (s.motion, s.tokens, s.offset, s.voltage, s.run)))
        late = _delayed(columns.voltage, rows, effects, delays, s.rest, case.dt)
        start = (0.0 if s.rest else s.motion[0, 0], 0.0 if s.rest else s.voltage[0], s.age, s.reached)
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
        first = sum(len(e.spec.parameters) for e in effects[: delays[0]])
        place = np.arange(len(voltage))
        for k, time in enumerate(rows[:, first]):
            late[:, k] = np.interp(place - time / dt, place, voltage, left=0.0 if rest else voltage[0])
    return late

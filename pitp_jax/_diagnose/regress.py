"""Regression on the screening's Gram matrices: single forms and pairs, all grid points against all, in closed form.

train = v' G v,   v = (1, -c, -s),   s = H^-1 b within its bounds   (nuisance columns c projected out first)
"""

from dataclasses import dataclass

import numpy as np

from .._effects.spec import EffectSpec, Start

# what the regression may multiply a coefficient by
_CHANGE = (0.5, 2.0)


@dataclass(frozen=True)
class Screened:
    """What one form, or two together, explain at their best grid points.

    Attributes:
        forms: one or two.
        values: their parameters there, strengths regressed.
        starts: bounds that go with them.
        factors: on the given nominal's coefficients, regressed beside them in a refit, shape (n + 1,).
        train, heldout: mean squared error in (1 %)^2, pooled over records.
    """

    forms: tuple[EffectSpec, ...]
    values: tuple[tuple[float, ...], ...]
    starts: tuple[Start, ...]
    factors: np.ndarray
    train: float
    heldout: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return tuple(f.name for f in self.forms)


@dataclass(frozen=True)
class Screening:
    """Gram matrices of (e, nuisance columns, one column per form and grid point) on both sides of the split.

    Attributes:
        points: (form, parameters, start) of every column.
        fitted, heldout: means over records, shape (1 + Q + M, 1 + Q + M).
        nuisance: Q.
        factors: of the nominal screened around, on the given one's coefficients, shape (n + 1,).
    """

    points: tuple
    fitted: np.ndarray
    heldout: np.ndarray
    nuisance: int
    factors: np.ndarray


def _limits(form) -> tuple[float, float]:
    """What a column's factor may be: a strength of either sign, a linear one, or one the grid must come close to."""
    strength = form.parameters[0]
    if strength.linear:
        return (0.0 if strength.positive else -30.0), 30.0
    return (0.7, 1.4) if strength.positive else (-5.0, 5.0)


def projected(gram: np.ndarray, q: int) -> np.ndarray:
    """The Gram matrix with the nuisance columns regressed out of everything: (e, M columns)."""
    keep = np.r_[0, np.arange(1 + q, len(gram))]
    if q == 0:
        return gram
    inner = np.linalg.pinv(gram[1 : 1 + q, 1 : 1 + q], rcond=1e-12)
    across = gram[np.ix_(keep, np.arange(1, 1 + q))]
    return gram[np.ix_(keep, keep)] - across @ inner @ across.T


def singles(found: Screening) -> list[Screened]:
    """Every form at its best grid point, best first by the error on fitted records."""
    g = projected(found.fitted, found.nuisance)
    limits = np.array([_limits(p[0]) for p in found.points])
    strength = np.clip(g[0, 1:] / np.maximum(np.diag(g)[1:], 1e-30), *limits.T)
    train = g[0, 0] - 2 * strength * g[0, 1:] + strength**2 * np.diag(g)[1:]
    best: dict = {}
    for m in np.argsort(train):
        form = found.points[m][0]
        if form not in best:
            best[form] = _told(found, [m], [strength[m]])
    return sorted(best.values(), key=lambda s: s.train)


def pairs(found: Screening, count: int, within: frozenset[str] = frozenset()) -> list[Screened]:
    """The best pairs of different names, all grid points against all, in closed form.

    One per pair of names, or, `within` two names, one per pair of their forms.
    """
    g = projected(found.fitted, found.nuisance)
    low, high = np.array([_limits(p[0]) for p in found.points]).T
    b, h = g[0, 1:], g[1:, 1:]
    d = np.maximum(np.diag(h), 1e-30)
    determinant = np.maximum(np.outer(d, d) - h**2, 1e-9 * np.outer(d, d))
    first = (np.outer(b, d) - b[None] * h) / determinant  # strength of the row's column beside the column's
    left = g[0, 0] - first * b[:, None] - first.T * b[None]
    names = np.array([p[0].name for p in found.points])
    bad = (first < low[:, None]) | (first > high[:, None])
    left[bad | bad.T | (names[:, None] == names[None])] = np.inf
    if within:
        outside = ~np.isin(names, list(within))
        left[outside] = left[:, outside] = np.inf
    left[np.tril_indices(len(left))] = np.inf
    best: dict = {}
    for flat in np.argsort(left, axis=None)[:200_000]:
        i, j = np.unravel_index(flat, left.shape)
        if not np.isfinite(left[i, j]) or len(best) >= count:
            break
        key = frozenset(found.points[m][0] if within else names[m] for m in (i, j))
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
        found.factors * np.clip(1 + v[1 : 1 + q], *_CHANGE) if q else found.factors,
        float(v @ found.fitted @ v),
        float(v @ found.heldout @ v),
    )


def _scaled(form, values, start: Start, strength: float) -> tuple[float, ...]:
    """The grid point with its strength regressed, inside its bounds; as it is where the effect is not linear in it.

    A clip moved by its factor once left the voltages played, and with them every slope.
    """
    if not form.parameters[0].linear:
        return tuple(values)
    first = values[0] * (strength if strength != 0 else 0.05)
    return (float(np.clip(first, start.low[0], start.high[0])), *values[1:])

"""Fit a flexible black-box model: how much of an error can be predicted from the input.

    y - y_h = sum_j w_j phi_j,   ridge, its penalty chosen out of fold;   phi of the free run (x, v) of a hypothesis h

LG   low passes of the input, and the linear plant's own response to sixteen forces of x, v, u and six low passes of x
LSG  the same forces unfiltered besides
LV   low passes with the products of their leading principal components (Volterra)

Plays are excluded: a reference that contains a mechanism would explain that effect itself. The reference is a lower
bound, because forces along a run without friction cannot follow friction.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import bilinear_zpk, lfilter, zpk2tf

from .data import Case
from .evidence import Evidence, evidence
from .library import CORE, INDEX
from .search import Hypothesis

_PENALTIES = np.geomspace(1e-6, 1.0, 7)  # of features of unit deviation: from almost free to almost zero weights
_FAMILIES = ("LG", "LSG", "LV")
_TAUS = 8  # lags of the input, beside the input itself
_ROWS = 20_000  # rows that are fitted


def _lowpass(w: np.ndarray, dt: float, tau: float) -> np.ndarray:
    keep = np.exp(-dt / max(tau, 1e-12))
    # starts at the first value, because a start at zero would add a step that was not played
    return lfilter([1 - keep], [1, -keep], w - w[0]) + w[0]


def _bank(u: np.ndarray, dt: float, longest: float) -> list[np.ndarray]:
    # up to a quarter of the record, in which a lag still settles
    taus = (0.0, *np.geomspace(dt, longest / 4, _TAUS))
    return [_lowpass(w, dt, tau) for w in (u, u * u, np.abs(u)) for tau in taus]


def _forces(x: np.ndarray, v: np.ndarray, u: np.ndarray) -> list[np.ndarray]:
    return [
        x**2, x**3, np.abs(x), v * np.abs(v), np.tanh(v / 0.1), np.tanh(v / 0.02), x * v, np.abs(x) * v, x * x * v,
        u * x, u * u * x, u * v, np.maximum(x - 1, 0), np.minimum(x + 1, 0), np.sin(1.5 * x),
        np.sign(x) * np.sqrt(np.abs(x)),
    ]  # fmt: skip


def sampled(poly: np.ndarray, dt: float) -> tuple:
    """Return the filter of 1 / poly(s), highest power first, at intervals of dt (s): numerator, denominator."""
    return zpk2tf(*bilinear_zpk([], np.roots(poly), 1 / poly[0], 1 / dt))


class _Features:
    """Basis functions of a black-box model for every record, from the simulation of one hypothesis."""

    def __init__(self, case: Case, h: Hypothesis):
        drives = case.simulator.drives
        runs = case.simulator.run(np.tile(h.fit.slots, (len(drives), 1)), range(len(drives)), h.fit.starts)
        runs = [np.nan_to_num(r) for r in runs]
        self.longest = max(len(d.voltage) * d.dt for d in drives)
        top = max(np.abs(d.voltage).max() for d in drives)
        # one unit for all records, because they share the weights
        sx = np.std(np.concatenate(runs)) + 1e-12
        speeds = [np.gradient(r, d.dt) for r, d in zip(runs, drives, strict=True)]
        sv = np.std(np.concatenate(speeds)) + 1e-12
        a0, a1, a2 = (h.fit.slots[INDEX[k]] for k in CORE)
        # a plant without a spring has no static gain for the scale
        unit = a0 if a0 > 0 else a1 / case.dt / 100
        poly = np.trim_zeros(np.array([a2, a1, a0]) / unit, "f")
        self.parts: list[dict[str, list[np.ndarray]]] = []
        for run, speed, d in zip(runs, speeds, drives, strict=True):
            # the linear plant as a filter, so that a force appears as its motion
            b, a = sampled(poly, d.dt)
            # clipped, because powers of a run that diverges would decide the fit alone
            x, v, u = np.clip(run / sx, -8, 8), np.clip(speed / sv, -8, 8), d.voltage / top
            forces = _forces(x, v, u)
            slow = [_lowpass(x, d.dt, t) for t in np.geomspace(d.dt, self.longest / 4, 6)]
            answered = [np.clip(lfilter(b, a, f - f[0]), -1e3, 1e3) for f in (*forces, *slow)]
            self.parts.append({"L": _bank(u, d.dt, self.longest), "S": forces, "G": answered, "Z": [x, v]})

    def columns(self, family: str) -> list[np.ndarray]:
        """Return the basis functions of one family for every record, shape (T, functions)."""
        rows = [np.stack([c for letter in family if letter in p for c in p[letter]], 1) for p in self.parts]
        if "V" not in family:
            return rows
        banks = [np.stack([*p["L"], *p["Z"]], 1) for p in self.parts]
        whole = np.concatenate(banks)
        # 1e-3: a feature that never changes must not be magnified
        mean, sd = whole.mean(0), whole.std(0) + 1e-3
        # leading directions of the bank alone, because all products of thirty lags would be thousands of columns
        axes = np.linalg.svd(((whole - mean) / sd)[:: max(1, len(whole) // 3000)], full_matrices=False)[2].T[:, :8]
        spread = (((whole - mean) / sd) @ axes).std(0) + 1e-2
        products = []
        for row, bank in zip(rows, banks, strict=True):
            z = np.clip(((bank - mean) / sd) @ axes / spread, -4, 4)
            two = [z[:, i] * z[:, j] for i in range(8) for j in range(i, 8)]
            three = [z[:, i] * z[:, j] * z[:, k] for i in range(4) for j in range(i, 4) for k in range(j, 4)]
            products.append(np.concatenate([row, np.stack([*two, *three], 1)], 1))
        return products


def reference(case: Case, h: Hypothesis, floors: np.ndarray) -> Evidence:
    """Return the out-of-fold evidence of the best black-box model added to a hypothesis."""
    features, tried = _Features(case, h), []
    for family in _FAMILIES:
        tried += _ridge(case, h, features.columns(family), floors)
    return min(tried, key=lambda e: e.score)


def _ridge(case: Case, h: Hypothesis, columns: list[np.ndarray], floors: np.ndarray) -> list[Evidence]:
    """Return the out-of-fold evidence of a ridge regression with each penalty.

    Moments are computed once for every stretch of rows that belongs to the same folds; the fit without a fold adds its
    stretches.
    """
    folds, weights = range(len(case.folds)), 1 / np.sqrt(h.evidence.mse)  # records weigh as in the log score
    masks = [case.masks(fold) for fold in folds]
    bits = [np.sum([(m[k] > 0).astype(np.int64) << f for f, m in enumerate(masks)], 0) for k in range(len(columns))]
    # Neighbours are redundant: in a long case every n-th row is fitted, and all are scored.
    step = -(-sum(map(len, columns)) // _ROWS)
    moments = [_moments(x, y, b, step) for x, y, b in zip(columns, h.fit.residuals, bits, strict=True)]
    rows = [[np.full(len(s.output), np.nan) for s in case.series] for _ in _PENALTIES]
    for fold in folds:
        solved = _solved([[m for seen, m in parts.items() if seen >> fold & 1] for parts in moments], weights)
        if solved is None:
            continue
        w, size, low, high = solved
        for k, tested in enumerate(case.tested(fold)):
            if tested.any():
                x = columns[k][tested]
                # clipped to the fitted range, outside which a product of three grows without limit
                z = np.clip((x - x.mean(0)) / size, 1.5 * low - 1e-9, 1.5 * high + 1e-9)
                e = h.residuals[k][tested, None] - z @ w
                e = e - (0.0 if case.blocks > 1 else np.nanmean(e, 0))
                for i in range(len(_PENALTIES)):
                    rows[i][k][tested] = e[:, i]
    least = np.sqrt(h.evidence.least)
    return [evidence(r, np.sqrt(floors), least, case.blocks) for r in rows]


@dataclass(frozen=True)
class _Moments:
    """Sums over some rows of a record: count, x, x x', x y and y; and the smallest and largest x."""

    size: int
    x: np.ndarray
    xx: np.ndarray
    xy: np.ndarray
    y: float
    low: np.ndarray
    high: np.ndarray


def _moments(x: np.ndarray, y: np.ndarray, seen: np.ndarray, step: int) -> dict[int, _Moments]:
    """Sum every `step`-th row of a record, separately for each combination of folds (bits of `seen`)."""
    x, y, seen = x[::step], y[::step], (seen * np.isfinite(y))[::step]
    # about the record's own mean, because squares far from zero would cancel
    centred, parts = x - (x[seen > 0].mean(0) if (seen > 0).any() else 0.0), {}
    for bits in np.unique(seen[seen > 0]):
        a, b = centred[seen == bits], y[seen == bits]
        parts[int(bits)] = _Moments(len(a), a.sum(0), a.T @ a, a.T @ b, float(b.sum()), a.min(0), a.max(0))
    return parts


def _solved(records: list[list[_Moments]], weights: np.ndarray):
    """Solve the ridge regression for all penalties: weights, column scales, extremes; None without rows."""
    n, xx, xy, low, high = 0, 0.0, 0.0, np.inf, -np.inf
    for parts, w in zip(records, weights, strict=True):
        if not parts:
            continue
        size, x, y = sum(m.size for m in parts), sum(m.x for m in parts), sum(m.y for m in parts)
        mean = x / size  # every record is centred by itself
        n, xx = n + size, xx + w**2 * (sum(m.xx for m in parts) - np.outer(mean, x))
        xy = xy + w**2 * (sum(m.xy for m in parts) - mean * y)
        low = np.minimum(low, w * (np.min([m.low for m in parts], 0) - mean))
        high = np.maximum(high, w * (np.max([m.high for m in parts], 0) - mean))
    if not n:
        return None
    # unit deviation: one penalty for columns of any scale
    size = np.sqrt(np.maximum(np.diag(xx) / n, 0.0)) + 1e-9
    # factored once, for all penalties
    value, axes = np.linalg.eigh(xx / n / np.outer(size, size))
    aim = axes.T @ (xy / n / size)
    w = axes @ (aim[:, None] / (np.maximum(value, 0)[:, None] + _PENALTIES))
    return w, size, low / size / weights.min(), high / size / weights.min()

"""The reference: how much of an error a flexible model explains from the input, without a name for it.

    y - y_h = sum_j w_j phi_j,   ridge, its penalty chosen out of fold;   phi of the free run (x, v) of a hypothesis h

LG   low passes of the input, and the linear plant's own response to sixteen forces of x, v, u and six low passes of x
LSG  the same forces unfiltered besides
LV   low passes with the products of their leading principal components (Volterra)

No plays: a reference that holds a mechanism steals its name. It is a bar, not a ceiling: forces along a run that lacks
them cannot follow friction.
"""

import numpy as np
from scipy.signal import bilinear, lfilter

from .data import Case
from .evidence import Evidence, evidence
from .library import CORE, INDEX
from .search import Hypothesis

_PENALTIES = np.geomspace(1e-6, 1.0, 7)
_FAMILIES = ("LG", "LSG", "LV")
_TAUS = 8


def _lowpass(w: np.ndarray, dt: float, tau: float) -> np.ndarray:
    keep = np.exp(-dt / max(tau, 1e-12))
    # from the first value on: a start at zero would be a step that nobody played
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


class _Features:
    """Functions of every record, for one hypothesis."""

    def __init__(self, case: Case, h: Hypothesis):
        drives = case.simulator.drives
        runs = case.simulator.run(np.tile(h.fit.slots, (len(drives), 1)), range(len(drives)), h.fit.starts)
        runs = [np.nan_to_num(r) for r in runs]
        self.longest = max(len(d.voltage) * d.dt for d in drives)
        top = max(np.abs(d.voltage).max() for d in drives)
        # one unit for all records: weights are shared among them
        sx = np.std(np.concatenate(runs)) + 1e-12
        speeds = [np.gradient(r, d.dt) for r, d in zip(runs, drives, strict=True)]
        sv = np.std(np.concatenate(speeds)) + 1e-12
        a0, a1, a2 = (h.fit.slots[INDEX[k]] for k in CORE)
        # a plant without a spring has no static gain to scale by
        unit = a0 if a0 > 0 else a1 / case.dt / 100
        poly = [a2 / unit, a1 / unit, a0 / unit] if a2 > 0 else [a1 / unit, a0 / unit]
        self.parts: list[dict[str, list[np.ndarray]]] = []
        for run, speed, d in zip(runs, speeds, drives, strict=True):
            # the linear plant as a filter, so that a force is seen as the motion it makes
            b, a = bilinear([1.0], poly, 1 / d.dt)
            x, v, u = np.clip(run / sx, -8, 8), np.clip(speed / sv, -8, 8), d.voltage / top
            forces = _forces(x, v, u)
            slow = [_lowpass(x, d.dt, t) for t in np.geomspace(d.dt, self.longest / 4, 6)]
            answered = [np.clip(lfilter(b, a, f - f[0]), -1e3, 1e3) for f in (*forces, *slow)]
            self.parts.append({"L": _bank(u, d.dt, self.longest), "S": forces, "G": answered, "Z": [x, v]})

    def columns(self, family: str) -> list[np.ndarray]:
        """Shape (T, functions) of every record."""
        rows = [np.stack([c for letter in family if letter in p for c in p[letter]], 1) for p in self.parts]
        if "V" not in family:
            return rows
        banks = [np.stack([*p["L"], *p["Z"]], 1) for p in self.parts]
        whole = np.concatenate(banks)
        mean, sd = whole.mean(0), whole.std(0) + 1e-3
        # leading directions of the bank alone: all products of thirty lags would be thousands of columns
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
    """What the best family leaves of a hypothesis, out of fold."""
    features, tried = _Features(case, h), []
    for family in _FAMILIES:
        tried += _ridge(case, h, features.columns(family), floors)
    return min(tried, key=lambda e: e.score)


def _ridge(case: Case, h: Hypothesis, columns: list[np.ndarray], floors: np.ndarray) -> list[Evidence]:
    rows = [[np.full(len(s.output), np.nan) for s in case.series] for _ in _PENALTIES]
    # records weigh by what is left of them, as in the log score
    weights = 1 / np.sqrt(h.evidence.mse)
    for fold in range(len(case.folds)):
        xs, ys = [], []
        for k, mask in enumerate(case.masks(fold)):
            seen = (mask > 0) & np.isfinite(h.residuals[k])
            if seen.any():
                x = columns[k][seen]
                xs.append((x - x.mean(0)) * weights[k])
                ys.append((h.fit.residuals[k][seen] - h.fit.residuals[k][seen].mean()) * weights[k])
        if not xs:
            continue
        x, y = np.concatenate(xs), np.concatenate(ys)
        # unit deviation: one penalty for columns of any scale
        size = x.std(0) + 1e-9
        low, high = x.min(0) / size / weights.min(), x.max(0) / size / weights.min()
        # factored once, for all penalties
        value, axes = np.linalg.eigh(x.T @ x / len(x) / np.outer(size, size))
        aim = axes.T @ (x.T @ y / len(x) / size)
        for i, penalty in enumerate(_PENALTIES):
            w = axes @ (aim / (np.maximum(value, 0) + penalty))
            for k, tested in enumerate(case.tested(fold)):
                if tested.any():
                    # clipped beside what was seen in the fit: outside a product of three grows without end
                    z = (columns[k] - columns[k][tested].mean(0)) / size
                    e = h.residuals[k] - np.clip(z, 1.5 * low - 1e-9, 1.5 * high + 1e-9) @ w
                    rows[i][k][tested] = e[tested] - (0.0 if case.blocks > 1 else np.nanmean(e[tested]))
    least = np.sqrt(h.evidence.least)
    return [evidence(r, np.sqrt(floors), least, case.blocks) for r in rows]

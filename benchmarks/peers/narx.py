"""NARX: a polynomial of lagged outputs and forces predicts the next output; the free run feeds itself.

    y_{k+1} = theta' phi(y_k ... y_{k-n+1}, w_{k+1} ... w_{k-n+1}),   phi all monomials up to a degree,   w = u^2

Ridge regression of the increment y_{k+1} - y_k on one step. Step, lags, degree and ridge are those whose free run of
the training records is best, every record weighted by its range; what diverges is out.
"""

import sys
import time
from itertools import combinations_with_replacement, product
from math import comb

import numpy as np

from .grid import batch, make_grid

_FAR = 5.0
PERIODS, DEGREES, LAGS = (15, 25, 10, 40), (1, 2, 3, 4, 5), (2, 3, 4, 5)
MOST_TERMS = 800
RIDGES = np.geomspace(1e-13, 1e-3, 8)


def monomials(count: int, degree: int) -> list[tuple[int, ...]]:
    """Index tuples of all monomials of degree 1 ... degree."""
    return [c for d in range(1, degree + 1) for c in combinations_with_replacement(range(count), d)]


def features(regressors: np.ndarray, terms) -> np.ndarray:
    """Monomials of regressors (..., count), shape (..., terms); each one factor times an earlier one."""
    place, columns = {}, []
    for term in terms:
        column = regressors[..., term[-1]]
        columns.append(columns[place[term[:-1]]] * column if len(term) > 1 else column)
        place[term] = len(columns) - 1
    return np.stack(columns, -1)


def lagged(x: np.ndarray, lags: int) -> np.ndarray:
    """(x_k, x_{k-1}, ...) with rest before the record, shape (..., K, lags)."""
    pad = [(0, 0)] * (x.ndim - 1)
    return np.stack([np.pad(x, [*pad, (i, 0)])[..., : x.shape[-1]] for i in range(lags)], -1)


def forces(inputs: np.ndarray, lags: int) -> np.ndarray:
    """w_{k+1}, w_k, ... of every step, shape (..., K, lags + 1)."""
    return np.concatenate([inputs[..., 3:], lagged(inputs[..., 1], lags)], -1).astype(np.float64)


def simulate(theta: np.ndarray, terms, lags: int, w: np.ndarray) -> np.ndarray:
    """Free runs of several solutions (P, terms) from rest under forces (R, K, lags + 1), shape (P, R, K + 1).

    What leaves every range turns nan and stays so.
    """
    shape = len(theta), len(w)
    past, runs = np.zeros((*shape, lags)), np.zeros((*shape, w.shape[1] + 1))
    for k in range(w.shape[1]):
        force = np.broadcast_to(w[:, k], (*shape, lags + 1))
        phi = features(np.concatenate([past, force], -1), terms)
        now = past[..., 0] + np.matmul(phi, theta[..., None])[..., 0]
        now[np.abs(now) > _FAR] = np.nan
        if not np.isfinite(now).any():
            runs[..., k + 1 :] = np.nan
            break
        runs[..., k + 1] = now
        past = np.concatenate([now[..., None], past[..., :-1]], -1)
    return runs


def candidates(y, w, lags, degree):
    """Terms of one structure and its ridge solutions (P, terms), least penalty first."""
    terms = monomials(2 * lags + 1, degree)
    rows = np.concatenate([lagged(y, lags)[:, :-1], w], -1).reshape(-1, 2 * lags + 1)
    aim = np.diff(y, axis=1).ravel()
    gram, moment = np.zeros((len(terms), len(terms))), np.zeros(len(terms))
    for part in np.array_split(np.arange(len(rows)), max(1, len(rows) * len(terms) // 4_000_000)):
        phi = features(rows[part], terms)
        gram, moment = gram + phi.T @ phi, moment + phi.T @ aim[part]
    scale = 1 / np.sqrt(np.diag(gram))
    values, vectors = np.linalg.eigh(gram * scale * scale[:, None])
    inner = (vectors.T @ (moment * scale)) / (np.maximum(values, 0) + RIDGES[:, None])
    return terms, scale * (inner @ vectors.T)


def fit(nominal, records, seconds, key):
    """Search the structures, simplest first, until the time is over."""
    began, best = time.monotonic(), (np.inf,)
    for degree, lags, period in product(DEGREES, LAGS, PERIODS):
        if degree > 1 and time.monotonic() - began > seconds:
            break
        if comb(2 * lags + 1 + degree, degree) > MOST_TERMS:
            continue
        grid = make_grid(nominal, records, period)
        inputs, y, weight = batch(grid, records)
        y, w = y.astype(np.float64), forces(inputs, lags)
        terms, solutions = candidates(y, w, lags, degree)
        runs = simulate(solutions, terms, lags, w)
        costs = np.mean(((runs - y) * weight[:, None]) ** 2, (1, 2))
        costs = np.where(np.isfinite(costs), costs, np.inf)  # a run that diverged is no candidate
        pick = int(np.argmin(costs))
        if costs[pick] < best[0]:
            best = costs[pick], grid, terms, solutions[pick], lags
            error = 100 * costs[pick] ** 0.5
            print(f"  degree {degree}, lags {lags}, {period} a period: {error:.2f} %", file=sys.stderr)
    _, grid, terms, theta, lags = best

    def predict(record):
        w = forces(grid.inputs(record)[None], lags)
        return grid.restore(record, simulate(theta[None], terms, lags, w)[0, 0])

    return predict

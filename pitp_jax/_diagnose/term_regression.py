"""Sparse regression: which few functions of the motion and the drive make up the force a nominal lacks.

    e = x_nominal - x_measured = G[f],   f = sum_j c_j phi_j,   G = 1 / sum_i a_i s^i        (phi_j on measured motion)

G is linear and phi_j needs no rollout, so every subset's least squares is closed form in one Gram matrix. Thresholds
and the memory's time constant are columns on a grid. Subsets grow one function at a time, the best of each size going
on (beam search), columns nearly in the span of others left out.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from .._effects.found_term import KNEES, LIBRARY, NAMES, Values
from .case import Case, Series
from .effect_responses import responses
from .regress import projected
from .screen import nuisance

FIRST, SECOND = "max(x - a, 0)", "max(x - d, 0)"
_BEAM, _MOST = 40, 6  # subsets that go on from one size to the next; functions in one
_NEW = 1e-3  # of a column's energy that must be outside the span of the others
_PLACES = 9  # of a threshold


class Point(NamedTuple):
    """One column: a function and, where it has one, its knee."""

    name: str
    knee: float


class Subset(NamedTuple):
    """A sparse sum: its columns, their coefficients and the mean squared error left on fitted records, (1 %)^2."""

    points: tuple[Point, ...]
    strengths: tuple[float, ...]
    train: float


def subsets(case: Case, refit: bool) -> list[list[Subset]]:
    """The best sparse sums of one function, of two, and so on, each list best first and one per set of functions."""
    points = _points(case)
    blocks = [_block(case, s, points, refit) for s in case.fitted]
    gram = np.mean([b.T @ b for b in blocks], 0)
    q = len(gram) - 1 - len(points)
    return _grown(projected(gram, q), points)


def numbers(subset: Subset) -> list[float]:
    """A subset in the order of FOUND_TERM.parameters; knees that it lacks at one."""
    values = [0.0] * len(NAMES) + [1.0] * len(KNEES)
    for point, strength in zip(subset.points, subset.strengths, strict=True):
        values[NAMES.index(point.name)] = strength
        knee = LIBRARY[point.name].knee
        if knee is not None:
            values[len(NAMES) + knee] = point.knee
    return values


def _points(case: Case) -> list[Point]:
    """Every function, those with a knee at several places of it."""
    s, speeds = case.surroundings, np.concatenate([np.abs(r.motion[:, 1]) for r in case.series])
    forces = np.concatenate([np.abs(r.force) for r in case.series])
    inside = np.linspace(0.0, 1.0, _PLACES + 2)[1:-1]
    places = (
        s.bottom + inside * (s.top - s.bottom),
        np.quantile(speeds, (0.3, 0.5, 0.7, 0.9)),
        np.quantile(forces, (0.3, 0.5, 0.7, 0.9)),
        np.geomspace(0.3 / s.omega, max(0.5 * s.duration, 3 / s.omega), 7),
        s.bottom + inside[1:] * (s.top - s.bottom),
    )
    square, found = case.model.input_map.one_sided, []
    for f in LIBRARY.values():
        if (f.powers[3] == 0.5 and not square) or (f.inertial and case.model.order < 2):
            continue  # a root of a voltage with a sign, a mass where there is none
        found += [Point(f.text, float(p)) for p in (places[f.knee] if f.knee is not None else (0.0,))]
    return found


def evaluated(series: Series, points, dt: float) -> np.ndarray:
    """Functions along the measured motion of a record, shape (T, points)."""
    x, v = series.motion[:, 0], series.motion[:, 1]
    memories, columns = {}, []
    for name, knee in points:
        f = LIBRARY[name]
        if f.knee == 3 and knee not in memories:
            memories[knee] = _followed(x, knee, dt, series.rest)
        knees = [knee if k == f.knee else 1.0 for k in range(len(KNEES))]
        value = np.asarray(f.of(Values(x, v, series.force, memories.get(knee, x), knees)), np.float64)
        value = value * np.tanh(100 * v) if f.friction else value * series.motion[:, 2] if f.inertial else value
        columns.append(value)
    return np.stack(columns, 1)


def _followed(x: np.ndarray, tau: float, dt: float, rest: bool) -> np.ndarray:
    """Z of tau z' = x - z, x held over a sample."""
    keep = np.exp(-dt / tau)
    first = 0.0 if rest else x[0]
    return first + np.asarray(lfilter([1 - keep], [1, -keep], x - first))


def _block(case: Case, s: Series, points, refit: bool) -> np.ndarray:
    """Weighted columns (e, nuisance, responses) of a record, thinned to two dozen samples a natural period."""
    thin = int(np.clip(2 * np.pi / case.surroundings.omega / case.dt / 24, 1, 20))
    level = np.ones((len(s.error), int(refit)))  # the sensor's zero
    found = responses(case.model, case.dt, evaluated(s, points, case.dt))
    whole = np.concatenate([s.error[:, None], nuisance(case, s, refit), level, found], 1)[::thin]
    return whole * np.sqrt(thin * s.weight[::thin, None])


def _grown(g: np.ndarray, points: list[Point]) -> list[list[Subset]]:
    d = np.sqrt(np.maximum(np.diag(g)[1:], 1e-30))
    b, h = g[0, 1:] / d, g[1:, 1:] / np.outer(d, d)
    knees = np.array([-1 if (k := LIBRARY[p.name].knee) is None else k for p in points])
    places, names = np.array([p.knee for p in points]), np.array([p.name for p in points])
    beam, found = np.zeros((1, 0), int), []

    def before(rows, last):  # a second corner stands behind a first one
        return (names[rows] == FIRST) & (places[rows] < places[last])

    for _ in range(_MOST):
        rows = np.concatenate([np.repeat(beam, len(points), 0), np.tile(np.arange(len(points)), len(beam))[:, None]], 1)
        last = rows[:, -1:]
        clash = (names[rows[:, :-1]] == names[last]) | (
            (knees[rows[:, :-1]] == knees[last]) & (knees[last] >= 0) & (places[rows[:, :-1]] != places[last])
        )
        clash = clash.any(1) | ((names[last[:, 0]] == SECOND) & ~np.any(before(rows[:, :-1], last), 1))
        rows = np.unique(np.sort(rows[~clash], 1), axis=0)
        inner = h[rows[:, :, None], rows[:, None, :]]
        apart = np.linalg.eigvalsh(inner)[:, 0] > _NEW
        rows, inner = rows[apart], inner[apart]
        strength = np.linalg.solve(inner, b[rows][..., None])[..., 0]
        left = g[0, 0] - np.sum(strength * b[rows], 1)
        best: dict[tuple, int] = {}
        for k in np.argsort(left):
            best.setdefault(tuple(names[rows[k]]), int(k))
            if len(best) >= _BEAM:
                break
        chosen = list(best.values())
        found.append([
            Subset(tuple(points[m] for m in rows[k]), tuple(map(float, strength[k] / d[rows[k]])), float(left[k]))
            for k in chosen
        ])  # fmt: skip
        beam = rows[chosen]
        if not len(beam):
            break
    return found

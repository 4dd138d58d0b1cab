"""Find initial poles for the output-error fit without a frequency response: by ARX models, and on a grid.

    y_t + a_1 y_{t-1} + ... + a_n y_{t-n} = b_0 u_t + ... + b_n u_{t-n} + c       (least squares)
    p = log(z) / h,  z: roots of 1 + a_1 z^-1 + ...;      on means over 1, 4 and 16 samples, for slow modes

Noise biases these poles; the fit that starts from them removes the bias. Source: Ljung (1999), 7.3.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..signal.reduced import means
from .linear_ode import bounded, logs_from_roots, poles
from .output_error import FASTEST, OutputError, Problem, Structure

_GRID = 7
_APART = 0.3  # of a logarithm: nearer starts lead to the same minimum
_DELAYS = (0.5, 1.5, 4.0, 10.0)  # samples: starting values of the delay


def best_starts(structure: Structure, problem: Problem, roots: list[np.ndarray], most: int) -> list[np.ndarray]:
    """Return the best few initial parameters among these sets of poles (rad/s), with several delays if fitted.

    Without a spring, the input's offset at first balances its mean: the motion of a recording is bounded.
    """
    delays = [[np.log(delay * problem.dt)] for delay in _DELAYS] if structure.delayed else [[]]
    scored, mean = [], float(np.mean(np.concatenate(problem.drive)))
    for some in roots:
        if len(some) != structure.moved or not np.isfinite(some).all():
            continue
        logs = bounded(logs_from_roots(some), 0.0, 0.99 * FASTEST / problem.fine)
        logs = np.append(logs, [-mean] * structure.integrates)
        for delay in delays:
            params = np.append(logs, delay)
            scored.append((params, OutputError(params, structure, problem).cost))
    chosen: list[np.ndarray] = []
    for params, cost in sorted(scored, key=lambda s: s[1]):
        if np.isfinite(cost) and all(np.abs(params - other).max() > _APART for other in chosen):
            chosen.append(params)
    return chosen[:most]


def guesses(order: int, problem: Problem) -> list[np.ndarray]:
    """Return several initial guesses of the poles (rad/s) of a model of this order."""
    tried = [roots for size in (1, 4, 16) for late in (0, 2) for roots in _arx(order, problem, size, late)]
    grid = np.geomspace(4 * np.pi / problem.seconds, 1 / problem.dt, _GRID)
    if order == 1:
        tried += [-grid[k : k + 1] for k in range(_GRID)]
    if order == 2:
        tried += [w * np.array([-z + 1j * np.sqrt(1 - z * z), -z - 1j * np.sqrt(1 - z * z)])
                  for w in np.geomspace(grid[1], grid[-1], 16) for z in (0.1, 0.7)]  # fmt: skip
    if order >= 2:
        tried += [-np.geomspace(grid[a], grid[b], order) for a, b in ((0, 3), (2, 5), (3, 6), (0, 6))]
    return tried


def one_more(logs: np.ndarray) -> list[np.ndarray]:
    """Return sets of poles (rad/s) of the next higher order: the known poles plus one slower or faster pole."""
    known = poles(logs)
    size = np.abs(known)
    return [np.append(known, -pole) for pole in (0.1 * size.min(), 4.0 * size.max(), 15.0 * size.max())]


def _arx(order: int, problem: Problem, size: int, late: int) -> list[np.ndarray]:
    """Return the poles (rad/s) of an ARX model of means over `size` samples; none if it cannot be solved."""
    rows, targets = [], []
    for force, output, weight in zip(problem.forces, problem.output, problem.weight, strict=True):
        seen = np.flatnonzero(weight)
        filled = np.interp(np.arange(len(output)), seen, output[seen])
        force = np.append(np.full(late, force[0]), force)[: len(force)]
        u, y = means(force, size), means(filled, size)
        if len(y) <= 2 * order + 4:
            continue
        inputs, outputs = (sliding_window_view(series, order + 1) for series in (u, y))
        regressors, target = np.column_stack([inputs, -outputs[:, :-1]]), outputs[:, -1]
        rows.append(regressors - regressors.mean(0))
        targets.append(target - target.mean())
    if not rows or max(map(len, rows)) < 7 * order + 16:
        return []
    theta = np.linalg.lstsq(np.concatenate(rows), np.concatenate(targets), rcond=1e-12)[0]
    roots = np.roots(np.append(theta[order + 1 :], 1.0)[::-1])
    if len(roots) != order or not np.isfinite(roots).all() or (np.abs(roots) < 1e-9).any():
        return []
    # reflected at the unit circle: the same size at every frequency, and stable
    roots = np.where(np.abs(roots) >= 1, 0.999 * roots / np.abs(roots) ** 2, roots)
    slow = np.log(roots.astype(complex)) / (size * problem.dt)
    alternating = np.abs(np.abs(slow.imag) * size * problem.dt - np.pi) < 1e-6  # no real pole makes these
    return [np.where(alternating, -np.abs(slow), slow)]

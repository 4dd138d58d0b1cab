"""Does a second mass hang on the moved one? Looked for along measured motion, before any free run.

    F = sum_j c_j phi_j - kappa (r - x),   r'' = w^2 (x - r) - 2 zeta w r',   kappa > 0        (least squares)
    phi: 1, X_i, low powers and products of them, slow lags of x, F' and F'' (what a lag before the square does)
    left(w, zeta) = share that the pull kappa (x - r) leaves of the residual without it

A strong mode within the driven band is like none of the phi: 0.42 is left on a roll with one at 1.7 times its first
resonance. Where nothing hangs there the best (w, zeta) leaves 0.94 to 0.97 on twelve healthy actuators, and 0.71 to
0.97 beside strong effects of other kinds. A weak mode that leaves 0.76 (a cone's, 1 % of range in its second harmonic)
is not worth two more states: its free runs were no better for them.
"""

from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.signal import cont2discrete, lfilter, lfilter_zi

from ._record.preprocess import StateRecord

LEFT = 0.65  # at most that share for a second mass
WORTH = (
    0.006  # at least that share of the force, rms, for the pull: 0.012 on the roll; 0.003 beside a clean hard spring
)
_ROWS, _SAMPLES = 30_000, 400_000
_GRID, _DAMPING = 32, (0.003, 0.15)  # with more damping it is a lag
_FASTEST = 1.0  # w dt; beyond, what the filter and the drive between samples leave looks like a mode (Silverbox: 0.23)


def second_mass(
    states: Sequence[StateRecord], omega: float, lags: Float[np.ndarray, " lags"]
) -> tuple[float, float, float] | None:
    """Eigenfrequency (rad/s) and damping ratio of a mass hanging on the moved one, and what its pull leaves; or None.

    Args:
        states: filtered motion and force of every record.
        omega: the nominal's natural frequency, rad/s.
        lags: time constants of slow lags of x, s.
    """
    states = _first(states)
    if states[0].states.shape[1] < 3:
        return None  # at order 1 nothing moved has a mass
    basis, left_over, weigh = _without(states, lags)
    if basis is None:
        return None

    def left(place) -> float:
        w, zeta = np.exp(place)
        if not (low <= w <= high and _DAMPING[0] <= zeta <= _DAMPING[1]):
            return 1.0
        parts = _polynomials([w * w], [1, 2 * zeta * w, w * w], states[0].dt)
        pull = weigh(lambda s: s.states[:, 0] - _along(parts, s.states[:, 0]))
        pull = pull - basis @ (basis.T @ pull)
        gain = float(pull @ left_over)
        return 1 - gain**2 / max(float(pull @ pull) * float(left_over @ left_over), 1e-300) if gain > 0 else 1.0

    low, high = 0.2 * omega, min(20 * omega, 2 * np.pi * states[0].cutoff_hz, _FASTEST / states[0].dt)
    if low >= high:
        return None
    start = min(np.geomspace(low, high, _GRID), key=lambda w: left(np.log([w, 0.08])))
    found = minimize(left, np.log([start, 0.08]), method="Nelder-Mead", options={"maxiter": 60, "fatol": 1e-4})
    w, zeta = np.exp(found.x)
    inside = 1.01 * low < w < 0.99 * high  # at an edge it is the tail of something else
    whole = weigh(lambda s: s.force)
    worth = (1 - found.fun) * float(left_over @ left_over) >= WORTH**2 * float(whole @ whole)
    return (float(w), float(zeta), float(found.fun)) if inside and worth and found.fun <= LEFT else None


def _first(states: Sequence[StateRecord]) -> list[StateRecord]:
    """Records with samples to read; of very many, every so manieth."""
    states = [s for s in states if s.valid.any()]
    return states[:: max(sum(len(s.force) for s in states) // _SAMPLES, 1)]


def _without(states: Sequence[StateRecord], lags) -> tuple[np.ndarray | None, np.ndarray, Callable]:
    """An orthonormal basis of all phi, what it leaves of the force, and how a column is read from the records."""
    dt, order = states[0].dt, states[0].states.shape[1] - 1
    every = max(sum(int(s.valid.sum()) for s in states) // _ROWS, 1)
    rows = [np.flatnonzero(s.valid)[k % every :: every] for k, s in enumerate(states)]
    weight = [1 / max(float(np.ptp(s.force)), 1e-300) for s in states]  # every record counts alike

    def weigh(column: Callable[[StateRecord], np.ndarray]) -> np.ndarray:
        return np.concatenate([w * column(s)[at] for s, at, w in zip(states, rows, weight, strict=True)])

    scale = np.sqrt(np.mean(np.concatenate([s.states[at] ** 2 for s, at in zip(states, rows, strict=True)]), 0))

    def power(degrees: np.ndarray) -> Callable[[StateRecord], np.ndarray]:
        return lambda s: np.prod((s.states / scale) ** degrees, axis=1)

    one = np.eye(order + 1, dtype=int)
    degrees = [0 * one[0], *one, 2 * one[0], 3 * one[0], 4 * one[0], one[0] + one[-1], 2 * one[0] + one[-1]]
    for v in one[1:order]:
        degrees += [one[0] + v, 2 * one[0] + v, 2 * v, 3 * v, one[0] + 2 * v]
    columns = [weigh(power(d)) for d in degrees]
    for tau in lags:
        parts = _polynomials([1], [tau, 1], dt)
        columns.append(weigh(lambda s, p=parts: _along(p, s.states[:, 0]) / scale[0]))
        columns.append(weigh(lambda s, p=parts: _along(p, s.states[:, 0]) * s.states[:, 0] / scale[0] ** 2))
    columns.append(weigh(lambda s: np.gradient(s.force, dt)))
    columns.append(weigh(lambda s: np.gradient(np.gradient(s.force, dt), dt)))
    matrix, force = np.stack(columns, 1), weigh(lambda s: s.force)
    if len(force) < 10 * len(columns):
        return None, force, weigh
    vectors, sizes, _ = np.linalg.svd(matrix / np.maximum(np.sqrt((matrix**2).sum(0)), 1e-300), full_matrices=False)
    basis = vectors[:, sizes > 1e-9 * sizes[0]]
    return basis, force - basis @ (basis.T @ force), weigh


def _polynomials(numerator, denominator, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """A continuous filter as a discrete one, exact for an input linear between samples."""
    b, a, _ = cast(tuple, cont2discrete((numerator, denominator), dt, "foh"))
    return np.ravel(b), np.ravel(a)


def _along(parts: tuple[np.ndarray, np.ndarray], x: np.ndarray) -> np.ndarray:
    """The filter along x, settled at its first value."""
    return cast("tuple[np.ndarray, np.ndarray]", lfilter(*parts, x, zi=lfilter_zi(*parts) * x[0]))[0]

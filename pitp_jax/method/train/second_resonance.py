"""Test measured motion for a second mass attached to the moving one, before any simulation.

    F = sum_j c_j phi_j - kappa (r - x),   r'' = w^2 (x - r) - 2 zeta w r',   kappa > 0        (least squares)
    phi: 1, X_i, low powers and products of them, slow lags of x, F' and F'' (effect of a lag before the square)
    u(w, zeta) = 1 - (pull . residual)^2 / (|pull|^2 |residual|^2)       fraction not explained by the pull

residual: of F on the phi alone; pull: x - r less its projection on the phi. A strong mode within the excited band
resembles none of the phi (docs/decisions/second_resonance.md).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

import numpy as np
import scipy
from jaxtyping import Float

from ..signal.preprocess import StateRecord

UNEXPLAINED = 0.65  # largest u for a second mass
WORTH = 0.006  # smallest fraction of the force (rms) for the pull; smaller ones come from terms missing in phi


def second_mass(
    states: Sequence[StateRecord], omega: float, lags: Float[np.ndarray, " lags"]
) -> tuple[float, float, float] | None:
    """Return eigenfrequency (rad/s), damping ratio and unexplained fraction u of an attached mass; None without one.

    Args:
        states: filtered motion and force of every record.
        omega: the nominal's natural frequency, rad/s.
        lags: time constants of slow lags of x, s.
    """
    if states[0].states.shape[1] < 3:
        return None  # at order 1 the moving part has no mass
    seen = _rows(states)
    # above w dt = 1, errors of the filter and of the input between samples look like a mode
    low, high = 0.2 * omega, min(20 * omega, 2 * np.pi * states[0].cutoff_hz, 1 / states[0].dt)
    columns, force = _columns(seen, lags), seen.weight * seen.read(lambda s: s.force)
    if len(force) < 10 * columns.shape[1] or low >= high:
        return None
    # phi may hold one column twice (a slow lag and a constant), so only directions with data are projected out
    vectors, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    basis = vectors[:, sizes > 1e-9 * sizes[0]]
    residual = force - basis @ (basis.T @ force)
    energy = float(residual @ residual)

    def unexplained(place) -> float:
        w, zeta = np.exp(place)
        if not (low <= w <= high and 0.003 <= zeta <= 0.15):  # with more damping it is a lag
            return 1.0
        pull = seen.weight * (seen.displacement - seen.filtered([w * w], [1, 2 * zeta * w, w * w]))
        # the residual is orthogonal to the basis already, and of the pull's rest only the length is needed
        gain, along, whole = float(pull @ residual), basis.T @ pull, float(pull @ pull)
        rest = max(whole - float(along @ along), 1e-12 * whole)  # less is the rounding of a pull within the basis
        # kappa < 0 would be a mass that pushes: not an explanation, however well it fits
        return 1 - gain**2 / max(rest * energy, 1e-300) if gain > 0 else 1.0

    # a grid first, because no slope leads from one narrow mode to another
    start = min(np.geomspace(low, high, 32), key=lambda w: unexplained(np.log([w, 0.08])))
    best = scipy.optimize.minimize(
        unexplained, np.log([start, 0.08]), method="Nelder-Mead", options={"maxiter": 60, "fatol": 1e-4}
    )
    w, zeta = np.exp(best.x)
    inside = 1.01 * low < w < 0.99 * high  # at an edge it is the tail of something else
    worth = (1 - best.fun) * energy >= WORTH**2 * float(force @ force)
    return (float(w), float(zeta), float(best.fun)) if inside and worth and best.fun <= UNEXPLAINED else None


class _Rows(NamedTuple):
    """The samples that the test uses, with weights: every record counts by the range of its force."""

    states: list[StateRecord]
    places: list[np.ndarray]
    weight: np.ndarray

    def read(self, column: Callable[[StateRecord], np.ndarray]) -> np.ndarray:
        """Read the used samples of all records, one after another; `column` selects the series of a record."""
        return np.concatenate([column(s)[at] for s, at in zip(self.states, self.places, strict=True)])

    @property
    def displacement(self) -> np.ndarray:
        """Return the filtered displacement of all used samples."""
        return self.read(lambda s: s.states[:, 0])

    def filtered(self, numerator, denominator) -> np.ndarray:
        """Apply a continuous-time filter to the displacement, exact for straight lines between samples."""
        b, a, _ = cast(tuple, scipy.signal.cont2discrete((numerator, denominator), self.states[0].dt, "foh"))
        b, a = np.ravel(b), np.ravel(a)
        settled = scipy.signal.lfilter_zi(b, a)
        return self.read(
            lambda s: np.asarray(cast(tuple, scipy.signal.lfilter(b, a, x := s.states[:, 0], zi=settled * x[0]))[0])
        )


def _rows(states: Sequence[StateRecord]) -> _Rows:
    """Choose records with valid samples, and every n-th of these samples, so that both numbers stay limited."""
    some = [s for s in states if s.valid.any()]
    some = some[:: max(sum(len(s.force) for s in some) // 400_000, 1)]
    every = max(sum(int(s.valid.sum()) for s in some) // 30_000, 1)
    # each record from another first sample, because one grid on records of one input would sample the same phases
    places = [np.flatnonzero(s.valid)[k % every :: every] for k, s in enumerate(some)]
    spans = [max(float(np.ptp(s.force)), 1e-300) for s in some]
    return _Rows(some, places, np.repeat(1 / np.array(spans), [len(at) for at in places]))


def _columns(seen: _Rows, lags) -> Float[np.ndarray, "rows phi"]:
    """Compute the weighted basis functions phi at the used samples, each normalised to length one."""
    dt = seen.states[0].dt
    motion = seen.read(lambda s: s.states)
    motion = motion / np.sqrt(np.mean(motion**2, 0))
    x, highest = motion[:, 0], motion[:, -1]
    columns = [np.ones_like(x), *motion.T, x**2, x**3, x**4, x * highest, x**2 * highest]
    for v in motion[:, 1:-1].T:
        columns += [x * v, x**2 * v, v**2, v**3, x * v**2]
    for tau in lags:
        lag = seen.filtered([1], [tau, 1])
        columns += [lag, lag * x]
    slope = seen.read(lambda s: np.gradient(s.force, dt))
    bend = seen.read(lambda s: np.gradient(np.gradient(s.force, dt), dt))
    matrix = seen.weight[:, None] * np.stack([*columns, slope, bend], 1)
    return matrix / np.maximum(np.sqrt((matrix**2).sum(0)), 1e-300)

"""Predict the error on a recording that was not used for training, e_rms in % of range.

    window w of a recording:   s_w = std(x),   f_w = rms(x') / (2 pi s_w),   e_w = rms(x - x_measured)
    expected^2 = mean over the windows of a motion of   sum_i k_i e_i^2 / sum_i k_i
    log k_i = -(log2(f_w / f_i)^2 + log2(s_w / s_i)^2) / 2

x is the simulated motion; e_w contains the mean error. No law of amplitude is assumed: the error of a nonlinear spring
grows faster than the motion, that of friction or noise not at all.

An identified model keeps the errors on its own recordings, which are as large as those on others because it has few
coefficients (docs/decisions/coverage.md). A trained model keeps those of recordings left out of its training.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...common.metrics import rms
from ..signal.excited import Table
from .fitted import Fitted


class Expected(NamedTuple):
    """The error to expect on a new recording, e_rms in % of range, and its source in words."""

    percent: float
    source: str


def error_table(runs: Sequence[np.ndarray], errors: Sequence[np.ndarray], dt: float) -> Table:
    """Tabulate errors of simulated recordings by frequency and amplitude, in cells of a quarter octave.

    Args:
        runs: simulated displacement of each recording, base unit, shape (time,).
        errors: of each, nan where not measured, shape (time,).
        dt: sampling interval in s.

    Returns:
        a row for every cell: frequency (Hz), amplitude and rms error (base unit); empty without motion.
    """
    rows: list[tuple[float, float, float]] = []
    for run, error in zip(runs, errors, strict=True):
        for place, moves in zip(_windows(len(run)), _moves(run, dt), strict=True):
            seen = error[place][np.isfinite(error[place])]
            if 2 * len(seen) >= place.stop - place.start:
                rows.append((*moves, rms(seen)))
    table = np.array(rows).reshape(-1, 3)
    if not (table[:, 1] > 0).any():
        return ()
    table[:, :2] = _limited(table[:, :2], table[:, 1].max(), dt)
    return merged(table)


def merged(rows: Sequence[tuple[float, float, float]] | Float[np.ndarray, "rows three"]) -> Table:
    """Merge rows (Hz, amplitude, error) of one cell to their geometric mean and their rms error."""
    table = np.array(rows).reshape(-1, 3)
    if not len(table):
        return ()
    cells = np.round(4 * np.log2(table[:, :2]))
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    cells = []
    for k in range(int(cell.max()) + 1):
        some = table[cell.ravel() == k]
        hz, amplitude = np.exp(np.log(some[:, :2]).mean(0))
        cells.append((float(hz), float(amplitude), rms(some[:, 2])))
    return tuple(cells)


def expected_error(model: Fitted, displacement: np.ndarray, dt: float) -> Expected | None:
    """Return the expected error for a motion (base unit, shape (time,)); None if no error is known.

    Args:
        model: identified or trained.
        displacement: the motion; nan where the simulation diverged.
        dt: sampling interval in s.
    """
    origin, x = model.origin, displacement[np.isfinite(displacement)]
    step = origin.lineage[-1].get("step") if origin.lineage else None
    # an adaptation changes the error, so the stored one no longer holds
    if step not in ("identify", "fit", "diagnose") or not origin.errors or len(x) < 2 or not np.ptp(x) > 0:
        return None
    hz, amplitude, error = np.array(origin.errors).T
    f, s = _limited(np.array(_moves(x, dt)), amplitude.max(), dt).T[..., None]
    away = (np.log2(f / hz) ** 2 + np.log2(s / amplitude) ** 2) / 2
    near = np.exp(away.min(1, keepdims=True) - away)
    squares = (near * error**2).sum(1) / near.sum(1)
    errors = [v for v in ((origin.training or {}).get("left_out_errors") or {}).values() if v is not None]
    source = "from the recordings that it was made from, at similar frequencies and amplitudes"
    if step == "fit":
        source = (
            f"from {len(errors)} recordings, each left out of a training ({min(errors):.2g} to {max(errors):.2g} "
            "%), at similar frequencies and amplitudes"
        )
    return Expected(float(100 * np.sqrt(squares.mean()) / np.ptp(x)), source)


def _windows(samples: int) -> list[slice]:
    # 8 windows, of at least 64 samples each
    edges = np.linspace(0, samples, max(1, min(8, samples // 64)) + 1).astype(int)
    return [slice(a, b) for a, b in pairwise(edges)]


def _moves(run: np.ndarray, dt: float) -> list[tuple[float, float]]:
    """Return frequency (Hz; 0 without motion) and standard deviation of a motion in every window."""
    speed, strokes = np.gradient(run, dt), []
    for place in _windows(len(run)):
        size = float(np.std(run[place]))
        strokes.append((float(np.std(speed[place])) / (2 * np.pi * size) if size > 0 else 0.0, size))
    return strokes


def _limited(moves: Float[np.ndarray, "windows two"], largest: float, dt: float) -> Float[np.ndarray, "windows two"]:
    """Return frequencies and amplitudes with a lower limit, which a window without motion would not have."""
    hz, size = moves.T
    # 2 % of the largest amplitude: slower and smaller motions count as this
    # the frequency of a motion below the limit is that of its speed over the limit
    limited = np.maximum(size, 0.02 * largest)
    # above 0 Hz, because the cells are counted in octaves
    return np.stack([np.maximum(hz * size / limited, 1e-6 / dt), limited], 1)

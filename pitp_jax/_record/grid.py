"""Samples onto the uniform grid they were meant for: jitter of up to half a sample, and lost samples.

t_i = a + b k_i + e_i,    |e_i| <= b / 2,    k_i = 0, 1, 2, ... less the lost samples

a, b by least squares. The input is interpolated linearly and the output by monotone cubics; the output of a lost
sample is missing. A gap longer than a tenth of a period of the fastest drive (99 % of its energy lies below) splits the
record.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from .._errors import BadInput
from .checks import MIN_SAMPLES, TIME_TOLERANCE, line, refuse_time
from .preprocess import force_band

_HALF, _ROUNDING = 0.55, 1e-6  # of a sample: a half, and what the line may be off that was fitted to such times
_ROUNDED = 0.02  # of the rows: more of them lost, evenly spread, are no losses but a clock with few digits
_GAP = 0.1  # of a period of the fastest drive


@dataclass(frozen=True)
class Piece:
    """One uniform stretch of a record.

    Attributes:
        time, voltage, displacement: shapes (T,).
        lost: samples filled in.
    """

    time: np.ndarray
    voltage: np.ndarray
    displacement: np.ndarray
    lost: int = 0


@dataclass(frozen=True)
class Gridded:
    """A record on its grid.

    Attributes:
        pieces: in order, one where no gap is too long.
        jitter: largest distance of a time from the grid, in samples.
        dropped: samples of pieces too short to use, or without any output.
        doubled: rows that stood twice.
    """

    pieces: tuple[Piece, ...]
    jitter: float
    dropped: int = 0
    doubled: int = 0


def on_grid(
    time: np.ndarray,
    voltage: np.ndarray,
    displacement: np.ndarray,
    source: str,
    column: str,
    place: Callable[[int], str],
) -> Gridded:
    """Put samples on the uniform grid.

    Args:
        time: in s, finite, shape (T,).
        voltage: finite, shape (T,).
        displacement: nan where missing, shape (T,).
        source: file, for messages.
        column: name of the time column, for messages.
        place: turns a sample index into words.

    Raises:
        BadInput: time decreases, or is no grid with lost samples.
    """
    # a logger that writes a row twice shows no sample more
    kept = _once(time, voltage, displacement)
    doubled = len(time) - int(kept.sum())
    if doubled:
        time, voltage, displacement = time[kept], voltage[kept], displacement[kept]
    index, start, dt, jitter = _grid(time, source, column, place)
    lost = np.diff(index) - 1
    if jitter <= TIME_TOLERANCE + _ROUNDING and not lost.any():
        return Gridded((Piece(time, voltage, displacement),), jitter, doubled=doubled)
    # what the drive did in a longer gap cannot be interpolated
    cuts = np.flatnonzero(lost > _longest_gap(voltage, index, dt)) + 1
    pieces, dropped = [], 0
    for begin, end in zip((0, *cuts.tolist()), (*cuts.tolist(), len(time)), strict=True):
        if end - begin < MIN_SAMPLES:
            dropped += end - begin
            continue
        part = slice(begin, end)
        pieces.append(_piece(time[part], voltage[part], displacement[part], index[part], (start, dt), jitter))
    dropped += sum(len(piece.time) - piece.lost for piece in pieces if not np.isfinite(piece.displacement).any())
    pieces = [piece for piece in pieces if np.isfinite(piece.displacement).any()]
    if not pieces:
        raise BadInput(
            f"{source}: column {column!r}: split at its {len(cuts)} gaps no stretch of {MIN_SAMPLES} samples is left; "
            "record without gaps"
        )
    return Gridded(tuple(pieces), jitter, dropped, doubled)


def _once(time: np.ndarray, voltage: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """False for rows that repeat the row before in all cells, shape (T,).

    Only where no time repeats without them: a clock that is rounded repeats in other rows too.
    """
    same = [np.diff(time) == 0, np.diff(voltage) == 0]
    same.append((np.diff(displacement) == 0) | (np.isnan(displacement[1:]) & np.isnan(displacement[:-1])))
    kept = np.append(True, ~np.all(same, axis=0))
    return kept if (np.diff(time[kept]) > 0).all() else np.ones(len(time), bool)


def _grid(time, source, column, place) -> tuple[np.ndarray, float, float, float]:
    """Places on the grid, its start and step, the largest distance from it in samples.

    Lost samples must explain the times better than none lost do, or one time that is wrong would shift all after it.
    """
    steps = np.diff(time)
    if (steps < 0).any():
        refuse_time(time, source, column, place)
    index = np.arange(len(time))
    # equal times have no step
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    # 2.0 usual steps: one sample was lost
    moves = np.maximum(np.round(steps / usual), 1.0) if usual > 0 else np.ones(len(steps))
    trials = [index, np.append(0, np.cumsum(moves)).astype(np.int64)] if moves.sum() < 2**53 else [index]
    # One row lost in the middle of a long record stays within half a sample of a straight line: both are tried
    lines = [_distances(trial, time) for trial in trials]
    fits = [line for line in lines if line[3].max() <= _HALF + _ROUNDING]
    if not fits or np.mean(fits[0][3] ** 2) > np.mean(lines[0][3] ** 2):  # then one time that is wrong shifted the rest
        return refuse_time(time, source, column, place)
    # of two grids that fit, the one with the smaller rest
    best = min(fits, key=lambda line: float(np.mean(line[3] ** 2)))
    if best[0][-1] - index[-1] > _ROUNDED * len(time) and lines[0][3].max() * lines[0][2] <= (_HALF + 0.1) * usual:
        best = lines[0]  # a clock in whole ms at 700 Hz: steps of 1 and 2, each within half a ms of a straight line
    index, start, dt, off = best
    return index, start, dt, float(off.max())


def _distances(index: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, float, float, np.ndarray]:
    """Places, the start and step of their line, and how far every time is from it, in samples."""
    start, dt = line(index, time)
    off = np.abs(time - start - dt * index) / dt if dt > 0 else np.full(len(time), np.inf)
    return index, start, dt, off


def _longest_gap(voltage: np.ndarray, index: np.ndarray, dt: float) -> float:
    """Samples that may be lost in a row: a tenth of a period of the fastest drive.

    A drive with few lost samples is taken whole, since short stretches of a slow drive would look fast.
    """
    # fewer lost than seen
    if index[-1] < 2 * len(voltage):
        stretches = [np.interp(np.arange(index[-1] + 1), index, voltage)]
    else:
        stretches = np.split(voltage, np.flatnonzero(np.diff(index) > 1) + 1)
    moving = [part for part in stretches if len(part) > 8 and np.ptp(part) > 1e-6 * np.abs(part).max()]
    fastest = force_band(moving, dt) if moving else 0.0
    return min(_GAP / (fastest * dt), len(voltage) / 10) if fastest > 0 else len(voltage) / 10


def _piece(time, voltage, displacement, index, line, jitter) -> Piece:
    """One stretch on the grid a + b k."""
    start, dt = line
    where = index - index[0]
    grid = start + dt * (index[0] + np.arange(where[-1] + 1))
    output = np.full(len(grid), np.nan)
    # lost samples stay missing
    output[where] = displacement
    lost = len(grid) - len(time)
    # the grid may begin half a sample before the first time: nothing is extrapolated
    at = np.clip(grid, time[0], time[-1])
    if jitter <= TIME_TOLERANCE + _ROUNDING or (np.diff(time) <= 0).any():  # equal times: rounded, not measured, ones
        drive = np.interp(grid, start + dt * index, voltage)
    else:
        # monotone cubics overshoot no step, as splines would
        seen = np.isfinite(displacement)
        drive = np.interp(at, time, voltage)
        if seen.sum() > 1:
            output = np.where(
                np.isfinite(output), scipy.interpolate.PchipInterpolator(time[seen], displacement[seen])(at), np.nan
            )
    return Piece(grid, drive, output, lost)

"""Check that samples are usable before anything is computed from them.

|t_i - (a + b i)| <= 0.01 b for some straight line a + b i,    T >= 64,
u_i finite for all i,    y_i finite or nan (missing) and finite for at least one i
"""

from collections.abc import Callable
from typing import NoReturn

import numpy as np
import scipy

from ...common.errors import BadInput

MIN_SAMPLES = 64
TIME_TOLERANCE = 0.01  # of one sample
LATEST = 1e11  # s, 3170 years: later than any clock, including days since the year 0 (MATLAB)
_ROUNDING = 1e-6  # of one sample: rounding must not refuse an offset of exactly 1 %


def sample(index: int) -> str:
    """Describe a sample of a file without lines, for messages."""
    return f"sample {index}"


def check_samples(
    time: np.ndarray,
    voltage: np.ndarray,
    displacement: np.ndarray,
    source: str,
    columns: tuple[str, str, str] = ("time", "voltage", "displacement"),
    place: Callable[[int], str] = sample,
    *,
    uniform: bool = True,
    least: int = MIN_SAMPLES,
) -> None:
    """Refuse samples from which nothing can be computed.

    Args:
        time: sample times in s, shape (T,).
        voltage: input in V, shape (T,).
        displacement: output in m or V, shape (T,); nan where missing.
        source: file or record, for the message.
        columns: names of the three columns, for the message.
        place: converts a sample index (from 0) to words, for the message (`sample 7 (line 9)`).
        uniform: whether the times must be uniform already.
        least: required number of samples.

    Raises:
        BadInput: shapes differ, fewer than 64 samples, infinite values, missing input or time, no output at
            all, decreasing, repeated or non-uniform time; all of them in one message, each with its first sample.
    """
    _check_shapes((time, voltage, displacement), source, columns, least)
    problems = []
    for values, column in zip((time, voltage, displacement), columns, strict=True):
        bad = np.isinf(values)
        if bad.any():
            problems.append(
                f"column {column!r}, {place(_first(bad))}: infinite value; correct it or delete the row"
                + (" (an empty cell or nan marks a missing output)" if values is displacement else "")
            )
    missing = np.isnan(voltage)
    if missing.any():
        problems.append(
            f"column {columns[1]!r}, {place(_first(missing))}: the input is missing "
            f"({int(missing.sum())} of {len(voltage)} samples); split the recording into files without the gap"
        )
    if np.isnan(displacement).all():
        problems.append(
            f"column {columns[2]!r}, {place(0)} to {len(displacement) - 1}: every output sample is "
            "missing; leave this recording out, or choose another column with --output-column"
        )
    # an infinite time was reported above
    if not np.isinf(time).any():
        try:
            (check_time if uniform else _check_clock)(time, source, columns[0], place)
        except BadInput as error:
            problems.append(str(error).removeprefix(f"{source}: "))
    if problems:
        raise BadInput(f"{source}: {'; '.join(problems)}")


def check_wanted(
    time: np.ndarray,
    wanted: np.ndarray,
    source: str,
    columns: tuple[str, str] = ("time", "displacement"),
    place: Callable[[int], str] = sample,
) -> None:
    """Refuse a target with gaps; arguments as for `check_samples`, for any number of samples.

    Raises:
        BadInput: shapes differ, fewer than two samples, non-uniform time, a wanted sample missing or infinite.
    """
    _check_shapes((time, wanted), source, columns, least=2)
    check_time(time, source, columns[0], place)
    missing = ~np.isfinite(wanted)
    if missing.any():
        raise BadInput(
            f"{source}: column {columns[1]!r}, {place(_first(missing))}: the target is missing "
            f"({int(missing.sum())} of {len(wanted)} samples); fill the gap, because a target needs every sample"
        )


def _first(mask: np.ndarray) -> int:
    return int(np.argmax(mask))


def _check_shapes(arrays, source, columns, least):
    for values, column in zip(arrays, columns, strict=True):
        if values.ndim != 1:
            raise BadInput(
                f"{source}: column {column!r}, sample 0: the shape is {values.shape}, not one value per sample; store "
                "it as a vector"
            )
        if len(values) != len(arrays[0]):
            raise BadInput(
                f"{source}: column {column!r}, sample {min(len(values), len(arrays[0]))}: {len(values)} samples, but "
                f"{columns[0]!r} has {len(arrays[0])}; store columns of equal length"
            )
    count = len(arrays[0])
    if count < least:
        end = f"ends after sample {count - 1}" if count else "no samples"
        raise BadInput(
            f"{source}: column {columns[0]!r}: {end}, {count} in all; at least {least} are needed, so record more or "
            "leave it out"
        )


def _check_clock(time: np.ndarray, source: str, column: str, place: Callable[[int], str]) -> None:
    """Refuse missing times, and times beyond the range of any clock."""
    missing = np.isnan(time)
    if missing.any():
        raise BadInput(
            f"{source}: column {column!r}, {place(_first(missing))}: the time is missing; fill it in or split the "
            "recording there"
        )
    far = np.abs(time) > LATEST
    if far.any():
        raise BadInput(
            f"{source}: column {column!r}, {place(_first(far))}: {time[far][0]:.4g} s is not a possible time; correct "
            "it, or give --time-unit"
        )


def check_time(time: np.ndarray, source: str, column: str, place: Callable[[int], str]) -> None:
    """Refuse times that are missing, do not increase, or leave the uniform grid by more than 1 % of a sample.

    Args:
        time: sample times in s, shape (T,), at least two.
        source: file or record, for the message.
        column: name of the time column, for the message.
        place: turns a sample index into words.

    Raises:
        BadInput: with the first offending sample; for a gap or a dropped sample that is the one after it.
    """
    _check_clock(time, source, column, place)
    resolved = 2 * np.spacing(np.abs(time).max()) * (len(time) - 1) / max(float(np.ptp(time)), 1e-300)  # an epoch clock
    if (np.diff(time) <= 0).any() or _grid_offset(time).max() > TIME_TOLERANCE + _ROUNDING + resolved:
        refuse_time(time, source, column, place)


def refuse_time(time: np.ndarray, source: str, column: str, place: Callable[[int], str]) -> NoReturn:
    """Refuse times off a uniform grid, with the first sample that is off; arguments as for `check_time`.

    Raises:
        BadInput: with the first sample that decreases, repeats or jumps.
    """
    steps = np.diff(time)
    if (steps <= 0).any():
        at = _first(steps < 0 if (steps < 0).any() else steps <= 0) + 1
        how = "decreases" if steps[at - 1] < 0 else "repeats"
        raise BadInput(
            f"{source}: column {column!r}, {place(at)}: time {how} ({time[at - 1]:.9g} s, then {time[at]:.9g} s); "
            "sort the rows, or split them (--split-by COLUMN)"
        )
    # the usual step, whatever a gap adds
    typical, offset = float(np.median(steps)), _grid_offset(time)
    jumps = np.abs(steps / typical - 1.0) > 2 * TIME_TOLERANCE
    # drift has no jump: then the sample farthest from the grid
    at = _first(jumps) + 1 if jumps.any() else int(np.argmax(offset))
    raise BadInput(
        f"{source}: column {column!r}, {place(at)}: time is not uniform (step {steps[max(at - 1, 0)]:.6g} s instead "
        f"of {typical:.6g} s, up to {offset.max():.2g} samples off the grid); split the recording at the gap or "
        "resample it"
    )


def line(index: np.ndarray, time: np.ndarray) -> tuple[float, float]:
    """Fit the line a + b k to times by least squares; return a and b.

    Sums are faster here than BLAS with its threads.

    Args:
        index: k, shape (T,).
        time: in s, shape (T,).
    """
    middle, mean = index.mean(), time.mean()
    k, t = index - middle, time - mean
    b = float(np.sum(k * t) / np.sum(k * k))
    return mean - b * middle, b


def _grid_offset(time: np.ndarray) -> np.ndarray:
    """Return the distance of every time from the best uniform grid, in samples, shape (T,).

    The line through the ends is usually near enough. If it exceeds the tolerance, the largest distance is minimised, so
    that jitter of up to 1 % about any uniform grid passes.
    """
    index, dt = np.arange(len(time)), np.ptp(time) / (len(time) - 1)
    off = (time - time[0]) / dt - index
    most = max(off.max(), -off.min())
    if most > TIME_TOLERANCE:
        tilt = index / len(time)
        # the ends of the best line are at most as far from this one
        best = scipy.optimize.minimize_scalar(
            lambda shift: np.ptp(off - shift * tilt), bounds=(-2 * most, 2 * most), options={"xatol": 1e-9}
        )
        off = off - best.x * tilt
        off -= (off.max() + off.min()) / 2
    return np.abs(off)

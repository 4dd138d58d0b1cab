"""Find and mask sensor faults: spikes, dropouts and clipping.

spike     1 to 3 samples:  |y - chord between the neighbours| > 10 max(step_local, step),  then a return
dropout   a run of one value of a noisy sensor, entered and left by jumps;  or a value far outside all others
clipping  a run of the record's extreme value while the input moves and the sensor is noisy elsewhere

step is the median of the record's steps |y_i - y_(i-1)| that are not zero, step_local the largest of the five steps
about the samples in question with them cut out. White noise of deviation s has |y - chord| of deviation 1.2 s and a
step of 0.95 s, so that 10 steps are 8 deviations: once in 10^15 samples. A well sampled motion changes by about one
step per sample.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import scipy

from .initial_state import noise_std

_FAR, _LONGEST_SPIKE = 10.0, 3
_SHORTEST_CLIP, _MOVES = 8, 0.02  # samples; fraction of the input's range by which it must move in them
_NOISY = 0.05  # noise as a fraction of a step, at least; fraction of equal neighbours, at most, to recognise a limit
_NOISE_OF_STEP = 0.002  # noise of a good laser relative to the steps of its motion; rounding to six digits is below
_NOISE_OF_QUANTUM, _CHANCE = 0.5, 1e-6  # noise that changes a rounded reading; odds of a run by chance in a record
_JUMP, _JUMP_OF_RANGE = 5.0, 0.05  # of the usual step of the input, and of its range: a step of the input exceeds both
_OFTEN = 0.1  # of a record: a value held for longer is a machine at rest, not a sensor dropout
_FROZEN = 0.5  # of the input's range, swept at one output value: no motion is so slow
_FEWEST_VALUES = 32  # distinct ones; with fewer, a record is not a measured motion (two levels, a counter)


@dataclass(frozen=True)
class Masked:
    """An output without its faults.

    Attributes:
        displacement: nan where masked, shape (T,).
        outliers: samples masked as spikes or dropouts.
        clipped: samples masked at a limit value.
        largest: the most distant outlier, in the output's unit; nan without one.
        limit: the value at which it was clipped, or that of `unseen` samples; nan without one.
        unseen: off-scale samples that are kept, because they are more than half.
        held: samples that repeat one value while the input moves and then jump. They are kept, because they may be
            stiction.
        turns: whole turns removed earlier from the input and the output.
    """

    displacement: np.ndarray
    outliers: int = 0
    clipped: int = 0
    largest: float = np.nan
    limit: float = np.nan
    unseen: int = 0
    held: int = 0
    turns: tuple[int, int] = (0, 0)


def mask_faults(displacement: np.ndarray, voltage: np.ndarray) -> Masked:
    """Mask spikes, dropouts and clipping.

    Args:
        displacement: output, shape (T,); nan where missing.
        voltage: input, shape (T,).
    """
    seen = np.flatnonzero(np.isfinite(displacement))
    y = displacement[seen]
    steps = np.abs(np.diff(y))
    moving = steps[steps > 0]
    if len(moving) < _FEWEST_VALUES:
        return Masked(displacement)
    # only nonzero steps, because a quantised sensor mostly repeats its value
    step = float(np.median(moving))
    drive = voltage[seen]
    off_scale, jumps = _off_scale(y), _jumps(drive)
    # a response to a pulse looks like a spike, so only where the input did not step
    bad = off_scale | (_spikes(y, step) & ~jumps)
    certain, held = _stuck(y, step, drive)
    bad |= certain & ~jumps
    # stiction holds a machine at its turning points too
    clipped = _clipped(np.where(bad, np.nan, y), drive) & (held.mean() <= _OFTEN)
    held = int((held & ~jumps & ~bad & ~clipped).sum())
    # more than half cannot be outliers
    if 2 * bad.sum() > len(y):
        far = float(y[off_scale][0]) if off_scale.any() else np.nan
        return Masked(displacement, limit=far, unseen=int(off_scale.sum()))
    if not bad.any() and not clipped.any():
        return Masked(displacement, held=held)
    kept, off = displacement.copy(), y[bad]
    kept[seen[bad | clipped]] = np.nan
    largest = off[np.argmax(np.abs(off - np.median(y)))] if bad.any() else np.nan
    limit = y[clipped][0] if clipped.any() else np.nan
    return Masked(kept, int(bad.sum()), int(clipped.sum()), float(largest), float(limit), held=held)


def at_limit(displacement: np.ndarray, limits: Collection[float]) -> tuple[np.ndarray, float]:
    """Return the samples at a value at which other records of the same sensor are clipped, and that value (or nan).

    A sensor has one limit, so a limit found in one record applies to records that cannot show it alone.

    Args:
        displacement: output, shape (T,); nan where missing.
        limits: values at which others are clipped, in its unit.

    Returns:
        True at those samples, shape (T,), and the limit.
    """
    for value in {np.nanmax(displacement), np.nanmin(displacement)} & set(limits):
        bad = np.zeros(len(displacement), dtype=bool)
        for begin, end in _runs(displacement, _SHORTEST_CLIP // 2):
            bad[begin:end] = displacement[begin] == value
        if bad.any() and not bad.all():
            return bad, float(value)
    return np.zeros(len(displacement), dtype=bool), float("nan")


def _jumps(drive: np.ndarray) -> np.ndarray:
    """Return the samples near a step of the input, where the output responds and is not faulty, shape (T,)."""
    steps = np.abs(np.diff(drive, prepend=drive[:1]))
    far = steps > max(_JUMP * float(np.median(steps)), _JUMP_OF_RANGE * float(np.ptp(drive)))
    return scipy.ndimage.binary_dilation(far, iterations=_LONGEST_SPIKE + 3) if far.any() else far


def _spikes(y: np.ndarray, step: float) -> np.ndarray:
    """Return runs of one to three samples far from the chord between their neighbours, all on one side."""
    bad = np.zeros(len(y), dtype=bool)
    for run in range(1, _LONGEST_SPIKE + 1):
        count = len(y) - run - 5
        if count <= 0:
            break
        # only where the first sample of the run is that far off its chord: few places
        before, after = y[2 : 2 + count], y[run + 3 : run + 3 + count]
        at = np.flatnonzero(np.abs(y[3 : 3 + count] - before - (after - before) / (run + 1)) > _FAR * step)
        # three samples before the run and three after it, for every such place at once
        a, b, c, d, e, f = (y[at + k] for k in (0, 1, 2, run + 3, run + 4, run + 5))
        local = np.maximum.reduce([np.abs(p - q) for p, q in ((a, b), (b, c), (c, d), (d, e), (e, f))])
        bound = _FAR * np.maximum(local, step)
        off = [y[at + 3 + k] - c - (d - c) * (k + 1) / (run + 1) for k in range(run)]
        far = (np.minimum.reduce(off) > bound) | (np.maximum.reduce(off) < -bound)
        for k in range(run):
            bad[at[far] + 3 + k] = True
    return bad


def _off_scale(y: np.ndarray) -> np.ndarray:
    """Return samples at a value farther from all others than these are apart, as a laser reads without a target."""
    bad = np.zeros(len(y), dtype=bool)
    # sorted, and both ends are examined in turn
    values = np.unique(y)
    while len(values) > _FEWEST_VALUES:
        low, high = values[1] - values[0], values[-1] - values[-2]
        if min(low, high) > values[-2] - values[1] > 0:  # both ends of its range, such as +99.999 and -99.999
            bad |= (y == values[0]) | (y == values[-1])
            values = values[1:-1]
            continue
        if high > values[-2] - values[0]:
            bad |= y == values[-1]
            values = values[:-1]
        elif low > values[-1] - values[1]:
            bad |= y == values[0]
            values = values[1:]
        else:
            break
    return bad


def _runs(y: np.ndarray, least: int) -> list[tuple[int, int]]:
    """Return the first and one past the last sample of every run of equal values."""
    # where a run of equal values starts, and one past the last
    edges = np.flatnonzero(np.append(True, np.append(y[1:] != y[:-1], True)))
    long = np.flatnonzero(np.diff(edges) >= least)
    return [(int(edges[k]), int(edges[k + 1])) for k in long]


def _is_quiet(y: np.ndarray, steps: np.ndarray) -> bool:
    """Return whether a sensor's noise is negligible beside its nonzero steps, or never changes its last digit."""
    noise = float(noise_std(y))
    return noise <= _NOISE_OF_STEP * float(np.median(steps)) or noise < _NOISE_OF_QUANTUM * float(steps.min())


def _stuck(y: np.ndarray, step: float, drive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return runs of one value under a moving input: dropouts, and runs that may be stiction.

    A dropout is entered and left by jumps, or lasts for many samples, of a sensor whose neighbouring samples differ
    everywhere else, at rest too. For any other sensor a held value followed by a jump may be stiction. Runs that
    together exceed a tenth of the record may also be stiction, because a gear stands still at every reversal.

    Returns:
        dropouts, possible stiction: True at their samples, shape (T,).
    """
    bad, kept, swing = np.zeros(len(y), dtype=bool), np.zeros(len(y), dtype=bool), np.ptp(drive)
    runs = _runs(y, _LONGEST_SPIKE + 1)
    if not runs:
        return bad, kept
    # when the input jumps at the end of a run, the settled machine responds late
    noise = 6 * noise_std(drive)
    runs = [(b, e) for b, e in runs if np.ptp(drive[b : (b + e) // 2 + 1]) > noise]
    inside = np.zeros(len(y) - 1, dtype=bool)
    for begin, end in runs:
        # steps within the runs do not characterise the sensor elsewhere
        inside[begin : end - 1] = True
    if inside.all():
        return bad, kept
    # a coarse sensor repeats values while it works: its runs are not dropouts
    repeats = float(np.mean((y[1:] == y[:-1])[~inside])) >= _NOISY
    quiet = _is_quiet(np.where(np.append(inside, False), np.nan, y), np.abs(np.diff(y))[np.diff(y) != 0])
    low, high = y.min(), y.max()
    often = sum(e - b for b, e in runs if y[b] not in (low, high)) > _OFTEN * len(y)
    for begin, end in runs:
        # a machine that moved before stands still while its input sweeps half of its range: the sensor is frozen
        frozen = begin >= 3 and y[begin] not in (low, high) and np.ptp(drive[begin:end]) > _FROZEN * swing
        kept[begin:end] = frozen and end - begin >= _SHORTEST_CLIP and (end == len(y) or end - begin > _OFTEN * len(y))
        if begin < 3 or end > len(y) - 3 or end - begin > _OFTEN * len(y) or y[begin] in (low, high):
            continue
        # entered and left by jumps: far larger than the steps beside the run
        before, after = y[begin - 3 : begin], y[end : end + 3]
        local = max(np.abs(np.diff(before)).max(), np.abs(np.diff(after)).max(), step)
        near, far = sorted((abs(before[-1] - y[begin]), abs(after[0] - y[begin])))
        long = end - begin >= _SHORTEST_CLIP and np.ptp(drive[begin:end]) > _MOVES * swing
        if often:
            kept[begin:end] = True
        elif repeats or quiet:
            kept[begin:end] = long and far > _FAR * local
        else:
            bad[begin:end] = long or (far > _FAR * local and near > _FAR / 2 * local)
    return bad, kept


def _clipped(y: np.ndarray, voltage: np.ndarray) -> np.ndarray:
    """Return runs of the extreme value under a moving input, from a sensor whose noise would have ended them.

    p is how often neighbours are equal away from these runs (a record at its limit for most of the time has a median
    step of zero); a run of n has the probability p^(n - 1), and counts if that is below 1e-6 in the record.
    """
    bad = np.zeros(len(y), dtype=bool)
    low, high, swing = np.nanmin(y), np.nanmax(y), np.ptp(voltage)
    runs = [(b, e) for b, e in _runs(y, _SHORTEST_CLIP // 2) if y[b] in (low, high)]
    runs = [(b, e) for b, e in runs if np.ptp(voltage[b:e]) > _MOVES * swing]
    for begin, end in runs:
        bad[begin:end] = True
    steps = np.abs(np.diff(y))[~(bad[1:] & bad[:-1])]
    moving = steps[steps > 0]
    if not bad.any() or not len(moving):
        return np.zeros_like(bad)
    # how often neighbours are equal by chance
    p = float(np.mean(steps == 0))
    if p > 0.5 or _is_quiet(np.where(bad, np.nan, y), moving):
        return np.zeros_like(bad)  # without any noise it is a stop, or a slow motion
    # p^(n - 1) T < 1e-6, solved for n
    least = 1 + np.log(_CHANCE / len(y)) / np.log(max(p, 1e-4))
    for begin, end in runs:
        bad[begin:end] = end - begin >= least
    return bad

"""Mask the faults of a sensor: spikes, off-scale values and clipping; count samples at which it stands still.

spike      1 to 3 samples:  |y - chord between the neighbours| > 10 max(step_local, step),  then a return
off scale  a value far outside all others, as a laser reads without a target
clipping   a run of the record's extreme value while the input moves and the sensor is noisy elsewhere
standing   a run of another value while the input moves: kept, because it may be stiction

step is the median of the record's steps |y_i - y_(i-1)| that are not zero, step_local the largest of the five steps
about the samples in question with them cut out. White noise of deviation s has |y - chord| of deviation 1.2 s and a
step of 0.95 s, so that 10 steps are 8 deviations: once in 10^15 samples. A well sampled motion changes by about one
step per sample.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from ...method.signal.initial_state import noise_std

_FAR, _LONGEST_SPIKE = 10.0, 3  # times the steps around it, or the usual step; samples
_SHORTEST_CLIP, _MOVES = 8, 0.02  # samples; fraction of the input's range by which it must move in them
_NOISE_OF_STEP = 0.002  # noise of a good laser relative to the steps of its motion; rounding to six digits is below
_NOISE_OF_QUANTUM, _CHANCE = 0.5, 1e-6  # noise that changes a rounded reading; odds of a run by chance in a record
_JUMP, _JUMP_OF_RANGE = 5.0, 0.05  # of the usual step of the input, and of its range: a step of the input exceeds both
_OFTEN = 0.1  # of a record: runs of one value that are more frequent are stiction, so the extreme value is not a limit
_SWEPT = 0.5  # of the input's range, swept at one output value: no motion is so slow
_FEWEST_LEVELS = 8  # a motion over fewer of them is the resolution of the sensor, and its extremes are no limits
_FEWEST_VALUES = 32  # distinct ones; with fewer, a record is not a measured motion (two levels, a counter)


@dataclass(frozen=True)
class Masked:
    """An output with its sensor faults masked, and how many samples of each fault were found.

    Attributes:
        displacement: nan where masked, shape (T,).
        outliers: samples masked as spikes or off scale.
        clipped: samples masked at a limit value.
        largest: the most distant outlier, in the output's unit; nan without one.
        limit: the value at which it was clipped, or that of `unseen` samples; nan without one.
        unseen: off-scale samples that are kept, because they are more than half.
        held: samples that repeat one value while the input moves. They are kept, because they may be stiction.
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
    """Mask the sensor's spikes, off-scale values and clipping in an output.

    Args:
        displacement: output, shape (T,); nan where missing.
        voltage: input, shape (T,).
    """
    seen = np.flatnonzero(np.isfinite(displacement))
    y = displacement[seen]
    steps = np.abs(np.diff(y))
    moving = steps[steps > 0]
    if len(moving) < _FEWEST_VALUES or has_few(y, _FEWEST_LEVELS - 1):
        return Masked(displacement)
    # only nonzero steps, because a quantised sensor mostly repeats its value
    step = float(np.median(moving))
    drive = voltage[seen]
    off_scale, jumps = _off_scale(y), _jumps(drive)
    # a response to a pulse looks like a spike, so only where the input did not step
    bad = off_scale | (_spikes(y, step) & ~jumps)
    runs, clipped = _still_runs(y, drive), np.zeros(len(y), dtype=bool)
    # stiction holds a machine at its turning points too, where its extreme value is not a limit
    if sum(end - begin for begin, end in runs) <= _OFTEN * len(y):
        clipped = _clipped(np.where(bad, np.nan, y), drive)
    held = int((_standing(y, step, drive, runs) & ~jumps & ~bad).sum())
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


def has_few(values: np.ndarray, most: int) -> bool:
    """Return whether there are at most so many distinct values; the first ones often suffice."""
    return all(len(np.unique(some)) <= most for some in (values[: 100 * most], values))


def _jumps(drive: np.ndarray) -> np.ndarray:
    """Return the samples near a step of the input, where a fast output is a response and not a fault, shape (T,)."""
    steps = np.abs(np.diff(drive, prepend=drive[:1]))
    far = steps > _JUMP_OF_RANGE * float(np.ptp(drive))
    if far.any():
        far &= steps > _JUMP * float(np.median(steps))
    return scipy.ndimage.binary_dilation(far, iterations=_LONGEST_SPIKE + 3) if far.any() else far


def _spikes(y: np.ndarray, step: float) -> np.ndarray:
    """Return where one to three samples lie far from the chord between their neighbours, on one side, shape (T,)."""
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
    """Return where the output lies farther from all other values than these from each other, shape (T,).

    A laser reads such values without a target.
    """
    bad = np.zeros(len(y), dtype=bool)
    inner = y[(y > y.min()) & (y < y.max())]
    if len(inner) and max(inner.min() - y.min(), y.max() - inner.max()) <= np.ptp(inner):
        return bad
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
    """Return the first and one past the last sample index of every stretch of at least `least` equal values."""
    # where a run of equal values starts, and one past the last
    edges = np.flatnonzero(np.append(True, np.append(y[1:] != y[:-1], True)))
    long = np.flatnonzero(np.diff(edges) >= least)
    return [(int(edges[k]), int(edges[k + 1])) for k in long]


def _is_quiet(y: np.ndarray, steps: np.ndarray) -> bool:
    """Return whether the sensor's noise is negligible beside its nonzero steps or below its resolution."""
    noise = float(noise_std(y))
    return noise <= _NOISE_OF_STEP * float(np.median(steps)) or noise < _NOISE_OF_QUANTUM * float(steps.min())


def _still_runs(y: np.ndarray, drive: np.ndarray) -> list[tuple[int, int]]:
    """Return stretches of one output value while the input moves, except those at its largest or smallest value."""
    ends = y.min(), y.max()
    runs = [(b, e) for b, e in _runs(y, _LONGEST_SPIKE + 1) if b >= 3 and y[b] not in ends]
    noise = 6 * noise_std(drive) if runs else 0.0
    # a settled machine stands still until the input jumps at the end of a run, so the input must move early in it
    return [(b, e) for b, e in runs if np.ptp(drive[b : (b + e) // 2 + 1]) > noise]


def _standing(y: np.ndarray, step: float, drive: np.ndarray, runs: list[tuple[int, int]]) -> np.ndarray:
    """Return where the output stands still because of a sensor dropout or stiction, shape (T,).

    Noise would end a long run. A sensor without noise repeats values at a turning point: there, a run counts if it ends
    with a jump, or if the input sweeps half of its range meanwhile.
    """
    mask = _inside(runs, len(y))
    if not runs:
        return mask
    longest, swing = _longest_by_chance(y, mask), np.ptp(drive)
    for begin, end in runs:
        sweeps = end - begin >= _SHORTEST_CLIP and np.ptp(drive[begin:end]) > _SWEPT * swing
        around = np.abs(np.diff(y[begin - 3 : begin])), np.abs(np.diff(y[end : end + 3]))
        jump = abs(y[min(end, len(y) - 1)] - y[begin]) > _FAR * max(step, *np.concatenate(around))
        mask[begin:end] = end - begin > longest or sweeps or jump
    return mask


def _clipped(y: np.ndarray, voltage: np.ndarray) -> np.ndarray:
    """Return where the output is clipped: at its extreme value for longer than noise explains while the input moves."""
    low, high, swing = np.nanmin(y), np.nanmax(y), np.ptp(voltage)
    runs = [(b, e) for b, e in _runs(y, _SHORTEST_CLIP // 2) if y[b] in (low, high)]
    runs = [(b, e) for b, e in runs if np.ptp(voltage[b:e]) > _MOVES * swing]
    # without any noise it is a stop, or a slow motion
    longest = _longest_by_chance(y, _inside(runs, len(y))) if runs else np.inf
    return _inside([(b, e) for b, e in runs if e - b > longest], len(y))


def _inside(runs: list[tuple[int, int]], count: int) -> np.ndarray:
    """Return a mask that is True within these stretches, shape (count,)."""
    inside = np.zeros(count, dtype=bool)
    for begin, end in runs:
        inside[begin:end] = True
    return inside


def _longest_by_chance(y: np.ndarray, apart: np.ndarray) -> float:
    """Return the longest stretch (samples) of equal values that chance explains; infinite for a sensor without noise.

    p is the probability that neighbours are equal: observed outside the runs `apart`, and at least q / (2 sqrt(pi) s)
    for white noise s on a sensor of resolution q that stands still. A run of n has the probability p^(n - 1) and is
    explained above 1e-6 in the record:  p^(n - 1) T > 1e-6.
    """
    steps = np.abs(np.diff(y))[~(apart[1:] & apart[:-1])]
    moving, seen = steps[steps > 0], np.where(apart, np.nan, y)
    # a record at its limit for most of the time has a median step of zero
    if not len(moving) or _is_quiet(seen, moving):
        return np.inf
    p = max(float(np.mean(steps == 0)), float(moving.min()) / (2 * np.sqrt(np.pi) * noise_std(seen)), 1e-4)
    return np.inf if p > 0.5 else 1 + np.log(_CHANCE / len(y)) / np.log(p)

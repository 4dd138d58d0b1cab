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
    seen = np.isfinite(displacement)
    y = displacement[seen]
    steps = np.abs(np.diff(y))
    moving = steps[steps > 0]
    # a motion over at most 7 levels is the sensor's resolution: its extremes are not the ends of the range
    if len(moving) < _FEWEST_VALUES or has_few(y, 7):
        return Masked(displacement)
    # only nonzero steps, because a quantised sensor mostly repeats its value
    step = float(np.median(moving))
    drive = voltage[seen]
    off_scale, jumps = _off_scale(y), _jumps(drive)
    # a response to a pulse looks like a spike, so only where the input did not step
    bad = off_scale | (_spikes(y, steps, step) & ~jumps)
    runs = _runs(steps)
    still, clipped = _still_runs(y, drive, runs), np.zeros(len(y), dtype=bool)
    # frequent runs are stiction, which holds a machine at its turning points too: its extreme value is not a limit
    if runs and sum(end - begin for begin, end in still) <= 0.1 * len(y):
        clipped = _clipped(np.where(bad, np.nan, y), drive, runs)
    held = int((_standing(y, step, drive, still) & ~jumps & ~bad).sum())
    # more than half cannot be outliers
    if 2 * bad.sum() > len(y):
        far = float(next(iter(y[off_scale]), np.nan))
        return Masked(displacement, limit=far, unseen=int(off_scale.sum()))
    if not bad.any() and not clipped.any():
        return Masked(displacement, held=held)
    kept, off = displacement.copy(), y[bad]
    kept[np.flatnonzero(seen)[bad | clipped]] = np.nan
    largest = off[np.argmax(np.abs(off - np.median(y)))] if bad.any() else np.nan
    limit = next(iter(y[clipped]), np.nan)
    return Masked(kept, int(bad.sum()), int(clipped.sum()), float(largest), float(limit), held=held)


def has_few(values: np.ndarray, most: int) -> bool:
    """Return whether there are at most so many distinct values; the first ones often suffice."""
    return all(len(np.unique(some)) <= most for some in (values[: 100 * most], values))


def _jumps(drive: np.ndarray) -> np.ndarray:
    """Return the samples near a step of the input, where a fast output is a response and not a fault, shape (T,)."""
    steps = np.abs(np.diff(drive, prepend=drive[:1]))
    # a step of the input exceeds a part of its range and its usual step
    far = steps > 0.05 * float(np.ptp(drive))
    if far.any():
        far &= steps > 5 * float(np.median(steps))
    return scipy.ndimage.binary_dilation(far, iterations=_LONGEST_SPIKE + 3) if far.any() else far


def _spikes(y: np.ndarray, steps: np.ndarray, step: float) -> np.ndarray:
    """Return where one to three samples lie far from the chord between their neighbours, on one side, shape (T,)."""
    bad = np.zeros(len(y), dtype=bool)
    # a spike starts with a step almost as long as its distance from the chord: few places
    first = np.flatnonzero(steps[2:] > (_FAR - 1) * step)
    for run in range(1, _LONGEST_SPIKE + 1):
        at = first[first < len(y) - run - 5]
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
    least, most = y.min(), y.max()
    inner = y[(y > least) & (y < most)]
    if len(inner) and max(inner.min() - least, most - inner.max()) <= np.ptp(inner):
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


def _runs(steps: np.ndarray) -> list[tuple[int, int]]:
    """Return the first and one past the last sample index of every stretch of equal values longer than a spike."""
    # the first and the last sample of every stretch without a step
    ends = np.flatnonzero(np.diff(steps == 0, prepend=False, append=False)).reshape(-1, 2)
    return [(first, last + 1) for first, last in ends[ends[:, 1] - ends[:, 0] >= _LONGEST_SPIKE].tolist()]


def _is_quiet(y: np.ndarray, steps: np.ndarray) -> bool:
    """Return whether the sensor's noise is negligible beside its nonzero steps or below its resolution."""
    noise = float(noise_std(y))
    # 0.002: a good laser; rounding to six digits is below. Half a step: noise that changes a rounded reading.
    return noise <= 0.002 * float(np.median(steps)) or noise < 0.5 * float(steps.min())


def _still_runs(y: np.ndarray, drive: np.ndarray, runs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return stretches of one output value while the input moves, except those at its largest or smallest value."""
    ends = y.min(), y.max()
    runs = [(b, e) for b, e in runs if b >= 3 and y[b] not in ends]
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
        # no motion is so slow that it stands while the input sweeps half of its range
        sweeps = end - begin >= 8 and np.ptp(drive[begin:end]) > 0.5 * swing
        around = np.abs(np.diff(y[begin - 3 : begin])), np.abs(np.diff(y[end : end + 3]))
        jump = abs(y[min(end, len(y) - 1)] - y[begin]) > _FAR * max(step, *np.concatenate(around))
        mask[begin:end] = end - begin > longest or sweeps or jump
    return mask


def _clipped(y: np.ndarray, voltage: np.ndarray, runs: list[tuple[int, int]]) -> np.ndarray:
    """Return where the output is clipped: at its extreme value for longer than noise explains while the input moves."""
    low, high, swing = np.nanmin(y), np.nanmax(y), np.ptp(voltage)
    runs = [(b, e) for b, e in runs if y[b] in (low, high) and np.ptp(voltage[b:e]) > 0.02 * swing]
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
    # odds of such a run in a record
    return np.inf if p > 0.5 else 1 + np.log(1e-6 / len(y)) / np.log(p)

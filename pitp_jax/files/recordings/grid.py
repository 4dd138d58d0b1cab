"""Put samples on a uniform grid despite jitter, lost samples, arrival time stamps, or an uneven clock.

t_i = a + b k_i + e_i,    |e_i| <= b / 2,    k_i = 0, 1, 2, ... less the lost samples

a, b by least squares. The input is interpolated linearly and the output by monotone cubics; the output of a lost sample
is missing. Arrival time stamps come in packets: e_i is bounded by a packet. A clock without such a line is uneven: its
rows are resampled on the median step b,

u_k = 1/b int_{t_k}^{t_k + b} u(s) ds of the held command,    y_k = monotone cubic through the outputs at t_k

A gap longer than a tenth of a period of the fastest input (99 % of its energy lies below) splits the record.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from ...common.errors import BadInput
from ...method.signal.checks import MIN_SAMPLES, TIME_TOLERANCE, line
from ...method.signal.preprocess import force_band
from ..containers.held import mean_of_held
from .stamps import EVEN, FEW, Rows, average_stamps, evenness

_HALF, _ROUNDING = 0.55, 1e-6  # of a sample: the limit, and the error of a line fitted to times that reach it


@dataclass(frozen=True)
class Piece:
    """A stretch of a record on a uniform time grid.

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
    """A record on a uniform time grid, and how it was put there.

    Attributes:
        pieces: in order; one piece if no gap is too long.
        jitter: largest distance of a time from the grid, in samples; 0 after resampling.
        rows: the rows as read.
        dropped: samples of pieces too short to use, or without any output.
        packets: whether the stamps are arrival times.
        steps: shortest and longest step in s of a clock that was resampled, or None.
        uneven: whether that clock was uneven.
        bridged: output samples masked because they would be interpolated across more than a few rows.
    """

    pieces: tuple[Piece, ...]
    jitter: float
    rows: Rows
    dropped: int = 0
    packets: bool = False
    steps: tuple[float, float] | None = None
    uneven: bool = False
    bridged: int = 0

    def names(self, name: str) -> list[str]:
        """Return a name for every piece: `name`, or `name.1`, `name.2`, ... of several."""
        if len(self.pieces) == 1:
            return [name]
        return [f"{name}.{k}" for k in range(1, len(self.pieces) + 1)]


@dataclass(frozen=True)
class _Line:
    """Samples on a uniform grid: indices, start and step of the grid (s), distance of every time from it in samples."""

    index: np.ndarray
    start: float
    dt: float
    off: np.ndarray

    @property
    def time(self) -> np.ndarray:
        return self.start + self.dt * self.index


def on_grid(rows: Rows, rate: float | None = None) -> Gridded:
    """Put the rows of a recording on a uniform time grid.

    Args:
        rows: with a time that does not decrease.
        rate: samples per second of the grid, if the user states it.

    Raises:
        BadInput: time repeats or contradicts the signals, or too few rows remain.
    """
    line, packets = _grid(rows), False
    if line is None and (line := _packets(rows)) is not None:
        packets = True
        # the mean rate of packets is not exact
        if rate is not None and abs(line.dt * rate - 1.0) <= 0.03:
            line = replace(line, dt=1 / rate)
        elif rate is None and line.off.max() > 0.01 * len(rows.time):  # such late stamps do not determine the rate
            how = "repeats" if (np.diff(rows.time) == 0).any() else "comes in packets"
            raise BadInput(f"the time {how}; give --rate HZ")
    if line is None:
        try:
            single = _separate(rows)
        except BadInput:
            if rate is None:
                raise
            return on_grid(rows.counted_at(rate))
        if single is not rows:
            return on_grid(single, rate)
    elif rate is None or abs(line.dt * rate - 1.0) <= TIME_TOLERANCE:
        return replace(_put(rows, line), packets=packets)
    elif (np.diff(rows.time) == 0).any():
        return on_grid(rows.counted_at(rate))
    else:
        rows = replace(rows, time=line.time)
    return replace(_resampled(rows, rate), packets=packets, uneven=line is None)


def _separate(rows: Rows) -> Rows:
    """Return rows with strictly increasing times; rows of equal time are averaged.

    Raises:
        BadInput: most stamps repeat, or the signals contradict them.
    """
    single = rows if (np.diff(rows.time) > 0).all() else average_stamps(rows)
    if 2 * len(single.time) < len(rows.time) or len(single.time) < min(MIN_SAMPLES, len(rows.time)):
        raise BadInput("most rows repeat the time of the row before; give --rate HZ")
    if evenness(single) > np.log(10):  # even rows predict the signals so much better that the stamps are wrong
        raise BadInput(
            "the time is not uniform, but input and output are smooth from row to row, "
            "as if sampled evenly; give --rate HZ"
        )
    return single


def _grid(rows: Rows) -> _Line | None:
    """Fit a uniform grid to the times; return the sample indices on it, or None if no grid is within half a sample.

    Lost samples must explain the times better than no losses, because one wrong time would shift all later ones.
    """
    time, index = rows.time, np.arange(len(rows.time))
    straight = _fitted(index, time)
    if straight.off.max() <= TIME_TOLERANCE + _ROUNDING:  # one lost row is half a sample
        return straight
    steps = np.diff(time)
    if not (steps > 0).any():
        return None
    # equal times have no step
    usual = float(np.median(steps[steps > 0]))
    # 2.0 usual steps: one sample was lost
    moves = np.maximum(np.round(steps / usual), 1.0)
    lost = len(steps) < moves.sum() < 2**53
    lines = [straight]
    if lost:  # one row lost in the middle of a long record stays within half a sample of a straight line
        lines.append(_fitted(np.append(0, np.cumsum(moves)).astype(np.int64), time))
    fits = [line for line in lines if line.off.max() <= _HALF + _ROUNDING]
    if not fits or np.mean(fits[0].off ** 2) > np.mean(lines[0].off ** 2):  # one wrong time shifted the rest
        return None
    # of two grids that fit, the one with the smaller residual
    best = min(fits, key=lambda line: float(np.mean(line.off**2)))
    # more losses, evenly spread, mean a clock with few digits instead
    many = best.index[-1] - index[-1] > 0.02 * len(time)
    near = lines[0].off.max() * lines[0].dt <= (_HALF + 0.1) * usual
    # A clock in whole ms at 700 Hz, or lost rows: the signals decide; 2 / sqrt(T) are seven deviations of noise alone.
    return lines[0] if many and near and evenness(rows) > -2 / np.sqrt(len(time)) else best


def _fitted(index: np.ndarray, time: np.ndarray) -> _Line:
    """Fit a uniform grid through times at these sample indices by least squares."""
    start, dt = line(index, time)
    off = np.abs(time - start - dt * index) / dt if dt > 0 else np.full(len(time), np.inf)
    return _Line(index, start, dt, off)


def _packets(rows: Rows) -> _Line | None:
    """Return indices of evenly sampled rows whose time stamps are arrival times of packets; None for any other rows.

    The signals decide between even rows and true stamps. If they cannot, crowded stamps count as packets.
    """
    time = rows.time
    steps, mean = np.diff(time), np.ptp(time) / (len(time) - 1)
    if not mean > 0:
        return None
    long = steps[steps >= mean]
    # pauses in a recording are few and differ in length; packets crowd many stamps
    regular = len(long) >= 8 and np.quantile(long, 0.9) < 3 * np.quantile(long, 0.1)
    crowded = regular and (steps < mean / 3).mean() >= 0.4
    if evenness(rows) < (-EVEN if crowded else EVEN):
        return None
    # a lost packet leaves a gap of two periods
    period, ends = float(np.median(long)), np.flatnonzero(steps >= mean)
    size = float(np.median(np.diff(ends))) if len(ends) > 1 else 1.0
    lost = size * np.where(steps > 1.5 * period, np.round(steps / period - 1), 0.0)
    line = _fitted(np.arange(len(time)) + np.append(0, np.cumsum(lost)).astype(np.int64), time)
    return line if line.off.max() <= period / line.dt + 1 else None


def _put(rows: Rows, line: _Line) -> Gridded:
    """Put rows on a fitted grid, split where too many samples in a row were lost."""
    time, voltage, displacement, index = rows.time, rows.voltage, rows.displacement, line.index
    jitter = float(line.off.max())
    if jitter <= TIME_TOLERANCE + _ROUNDING and index[-1] < len(index):
        return Gridded((Piece(time, voltage, displacement),), jitter, rows)
    # the input in a longer gap cannot be interpolated
    cuts = np.flatnonzero(np.diff(index) - 1 > _longest_gap(voltage, index, line.dt)) + 1
    parts, dropped = _parts(rows, cuts)
    pieces = [_piece(time[p], voltage[p], displacement[p], index[p], line, jitter) for p in parts]
    return Gridded(tuple(pieces), jitter, rows, dropped)


def _parts(rows: Rows, cuts: np.ndarray, dt: float = 0.0) -> tuple[list[slice], int]:
    """Return the stretches between the cuts that are long enough to use, and the number of rows outside them.

    Args:
        rows: of the record.
        cuts: places of the first rows of stretches.
        dt: step of the grid in s: a stretch needs 64 rows and 64 such steps.

    Raises:
        BadInput: the stretches contain less than half of the rows.
    """
    count, kept = len(rows.time), []
    least = min(MIN_SAMPLES, count)  # a voltage to be played may have fewer rows
    for begin, end in zip((0, *cuts.tolist()), (*cuts.tolist(), count), strict=True):
        long = end - begin >= least and rows.time[end - 1] - rows.time[begin] >= (least - 1) * dt
        if long and np.isfinite(rows.displacement[begin:end]).any():
            kept.append(slice(begin, end))
    dropped = count - sum(part.stop - part.start for part in kept)
    if 2 * dropped > count or not kept:
        raise BadInput(
            f"{len(cuts)} gaps leave less than half of the rows in pieces of at least "
            f"{MIN_SAMPLES} samples; record without gaps"
        )
    return kept, dropped


def _longest_gap(voltage: np.ndarray, index: np.ndarray, dt: float) -> float:
    """Return how many samples may be lost in a row before the record is split: a tenth of the fastest input's period.

    An input with few lost samples is analysed as a whole, because short parts of a slow input would look fast.
    """
    # fewer lost than measured
    if index[-1] < 2 * len(voltage):
        stretches = [np.interp(np.arange(index[-1] + 1), index, voltage)]
    else:
        stretches = np.split(voltage, np.flatnonzero(np.diff(index) > 1) + 1)
    moving = [part for part in stretches if len(part) > 8 and np.ptp(part) > 1e-6 * np.abs(part).max()]
    fastest = force_band(moving, dt) if moving else 0.0
    # a tenth of a period of the fastest input
    return min(0.1 / max(fastest * dt, 1e-300), len(voltage) / 10)


def _piece(time, voltage, displacement, index, line: _Line, jitter) -> Piece:
    """Put one stretch on the grid a + b k; interpolate the input and mark lost outputs as missing."""
    start, dt = line.start, line.dt
    where = index - index[0]
    grid = start + dt * (index[0] + np.arange(where[-1] + 1))
    output = np.full(len(grid), np.nan)
    # lost samples stay missing
    output[where] = displacement
    lost = len(grid) - len(time)
    # Equal times are rounded, and times of arrival are late, so neither was measured.
    if jitter <= TIME_TOLERANCE + _ROUNDING or jitter > _HALF + _ROUNDING or (np.diff(time) <= 0).any():
        drive = np.interp(grid, start + dt * index, voltage)
    else:
        # the grid may start half a sample before the first time: nothing is extrapolated
        at = np.clip(grid, time[0], time[-1])
        # monotone cubics do not overshoot a step, as splines would
        seen = np.isfinite(displacement)
        drive = np.interp(at, time, voltage)
        if seen.sum() > 1:
            output = np.where(
                np.isfinite(output), scipy.interpolate.PchipInterpolator(time[seen], displacement[seen])(at), np.nan
            )
    return Piece(grid, drive, output, lost)


def _resampled(rows: Rows, rate: float | None) -> Gridded:
    """Resample rows at their median time step or at `rate` (Hz), split at gaps in which the input is unknown."""
    time, voltage = rows.time, rows.voltage
    steps = np.diff(time)
    usual = float(np.median(steps))
    dt = 1 / rate if rate is not None else usual
    index = np.round((time - time[0]) / usual).astype(np.int64)
    longest = max(FEW, _longest_gap(voltage, index, usual)) * usual
    # an input that is constant before and after a gap was held during it
    still = np.append(True, np.diff(voltage) == 0)
    held = still[:-1] & still[1:] & np.append(still[2:], True)
    parts, dropped = _parts(rows, np.flatnonzero((steps > longest) & ~held) + 1, dt)
    made = [_interpolated(time[p], voltage[p], rows.displacement[p], dt, FEW * usual) for p in parts]
    ends, bridged = (float(steps.min()), float(steps.max())), sum(count for _, count in made)
    if 2 * bridged > sum(len(piece.time) for piece, _ in made):
        raise BadInput(
            f"steps of {ends[0]:.3g} to {ends[1]:.3g} s are too irregular to resample; "
            "give --rate HZ if the rows were sampled evenly"
        )
    return Gridded(tuple(piece for piece, _ in made), 0.0, rows, dropped, steps=ends, bridged=bridged)


def _interpolated(time, voltage, displacement, dt: float, longest: float) -> tuple[Piece, int]:
    """Interpolate one stretch at steps of `dt` (s); return it and the number of output samples masked in gaps."""
    # 1e-12: rounding must not lose the last instant
    grid = time[0] + dt * np.arange(int((time[-1] - time[0]) / dt * (1 + 1e-12)) + 1)
    drive = mean_of_held(time, voltage, np.append(grid, grid[-1] + dt))
    seen = np.isfinite(displacement)
    t, y = time[seen], displacement[seen]
    if len(t) < 2:
        return Piece(grid, drive, np.full(len(grid), np.nan)), len(grid)
    curve = scipy.interpolate.PchipInterpolator(t, y)
    at = np.clip(grid, t[0], t[-1])
    output = curve(at)
    if dt > 1.5 * np.median(np.diff(t)):  # several rows a step: their mean, to avoid aliasing
        low, high = np.clip(grid - dt / 2, t[0], t[-1]), np.clip(grid + dt / 2, t[0], t[-1])
        whole = curve.antiderivative()
        output = np.where(high > low, (whole(high) - whole(low)) / np.maximum(high - low, 1e-300), output)
    # the rows around every instant
    after = np.clip(np.searchsorted(t, at, side="left"), 1, len(t) - 1)
    far = ((t[after] - t[after - 1] > longest) & (at > t[after - 1]) & (at < t[after])) | (np.abs(grid - at) > longest)
    output[far] = np.nan
    return Piece(grid, drive, output), int(far.sum())

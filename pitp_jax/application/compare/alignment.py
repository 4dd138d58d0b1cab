"""Align two recordings by their commands: the time lag, size ratio and sign at which the commands agree.

    rho(k) = sum_i (a_i - mean a) (b_{i+k} - mean b) / (T_k std a std b)      over the T_k samples that overlap at lag k
    offset = argmin_d sum_t (a(t) - s b(t - d))^2                             Gauss-Newton on interpolated samples

Of several lags that fit equally well (a sine repeats every period) the one with the longest overlap is taken. The sign
s is -1 for a mirrored axis: there the smallest rho counts in place of the largest.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import correlate

from ...method.signal.record import Record

ALIKE = 0.99  # correlation from which two commands count as equal


@dataclass(frozen=True)
class Alignment:
    """The agreement of one command with another: correlation, time offset, size ratio and difference.

    Attributes:
        correlation: of the two commands where they overlap; negative for a mirrored command.
        offset: clock of the first less clock of the second at the same instant, s.
        size: amplitude of the first over that of the second.
        misfit: standard deviation of the difference at that offset, over that of the first; after mirroring.
        shift, spread: mean of that difference, first less second, and the standard deviation of the first (base unit).
    """

    correlation: float
    offset: float
    size: float
    misfit: float
    shift: float = 0.0
    spread: float = 1.0

    @property
    def accepted(self) -> bool:
        """Return whether the two commands are equal except for time offset, sign and a tenth of their size."""
        return abs(self.correlation) >= ALIKE and abs(self.size - 1) <= 0.1


_NOTHING = Alignment(0.0, 0.0, np.inf, np.inf)


def align(a: Record, b: Record) -> tuple[Alignment, Alignment]:
    """Find the time offset at which two commands agree best, once with equal and once with opposite sign.

    All lags are tried on a common grid, then the best is refined between samples.

    Returns:
        the alignment with the same sign, and that with the opposite sign.
    """
    dt = max(a.dt, b.dt)
    longest = max(a.time[-1] - a.time[0], b.time[-1] - b.time[0])
    # the first search takes at most 8192 samples, because the peak is refined between samples anyway
    dt *= max(1, int(np.ceil(longest / dt / 8192)))
    x, y = (_on_grid(r, dt) for r in (a, b))
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return _NOTHING, _NOTHING
    lags, rho = _correlation(x, y)
    overlap = np.minimum(len(x), lags + len(y)) - np.maximum(0, lags)
    alignments = []
    for sign in (1, -1):
        signed = sign * rho
        # noise of a logged command changes a lag's correlation by as much
        good = np.flatnonzero(signed >= signed.max() - 2e-3)
        at = good[np.lexsort((-signed[good], -overlap[good]))[0]]
        # the peak with the longest overlap
        at = int(at + np.argmax(signed[max(at - 2, 0) : at + 3]) - min(at, 2))
        offset = float(a.time[0] - b.time[0] + lags[at] * dt)  # of clocks: lags count samples from both starts
        coarse = Alignment(float(rho[at]), offset, np.inf, np.inf)
        # half a sample of lag turns a sine of four samples a period by 45 degrees, whose cosine is 0.7
        alignments.append(_refined(a, b, coarse, sign) if signed[at] >= 0.7 else coarse)
    return alignments[0], alignments[1]


def _on_grid(record: Record, dt: float) -> np.ndarray:
    count = int((record.time[-1] - record.time[0]) / dt + 1e-9) + 1
    return np.interp(record.time[0] + dt * np.arange(count), record.time, record.voltage)


def _correlation(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Correlate two commands at all lags with enough overlap; return lags k (x_i beside y_{i-k}) and correlations."""
    lags = np.arange(-(len(y) - 1), len(x))
    low, high = np.maximum(0, lags), np.minimum(len(x), lags + len(y))
    # at least half of the shorter recording
    enough = (high - low) >= 0.5 * min(len(x), len(y))
    lags, low, high = lags[enough], low[enough], high[enough]
    x, y = x - x.mean(), y - y.mean()
    cross = correlate(x, y, method="fft")[enough]
    count = high - low

    def sums(values, first, last):  # over any part, as a difference of two cumulative sums
        total = np.concatenate([[0.0], np.cumsum(values)])
        return total[last] - total[first]

    sx, sxx = sums(x, low, high), sums(x * x, low, high)
    sy, syy = sums(y, low - lags, high - lags), sums(y * y, low - lags, high - lags)
    spread = np.maximum(sxx - sx**2 / count, 0) * np.maximum(syy - sy**2 / count, 0)
    # a part in which hardly anything moves correlates with everything
    moving = spread > 0.05 * (x @ x) * (y @ y)
    rho = np.where(moving, (cross - sx * sy / count) / np.sqrt(np.where(moving, spread, 1.0)), 0.0)
    return lags, rho


def _refined(a: Record, b: Record, coarse: Alignment, sign: int) -> Alignment:
    """Refine the time offset of two commands between samples, and measure how much they differ there."""
    step, offset = max(a.dt, b.dt), coarse.offset
    for _ in range(8):
        inside, x, y = _overlap(a, b, offset, sign)
        if inside.sum() < 8:
            return _NOTHING
        slope = np.gradient(y, a.dt)
        # a step of at most a sample, because the peak is that near, and a square wave has no usable slope
        move = float(np.clip(-((x - x.mean() - y + y.mean()) @ slope) / max(slope @ slope, 1e-300), -step, step))
        offset += move
        if abs(move) < 1e-6 * step:
            break
    _, x, y = _overlap(a, b, offset, sign)
    x_, y_ = x - x.mean(), y - y.mean()
    if not (np.any(x_) and np.any(y_)):
        return _NOTHING
    rho = float(x_ @ y_ / np.sqrt((x_ @ x_) * (y_ @ y_)))
    size = float(np.sqrt((x_ @ x_) / (y_ @ y_)))
    spread, shift = float(x_.std()), float(x.mean() - y.mean())
    misfit = float((x_ - y_).std()) / spread
    return Alignment(sign * max(rho, abs(coarse.correlation)), offset, size, misfit, shift, spread)


def _overlap(a: Record, b: Record, offset: float, sign: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    at = a.time - offset
    inside = (at >= b.time[0]) & (at <= b.time[-1])
    return inside, a.voltage[inside], sign * np.interp(at[inside], b.time, b.voltage)

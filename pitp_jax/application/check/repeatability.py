"""Estimate the noise floor of records with a periodic input from the scatter between cycles.

    sigma^2 = mean over a window of  (e(t + P) - e(t))^2 / 2        where  u(t + P) = u(t)

A model's error repeats with the input and cancels; noise does not, nor does the scatter of the rig. Slow errors (creep,
drift) and transients remain in part, so this is an upper bound, like the spectrum's. A Peano-HASEL in bursts of sines
has such broad lines that the spectrum between them gave 3.7 % of range; its cycles repeat to 0.1 %.
"""

import numpy as np

from ...method.signal.excitation_kind import spectrum
from ...method.signal.record import Record

_FEWEST = 3  # windows of two periods, at least


def repeat_scatter(record: Record, error: np.ndarray, counts: np.ndarray) -> float | None:
    """Return the squared scatter of an error between cycles of the input; None if the input does not repeat."""
    u = record.voltage
    period = _period(record)
    # too few samples of a period, or periods of a record, to compare
    if not 8 <= period <= len(u) / (2 * _FEWEST):
        return None
    # the period is known to a sample or two after several of them, at most 8
    lags = {round(k * period) + d for k in range(1, 9) for d in (-2, -1, 0, 1, 2)}
    inputs, errors = ((values, np.gradient(values)) for values in (u, error))
    rows = [_at(inputs, errors, counts, lag, int(np.ceil(2 * period))) for lag in sorted(lags)]
    rows = [row for row in rows if row is not None]
    best = min((apart for apart, _ in rows), default=np.inf)
    # of the lags at which the input repeats about as well as at the best
    return max((level for apart, level in rows if apart <= 1.5 * best), default=None)


def _period(record: Record) -> float:
    """Return the period (samples) of the input's strongest Fourier line, interpolated by a parabola."""
    size = spectrum(record)
    k = int(np.argmax(size[1:-1])) + 1
    a, b, c = np.log(np.maximum(size[k - 1 : k + 2], 1e-300))
    # vertex of the parabola through three points, in lines
    shift = 0.5 * (a - c) / min(a - 2 * b + c, -1e-12)
    return record.samples / (k + float(np.clip(shift, -0.5, 0.5)))


def _at(u, error, counts, lag: int, size: int) -> tuple[float, float] | None:
    """Return the input's difference after `lag` samples (over its deviation), and half the error's mean square change.

    Both are medians over windows; None if too few windows repeat.
    """
    count = (len(counts) - lag) // size
    if count < _FEWEST:
        return None

    def windows(values):
        return values[: count * size].reshape(count, size)

    both = windows(counts[lag:] & counts[:-lag])
    spread = windows(u[0]).std(1)
    change, more = (windows(v) for v in _change(u, lag))
    apart = np.sqrt(_square(change, more, np.ones_like(both))) / np.maximum(spread, 1e-30)
    # the input repeats there, it moves, and half was observed
    good = (apart < 0.03) & (spread > 0.1 * spread.max()) & (both.mean(1) > 0.5)
    if good.sum() < _FEWEST:
        return None
    change, more = (windows(v) for v in _change(error, lag))
    return float(np.median(apart[good])), float(np.median(_square(change, more, both)[good]))


def _change(series, lag: int):
    """Return the change of a series after `lag` samples, and its derivative by a fraction of a sample."""
    values, slope = series
    return values[lag:] - values[:-lag], slope[:-lag]


def _square(change, more, counts):
    """Return half the mean square of a change in every window, without the part that a non-integer period explains."""
    more = more - more.mean(1, keepdims=True)  # the mean slope of a slow drift stays
    part = np.sum(counts * change * more, 1) / np.maximum(np.sum(counts * more**2, 1), 1e-300)
    return np.sum(counts * (change - part[:, None] * more) ** 2, 1) / 2 / np.maximum(counts.sum(1), 1)

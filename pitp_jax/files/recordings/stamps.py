"""Repair time stamps before a uniform grid is fitted: counter overflows, rows out of order, equal stamps.

overflow: t_{i+1} - t_i + 2^n ticks is a usual step (n = 16, 31, 32; ticks of ms, us or ns), or plus a day at midnight

Two assumptions about the stamps are compared: they are correct, or the rows were sampled evenly and stamped late. Each
assumption predicts a row from its neighbours, y_i = w y_{i-1} + (1 - w) y_{i+1}, with w from the stamps or w = 1/2.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...method.signal.checks import refuse_time

FEW = 3.0  # usual steps: rows out of order by less are sorted, output interpolated across more is masked
EVEN = np.log(2)  # even rows predict the signals twice as well as the stamps do
# s: counters of 16, 31 and 32 bits in ms, us and ns; seconds of the hour, the day and the week
_TURNS = (*(2**bits * tick for bits in (16, 31, 32) for tick in (1e-3, 1e-6, 1e-9)), 3600.0, 86400.0, 604800.0)


@dataclass(frozen=True)
class Rows:
    """Rows of a recording in the order of their time stamps, with counts of what was repaired.

    Attributes:
        time, voltage, displacement: shapes (T,).
        turns: overflows of the clock's counter.
        sorted: rows or stamps that were out of order.
        doubled: rows equal to the row before, left out.
        averaged: rows that were averaged with the row before, whose stamp they share.
        counted: whether only the number of a row gives its time (`--rate` with a wrong clock).
    """

    time: np.ndarray
    voltage: np.ndarray
    displacement: np.ndarray
    turns: int = 0
    sorted: int = 0
    doubled: int = 0
    averaged: int = 0
    counted: bool = False

    def counted_at(self, rate: float) -> "Rows":
        """Return the rows with times computed from row number and rate (Hz)."""
        return replace(self, time=np.arange(len(self.time)) / rate, counted=True)


def usable_rows(
    time: np.ndarray,
    voltage: np.ndarray,
    displacement: np.ndarray,
    source: str,
    column: str,
    place: Callable[[int], str],
    rate: float | None = None,
) -> Rows:
    """Repair time stamps; return rows whose time does not decrease.

    Args:
        time: in s, finite, shape (T,).
        voltage: finite, shape (T,).
        displacement: nan where missing, shape (T,).
        source: file, for messages.
        column: name of the time column, for messages.
        place: turns a sample index into words.
        rate: samples per second from the user, used instead of a decreasing clock.

    Raises:
        BadInput: time decreases by more than a few steps.
    """
    time, turns = continued(time)
    rows = Rows(time, voltage, displacement, turns)
    steps = np.diff(time)
    if (steps > 0).all():
        return rows
    if (steps < 0).any():
        usual = max(float(np.median(steps)), float(np.ptp(time)) / (len(time) - 1))
        if steps.min() >= -FEW * usual and (steps < 0).mean() < 0.5:
            rows = _in_order(rows)
        elif rate is not None:
            return rows.counted_at(rate)
        else:
            refuse_time(time, source, column, place)
    rows = _once(rows)
    sizes = np.diff(np.append(_firsts(rows.time), len(rows.time)))
    # pairs of least and greatest
    if (sizes == 2).mean() >= 0.95 and evenness(rows) < EVEN:
        return average_stamps(rows)
    return rows


def continued(time: np.ndarray) -> tuple[np.ndarray, int]:
    """Add counter overflows to a clock's time (s); return the continuous time and the number of overflows."""
    steps = np.diff(time)
    back = steps < 0
    if not back.any() or not len(ahead := steps[steps > 0]):
        return time, 0
    usual = max(2 * float(np.median(ahead)), float(np.quantile(ahead, 0.99)))
    added = np.zeros(len(steps))
    for turn in _TURNS:
        # a counter does not overflow every few steps
        if turn > 20 * usual:
            added[back & (steps + turn >= 0) & (steps + turn <= usual)] = turn
    return time + np.append(0.0, np.cumsum(added)), int(np.count_nonzero(added))


def _in_order(rows: Rows) -> Rows:
    """Sort time stamps; move each row with its stamp only if that makes the signals smoother.

    Packets in the wrong order are sorted. A clock that was set back gives late stamps of correctly ordered rows.
    """
    order = np.argsort(rows.time, kind="stable")
    moves = order != np.arange(len(order))
    sorted_ = replace(rows, time=rows.time[order], sorted=int(moves.sum()))
    near = np.convolve(moves, np.ones(3), "same") > 0
    log_ratio = 0.0
    for values in (rows.voltage, rows.displacement):
        as_it_was, as_sorted = (float(np.nanmean(np.abs(np.diff(v)[near[1:]]))) for v in (values, values[order]))
        if min(as_it_was, as_sorted) > 0:
            log_ratio += float(np.log(as_sorted / as_it_was))
    if log_ratio > 0:
        return sorted_
    return replace(sorted_, voltage=rows.voltage[order], displacement=rows.displacement[order])


def _once(rows: Rows) -> Rows:
    """Drop rows that repeat the row before in every cell.

    This applies only if no time repeats without them, because a rounded clock also repeats in other rows.
    """
    y = rows.displacement
    same = [np.diff(rows.time) == 0, np.diff(rows.voltage) == 0]
    same.append((np.diff(y) == 0) | (np.isnan(y[1:]) & np.isnan(y[:-1])))
    kept = np.append(True, ~np.all(same, axis=0))
    if kept.all() or not (np.diff(rows.time[kept]) > 0).all():
        return rows
    return replace(
        rows, time=rows.time[kept], voltage=rows.voltage[kept], displacement=y[kept], doubled=int((~kept).sum())
    )


def _firsts(time: np.ndarray) -> np.ndarray:
    """Return the indices of the rows whose time stamp differs from the row before."""
    return np.flatnonzero(np.append(True, np.diff(time) > 0))


def average_stamps(rows: Rows) -> Rows:
    """Average rows of equal time stamp: the mean of the input and of the measured output."""
    firsts = _firsts(rows.time)
    sizes = np.diff(np.append(firsts, len(rows.time)))
    observed = np.isfinite(rows.displacement)
    count = np.add.reduceat(observed.astype(float), firsts)
    total = np.add.reduceat(np.where(observed, rows.displacement, 0.0), firsts)
    output = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    means = np.add.reduceat(rows.voltage, firsts) / sizes
    return replace(
        rows, time=rows.time[firsts], voltage=means, displacement=output, averaged=len(rows.time) - len(firsts)
    )


def evenness(rows: Rows) -> float:
    """Compare how well rows predict their neighbours: log error ratio of the time stamps to even sampling.

    Positive if even sampling fits better; 0 if the signals do not decide.
    """
    before, after = rows.time[1:-1] - rows.time[:-2], rows.time[2:] - rows.time[1:-1]
    weight = np.where(before + after > 0, after / np.maximum(before + after, 1e-300), 0.5)
    log_ratio = 0.0
    for values in (rows.voltage, rows.displacement):
        if not np.nanmedian(np.abs(np.diff(values))) > 0:  # steps fit both readings
            continue
        sums = []
        for w in (weight, np.full_like(weight, 0.5)):
            rest = values[1:-1] - w * values[:-2] - (1 - w) * values[2:]
            # noise alone has the same residual under both readings
            sums.append(float(np.nansum(np.abs(rest) / np.sqrt(1 + w**2 + (1 - w) ** 2))))
        if min(sums) > 0:
            log_ratio += float(np.log(sums[0] / sums[1]))
    return log_ratio

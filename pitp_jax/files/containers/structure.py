"""Recognise the structure of a log before its numbers are used: rows that take turns, sign bits, values that stand.

rows of several joints   a column's values take turns in one order, and the signals jump with them, or stamps repeat
sign and magnitude       v >= 2^n  ->  -(v - 2^n)   if the motion passes zero there, and no value lies between
two's complement         v >= 2^n  ->  v - 2^(n+1)  likewise, n = 15 or 31
values that stand        y changes every P > 1 rows only, by more than its resolution: the bus is slower than the log
"""

from collections.abc import Sequence

import numpy as np

from ...common.errors import BadInput, cleaned
from .table import Table

_MOST_KEYS, _TURNS = 64, 8  # joints of a log; rows of each, at least
_SMOOTHER = 2.0  # times smoother is a signal within its key than from row to row
_FASTEST = 1.8  # rows a refresh, at least


def keys_in_turn(table: Table, chosen: Sequence[int], time: np.ndarray, signals: Sequence[np.ndarray]):
    """Return the column whose values take turns from row to row, and those values; None if there is none.

    Args:
        table: the opened file.
        chosen: places of time, input and output, which are no keys.
        time: of the rows, s, shape (T,).
        signals: input and output, shape (T,) each.
    """
    if any(len(s) != len(time) for s in signals) or not (_repeats(time) or any(map(_strides, signals))):
        return None
    named = [place for place, column in enumerate(table.columns) if column.name and place not in chosen]
    for place in named[:64]:
        keys = _keys(table, place)
        if keys is None or len(keys) != len(time):
            continue
        values, index, counts = np.unique(keys, return_inverse=True, return_counts=True)
        if not 2 <= len(values) <= _MOST_KEYS or counts.min() < _TURNS or not _in_order(index):
            continue
        within = np.argsort(index, kind="stable")
        if (
            _repeats(time)
            and not _repeats(time[index == 0])
            or any(
                # the signals are smoother within each key than from row to row
                _step(s[1:], s[:-1]) > _SMOOTHER * _step(s[within][1:], s[within][:-1])
                for s in signals
            )
        ):
            return table.columns[place].name, list(dict.fromkeys(cleaned(k) for k in keys.tolist()))
    return None


def _keys(table: Table, place: int) -> np.ndarray | None:
    """Return the values of a column that may be keys: texts, or whole numbers; None for other columns."""
    try:
        if table.columns[place].form == "text":
            return table.texts(place) if table.texts is not None else None
        values = table.load([place])[0]
    except BadInput:
        return None
    whole = np.isfinite(values).all() and len(values) and np.array_equal(values, np.round(values))
    return values.astype(np.int64) if whole and np.abs(values).max() < 2**53 else None


def _in_order(index: np.ndarray) -> bool:
    """Return whether each key is followed by one and the same other key, which differs from key to key."""
    followers = []
    for k in np.unique(index):
        after, counts = np.unique(index[1:][index[:-1] == k], return_counts=True)
        # a few rows may be lost
        if not len(after) or counts.max() < 0.9 * counts.sum():
            return False
        followers.append(int(after[np.argmax(counts)]))
    return len(set(followers)) == len(followers) and all(k != f for k, f in enumerate(followers))


def _repeats(time: np.ndarray) -> bool:
    """Return whether a third of the stamps repeat the stamp before, or more."""
    return len(time) > 1 and 3 * int((time[1:] == time[:-1]).sum()) >= len(time) - 1


def _strides(values: np.ndarray) -> bool:
    """Return whether a signal is much smoother over some stride of rows than from row to row."""
    values = values[: _TURNS * _MOST_KEYS * 8]
    strides = range(2, min(_MOST_KEYS, len(values) // _TURNS) + 1)
    rows = _step(values[1:], values[:-1])
    return any(_SMOOTHER * _step(values[k:], values[:-k]) < rows for k in strides)


def _step(after: np.ndarray, before: np.ndarray) -> float:
    """Return the mean size of the steps between two arrays, of the finite ones; 0 without any."""
    with np.errstate(over="ignore", invalid="ignore"):  # numbers near the largest float are refused later
        steps = np.abs(after - before)
    finite = np.isfinite(steps)
    return float(steps[finite].mean()) if finite.any() else 0.0


def sign_bit(values: np.ndarray, other: int | None = None) -> int | None:
    """Return which bit of a register is its sign; None if the values are plain numbers.

    Args:
        values: as in the file, shape (T,).
        other: the sign bit of another column of this log, which a command that jumps across zero shares.
    """
    for some in (values[:64], values):  # the first ones often suffice
        seen = some[np.isfinite(some)]
        if not np.array_equal(seen, np.abs(np.round(seen))):
            return None
    for bit in (7, 9, 10, 11, 15, 31):  # of registers
        sign = 2.0**bit
        high = seen >= sign
        # a sign bit is far above all magnitudes; otherwise it belongs to the number
        if not high.any() or high.all() or seen[high].max() >= 1.5 * sign or seen[~high].max() >= sign / 2:
            continue
        at = np.flatnonzero(np.diff(high))
        magnitude = np.where(high, seen - sign, seen)
        steps = np.abs(np.diff(np.where(high, -magnitude, magnitude)))
        moving = np.delete(steps, at)
        usual = float(np.median(moving[moving > 0])) if moving.any() else 0.0
        # a motion passes zero in a few usual steps
        if bit == other or steps[at].max() <= 10 * max(usual, 1.0):
            return bit
    return None


def mirrored(values: np.ndarray) -> np.ndarray:
    """Return a two's complement of 16 or 32 bits, read as unsigned, as sign and magnitude.

    Args:
        values: shape (T,).
    """
    sign = 2.0**15 if np.nanmax(values, initial=0.0) < 2**16 else 2.0**31
    return np.where(values >= sign, 3 * sign - values, values)


def signed(values: np.ndarray, bit: int) -> np.ndarray:
    """Read a register as sign and magnitude.

    Args:
        values: shape (T,).
        bit: that holds the sign.
    """
    return np.where(values >= 2.0**bit, 2.0**bit - values, values)


def refreshed(values: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Return where an output that stands several rows each was refreshed, in rows, and rows per refresh; or None.

    A ramp of a coarse sensor also changes in a rhythm, but always by its resolution; there the rows stay as they are.

    Args:
        values: output, shape (T,).
    """
    steps = np.diff(values)
    count = np.count_nonzero(steps) - 1
    # too few to show a rhythm, or too many: the period is at most the mean gap
    if count < 23 or len(steps) <= _FASTEST * count or not np.isfinite(values).all():
        return None
    at = np.flatnonzero(steps) + 1
    gaps = np.diff(at)
    sizes, period = np.abs(steps[at - 1]), float(np.median(gaps))
    turns = np.maximum(np.round(gaps / period), 1)
    for _ in range(3):  # the median of 6 and 7 rows is refined to 6.4
        period = float(gaps.sum() / turns.sum())
        turns = np.maximum(np.round(gaps / period), 1)
    regular = (turns == 1) & (np.abs(gaps - period) < 1)
    if period < _FASTEST or regular.mean() < 0.9 or np.median(sizes) < 2 * sizes.min():
        return None
    count = np.append(0, np.cumsum(turns))
    period = float(np.polyfit(count, at, 1)[0])
    # a value is logged in the first row after its refresh
    late = at - period * count
    first = float(late.min())
    if late.max() - first > 1 + 0.1 * period:  # rows were lost, so the rhythm is unknown
        return None
    before = int(first // period)
    return first + period * np.arange(-before, int((len(values) - 1 - first) // period) + 1), period

"""Unwrap values on a circle: angles at +-180 deg or 0 to 360 deg, counts of a rotary encoder.

    d_i = y_{i+1} - y_i,    n_i = round(d_i / P),    r_i = d_i - n_i P        P: one turn, d_i: step, r_i: its short way

A step of the output with n_i != 0 is a turn if r_i continues the neighbouring steps. A machine cannot jump, but a
command can: a step of the input is a turn only if the output then follows the short way.
"""

import math
from itertools import pairwise

import numpy as np

_SLACK = 1.01  # turns that values on one circle may span, because noise may exceed the seam
_COUNTS = np.sort(np.concatenate([
    2.0 ** np.arange(9, 33), np.outer(10.0 ** np.arange(2, 7), [3.6, 4, 5, 10, 20, 25]).ravel()
]))  # of encoders in one turn  # fmt: skip


def unwrap(
    voltage: np.ndarray, displacement: np.ndarray, units: tuple[str, str]
) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """Unwrap the output of a record, and its input if the output shows that the input has turned too.

    Args:
        voltage: input, shape (T,).
        displacement: output, shape (T,); nan where missing.
        units: base units of both; an angle and counts lie on a circle.

    Returns:
        input and output, and the number of turns removed from each.
    """
    seen = np.flatnonzero(np.isfinite(displacement))
    if len(seen) < 3:
        return voltage, displacement, (0, 0)
    inner, period = _period(voltage, units[0]), _period(displacement[seen], units[1])
    # Two signals in one unit have one turn; the output shows it more reliably, because it cannot step.
    if units[0] == units[1]:
        inner = period = period or inner
    if period is None:
        return voltage, displacement, (0, 0)
    output = displacement.copy()
    turns = _turns(displacement[seen], period)
    output[seen] -= period * np.append(0, np.cumsum(turns))
    inputs = 0
    if inner is not None:
        whole = np.interp(np.arange(len(output)), seen, output[seen])
        voltage, inputs = _unwrapped_input(voltage, whole, inner, period)
    return voltage, output, (inputs, int(np.abs(turns).sum()))


def _period(values: np.ndarray, unit: str) -> float | None:
    """Return the size of one turn in the values' unit (for counts: the round number nearest to the jumps), or None."""
    if unit == "rad":
        return 2 * math.pi
    if unit != "counts":
        return None
    steps = np.diff(values)
    largest = np.abs(steps) > np.ptp(values) / 2
    if not largest.any():
        return None
    seen = float(np.median(np.abs(steps[largest] - _beside(np.where(largest, 0.0, steps))[0][largest])))
    nearest = float(_COUNTS[np.argmin(np.abs(_COUNTS - seen))])
    # measured from steps that also move
    return nearest if abs(nearest - seen) <= 0.02 * nearest else None


def _beside(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of the two neighbours of each step, and the sum of their magnitudes."""
    before, after = np.append(steps[:1], steps[:-1]), np.append(steps[1:], steps[-1:])
    return (before + after) / 2, np.abs(before) + np.abs(after)


def _turns(values: np.ndarray, period: float) -> np.ndarray:
    """Return how many turns each sample-to-sample step jumps, 0 if it is not a wrap, shape (T - 1,)."""
    steps = np.diff(values)
    turns = np.round(steps / period)
    if not turns.any() or np.ptp(values) > _SLACK * period:
        return np.zeros(len(steps))
    short = steps - turns * period
    mean, size = _beside(short)
    usual = float(np.median(np.abs(short[short != 0]))) if short.any() else 0.0
    off = np.abs(short - mean)
    # a short step continues those beside it, up to a few usual steps
    return np.where((off <= 2 * size + 10 * usual) & (off < np.abs(steps - mean)), turns, 0.0)


def _unwrapped_input(
    voltage: np.ndarray, output: np.ndarray, period: float, turn_of_output: float
) -> tuple[np.ndarray, int]:
    """Unwrap the input at steps that the output follows the short way; return the input and the number of turns."""
    steps = np.flatnonzero(np.round(np.diff(voltage) / period))
    if not steps.size or np.ptp(voltage) > _SLACK * period:
        return voltage, 0
    edges = np.concatenate([[0], steps + 1, [len(voltage)]])
    # in the second half of each stretch between two such steps the output has followed
    late = [slice((begin + end) // 2, end) for begin, end in pairwise(edges)]
    follows = output / turn_of_output
    apart, reversed_apart = follows - voltage / period, -follows - voltage / period
    turns = np.round([apart[part].mean() for part in late])
    after = sum(np.sum((apart[part] - n) ** 2) for part, n in zip(late, turns, strict=True))
    # unchanged, in either direction; whole turns between input and output only shift the offset
    before = min(sum(np.sum((some[part] - np.round(np.median(some))) ** 2) for part in late)
                 for some in (apart, reversed_apart))  # fmt: skip
    if after > 0.25 * before:  # squares: half of the distance remains
        return voltage, 0
    taken = np.repeat(turns - turns[0], np.diff(edges))
    return voltage + period * taken, round(float(np.abs(np.diff(taken)).sum()))

"""Classify the input of a record (sweep, sine, steps, broadband), and select a few records of every kind.

    j-th of m records of a kind:  rank of the loudest line near (j + 1/2) / m,  rank of the strength near frac(0.618 j)

Ranks run through 0 ... 1; successive values of frac(0.618 j) are far apart, so neighbours in frequency differ in
strength.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ..numerics.coloured_noise import project
from .record import Record

_PARTS = 1000  # of a record, over which a step must be constant
_STILL = 0.4  # of the time between two turning points: the input steps
_LEVEL = 0.07  # of a move: distance to its ends within which a sine spends a third of its time
_SEGMENTS = 16  # turning points at least of a sweep, and half the number of segments compared
_GOLDEN = (5**0.5 - 1) / 2  # multiples of the golden ratio, modulo 1, fill [0, 1] evenly


def is_sweep(record: Record) -> bool:
    """Return whether an input is a sweep: the time between turning points varies smoothly, by at least a factor of 1.4.

    The ranks of these times are smooth, up, down or both ways: their mean squared successive difference lies 3.7
    standard deviations below that of a random order. Rests before, after or between do not matter.
    """
    return _is_swept(_turns(record.voltage))


def _is_swept(turns: np.ndarray) -> bool:
    if len(turns) <= _SEGMENTS:
        return False
    # ends of at most 32 segments with equally many turning points each
    ends = turns[np.unique(np.linspace(0, len(turns) - 1, min(len(turns), 2 * _SEGMENTS + 1)).astype(int))]
    spans = np.log(np.diff(ends) / np.diff(np.searchsorted(turns, ends)))
    # the outer twentieths may be rests before and after the sweep
    low, high = np.quantile(spans, (0.05, 0.95))
    # 1.4: an octave without its ends
    if high - low < np.log(1.4) or len(np.unique(np.round(spans, 1))) < 4:
        return False
    ranks = np.argsort(np.argsort(spans))
    ratio = np.sum(np.diff(ranks) ** 2) / np.sum((ranks - ranks.mean()) ** 2)
    return bool(ratio < 2 * (1 - 3.7 / np.sqrt(len(ranks))))  # 2 +- 2 / sqrt(n): one in 10,000


def _turns(u: np.ndarray) -> np.ndarray:
    """Return the sample indices at which an input turns back by at least a twentieth of its range.

    The smallest moves between neighbouring extremes are dropped, a pair of extremes at a time, until none is left.
    """
    moves = np.flatnonzero(np.diff(u))
    turns = moves[np.flatnonzero(np.diff(np.sign(np.diff(u)[moves]))) + 1]
    turns = np.concatenate([[0], turns, [len(u) - 1]])
    least = 0.05 * np.ptp(u)  # more than noise
    while len(turns) > 2:
        size = np.append(np.inf, np.append(np.abs(np.diff(u[turns])), np.inf))
        inner = size[1:-1]
        small = np.flatnonzero((inner < least) & (inner < size[:-2]) & (inner <= size[2:]))
        if not len(small):
            break
        gone = np.concatenate([small, small + 1])
        # the first and the last sample stay, and the extreme beside them is removed
        turns = np.delete(turns, gone[(gone > 0) & (gone < len(turns) - 1)])
    return turns[1:-1]


def kind(record: Record) -> str:
    """Return the kind of input: "sweep", "sine" (one line dominates), "steps" (constant between moves) or "broadband".

    Rests before, after and between are not counted.
    """
    u = record.voltage
    turns = _turns(u)
    if _is_swept(turns):
        return "sweep"
    if _stands_still(u, turns):
        return "steps"
    if len(turns) > 2:
        u = u[turns[0] : turns[-1] + 1]
    power = _lines(u) ** 2
    peak = int(np.argmax(power[1:])) + 1
    # three lines on either side hold what the window spreads
    return "sine" if power[max(peak - 3, 1) : peak + 4].sum() > 0.8 * power[1:].sum() else "broadband"


def _stands_still(u: np.ndarray, turns: np.ndarray) -> bool:
    """Return whether an input stays at a level for most of the time between two turning points."""
    apart = max(len(u) // _PARTS, 1)  # from one sample to the next, a slow sine is constant too
    still = np.append(np.abs(u[apart:] - u[:-apart]) < 1e-3 * np.ptp(u), np.zeros(apart, bool))
    ends = turns if len(turns) > 2 else np.array([0, *turns, len(u) - 1])
    sizes = np.diff(ends)
    first, second = (np.repeat(u[e], sizes) for e in (ends[:-1], ends[1:]))
    inside = u[ends[0] : ends[-1]]
    level = np.minimum(np.abs(inside - first), np.abs(inside - second)) < _LEVEL * np.abs(second - first)
    # half of the segments lie outside any rest
    held = [
        np.median(np.add.reduceat(seen, ends[:-1] - ends[0]) / sizes) for seen in (still[ends[0] : ends[-1]], level)
    ]
    return bool(held[0] > _STILL or held[1] > 0.5)


def loudest(record: Record) -> float:
    """Return the frequency (Hz) of the strongest Fourier line of the input."""
    return float(np.argmax(spectrum(record)[1:]) + 1) / (record.samples * record.dt)


def only_frequency(record: Record) -> float | None:
    """Return the frequency (Hz) of an input that is one sine about a mean, to 1 % of its energy; None otherwise."""
    u, time = record.voltage - record.voltage.mean(), np.arange(record.samples) * record.dt

    def misfit(hz: float) -> float:
        wave = np.exp(2j * np.pi * hz * time)
        return float(np.sum(project(u, np.column_stack([np.real(wave), np.imag(wave), np.ones(len(u))]))[1] ** 2))

    # a sine is off by at most an eightieth of a line, whose phase changes by 0.04 rad from the middle to the ends
    tried = loudest(record) + np.linspace(-1, 1, 81) / (record.samples * record.dt)
    errors = [misfit(hz) for hz in tried if hz > 0]
    return float(tried[tried > 0][np.argmin(errors)]) if min(errors) < 0.01 * float(u @ u) else None


def spectrum(record: Record) -> np.ndarray:
    """Return the magnitudes of the windowed input's Fourier lines, without its mean, shape (samples // 2 + 1,)."""
    return _lines(record.voltage)


def _lines(u: np.ndarray) -> np.ndarray:
    return np.abs(np.fft.rfft((u - u.mean()) * np.hanning(len(u))))


def spread_over_kinds(records: Sequence[Record], count: int) -> list[int]:
    """Return indices of `count` records; every kind of input is chosen at least once and in its proportion."""
    if count >= len(records):
        return list(range(len(records)))
    line, strength = _ranks([loudest(r) for r in records]), _ranks([np.sqrt(np.mean(r.voltage**2)) for r in records])
    kinds = np.array([kind(r) for r in records])
    names, sizes = np.unique(kinds, return_counts=True)
    names = names[np.argsort(sizes)][:count]  # if there are more kinds than places, the rarest
    chosen, free = [], count
    for k, name in enumerate(names):  # the most common kind comes last and takes the remaining places
        places, later = np.flatnonzero(kinds == name), len(names) - 1 - k
        fair = round(count * len(places) / len(records)) if later else free
        many = min(max(fair, 1), free - later, len(places))
        chosen, free = chosen + _even(places, line, strength, many), free - many
    return sorted(chosen)


def _even(places: np.ndarray, line: np.ndarray, strength: np.ndarray, count: int) -> list[int]:
    """Return `count` of these record indices, evenly distributed in frequency rank and mixed in strength."""
    unused = list(places)
    for j in range(count):
        wanted = (j + 0.5) / count, (j * _GOLDEN) % 1.0
        apart = [count * abs(line[p] - wanted[0]) + abs(strength[p] - wanted[1]) for p in unused]
        unused.pop(int(np.argmin(apart)))
    return [int(p) for p in places if p not in unused]


def _ranks(values: Sequence[float]) -> np.ndarray:
    """Rank values from 0 to 1 at the middles of equal intervals; values within 1 % share a rank."""
    order, rank = np.argsort(values), np.zeros(len(values))
    for before, here in pairwise(order):
        rank[here] = rank[before] + (values[here] > values[before] + 0.01 * abs(values[before]))
    return (rank + 0.5) / (rank.max() + 1)

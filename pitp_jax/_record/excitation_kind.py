"""What kind of drive a record has, and which records to take where all would be too many.

    j-th of m records of a kind:  rank of the loudest line near (j + 1/2) / m,  rank of the strength near frac(0.618 j)

Ranks run through 0 ... 1; frac(0.618 j) never comes back to where it just was: neighbours in line differ in strength.
"""

from collections.abc import Sequence

import numpy as np
import scipy

from .record import Record

_PARTS = 1000  # of a record, over which a step stands still
_SEGMENTS = 16  # of a record, in which a sweep's zero crossings are counted
_GOLDEN = (5**0.5 - 1) / 2


def is_sweep(record: Record) -> bool:
    """True when the zero crossings of the drive, counted in 16 segments, rise or fall (rank correlation > 0.9).

    The drive is taken about its own mid-range; a record with fewer than 16 crossings in all is no sweep.
    """
    # about mid-range, which a bias does not move
    u = record.voltage - (record.voltage.max() + record.voltage.min()) / 2
    crossings = np.flatnonzero(np.diff(np.signbit(u)))
    if len(crossings) < _SEGMENTS:
        return False
    # a sweep crosses ever more (or less) often
    counts = np.bincount(np.minimum(crossings * _SEGMENTS // record.samples, _SEGMENTS - 1), minlength=_SEGMENTS)
    if len(np.unique(counts)) < 4:
        return False
    trend = float(scipy.stats.spearmanr(np.arange(_SEGMENTS), counts)[0])  # pyright: ignore[reportArgumentType]
    return abs(trend) > 0.9 and bool(counts.max() >= 3 * max(counts.min(), 1))


def kind(record: Record) -> str:
    """sweep, sine (one line holds the drive), steps (it stands still mostly), or broadband."""
    if is_sweep(record):
        return "sweep"
    apart = max(record.samples // _PARTS, 1)  # by the sample a slow sine stands still too
    still = np.abs(record.voltage[apart:] - record.voltage[:-apart]) < 1e-3 * np.ptp(record.voltage)
    if still.mean() > 0.4:
        return "steps"
    power = spectrum(record) ** 2
    peak = int(np.argmax(power[1:])) + 1
    return "sine" if power[max(peak - 3, 1) : peak + 4].sum() > 0.8 * power[1:].sum() else "broadband"


def loudest(record: Record) -> float:
    """Strongest line of the drive in Hz."""
    return float(np.argmax(spectrum(record)[1:]) + 1) / (record.samples * record.dt)


def spectrum(record: Record) -> np.ndarray:
    """Size of the windowed drive's Fourier lines, without its mean, shape (samples // 2 + 1,)."""
    u = record.voltage - record.voltage.mean()
    return np.abs(np.fft.rfft(u * np.hanning(len(u))))


def spread_over_kinds(records: Sequence[Record], count: int) -> list[int]:
    """Places of `count` records (or all), in the order given: every kind by its share, its first before any second."""
    if count >= len(records):
        return list(range(len(records)))
    line, strength = _ranks([loudest(r) for r in records]), _ranks([np.sqrt(np.mean(r.voltage**2)) for r in records])
    kinds = np.array([kind(r) for r in records])
    names, sizes = np.unique(kinds, return_counts=True)
    names = names[np.argsort(sizes)][:count]  # where there are more kinds than places, the rarest
    chosen, free = [], count
    for k, name in enumerate(names):  # the commonest kind comes last and takes what remains
        places, later = np.flatnonzero(kinds == name), len(names) - 1 - k
        fair = round(count * len(places) / len(records)) if later else free
        many = min(max(fair, 1), free - later, len(places))
        chosen, free = chosen + _even(places, line, strength, many), free - many
    return sorted(chosen)


def _even(places: np.ndarray, line: np.ndarray, strength: np.ndarray, count: int) -> list[int]:
    """Of these places `count`, evenly along the rank of the line, each with another strength than its neighbours."""
    unused = list(places)
    for j in range(count):
        wanted = (j + 0.5) / count, (j * _GOLDEN) % 1.0
        apart = [count * abs(line[p] - wanted[0]) + abs(strength[p] - wanted[1]) for p in unused]
        unused.pop(int(np.argmin(apart)))
    return [int(p) for p in places if p not in unused]


def _ranks(values: Sequence[float]) -> np.ndarray:
    """Middles of as many equal shares of 0 ... 1 as there are values, equal ones (to 1 %) alike."""
    order, rank = np.argsort(values), np.zeros(len(values))
    for before, here in zip(order[:-1], order[1:], strict=True):
        rank[here] = rank[before] + (values[here] > values[before] + 0.01 * abs(values[before]))
    return (rank + 0.5) / (rank.max() + 1)

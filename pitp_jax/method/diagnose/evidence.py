"""Compare hypotheses by their out-of-fold residuals: how much better one is, and with what probability.

    score   S = sum_r n_r log MSE_r / sum_r n_r          (the Gaussian log score with one variance per record)
    P       fraction of draws in which S_a + log q < S_b: records are drawn first, then blocks within, the same for all

Pooled squares would be dominated by one large record. Drawing blocks alone gave P = 0.99 to second effects that only
one record shows. With fewer than four records (or one that alone shows an effect), the parts that a fold leaves out are
drawn instead: of two records, every fourth draw would contain only one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

_BLOCKS, _FEWEST, _DRAWS = 30, 6, 2000  # blocks of all records; of one record; bootstrap draws: 0.9 is known to 0.007


@dataclass(frozen=True)
class Evidence:
    """Sums of squared out-of-fold residuals, in blocks of samples.

    Attributes:
        squares, sizes: sum of squares and samples of every block.
        records: which record it is of.
        units: drawn together with it: a record, or a part of one.
        floor: mean square of every record, added to all errors: smaller errors do not count as evidence.
        least: smallest mean square of every record: the nominal's error on its own records, which no effect can
            explain.
    """

    squares: np.ndarray
    sizes: np.ndarray
    records: np.ndarray
    units: np.ndarray
    floor: np.ndarray
    least: float = 0.0

    @property
    def mse(self) -> np.ndarray:
        """Return the mean squared error of every record, shape (records,)."""
        count = self.floor.size
        # bincount sums the blocks of each record
        total = np.bincount(self.records, self.squares, count)
        mean = total / np.maximum(np.bincount(self.records, self.sizes, count), 1) + self.floor
        return np.maximum(mean, self.least)

    @property
    def score(self) -> float:
        """Return the score S: the logarithm of the mean squared error, averaged over records by their samples."""
        return float(self.per_record.sum() / self.sizes.sum())

    @property
    def per_record(self) -> np.ndarray:
        """Return the terms n log MSE of the score, shape (records,)."""
        return np.bincount(self.records, self.sizes, self.floor.size) * np.log(self.mse)

    @property
    def bare(self) -> "Evidence":
        """Return the evidence without the lower limit on errors, to judge a model without reference to effects."""
        return replace(self, least=0.0)

    @property
    def rms(self) -> float:
        """Return the geometric mean of the records' rms errors."""
        return float(np.exp(self.score / 2))


def evidence(residuals: Sequence[np.ndarray], floors: np.ndarray, least: float = 0.0, parts: int = 1) -> Evidence:
    """Sum squared residuals in blocks of valid samples: about thirty in all, at least six per record.

    Args:
        residuals: per record, nan where samples do not count.
        floors, least: as errors.
        parts: of every record, drawn separately.
    """
    total = sum(int(np.isfinite(r).sum()) for r in residuals)
    squares, sizes, records, units = [], [], [], []
    for k, r in enumerate(residuals):
        for n, part in enumerate(np.array_split(r, parts)):
            seen = part[np.isfinite(part)]
            # blocks instead of samples, because neighbours on a smooth run are not independent
            count = max(_FEWEST, round(_BLOCKS * len(seen) / total)) if len(seen) else 0
            for block in np.array_split(seen, count) if count else ():
                squares.append(float(np.sum(block**2)))
                sizes.append(len(block))
                records.append(k)
                units.append(k * parts + n)
    squares, sizes, records, units = map(np.array, (squares, sizes, records, units))
    return Evidence(squares, sizes, records, units, np.array(floors) ** 2 + 1e-300, least**2)


def resampled(first: Evidence, count: int, seed: int) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the bootstrap draws of each record: units (records or parts of one), then blocks within each.

    Yields:
        record, times that it was drawn (count,), its blocks, and how often each of them was (count, blocks).
    """
    times, often = _drawn(tuple(first.units.tolist()), count, seed)
    for r in np.unique(first.records):
        place = np.flatnonzero(first.records == r)
        yield int(r), times[:, place] @ first.sizes[place] / first.sizes[place].sum(), place, often[:, place]


@lru_cache(maxsize=8)  # all sets of a case use the same draws, hundreds of times
def _drawn(units: tuple[int, ...], count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return how often each block's unit was drawn, and how often the block itself, both (count, blocks)."""
    rng, place_of = np.random.default_rng(seed), np.array(units)
    there = np.unique(place_of)
    # with one unit only its blocks can vary
    drawn = rng.multinomial(len(there), np.full(len(there), 1 / len(there)), count)
    times, often = np.zeros((2, count, len(units)))
    for j, u in enumerate(there):
        place = np.flatnonzero(place_of == u)
        pick = rng.integers(0, len(place), (count, len(place)))
        times[:, place] = drawn[:, j, None]
        often[:, place] = drawn[:, j, None] * (pick[:, :, None] == np.arange(len(place))).sum(1)
    return times, often


def draws(sets: Sequence[Evidence]) -> np.ndarray:
    """Return the score of every hypothesis in every bootstrap draw, (sets, draws); all use the same draws."""
    first = sets[0]
    scores, weight = np.zeros((len(sets), _DRAWS)), np.zeros(_DRAWS)
    for r, times, place, often in resampled(first, _DRAWS, seed=0):
        # a record counts by its samples, as in the score; equal blocks for all sets, so that common parts cancel
        size = times * first.sizes[place].sum()
        weight += size
        count = np.maximum(often @ first.sizes[place], 1)
        for k, s in enumerate(sets):
            scores[k] += size * np.log(np.maximum(often @ s.squares[place] / count + s.floor[r], s.least))
    return scores / weight


def probability(a: Evidence, b: Evidence, ratio: float = 1.0) -> float:
    """Return the probability that the rms error of `a` is below `ratio` times the rms error of `b`."""
    first, second = draws([a, b])
    return float(np.mean(first < second + 2 * np.log(ratio)))

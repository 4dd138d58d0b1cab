"""Evidence: how much better one set of out-of-fold residuals is than another, and how sure that is.

    score   S = sum_r n_r log MSE_r / sum_r n_r          (the Gaussian log score with one variance per record)
    P       share of draws in which S_a + log q < S_b: records are drawn first, then blocks within, the same for all

One large record decides pooled squares, and blocks alone gave 0.99 to second effects that one record knows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

_BLOCKS, _FEWEST, _DRAWS = 30, 6, 2000


@dataclass(frozen=True)
class Evidence:
    """Squares of out-of-fold residuals in blocks.

    Attributes:
        squares, sizes: sum of squares and samples of every block.
        records: which record it is of.
        floor: mean square of every record that is added to all of them: below it an error is no evidence.
        least: mean square that is the least of every record: the square of what the nominal leaves where nothing is
            wrong, which no name may claim to explain.
    """

    squares: np.ndarray
    sizes: np.ndarray
    records: np.ndarray
    floor: np.ndarray
    least: float = 0.0

    @property
    def mse(self) -> np.ndarray:
        """Mean square of every record."""
        count = self.floor.size
        # bincount sums blocks by the record they are of
        total = np.bincount(self.records, self.squares, count)
        mean = total / np.maximum(np.bincount(self.records, self.sizes, count), 1) + self.floor
        return np.maximum(mean, self.least)

    @property
    def score(self) -> float:
        """The score S, the log of the error squared."""
        weight = np.bincount(self.records, self.sizes, self.floor.size)
        return float(np.sum(weight * np.log(self.mse)) / weight.sum())

    @property
    def bare(self) -> "Evidence":
        """Without a least: how good a model is, where no name is asked for."""
        return replace(self, least=0.0)

    @property
    def rms(self) -> float:
        """Geometric mean over records of the error."""
        return float(np.exp(self.score / 2))


def evidence(residuals: Sequence[np.ndarray], floors: np.ndarray, least: float = 0.0) -> Evidence:
    """Blocks of the samples that are there: about thirty in all, at least six a record; `floors`, `least` as errors."""
    total = sum(int(np.isfinite(r).sum()) for r in residuals)
    squares, sizes, records = [], [], []
    for k, r in enumerate(residuals):
        seen = r[np.isfinite(r)]
        if not len(seen):
            continue
        # blocks, not samples: neighbours on one smooth run are no independent witnesses
        for block in np.array_split(seen, max(_FEWEST, round(_BLOCKS * len(seen) / total))):
            squares.append(float(np.sum(block**2)))
            sizes.append(len(block))
            records.append(k)
    return Evidence(np.array(squares), np.array(sizes), np.array(records), np.array(floors) ** 2 + 1e-300, least**2)


def resampled(first: Evidence, count: int, seed: int) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Draw records, then blocks within each: (record, times drawn (count,), its blocks (count, blocks)) in turn."""
    rng, there = np.random.default_rng(seed), np.unique(first.records)
    # how often each record is drawn; with one record only its blocks can vary
    times = rng.multinomial(len(there), np.full(len(there), 1 / len(there)), count)
    for j, r in enumerate(there):
        place = np.flatnonzero(first.records == r)
        yield int(r), times[:, j], place[rng.integers(0, len(place), (count, len(place)))]


def draws(sets: Sequence[Evidence]) -> np.ndarray:
    """Score every set in every draw, shape (sets, draws); all sets are drawn alike."""
    first = sets[0]
    scores, weight = np.zeros((len(sets), _DRAWS)), np.zeros(_DRAWS)
    for r, times, pick in resampled(first, _DRAWS, seed=0):
        # a record counts by its samples, as in the score itself; the same blocks for all sets: what they share cancels
        size = times * first.sizes[first.records == r].sum()
        weight += size
        count = first.sizes[pick].sum(1)
        for k, s in enumerate(sets):
            scores[k] += size * np.log(np.maximum(s.squares[pick].sum(1) / count + s.floor[r], s.least))
    return scores / weight


def probability(a: Evidence, b: Evidence, ratio: float = 1.0) -> float:
    """P that the rms error of `a` is below `ratio` times that of `b`."""
    first, second = draws([a, b])
    return float(np.mean(first < second + 2 * np.log(ratio)))

"""Block bootstrap: how far means over records would have come out otherwise.

    m* = mean over records of mean over blocks drawn anew,     blocks of 4 tau,     tau = 1 + 2 sum_k rho_k

tau is the memory of what is averaged (its integrated autocorrelation up to the first zero). Blocks that long see all of
its variance but tau / (2 L), and n of them scatter by sqrt((n - 1) / n) too little: draws are widened by both.
"""

from collections.abc import Callable, Sequence

import numpy as np

from .case import Case

_DRAWS = 400
_LONG, _FEWEST, _MOST = 4.0, 8, 400  # blocks: of so many memories; how many of them in a record


def means(case: Case, which: Sequence[int], square: Callable[[int], np.ndarray], draws: int = _DRAWS) -> np.ndarray:
    """Draws of the mean over records of the mean of `square` (..., T) where it counts, shape (..., draws).

    Rows of one record are drawn together: they stay paired.
    """
    rng, total, shape = np.random.default_rng(0), 0.0, ()
    for k in which:
        counts, values = case.series[k].weight > 0, np.asarray(square(k))
        rows, shape = np.atleast_2d(values), values.shape[:-1]
        tau = max(memory(row[counts]) for row in rows)
        blocks = int(np.clip(counts.sum() / (_LONG * tau), _FEWEST, _MOST))
        edges = np.linspace(0, len(counts), blocks + 1).astype(int)[:-1]
        sums, sizes = np.add.reduceat(rows * counts, edges, axis=1), np.add.reduceat(counts.astype(float), edges)
        drawn = rng.integers(0, blocks, (draws, blocks))
        found = sums[:, drawn].sum(-1) / np.maximum(sizes[drawn].sum(-1), 1.0)
        middle = sums.sum(1, keepdims=True) / max(sizes.sum(), 1.0)
        unseen = min(tau * blocks / (2 * max(counts.sum(), 1)), 0.5)
        wider = np.sqrt(blocks / (blocks - 1) / (1 - unseen))
        total = total + (middle + wider * (found - middle)) / len(which)
    return np.reshape(total, (*shape, draws))


def memory(values: np.ndarray) -> float:
    """Integrated autocorrelation of a signal in samples, up to where its correlation is first gone; at least 1."""
    centred = values - values.mean() if len(values) else values
    power = np.abs(np.fft.rfft(centred, 2 * len(values))) ** 2 if len(values) else np.zeros(1)
    if power.sum() <= 0:
        return 1.0
    lags = np.fft.irfft(power)[: len(values)]
    gone = int(np.argmax(lags <= 0.0)) if (lags <= 0.0).any() else len(lags)
    return float(max(2 * lags[:gone].sum() / lags[0] - 1, 1.0))

"""Choose the recordings that lower the variance of predictions most, from their information on the parameters.

    Lambda = sum_r M_r,   M_r = J_r' J_r,        J: derivatives of a free run by the parameters, in units of its error
    v(c)   = tr[(Lambda + M_c)^-1 G],            G: mean of J_t' J_t over the inputs to be predicted
    next   = argmin_c v(c), then Lambda <- Lambda + M_next                     (greedy, Laplace, V-optimal)

v is the mean variance of the predictions; the prior enters Lambda as one more recording.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

_JITTER = 1e-9  # of the mean diagonal, because float32 slopes leave a matrix barely singular


def variance(precision: np.ndarray, predicted: np.ndarray) -> float:
    """Return the mean variance of predictions, tr(Lambda^-1 G), for precision Lambda and predictions G, both (P, P)."""
    size = len(precision)
    return float(
        np.trace(cho_solve(cho_factor(precision + _JITTER * np.trace(precision) / size * np.eye(size)), predicted))
    )


def choose(
    precision: np.ndarray, candidates: Sequence[np.ndarray], predicted: np.ndarray, count: int
) -> tuple[list[int], list[float]]:
    """Choose `count` candidates one by one, each the one that lowers the mean variance of predictions most.

    Args:
        precision: Lambda before, shape (P, P).
        candidates: M_c, shape (P, P) each.
        predicted: G, shape (P, P).
        count: number of recordings, at most all.

    Returns:
        their places, and the mean variance before the first and after each of them.
    """
    # One at a time: subsets of 48 would be too many, and two candidates with the same information are not both chosen.
    taken, variances = [], [variance(precision, predicted)]
    while len(taken) < min(count, len(candidates)):
        remaining = [k for k in range(len(candidates)) if k not in taken]
        after = [variance(precision + candidates[k], predicted) for k in remaining]
        best = int(np.argmin(after))
        taken.append(remaining[best])
        variances.append(after[best])
        precision = precision + candidates[remaining[best]]
    return taken, variances

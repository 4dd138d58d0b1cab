"""Compare explanations of one record by likelihood, where what they leave is coloured.

    e_t = sum_j phi_j e_{t-j} + w_t,    w white           (autoregression of order P, Yule-Walker on the richest e)
    BIC = T log(sum_t w_t^2) + p log T                    (Schwarz, 1978)

A model's error is strongly correlated: taken as white noise, any constant and any transient would be significant.
Whitened by its own spectrum, a constant counts as many samples as the slow part of the error has independent values,
and a transient is set against what the error holds at the transient's own frequency.
"""

from collections.abc import Callable

import numpy as np
import scipy
from jaxtyping import Float

_ORDER = 6


def whitener(error: Float[np.ndarray, " time"]) -> Callable[[np.ndarray], np.ndarray]:
    """The map (time, ...) -> (time, ...) that makes a signal with the error's spectrum white.

    The first P samples by the Cholesky factor of their covariance: nothing of the beginning is lost.
    """
    size = len(error)
    lags = np.array([error[: size - k] @ error[k:] for k in range(_ORDER + 1)]) / size
    lags[0] = lags[0] * (1 + 1e-9) + 1e-300
    phi = scipy.linalg.solve_toeplitz(lags[:_ORDER], lags[1:])
    left = max(lags[0] - phi @ lags[1:], 1e-12 * lags[0])
    first = scipy.linalg.cholesky(scipy.linalg.toeplitz(lags[:_ORDER]) / left, lower=True)

    def whiten(values):
        found = np.asarray(scipy.signal.lfilter(np.append(1.0, -phi), [1.0], values, axis=0))
        found[:_ORDER] = scipy.linalg.solve_triangular(first, values[:_ORDER], lower=True)
        return found

    return whiten


def project(
    values: Float[np.ndarray, " time"], columns: Float[np.ndarray, "time n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " time"]]:
    """Least squares on the columns: their factors, and what is left."""
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    factors = np.linalg.lstsq(columns / size, values, rcond=1e-10)[0] / size
    return factors, values - columns @ factors


def criterion(left: Float[np.ndarray, " time"], parameters: int, floor: float = 0.0) -> float:
    """BIC of an explanation that leaves this of a whitened record, beside white noise of deviation `floor`."""
    size = len(left)
    return float(size * np.log(max(left @ left + size * floor**2, 1e-300)) + parameters * np.log(size))


def block_means(values: np.ndarray, weight: Float[np.ndarray, " time"], size: int) -> tuple[np.ndarray, np.ndarray]:
    """Weighted means over blocks of `size` samples, shape (blocks, ...), and the share of weight in each."""
    count = len(weight) // size
    w = weight[: count * size].reshape(count, size)
    v = values[: count * size].reshape(count, size, *values.shape[1:])
    total = w.sum(1)
    sums = np.einsum("bs,bs...->b...", w, v)
    return sums / np.maximum(total, 1e-300).reshape(-1, *[1] * (sums.ndim - 1)), total / size

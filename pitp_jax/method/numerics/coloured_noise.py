"""Compare hypotheses on one record by their likelihood, for coloured (correlated) residuals.

    e_t = sum_j phi_j e_{t-j} + w_t,    w white           (autoregression of order P, Yule-Walker on the richest e)
    BIC = T log(sum_t w_t^2) + p log T                    (Schwarz, 1978)

A model's error is strongly correlated: taken as white noise, any constant and any transient would be significant.
Whitened by its own spectrum, a constant counts as many samples as the slow part of the error has independent values,
and a transient is compared with the error at the transient's own frequency.
"""

from collections.abc import Callable

import numpy as np
import scipy
from jaxtyping import Bool, Float

_ORDER = 6  # P, lags of the autoregression


def whitener(error: Float[np.ndarray, " time"]) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that whitens signals, shape (time, ...), with the spectrum of an error.

    The first P samples are whitened by the Cholesky factor of their covariance, so no sample is lost.
    """
    size = len(error)
    # Divided by T at every lag, so that the Toeplitz matrix has no negative eigenvalue and 1 / phi is a stable filter.
    lags = np.array([error[: size - k] @ error[k:] for k in range(_ORDER + 1)]) / size
    # a silent or perfectly predictable error would make the system singular
    lags[0] = lags[0] * (1 + 1e-9) + 1e-300
    phi = scipy.linalg.solve_toeplitz(lags[:_ORDER], lags[1:])
    innovation = max(lags[0] - phi @ lags[1:], 1e-12 * lags[0])  # var w; rounding may take it below zero
    # in units of var w, so that the first samples weigh as much as the filtered ones
    first = scipy.linalg.cholesky(scipy.linalg.toeplitz(lags[:_ORDER]) / innovation, lower=True)

    def whiten(values):
        white = np.asarray(scipy.signal.lfilter(np.append(1.0, -phi), [1.0], values, axis=0))
        # the filter assumes silence before the record, which in fact held the same noise
        white[:_ORDER] = scipy.linalg.solve_triangular(first, values[:_ORDER], lower=True)
        return white

    return whiten


def project(
    values: Float[np.ndarray, "time *many"],
    columns: Float[np.ndarray, "time n"],
    counts: Bool[np.ndarray, " time"] | bool = True,
) -> tuple[Float[np.ndarray, "n *many"], Float[np.ndarray, "time *many"]]:
    """Fit `columns` to `values` by least squares, where they count; return the coefficients and the whole residual."""
    # QR instead of normal equations, because free responses of two close poles are nearly collinear
    inside = columns * np.reshape(counts, (-1, 1))
    # columns of equal size, so that rcond drops directions, not columns of small units
    size = np.maximum(np.linalg.norm(inside, axis=0), 1e-300)
    q, r = np.linalg.qr(inside / size)
    factors = ((np.linalg.pinv(r, rcond=1e-10) @ (q.T @ values)).T / size).T
    return factors, values - columns @ factors


def criterion(residual: Float[np.ndarray, " time"], parameters: int) -> float:
    """Return the Bayesian information criterion (BIC) of a whitened residual."""
    size = len(residual)
    return float(size * np.log(max(residual @ residual, 1e-300)) + parameters * np.log(size))


def block_means(values: np.ndarray, weight: Float[np.ndarray, " time"], size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return weighted means over blocks of `size` samples, (blocks, ...), and the mean weight of each block.

    Samples after the last whole block are dropped.
    """
    count = len(weight) // size
    w = weight[: count * size].reshape(count, size)
    v = values[: count * size].reshape(count, size, *values.shape[1:])
    total = w.sum(1)
    sums = np.einsum("bs,bs...->b...", w, v)
    return sums / np.maximum(total, 1e-300).reshape(-1, *[1] * (sums.ndim - 1)), total / size

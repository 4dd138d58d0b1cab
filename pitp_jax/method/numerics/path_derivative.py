"""Differentiate a sampled path in a traced program, by products with constant matrices.

    x^(i)_t dt^i = sum_s W_i(s) x_{t+s},  |s| <= R       W: the spline's response to a single sample
    within R samples of an end, and for a short path: rows of the spline's own matrix

Every sum uses differences from one sample of its own block. W_i sums to zero, so rounding depends only on the motion
within a block.
"""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .spline_derivative import derivatives, inner, reach

_BLOCK = 64  # samples that share one matrix product


@lru_cache
def _matrix(count: int, order: int) -> Float[np.ndarray, "count count order"]:
    return derivatives(np.eye(count), 1.0, order)[..., 1:]


@lru_cache
def _band(order: int) -> Float[np.ndarray, "window block order"]:
    """Return the matrix from a block of samples, with R more on either side, to the derivatives in the block."""
    r = reach(order)
    taps = inner(np.eye(1, 4 * r + 1, 2 * r)[0], 1.0, order)[::-1, 1:]  # by s = -R ... R
    band = np.zeros((_BLOCK + 2 * r, _BLOCK, order))
    for at in range(_BLOCK):
        band[at : at + 2 * r + 1, at] = taps
    return band


def path_derivatives(x: Float[Array, " time"], order: int) -> Float[Array, "time tokens"]:
    """Differentiate a whole path; return [x, x' dt, ..., x^(order) dt^order], shape (time, order + 1).

    Raises:
        BadInput: fewer samples than the order needs.
    """
    r, count = reach(order), len(x)
    if count <= 6 * r:  # the two end pieces of 3 R are then the whole path
        rows = _product(x - x[0], _matrix(count, order))
    else:
        ends = _matrix(3 * r, order)
        head, tail = x[: 3 * r], x[-3 * r :]
        first, last = _product(head - head[0], ends[:r]), _product(tail - tail[0], ends[-r:])
        rows = jnp.concatenate([first, _inner(x, order), last])
    return jnp.concatenate([x[:, None], rows], -1)


def _product(values: Float[Array, " samples"], matrix: Float[np.ndarray, "rows samples order"]) -> Array:
    weights = jnp.asarray(matrix, values.dtype)
    return jnp.einsum("tsi,s->ti", weights, values, precision=jax.lax.Precision.HIGHEST)


def _inner(x: Float[Array, " time"], order: int) -> Float[Array, "inner order"]:
    r, count = reach(order), len(x) - 2 * reach(order)
    blocks = -(-count // _BLOCK)
    padded = jnp.pad(x, (0, blocks * _BLOCK - count), mode="edge")
    windows = padded[np.arange(blocks)[:, None] * _BLOCK + np.arange(_BLOCK + 2 * r)]
    windows = windows - windows[:, r : r + 1]
    band = jnp.asarray(_band(order).reshape(_BLOCK + 2 * r, -1), x.dtype)
    rows = jnp.matmul(windows, band, precision=jax.lax.Precision.HIGHEST)
    return rows.reshape(-1, order)[:count]

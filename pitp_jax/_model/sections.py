"""Tokens of a stable polynomial: factors whose coefficients are the nominal's times positive numbers.

    sum_i sigma_i s^i = sigma_n prod_k (s^2 + p_k s + q_k) [(s + r)]       q_0, p_0, q_1, p_1, ..., r, sigma_n > 0

For n <= 2 these are the tokens themselves. For n >= 3 positive tokens alone may be unstable (Routh-Hurwitz); positive
factors never are, and every stable polynomial is reached.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def sections_of(coefficients: np.ndarray) -> tuple[float, ...]:
    """(q_0, p_0, q_1, p_1, ..., [r]) of nominal coefficients a_0 ... a_n, slowest pair first; needs stable roots."""
    roots = np.roots(np.asarray(coefficients, np.float64)[::-1])
    upper = sorted(roots[roots.imag > 1e-9 * np.abs(roots)], key=abs)
    real = sorted(-roots[np.abs(roots.imag) <= 1e-9 * np.abs(roots)].real)
    pairs = [(abs(r) ** 2, -2 * r.real) for r in upper]
    pairs += [(real[k] * real[k + 1], real[k] + real[k + 1]) for k in range(0, len(real) - 1, 2)]
    flat = [float(v) for pair in sorted(pairs) for v in pair]
    return tuple(flat + ([float(real[-1])] if len(real) % 2 else []))


def product(values: Float[Array, " n"]) -> Float[Array, " n+1"]:
    """Ascending coefficients c_0 ... c_{n-1}, 1 of the polynomial with these sections."""
    one = jnp.ones((), values.dtype)
    poly = one[None]
    for k in range(0, len(values) - 1, 2):
        poly = jnp.convolve(poly, jnp.stack([values[k], values[k + 1], one]))
    return jnp.convolve(poly, jnp.stack([values[-1], one])) if len(values) % 2 else poly

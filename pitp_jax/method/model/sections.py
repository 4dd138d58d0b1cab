"""Keep the polynomial of the coefficients stable: its quadratic factors keep positive coefficients.

    sum_i sigma_i s^i = sigma_n prod_k (s^2 + p_k s + q_k) [(s + r)]       q_0, p_0, q_1, p_1, ..., r, sigma_n > 0

For n <= 2 these are the tokens themselves. For n >= 3 positive tokens alone may be unstable (Routh-Hurwitz); positive
factors never are, and every stable polynomial is reached.
"""

from collections.abc import Sequence

import numpy as np

from .rows import Rows


def factored(roots: np.ndarray) -> tuple[list[tuple[float, float]], list[float]]:
    """Return the factors of a polynomial with these stable roots: (q, p) of every s^2 + p s + q, then r of an s + r."""
    # rounding may give a real root a small imaginary part
    is_real = np.abs(np.imag(roots)) <= 1e-9 * np.abs(roots)
    real = sorted((-np.real(roots[is_real])).tolist())
    pairs = [(abs(r) ** 2, -2 * r.real) for r in roots[~is_real & (np.imag(roots) > 0)].tolist()]
    pairs += [(a * b, a + b) for a, b in zip(real[::2], real[1::2], strict=False)]
    return pairs, real[len(real) - len(real) % 2 :]


def sections_of(coefficients: np.ndarray) -> tuple[float, ...]:
    """Factor the polynomial a_0 ... a_n into sections (q_0, p_0, q_1, p_1, ..., [r]), slowest pair first.

    The roots must be stable.
    """
    pairs, rest = factored(np.roots(np.asarray(coefficients, np.float64)[::-1]))
    return (*(v for pair in sorted(pairs) for v in pair), *rest)


def product(values: Rows | Sequence[float]) -> list:
    """Multiply sections: return the ascending coefficients of their product polynomial; the highest one is 1."""
    poly: list = [1.0]  # values may be traced rows, which np.polymul does not accept
    for section in ([*values[k : k + 2], 1.0] for k in range(0, len(values), 2)):
        wide: list = [0.0] * (len(poly) + len(section) - 1)
        for i, a in enumerate(poly):
            for k, b in enumerate(section):
                wide[i + k] = wide[i + k] + a * b
        poly = wide
    return poly

"""Find the resonance frequency of a linear model a_0 x + ... + a_n x^(n) = F with any poles.

    1. |p| of the pole pair with the largest residue 1 / |a'(p)| in displacement, among those with -Re p / |p| < 0.7
    2. else where the model lags 90 degrees,        Re a(jw) = a_0 - a_2 w^2 + a_4 w^4 - ... = 0
    3. else the corner of its slowest pole,         min |p|, p != 0

A pole below 1e-7 of the fastest counts as 0 (a plant without a spring), which no division by a_0 may meet.

Not the geometric mean of all poles: a lag at 347 Hz or creep at 0.01 Hz would move that of an 8 Hz mode to 28 or 0.9.
Not the least damped pair: a joint at 10 Hz has a gear's mode at 200 Hz that rings longer, but hardly moves it.
"""

import numpy as np
from jaxtyping import Complex, Float


def nonzero_poles(a: Float[np.ndarray, " tokens"]) -> Complex[np.ndarray, " poles"]:
    """Return the poles (rad/s) for coefficients a_0 ... a_n, without those of integrators."""
    roots = np.roots(a[::-1]).astype(complex)
    return roots[np.abs(roots) > 1e-7 * np.abs(roots).max(initial=0.0)]


def has_spring(a: Float[np.ndarray, " tokens"]) -> bool:
    """Return whether no pole is an integrator's, for coefficients a_0 ... a_n."""
    return len(nonzero_poles(a)) == len(np.roots(a[::-1]))


def dominant_frequency(a: Float[np.ndarray, " tokens"]) -> float:
    """Return the resonance frequency (rad/s) for coefficients a_0 ... a_n; 0 if all poles are integrators."""
    a = np.nan_to_num(a)  # a diverged model still gets a number; its runs show what is wrong
    roots = nonzero_poles(a)  # an integrator's pole has no damping ratio
    damping = -np.real(roots) / np.abs(roots)
    pairs = roots[(np.imag(roots) > 0) & (damping < 0.7)]  # sqrt(1/2): a pair with less damping has a resonance
    if len(pairs):
        slope = np.polyval(np.polyder(a[::-1]), pairs)
        return float(np.abs(pairs[np.argmin(np.abs(slope))]))
    even = a[::2] * (-1.0) ** np.arange(len(a[::2]))  # Re a(jw) as a polynomial in w^2
    squares = np.roots(even[::-1] if has_spring(a) else [1.0])  # without a spring the phase starts at -90
    # roots that are real but for rounding
    lags = np.sqrt(squares.real[(np.abs(squares.imag) <= 1e-9 * np.abs(squares)) & (squares.real > 0)])
    return float(min(lags, default=min(np.abs(roots), default=0.0)))

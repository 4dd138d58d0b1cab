"""Differentiate a series of samples numerically.

    central   (d x)_t = (x_{t+1} - x_{t-1}) / (2 dt), one-sided at both ends   (paper, eq. 8)
    stencil   (d x)_t = sum_{k=1..4} c_k (x_{t+k} - x_{t-k}) / dt   (8th order)
              c = 4/5, -1/5, 4/105, -1/280

Eq. 8 applied twice multiplies x'' of a sine by (sin(w dt) / (w dt))^2, 3.6 % too small at w dt = 0.33 (130 Hz twice, at
5 kHz); the force is not attenuated, so the coefficients would be biased. The stencil is off by 5e-7 there. Near the
ends it falls back to 6th, 4th and 2nd order, at the ends themselves to a one-sided difference of 2nd order.
"""

import numpy as np

_STENCILS = (  # reach 1 to 4: orders 2, 4, 6, 8
    (1 / 2,),
    (2 / 3, -1 / 12),
    (3 / 4, -3 / 20, 1 / 60),
    (4 / 5, -1 / 5, 4 / 105, -1 / 280),
)
MIN_LENGTH = 9  # samples of the widest stencil: four on either side


def central(values: np.ndarray, dt: float) -> np.ndarray:
    """Differentiate samples by central differences, exactly as the paper does (eq. 8).

    Args:
        values: shape (T,), T >= 2.
        dt: sampling interval in s.

    Returns:
        the derivative per second, shape (T,).
    """
    return np.gradient(values, dt)


def stencil(values: np.ndarray, dt: float) -> np.ndarray:
    """Differentiate samples by central differences of 8th order.

    Args:
        values: shape (T,), T >= 9.
        dt: sampling interval in s.

    Returns:
        the derivative per second, shape (T,).
    """
    slope = np.gradient(values, edge_order=2)
    # the longer stencils where as many neighbours lie on either side
    for reach, half in enumerate(_STENCILS, start=1):
        slope[reach:-reach] = np.convolve(values, [*half[::-1], 0.0, *np.negative(half)], "valid")
    return slope / dt


DIFFERENCES = {"central": central, "stencil": stencil}

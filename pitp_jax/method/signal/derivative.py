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
MIN_LENGTH = 9


def central(values: np.ndarray, dt: float) -> np.ndarray:
    """Differentiate samples by central differences, exactly as the paper does (eq. 8).

    Args:
        values: shape (T,), T >= 2.
        dt: sampling interval in s.

    Returns:
        the derivative per second, shape (T,).
    """
    slope = np.empty_like(values)
    slope[1:-1] = (values[2:] - values[:-2]) / (2 * dt)
    slope[0] = (values[1] - values[0]) / dt
    slope[-1] = (values[-1] - values[-2]) / dt
    return slope


def stencil(values: np.ndarray, dt: float) -> np.ndarray:
    """Differentiate samples by central differences of 8th order.

    Args:
        values: shape (T,), T >= 9.
        dt: sampling interval in s.

    Returns:
        the derivative per second, shape (T,).
    """
    count = len(values)
    slope = np.zeros(count)
    # where four neighbours lie on either side
    inside = slice(4, count - 4)
    for k, weight in enumerate(_STENCILS[3], start=1):
        slope[inside] += weight * (values[4 + k : count - 4 + k] - values[4 - k : count - 4 - k])
    # towards the ends shorter stencils, which are still central
    for reach in (1, 2, 3):
        for at in (reach, count - 1 - reach):
            slope[at] = sum(
                weight * (values[at + k] - values[at - k]) for k, weight in enumerate(_STENCILS[reach - 1], start=1)
            )
    # one-sided of second order, (-3 y_0 + 4 y_1 - y_2) / 2
    slope[0] = -1.5 * values[0] + 2.0 * values[1] - 0.5 * values[2]
    slope[-1] = 1.5 * values[-1] - 2.0 * values[-2] + 0.5 * values[-3]
    return slope / dt


DIFFERENCES = {"central": central, "stencil": stencil}

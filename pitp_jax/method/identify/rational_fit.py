"""Fit poles, zeros and a delay to the frequency response: what a claim on zeros or a resonance needs.

    G(s) = e^{-s tau} sinc^2(w h / 2) (b_0 + ... + b_m s^m) / prod (s^2 + 2 z w s + w^2) [(s + c)],    s = j w
    minimise  sum_k | G(j w_k) - G_k |^2 / s_k^2,    s_k: its standard error, at least 2 % of |G_k|

b is projected out (variable projection), so a start needs poles and a delay alone; these come from the equation error
|a(s) G_k - b(s) e^{-s tau}|, iterated with its own denominator as weight. A resonance is a pole pair with a peak
(z < 1 / sqrt 2) without which the best fit leaves a quarter more error.
Source: Sanathanan & Koerner (1963); Golub & Pereyra (1973); Pintelon & Schoukens (2012), 9.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from .frequency_fit import DELAYS, Lines, equation_error, projected
from .frequency_response import FrequencyResponse
from .linear_ode import logs_from_roots, poles

PEAK = 0.5**0.5  # damping below which a pole pair has a resonance peak
_CLEARLY = 0.8  # of the error, beside one standard error: what a fit with a peak leaves where it needs one


@dataclass(frozen=True)
class Rational:
    """A fit of the response: rms error over the standard error, poles and zeros in rad/s, delay in s."""

    error: float
    poles: np.ndarray
    zeros: np.ndarray
    delay: float


def needs_resonance(response: FrequencyResponse, dt: float) -> bool:
    """Return whether the response needs a pole pair with a peak."""
    if not response.rich:
        return False
    without = fit_rational(response, dt, 3, 2, least=PEAK).error
    fits = (fit_rational(response, dt, order, zeros).error for order, zeros in ((2, 0), (3, 2)))
    return any(np.hypot(1, error) < _CLEARLY * np.hypot(1, without) for error in fits)


def fit_rational(
    response: FrequencyResponse, dt: float, order: int, zeros: int = 0, *, least: float = 1e-3
) -> Rational:
    """Fit `order` poles, `zeros` zeros and a delay; `least` is the smallest damping ratio of a pole pair."""
    lines = Lines.of(response, dt)
    step = lines.unit * dt

    def damped(p):
        logs = p[:-1].copy()
        for k in range(0, order - 1, 2):
            logs[k] = max(logs[k], np.log(2 * least) + logs[k + 1] / 2)
        return logs

    def misfit(p):
        return projected(lines, damped(p), p[-1] * step, zeros)[0]

    def begin(late, origin):
        roots = equation_error(lines, order, late * step, zeros=zeros, origin=origin)
        logs = logs_from_roots(np.append(roots, [-1.0] * (order - len(roots))))
        return np.clip(np.append(logs, late), low + 1e-6, high - 1e-6)

    low, high = np.append(np.full(order, -16.0), 0.0), np.append(np.full(order, 16.0), 2 * DELAYS[-1])
    fits = []
    for origin in (False, True)[: 1 + (zeros > 0)]:
        start = min((begin(d, origin) for d in (0.0, *DELAYS)), key=lambda p: float(np.sum(misfit(p) ** 2)))
        fits.append(least_squares(misfit, start, bounds=(low, high), max_nfev=40, x_scale="jac"))
    fit = min(fits, key=lambda f: f.cost)
    logs = damped(fit.x)
    found = np.roots(projected(lines, logs, fit.x[-1] * step, zeros)[1][::-1])
    error = float(np.sqrt(2 * fit.cost / len(lines.s)))
    return Rational(error, lines.unit * poles(logs), lines.unit * found, float(fit.x[-1] * dt))

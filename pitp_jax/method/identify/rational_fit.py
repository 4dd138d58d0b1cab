"""Fit poles, zeros and a delay to the frequency response: what a claim on zeros or a resonance needs.

    G(s) = e^{-s tau} sinc^2(w h / 2) (b_0 + ... + b_m s^m) / prod (s^2 + 2 z w s + w^2) [(s + c)],    s = j w
    minimise  sum_k | G(j w_k) - G_k |^2 / s_k^2,    s_k: its standard error, at least 2 % of |G_k|

b is projected out (variable projection), so a start needs poles and a delay alone; these come from the equation error
|a(s) G_k - b(s) e^{-s tau}|, iterated with its own denominator as weight. A resonance is a pole pair with a peak
(z < 1 / sqrt 2) without which the best fit leaves a quarter more error.
Source: Sanathanan & Koerner (1963); Golub & Pereyra (1973); Pintelon & Schoukens (2012), 9.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Inexact
from scipy.optimize import least_squares

from .frequency_response import FrequencyResponse
from .linear_ode import logs_from_roots, poles, polynomial

PEAK = 0.5**0.5  # damping below which a pole pair has a resonance peak
DELAYS = np.geomspace(0.5, 45.0, 8)  # samples: starting values of the delay


class Lines(NamedTuple):
    """Coherent lines: s = j w in units of `unit` (rad/s), response, weight, transfer function of the hold."""

    s: np.ndarray
    value: np.ndarray
    weight: np.ndarray
    held: np.ndarray
    unit: float

    @classmethod
    def of(cls, response: FrequencyResponse, dt: float) -> "Lines":
        """Select the frequencies at which a response, sampled every `dt` seconds, is coherent."""
        known = np.flatnonzero(response.coherent)
        hz, value = response.hz[known], response.value[known]
        # no response is linear to better than 2 %
        weight = 1 / np.maximum(response.stderr[known], 0.02 * np.abs(value))
        # powers of s up to six stay of order one
        unit = 2 * np.pi * float(np.exp(np.log(hz).mean()))
        return cls(2j * np.pi * hz / unit, value, weight, np.sinc(hz * dt) ** 2, unit)


def equation_error(
    lines: Lines, order: int, late: float, *, zeros: int = 0, origin: bool = False
) -> Inexact[np.ndarray, " poles"]:
    """Return the poles of the linear fit  a(s) G = b(s) e^{-s tau},  weighted by 1 / |a|, with tau = `late`.

    Scaled so that b_0 = 1. `origin`: b_0 may be 0; the sum of squares of all coefficients is 1 instead.
    """
    s, size, a = lines.s, np.ones(len(lines.s)), np.ones(order + 1)
    value, powers = lines.value / lines.held * np.exp(s * late), s[:, None] ** np.arange(max(order, zeros) + 1)
    for _ in range(8):
        rows = np.column_stack([powers[:, : order + 1] * value[:, None], -powers[:, : zeros + 1]])
        rows = rows * (lines.weight * np.abs(lines.held) * size)[:, None]
        rows = np.vstack([rows.real, rows.imag])
        norm, last = np.linalg.norm(rows, axis=0) + 1e-300, order + 1  # the column of b_0
        if origin:
            a = (np.linalg.svd(rows / norm, full_matrices=False)[2][-1] / norm)[:last]
        else:
            others = np.delete(rows / norm, last, axis=1)
            a = (np.linalg.lstsq(others, -rows[:, last], rcond=1e-10)[0] / np.delete(norm, last))[:last]
        # the weight 1 / |a| of the last round makes an equation error an output error (Sanathanan & Koerner)
        size = 1 / np.maximum(np.abs(powers[:, : order + 1] @ a), 1e-9 * np.abs(a).max())
    return np.roots(a[::-1])


def projected(
    lines: Lines, logs: np.ndarray, late: float, zeros: int = 0
) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " powers"]]:
    """Fit the numerator b_0 ... b_m to the lines at given poles and delay, both in units of `lines`.

    Returns:
        the weighted residual, real then imaginary parts, and the numerator's coefficients.
    """
    s, powers = lines.s[:, None], np.arange(zeros + 1)
    own = lines.weight * lines.held * np.exp(-lines.s * late) / np.polyval(polynomial(logs)[::-1], lines.s)
    rows, target = (
        np.concatenate([np.real(v), np.imag(v)]) for v in (own[:, None] * s**powers, lines.weight * lines.value)
    )
    size = np.linalg.norm(rows, axis=0) + 1e-300
    b = np.linalg.lstsq(rows / size, target, rcond=1e-12)[0] / size
    return rows @ b - target, b


@dataclass(frozen=True)
class Rational:
    """A fit of the response: rms error over the standard error, poles and zeros in rad/s, delay in s."""

    error: float
    poles: np.ndarray
    zeros: np.ndarray
    delay: float


def needs_resonance(response: FrequencyResponse, dt: float) -> bool:
    """Return whether a pole pair with a peak leaves less than 0.8 times the error, beside one standard error."""
    if not response.rich:
        return False
    without = fit_rational(response, dt, 3, 2, least=PEAK).error
    fits = (fit_rational(response, dt, order, zeros).error for order, zeros in ((2, 0), (3, 2)))
    return any(np.hypot(1, error) < 0.8 * np.hypot(1, without) for error in fits)


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

    def fitted(p):
        return projected(lines, damped(p), p[-1] * step, zeros)

    def misfit(p):
        return fitted(p)[0]

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
    found = np.roots(fitted(fit.x)[1][::-1])
    error = float(np.sqrt(2 * fit.cost / len(lines.s)))
    return Rational(error, lines.unit * poles(damped(fit.x)), lines.unit * found, float(fit.x[-1] * dt))

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

from .frequency_fit import Lines
from .frequency_response import FrequencyResponse

PEAK = 0.5**0.5  # damping below which a pole pair has a resonance peak
_CLEARLY = 0.8  # of the error, beside one standard error: what a fit with a peak leaves where it needs one
_DELAYS = np.concatenate([[0.0], np.geomspace(0.5, 45.0, 8)])  # samples: starts
_ROUNDS, _MOST = 8, 40


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
    response: FrequencyResponse, dt: float, order: int, zeros: int = 0, *, delayed: bool = True, least: float = 1e-3
) -> Rational:
    """Fit `order` poles, `zeros` zeros and a delay; `least` is the smallest damping ratio of a pole pair."""
    lines = Lines.of(response, dt)
    s, pairs, step = lines.s, order // 2, lines.unit * dt
    powers, goal = s[:, None] ** np.arange(zeros + 1), lines.weight * lines.value

    def project(p):
        w, z = np.exp(p[:pairs]), np.exp(p[pairs : 2 * pairs])
        scale = lines.weight * lines.held * np.exp(-s * p[-1] * step)
        scale = scale / np.prod(s[:, None] ** 2 + 2 * z * w * s[:, None] + w**2, axis=1)
        if order % 2:
            scale = scale / (s + np.exp(p[2 * pairs]))
        rows, target = (np.concatenate([np.real(v), np.imag(v)]) for v in (scale[:, None] * powers, goal))
        size = np.linalg.norm(rows, axis=0) + 1e-300
        b = np.linalg.lstsq(rows / size, target, rcond=1e-12)[0] / size
        return rows @ b - target, b

    low = np.concatenate([np.full(pairs, -8.0), np.full(pairs, np.log(least)), np.full(order % 2, -12.0), [0.0]])
    latest = 2 * _DELAYS[-1] if delayed else 1e-5
    high = np.concatenate([np.full(pairs, 8.0), np.full(pairs, 4.0), np.full(order % 2, 8.0), [latest]])
    late = _DELAYS if delayed else _DELAYS[:1]
    fits = []
    for origin in (False, True)[: 1 + (zeros > 0)]:
        starts = [np.clip(_start(lines, order, zeros, d, step, origin), low + 1e-6, high - 1e-6) for d in late]
        start = min(starts, key=lambda p: float(np.sum(project(p)[0] ** 2)))
        fits.append(least_squares(lambda p: project(p)[0], start, bounds=(low, high), max_nfev=_MOST, x_scale="jac"))
    fit = min(fits, key=lambda f: f.cost)
    w, z = np.exp(fit.x[:pairs]), np.exp(fit.x[pairs : 2 * pairs])
    roots = [-z * w + sign * w * np.sqrt(z**2 - 1 + 0j) for sign in (1, -1)]
    poles = np.concatenate([*roots, -np.exp(fit.x[2 * pairs : -1])])
    found = np.roots(project(fit.x)[1][::-1]) if zeros else np.zeros(0)
    error, delay = float(np.sqrt(2 * fit.cost / len(s))), float(fit.x[-1] * dt) if delayed else 0.0
    return Rational(error, lines.unit * poles, lines.unit * found, delay)


def _start(lines: Lines, order: int, zeros: int, late: float, step: float, origin: bool = False) -> np.ndarray:
    """Return initial parameters from the equation error at a delay of `late` samples, scaled so that b_0 = 1.

    `origin`: b_0 may be 0; the sum of squares of all coefficients is 1 instead.
    """
    s, weight = lines.s, lines.weight * np.abs(lines.held)
    value, size = lines.value / lines.held * np.exp(s * late * step), np.ones(len(s))
    powers = s[:, None] ** np.arange(max(order, zeros) + 1)
    a = np.ones(order + 1)
    for _ in range(_ROUNDS):
        rows = np.column_stack([powers[:, : order + 1] * value[:, None], -powers[:, : zeros + 1]])
        rows = rows * (weight * size)[:, None]
        rows = np.vstack([rows.real, rows.imag])
        norm, last = np.linalg.norm(rows, axis=0) + 1e-300, order + 1  # the column of b_0
        if origin:
            a = (np.linalg.svd(rows / norm, full_matrices=False)[2][-1] / norm)[:last]
        else:
            others = np.delete(rows / norm, last, axis=1)
            a = (np.linalg.lstsq(others, -rows[:, last], rcond=1e-10)[0] / np.delete(norm, last))[:last]
        # the weight 1 / |a| of the last round makes an equation error an output error (Sanathanan & Koerner)
        size = 1 / np.maximum(np.abs(powers[:, : order + 1] @ a), 1e-9 * np.abs(a).max())
    roots = np.roots(a[::-1])
    roots = np.concatenate([roots, np.full(order - len(roots), -1.0)])
    pairs = sorted([r for r in roots if r.imag > 0], key=abs)
    reals = sorted([abs(r.real) + 1e-9 for r in roots if r.imag == 0])
    single = [reals.pop()] if order % 2 else []
    quads = [(abs(r), abs(r.real) / abs(r)) for r in pairs]
    quads += [(np.sqrt(a * b), (a + b) / 2 / np.sqrt(a * b)) for a, b in zip(reals[::2], reals[1::2], strict=True)]
    w, z = np.array(quads).reshape(-1, 2).T
    return np.concatenate([np.log(w), np.log(np.maximum(z, 1e-6)), np.log(single), [late]])

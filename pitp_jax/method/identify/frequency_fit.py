"""Fit poles and delays of every order to the frequency response, by Levenberg-Marquardt (optimistix).

    minimise  sum_k | g M(j w_k) - G_k |^2 / s_k^2 + 1e-8 |p - p_0|^2,    s_k: its standard error, at least 2 % of |G_k|
    M = e^{-s tau} sinc^2(w h / 2) prod_active e^q / (s^2 + e^p s + e^q) [e^r / (s + e^r)],    s = j w,  g: real

All orders, with and without a delay, use one program; a mask removes the poles that an order does not have. The starts
come from the linear equation-error fit in frequency (iterated with its own denominator as weight).
Source: Sanathanan & Koerner (1963); Pintelon & Schoukens (2012), 9.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float

from ..numerics.where import where
from .frequency_response import LINES, FrequencyResponse
from .linear_ode import logs_from_roots
from .rational_fit import DELAYS, Lines, equation_error, projected

_PAIRS = 3


def fit_response(
    response: FrequencyResponse, dt: float, orders: Sequence[int], delays: Sequence[bool] = (False, True)
) -> dict[tuple[int, bool], np.ndarray]:
    """Fit every (order, delayed); return logarithms of the pole coefficients (rad/s), then of the delay (s)."""
    lines = Lines.of(response, dt)
    s, value, weight, held, unit = lines
    shapes = [(order, delayed) for order in orders for delayed in delays]
    rows = [(_start(*shape, lines, unit * dt), _mask(*shape)) for shape in shapes]
    pad = LINES - len(s)  # padded to one shape with weight 0, so that one program serves every record
    data = [np.pad(a, (0, pad)) for a in (np.imag(s), np.real(value), np.imag(value), weight, held)]
    with jax.enable_x64(True):
        fixed = [jnp.asarray(a) for a in data]
        fits = [_least_squares(jnp.asarray(start), jnp.asarray(mask), fixed) for start, mask in rows]
    result = {}
    for (order, delayed), row in zip(shapes, fits, strict=True):
        logs = _logs(row, order, unit)
        with np.errstate(over="ignore"):  # sines far below a pole move it to infinity
            finite = np.isfinite([*row, *np.exp(2 * logs)]).all()
        if finite:
            result[order, delayed] = np.append(logs, [row[-1] - np.log(unit)] * delayed)
    return result


def _logs(row: np.ndarray, order: int, unit: float) -> np.ndarray:
    """Return the logarithms of one order's pole coefficients in rad/s, from a padded and scaled parameter vector."""
    logs = np.concatenate([row[: 2 * (order // 2)], row[2 * _PAIRS : 2 * _PAIRS + order % 2]])
    return logs + np.log(unit) * np.array([1.0, 2.0] * (order // 2) + [1.0] * (order % 2))


def _least_squares(start: Array, mask: Array, data: list[Array]) -> np.ndarray:
    """Return the fitted parameters of one order. Orders are fitted one by one: a batch compiles twice as long."""
    solver = optimistix.LevenbergMarquardt(rtol=1e-6, atol=1e-9)
    solution = optimistix.least_squares(
        _residual, solver, start, args=(start, mask, *data), max_steps=60, throw=False
    )  # fmt: skip
    return np.asarray(solution.value)


def _mask(order: int, delayed: bool) -> np.ndarray:
    pairs = np.repeat(np.arange(_PAIRS) < order // 2, 2)
    return np.concatenate([pairs, [order % 2 == 1, delayed]]).astype(float)


def _start(order: int, delayed: bool, lines: Lines, sample: float) -> np.ndarray:
    """Return initial parameters from the equation error, at the best delay."""
    best, chosen = np.inf, np.zeros(2 * _PAIRS + 2)
    for late in DELAYS * sample if delayed else (0.0,):
        roots = equation_error(lines, order, late)
        if len(roots) != order or not np.isfinite(roots).all():
            continue
        logs = logs_from_roots(roots)
        cost = float(np.sum(projected(lines, logs, late)[0] ** 2))
        if cost < best:
            best, chosen = cost, np.zeros(2 * _PAIRS + 2)
            chosen[: 2 * (order // 2)] = logs[: 2 * (order // 2)]
            chosen[2 * _PAIRS : 2 * _PAIRS + order % 2] = logs[2 * (order // 2) :]
            chosen[-1] = np.log(max(late, 1e-6))
    return chosen


def _residual(p: Float[Array, " numbers"], given) -> Float[Array, " rows"]:
    """Return the weighted error of the fitted response, real then imaginary parts; masked parameters do not change."""
    start, mask, omega, real, imag, weight, held = given
    s, value = 1j * omega, real + 1j * imag
    p = where(mask > 0, p, start)
    damping, size = (jnp.exp(p[k : 2 * _PAIRS : 2])[:, None] for k in (0, 1))
    pairs = where(mask[: 2 * _PAIRS : 2, None] > 0, size / (s**2 + damping * s + size), 1.0)
    corner = jnp.exp(p[2 * _PAIRS])
    single = jnp.where(mask[2 * _PAIRS] > 0, corner / (s + corner), 1.0)
    own = weight * held * jnp.exp(-s * jnp.exp(p[-1]) * mask[-1]) * jnp.prod(pairs, 0) * single
    # g is linear and real: it is projected out, so it needs no start
    gain = jnp.sum((own.conj() * weight * value).real) / jnp.maximum(jnp.sum(jnp.abs(own) ** 2), 1e-300)
    misfit = gain * own - weight * value
    return jnp.concatenate([misfit.real, misfit.imag, 1e-4 * (p - start)])

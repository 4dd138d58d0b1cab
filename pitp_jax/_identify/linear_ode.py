"""Stable linear ODEs by construction, and their exact response to a sampled drive.

    P(s) = prod (s^2 + e^p s + e^q) [(s + e^r)] = prod (s - p_i):  every stable polynomial is reached
    P(0) / P(s) = sum_i r_i / (s - p_i),    r_i = P(0) / prod_{j != i} (p_i - p_j)            (partial fractions)
    m_i(t+1) = e^z m_i(t) + f_1 F_t + f_2 (F_{t+1} - F_t) + f_3 (u_{t+1} - u_t)^2,    x = sum_i r_i m_i,    z = p_i h
    f_1 = phi_1(z),   f_2 = phi_2(z),   f_3 = 2 phi_3(z) - phi_2(z),    phi_k(z) = sum_j z^j / (j + k)!

Exact for a voltage linear (foh) or constant (zoh) between samples, squared or not; f_3 is what the square of a line has
beside the line between squares. A mode is one first-order filter, ten times faster than the chained state space.
"""

from math import factorial

import numpy as np
from jaxtyping import Complex, Float
from scipy.signal import lfilter

from .._numerics.intersample import between

_FINER = 4
_APART = 1e-5  # of a pole: two nearer ones are moved apart, which shifts a response by less than 1e-9
_TERMS = 24


def _factors(logs: np.ndarray) -> list[np.ndarray]:
    """Ascending coefficients of the quadratic factors, and of the linear one of an odd order."""
    sizes = np.exp(logs)
    pairs = [np.array([sizes[k + 1], sizes[k], 1.0]) for k in range(0, len(logs) - 1, 2)]
    return pairs + [np.array([sizes[-1], 1.0])] * (len(logs) % 2)


def _product(factors) -> np.ndarray:
    product = np.ones(1)
    for factor in factors:
        product = np.convolve(product, factor)
    return product


def polynomial(logs: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n+1"]:
    """Ascending coefficients c_0 ... c_{n-1}, 1 of the factors whose coefficients have the logarithms `logs`."""
    return _product(_factors(logs))


def polynomial_slopes(logs: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n+1 n"]:
    """Derivatives dc_i / dlogs_j: the other factors times the one term that logs_j scales."""
    factors, slopes = _factors(logs), np.zeros((len(logs) + 1, len(logs)))
    for k, factor in enumerate(factors):
        others = _product(factors[:k] + factors[k + 1 :])
        for power in range(len(factor) - 1):  # ascending, while logs hold the highest power first
            column = 2 * k + len(factor) - 2 - power
            slopes[power : power + len(others), column] = factor[power] * others
    return slopes


def logs_from_roots(roots: np.ndarray) -> np.ndarray:
    """Inverse of `polynomial`, after reflecting the roots into the stable half plane."""
    roots = np.asarray(roots, complex)
    size = np.maximum(np.abs(roots), 1e-4)
    roots = np.asarray(-np.maximum(np.abs(np.real(roots)), 1e-3 * size) + 1j * np.imag(roots))
    real_root = np.abs(np.imag(roots)) <= 1e-9 * size
    pairs = roots[~real_root & (np.imag(roots) > 0)]
    real = sorted(-np.real(roots[real_root]))
    logs = [v for r in pairs for v in (np.log(-2 * r.real), np.log(abs(r) ** 2))]
    while len(real) > 1:
        a, b = real.pop(0), real.pop(0)
        logs += [np.log(a + b), np.log(a * b)]
    return np.array(logs + [np.log(r) for r in real])


def poles(logs: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " n"]:
    """The poles, no two of them alike."""
    found: list[complex] = []
    for factor in _factors(logs):
        if len(factor) == 2:
            found.append(complex(-factor[0]))
            continue
        half = np.sqrt(complex(factor[1] ** 2 / 4 - factor[0]))
        half = half if abs(half) > _APART * factor[1] else complex(_APART * factor[1])
        far = -factor[1] / 2 - half  # the larger one, which does not cancel
        found += [far, factor[0] / far if half.imag == 0 else far.conjugate()]
    for k, pole in enumerate(found):
        if any(abs(pole - other) < _APART * abs(pole) for other in found[:k]):
            found[k] = pole * (1 + 3 * _APART * (k + 1))
    return np.array(found)


def _phi(z: complex, k: int) -> complex:
    """phi_k: by its series near zero, where the closed form cancels."""
    if abs(z) < 1:
        term = total = 1 / factorial(k) + 0j
        for j in range(1, _TERMS):
            term *= z / (j + k)
            total += term
        return total
    closed = np.exp(z)
    for j in range(k):
        closed = (closed - 1 / factorial(j)) / z
    return closed


def respond(
    logs: Float[np.ndarray, " n"],
    drive: Float[np.ndarray, " time"],
    *,
    step: float,
    square: bool,
    hold: str,
    settled: bool = False,
) -> Float[np.ndarray, " time"]:
    """Response with unit static gain to the force drive^2 (or drive).

    Args:
        logs: of the pole coefficients, in rad per unit of time.
        drive: voltage at the samples.
        step: duration of one sample in the unit of time of the poles.
        square: whether the force is the square of the voltage.
        hold: "foh", "zoh" or "bandlimited" (foh on the voltage read four times a sample).
        settled: from the equilibrium of the first sample, not from rest.
    """
    if hold == "bandlimited":
        fine = between(drive, hold, np.arange(_FINER) / _FINER, np).reshape(-1)
        return respond(logs, fine, step=step / _FINER, square=square, hold="foh", settled=settled)[::_FINER]
    force = drive**2 if square else drive
    level = force[0] if settled else 0.0
    now = force[:-1] - level
    z = poles(logs) * step
    change, bend = np.diff(force), np.diff(drive) ** 2 if square else None
    found = np.zeros(len(drive))
    for k, pole in enumerate(z):
        if pole.imag < 0:
            continue
        others = np.delete(z, k)
        residue = np.prod(-z) / np.prod(pole - others)
        one, two, three = (_phi(pole, j) for j in (1, 2, 3))
        pushed = one * now
        if hold == "foh":
            pushed = pushed + two * change
            if bend is not None:
                pushed = pushed + (2 * three - two) * bend
        decay = np.exp(pole)
        if pole.imag == 0:  # real arithmetic is three times as fast
            residue, pushed, decay = residue.real, pushed.real, decay.real
        mode = np.asarray(lfilter([1.0], [1.0, -decay], pushed))
        found[1:] += (2 if pole.imag > 0 else 1) * np.real(residue * mode)
    return found + level


def coast(
    logs: Float[np.ndarray, " n"], samples: int, *, step: float
) -> tuple[Float[np.ndarray, "time n"], np.ndarray]:
    """Free responses of every mode, of size one at the start, and which of them oscillate."""
    columns, rings = [], []
    for pole in poles(logs) * step:
        if pole.imag < 0:
            continue
        mode = np.exp(pole * np.arange(samples))
        columns += [mode.real, mode.imag] if pole.imag > 0 else [mode.real]
        rings += [True, True] if pole.imag > 0 else [False]
    return np.column_stack(columns) if columns else np.zeros((samples, 0)), np.array(rings, bool)

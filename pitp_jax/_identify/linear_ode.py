"""Stable linear ODEs by construction, and their exact response to a sampled voltage with its slopes.

    P(s) = prod (s^2 + e^p s + e^q) [(s + e^r)]:  every p, q, r is stable, and every stable polynomial is reached

    P x = c_0 F,   P w = c_0 x   =>   dx/dc_i = (delta_i0 x - w^(i)) / c_0       (from rest)

The response is exact for a voltage linear (foh) or constant (zoh) between samples, squared or not: inside a step
the force is a polynomial in time, so one matrix exponential of the chained system (F, x, w) gives the step. A second
pass through the same poles is all that every slope takes.
"""

import numpy as np
from jaxtyping import Float

from .._numerics.intersample import between
from .._numerics.linear_recurrence import linear_recurrence, times

_FINER = 4


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


def exponential(matrix: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """exp(M) = (sum_k (M / 2^s)^k / k!)^(2^s) to order 14, with the 1-norm of M / 2^s below 1/2.

    Of a size where a library's threads take longer to start than the sum to form.
    """
    size = np.abs(matrix).sum(0).max()
    squarings = max(int(np.ceil(np.log2(max(size, 1e-300)))) + 1, 0)
    small = matrix / 2.0**squarings
    power = total = np.eye(len(matrix))
    for k in range(1, 15):
        power = power @ small / k
        total = total + power
    for _ in range(squarings):
        total = total @ total
    return total


def _exact_step(poly: np.ndarray, step: float) -> np.ndarray:
    """One step of (x, ..., x^(n-1), w, ..., w^(n-1), F, F', F''), time of the force in samples; nan if not finite.

    The exponential is taken with derivatives in units of the fastest pole: in any other unit rounding grows with
    the power n of its ratio to the slowest.
    """
    n = len(poly) - 1
    fastest = (poly[:n] ** (1 / np.arange(n, 0, -1))).max()
    poly, step = poly / fastest ** np.arange(n, -1, -1), step * fastest
    block = np.zeros((2 * n + 3, 2 * n + 3))
    for at, source in ((0, 2 * n), (n, 0)):
        block[np.arange(at, at + n - 1), np.arange(at + 1, at + n)] = step
        block[at + n - 1, at : at + n] = -step * poly[:n]
        block[at + n - 1, source] += step * poly[0]
    block[2 * n, 2 * n + 1] = block[2 * n + 1, 2 * n + 2] = 1.0
    unit = np.concatenate([fastest ** np.arange(n), fastest ** np.arange(n), np.ones(3)])
    return exponential(block) * unit[:, None] / unit if np.isfinite(block).all() else np.full_like(block, np.nan)


def respond(
    logs: Float[np.ndarray, " n"], drive: Float[np.ndarray, " time"], *, step: float, square: bool, hold: str
) -> tuple[Float[np.ndarray, " time"], Float[np.ndarray, "time n"]]:
    """Response from rest, with unit static gain, to the force drive^2 (or drive); and its derivative by `logs`.

    Args:
        logs: of the pole coefficients.
        drive: voltage at the samples.
        step: duration of one sample in the unit of time of the poles.
        square: whether the force is the square of the voltage.
        hold: "foh", "zoh" or "bandlimited" (foh on the voltage read four times a sample).
    """
    if hold == "bandlimited":
        fine = between(drive, hold, np.arange(_FINER) / _FINER, np).reshape(-1)
        x, slopes = respond(logs, fine, step=step / _FINER, square=square, hold="foh")
        return x[::_FINER], slopes[::_FINER]
    poly = polynomial(logs)
    n = len(logs)
    exact = _exact_step(poly, step)
    now = drive[:-1]
    change = np.diff(drive) if hold == "foh" else np.zeros_like(now)
    force = [now**2, 2 * now * change, 2 * change**2] if square else [now, change, np.zeros_like(now)]
    forced = np.zeros((len(drive), 2 * n))
    forced[:-1] = times(np.stack(force, -1), exact[: 2 * n, 2 * n :].T)
    states = linear_recurrence(exact[: 2 * n, : 2 * n], forced, np.zeros(2 * n))
    slopes = polynomial_slopes(logs)[:n] / poly[0]
    return states[:, 0], states[:, :1] * slopes[0] - times(states[:, n:], slopes)


def coast(
    logs: Float[np.ndarray, " n"], start: Float[np.ndarray, " n"], samples: int, *, step: float
) -> tuple[Float[np.ndarray, " time"], Float[np.ndarray, "time n"], Float[np.ndarray, "time n"]]:
    """Free response from `start` = x(0), x'(0), ...; its derivatives by `logs` and by `start`.

    The start is fixed while the poles move. w starts at rest, but its derivatives from the n-th on do not:
    w^(n+j)(0) = c_0 x^(j)(0) - sum_m c_{n-m} w^(n+j-m)(0); what they would let coast on is taken off again.
    """
    poly = polynomial(logs)
    n = len(logs)
    exact = _exact_step(poly, step)[: 2 * n, : 2 * n]
    by_start = linear_recurrence(exact[:n, :n].T, np.zeros((samples, n)), np.eye(n)[0])
    states = linear_recurrence(exact, np.zeros((samples, 2 * n)), np.append(start, np.zeros(n)))
    jumps = np.zeros(2 * n)  # w, w', ... w^(2n-1) at the first sample, over c_0
    for j in range(n):
        jumps[n + j] = start[j] - poly[:n] @ jumps[j : n + j]
    taken = np.stack([jumps[i : i + n] for i in range(n)], -1)
    return states[:, 0], (by_start @ taken - states[:, n:] / poly[0]) @ polynomial_slopes(logs)[:n], by_start

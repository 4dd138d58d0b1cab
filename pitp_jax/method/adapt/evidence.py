"""Decide which parameters changed, by the evidence of every subset of them, with coloured residuals.

    z_hat ~ N(A q, C),   q ~ N(0, P):    ln p(z_hat, subset) = ln N(z_hat; 0, C + A P A') + ln p(subset)
    C = H^-1 M H^-1 + s^2 / N (J'J / T)^-1,      M = sum_f |e_f|^2 J_f* J_f' / T^2,   H = J'J

M is the covariance of J'e for an error with the spectrum of e. Noise averages out over the samples; a model's error
repeats in every period and lies at few frequencies. The residual does not contain the part of that error which the fit
absorbed. That part is taken to be as large as the residual, s (noise subtracted), with N independent values.
"""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from jaxtyping import Float

from ..fit.factors import TILTS, Factors

_CHANGED, _ALONG = 0.1, 0.3  # probabilities: of any change; that a parameter is part of it
_UNSEEN = 1e-10  # of the largest eigenvalue of H, which is at least 1: the smallest that counts


def covariance(
    residual: Float[np.ndarray, "records time"], jacobian: Float[np.ndarray, "samples numbers"], model_error: float
) -> Float[np.ndarray, "numbers numbers"]:
    """Return the covariance of a least-squares estimate, from its residuals, derivatives and model error."""
    count = jacobian.shape[1]
    slopes = np.fft.rfft(jacobian.reshape(*residual.shape, -1), axis=1)
    power = np.abs(np.fft.rfft(residual, axis=1)) ** 2
    # J'e as a sum over frequencies of terms with random phases: their covariances add up
    score = (slopes * np.sqrt(power)[..., None]).reshape(-1, count)
    meat = 2 * (score.conj().T @ score).real / residual.shape[1] ** 2
    weight = (np.abs(slopes) ** 2).sum(-1) * power
    lines = weight.sum() ** 2 / max((weight**2).sum(), 1e-300)  # effective number of frequencies in M
    size, along = np.linalg.eigh(jacobian.T @ jacobian)
    # A pseudo-inverse would give a direction that the recording does not show no variance, as if it were certain.
    inverse = along / np.maximum(size, _UNSEEN * max(size[-1], 1.0)) @ along.T
    samples = np.count_nonzero(residual)  # padded and missing samples are exactly zero
    # lines / (lines - count): the fit has removed `count` of them from the residual, as degrees of freedom
    noise = inverse @ meat @ inverse * lines / max(lines - count, 1.0)
    # with N = 10, z' C^-1 z of unchanged virtual actuators was at most its dimension
    return noise + model_error**2 / 10 * samples * inverse


def subsets(factors: Factors) -> Iterator[tuple[str, ...]]:
    """Yield every subset of parameters; "gain" changes all coefficients, so it excludes single ones.

    The slopes over the stroke are in every subset with a coefficient, because it rarely changes equally over the
    stroke.
    """
    tokens, tilts = factors.names[: factors.tokens], tuple(n for n in factors.names if n in TILTS)
    others = tuple(n for n in factors.names[factors.tokens :] if n not in TILTS)
    named = [c for size in range(len(tokens + others) + 1) for c in combinations(tokens + others, size)]
    if len(tokens) > 1:
        named += [("gain", *c) for size in range(len(others) + 1) for c in combinations(others, size)]
    for chosen in named:
        yield chosen + tilts if set(chosen) & {*tokens, "gain"} else chosen


def directions(factors: Factors, names: tuple[str, ...]) -> np.ndarray:
    """Return the matrix A from changes of named parameters to all coordinates z, shape (numbers, names)."""
    return np.reshape([factors.direction(n) for n in names], (-1, len(factors.names))).T


def prior_of(factors: Factors, names: tuple[str, ...]) -> np.ndarray:
    """Return the prior standard deviations of named parameters; "gain" has that of a coefficient."""
    return np.array([factors.prior[0 if n == "gain" else factors.names.index(n)] for n in names])


def select(z: np.ndarray, spread: np.ndarray, factors: Factors) -> tuple[str, ...]:
    """Choose the changed parameters from the estimate z and its covariance; none without evidence of a change.

    The evidence, with its priors, decides whether anything changed. The estimate alone decides which parameters
    changed; each must differ by two standard deviations.
    """
    count = sum(name not in TILTS for name in factors.names)
    # so that all subsets but the empty one have the probability `_CHANGED` together
    some = np.log(_CHANGED / (1 - _CHANGED)) - np.log(1 - (1 - _ALONG) ** count)

    def evidence(names):
        a = directions(factors, names)
        total = spread + (a * prior_of(factors, names) ** 2) @ a.T
        root = np.sqrt(np.diag(total))  # unit diagonal, because times and logarithms differ by orders of magnitude
        whole = total / np.outer(root, root)
        fit = (z / root) @ np.linalg.solve(whole, z / root)
        size = sum(name not in TILTS for name in names)
        before = some + size * np.log(_ALONG) + (count - size) * np.log(1 - _ALONG) if names else 0.0
        return -0.5 * (fit + np.linalg.slogdet(whole)[1]) - np.log(root).sum() + before

    def beside(names):
        a = directions(factors, names)
        unmoved = z - a @ combined(a, z, spread)
        # two standard deviations for each parameter
        return unmoved @ np.linalg.solve(spread, unmoved) + 4 * sum(name not in TILTS for name in names)

    every = list(subsets(factors))  # the first is the empty one
    return min(every[1:], key=beside) if max(every, key=evidence) else ()


def combined(moves: np.ndarray, z: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Return the named parameters that best fit an estimate z of all coordinates, weighted by its covariance."""
    weighed = np.linalg.solve(spread, moves)
    return np.linalg.solve(moves.T @ weighed, weighed.T @ z)

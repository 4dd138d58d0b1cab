"""Test whether a model's residual is white, and whether it is uncorrelated with the input.

    r_e(k) = sum_t e_t e_{t+k} / sum_t e_t^2                            within +- z / sqrt(N) where e is white
    r_eu(k) = sum_t u_t e_{t+k} / sqrt(sum e^2 sum u^2)                 within +- z sqrt(sum_j r_e(j) r_u(j) / N)
                                                                        where e and u are independent

u: the force about its mean; N: samples that count; z: the largest of all K lags exceeds it in 5 % of cases,
Phi^-1(1 - 0.025 / K). A missing effect shows at lags on both sides of zero, because an input is correlated with its own
past.
Source: Ljung (1999), System Identification, 16.6; Bartlett (1946) for the band of the second.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import correlate
from scipy.stats import norm

from .output_error import OutputError

_LAGS = 40  # on either side


@dataclass(frozen=True)
class ResidualTest:
    """Correlations of the chosen model's residual with itself and with the input, pooled over records.

    Attributes:
        lag: in s, shape (K,), from before zero to after it.
        own, drive: correlation of the residual with itself and with the force, shape (K,).
        own_band, drive_band: half widths that contain all lags in 95 % of cases without correlation.
    """

    lag: Float[np.ndarray, " lags"]
    own: Float[np.ndarray, " lags"]
    drive: Float[np.ndarray, " lags"]
    own_band: float
    drive_band: float

    @property
    def white(self) -> bool:
        """Return whether the residual is white: uncorrelated with itself at every lag except zero."""
        return bool((np.abs(self.own[self.lag != 0]) <= self.own_band).all())

    @property
    def independent(self) -> bool:
        """Return whether the residual is uncorrelated with present and past input; a linear model then suffices."""
        return bool((np.abs(self.drive[self.lag >= 0]) <= self.drive_band).all())


def residual_test(error: OutputError) -> ResidualTest:
    """Correlate the residual of all records with itself and with the input (V^2 or V), over lags in time.

    The lags cover two periods of the slowest oscillation (or time constant).
    """
    problem = error.problem
    period = 2 * np.pi / max(np.abs(error.poles).min(), 1 / problem.seconds)
    shortest = min(map(len, problem.drive))
    spacing = int(np.clip(2 * period / problem.dt / _LAGS, 1, max(shortest // (4 * _LAGS), 1)))
    far = spacing * _LAGS
    # e and u may be correlated for long
    long = max(far, min(20 * far, shortest // 2))
    sums = np.zeros((3, 2 * long + 1))
    energy = moved = 0.0
    for residual, force, weight in zip(error.solved.residuals, problem.forces, problem.weight, strict=True):
        force = weight * (force - weight @ force / max(weight.sum(), 1.0))
        sums += np.stack(
            # sum_t a_t b_{t+k} for k = -long ... long
            [
                correlate(b, a, method="fft")[len(a) - 1 - long : len(a) + long]
                for a, b in ((residual, residual), (force, residual), (force, force))
            ]
        )
        energy, moved = energy + float(residual @ residual), moved + float(force @ force)
    sums /= np.array([[energy], [np.sqrt(energy * moved)], [moved]]) + 1e-300
    some = np.arange(-_LAGS, _LAGS + 1) * spacing
    z = float(norm.ppf(1 - 0.025 / len(some)))
    common = max(float(sums[0] @ sums[2]), 0.0)  # Bartlett: sum_j r_e(j) r_u(j), over all lags of memory
    return ResidualTest(
        some * problem.dt,
        sums[0][long + some],
        sums[1][long + some],
        z / np.sqrt(problem.samples),
        z * np.sqrt(common / problem.samples),
    )

"""Differentiate the target of exported code by a weighted window of samples.

    y^(i)(t) = sum_k W_ik m_k,   m_k = mean of the k-th block of samples          26 blocks of B samples

B = 1 has an odd interpolating spline. If the rounding of the input, eps / 2 of the largest reading, would be visible in
the force, blocks are longer and W is the least-squares polynomial of degree d through their means. (B, d) is the
shortest window whose force is right to 0.2 % for a cosine at the resonance: truncation of the cosine plus four standard
deviations of the rounding; otherwise the best one.

Savitzky and Golay (1964), Smoothing and differentiation of data by simplified least squares procedures.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre
from scipy.interpolate import make_interp_spline

HALF = 12  # blocks on either side of the one in which the derivative is taken
BLOCKS = 2 * HALF + 2
ALLOWED = 5e-3  # of the force


@dataclass(frozen=True)
class Differentiator:
    """A window of samples with the weights of their derivatives.

    Attributes:
        order: highest derivative.
        dt: s between two samples.
        block: samples to a block.
        degree: of the polynomial; 0: the spline.
        late: time of the derivative after the middle of the window, s.
    """

    order: int
    dt: float
    block: int
    degree: int
    late: float

    @property
    def look_ahead(self) -> int:
        """Return the number of samples by which the target must be known in advance."""
        return HALF * self.block + self.block // 2 + int(np.ceil(self.late / self.dt))

    @property
    def place(self) -> float:
        """Return the time of the derivative, in samples relative to the newest sample."""
        return self.late / self.dt - self.look_ahead

    @cached_property
    def weights(self) -> np.ndarray:
        """Return the weights for derivatives 0 ... order and for the next sample, shape (order + 2, BLOCKS)."""
        degree = self.degree or 2 * ((self.order + 3) // 2) + 1
        fitted = self._fitted(degree)
        if self.degree:
            return fitted
        at = (self.place + BLOCKS - 1) * self.dt
        spline = make_interp_spline(np.arange(BLOCKS) * self.dt, np.eye(BLOCKS), k=degree)
        rows = [spline.derivative(i)(at) if i else spline(at) for i in range(self.order + 1)]
        return np.stack([*rows, fitted[-1]])

    def _fitted(self, degree: int) -> np.ndarray:
        half = BLOCKS * self.block / 2
        ends = (np.arange(BLOCKS) - BLOCKS + 1) * self.block  # newest sample of each block, the last at 0
        samples = ends[:, None] - np.arange(self.block)

        def scaled(k):
            return (k + half - 0.5) / half

        # Legendre polynomials on [-1, 1], because powers of the sample's number are nearly linearly dependent
        design = legendre.legvander(scaled(samples), degree).mean(1)
        to_coefficients = np.linalg.pinv(design)
        unit, rows = 1 / (half * self.dt), []
        for i in range(self.order + 1):
            slope = legendre.legder(np.eye(degree + 1), i) if i else np.eye(degree + 1)
            rows.append(unit**i * legendre.legval(scaled(self.place), slope) @ to_coefficients)
        return np.stack([*rows, legendre.legval(scaled(1.0), np.eye(degree + 1)) @ to_coefficients])

    def error(self, a: np.ndarray, omega: float, rounding: float) -> float:
        """Compute the relative error of the force for a cosine target of amplitude 1 at omega (rad/s).

        It is the error over a_0, with samples rounded by the standard deviation `rounding`.
        """
        samples = (np.arange(BLOCKS) - BLOCKS + 1)[:, None] * self.block - np.arange(self.block)
        seen = np.exp(1j * omega * self.dt * samples).mean(1)
        exact = np.exp(1j * omega * self.dt * self.place) * (1j * omega) ** np.arange(self.order + 1)
        truncated = abs(a @ (self.weights[:-1] @ seen - exact))
        noise = np.linalg.norm(a @ self.weights[:-1]) / np.sqrt(self.block)  # a mean of B roundings
        return float((truncated + 4 * rounding * noise) / a[0])


def differentiator(
    a: np.ndarray, dt: float, omega: float, rounding: float, late: float
) -> tuple[Differentiator, float]:
    """Return the shortest window with at most 0.2 % error of the force (otherwise the best one), and its error.

    Args:
        a: nominal coefficients a_0 ... a_n.
        dt: s between two samples.
        omega: of the resonance, rad/s.
        rounding: standard deviation of a sample's rounding, over the half-swing of the smallest motion.
        late: delay of the input, s.
    """
    order = len(a) - 1
    best, least = Differentiator(order, dt, 1, 0, late), np.inf
    blocks = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)  # samples each
    tried = [best] + [Differentiator(order, dt, b, order + d, late) for b in blocks for d in (2, 4, 6)]
    for one in tried:
        error = one.error(a, omega, rounding)
        if error < least:
            best, least = one, error
        if least < 2e-3:
            break
    return best, least

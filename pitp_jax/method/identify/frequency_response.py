"""Measure the frequency response of the records, with standard error and coherence.

    Y(k + r) = (G + g_1 r + g_2 r^2) U(k + r) + t_0 + t_1 r + t_2 r^2 + e,    r = -6 ... 6     (least squares)
    coherence = |G|^2 S_uu / (|G|^2 S_uu + s_e^2)

U, Y: transforms of force and output over the whole record. Transients at both ends of the record are smooth in
frequency. The terms t model them, so neither a window nor a settling time is needed.
Source: Pintelon & Schoukens (2012), System Identification, 7.2 (local polynomial method).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.signal.windows import tukey

from .output_error import Problem

_HALF, _DEGREE = 6, 2  # lines on either side; degree of the polynomials
LINES = 256  # at most, over all records


@dataclass(frozen=True)
class FrequencyResponse:
    """Response of the output to the input (m per V^2 or V) at frequencies (Hz), with standard error and coherence."""

    hz: Float[np.ndarray, " lines"]
    value: Complex[np.ndarray, " lines"]
    stderr: Float[np.ndarray, " lines"]
    coherence: Float[np.ndarray, " lines"]

    @property
    def coherent(self) -> np.ndarray:
        """Return True for the frequency lines whose coherence is at least 0.8, shape (lines,)."""
        return self.coherence >= 0.8

    @property
    def rich(self) -> bool:
        """Return whether coherent lines are numerous and wide enough in band to distinguish orders and delays."""
        known = self.hz[self.coherent]
        return len(known) >= 24 and float(known.max()) >= 3 * float(known.min())


UNKNOWN_RESPONSE = FrequencyResponse(np.zeros(0), np.zeros(0, complex), np.zeros(0), np.zeros(0))


def frequency_response(problem: Problem) -> FrequencyResponse:
    """Measure the frequency response of every record at logarithmically spaced frequencies, sorted by Hz."""
    each = max(LINES // len(problem.drive), 8)
    parts = []
    for force, output, weight in zip(problem.forces, problem.output, problem.weight, strict=True):
        seen = np.flatnonzero(weight)
        if len(seen) < 0.9 * len(weight) or len(weight) < 8 * _HALF:
            continue
        filled = np.interp(np.arange(len(output)), seen, output[seen])
        parts.append(_local(force - force.mean(), filled - filled.mean(), problem.dt, each))
    if not parts:
        return UNKNOWN_RESPONSE
    hz, value, stderr, coherence = (np.concatenate(p) for p in zip(*parts, strict=True))
    order = np.argsort(hz)[-LINES:]
    return FrequencyResponse(hz[order], problem.scale * value[order], problem.scale * stderr[order], coherence[order])


def _local(force: np.ndarray, output: np.ndarray, dt: float, most: int) -> Sequence[np.ndarray]:
    """Return frequencies (Hz), response, standard error and coherence of one record."""
    u, y = np.fft.rfft(force)[1:], np.fft.rfft(output)[1:]
    last = len(u) - 2 * _HALF - 2
    middle = np.unique(np.geomspace(_HALF, max(last, _HALF + 1), 4 * most).astype(int))
    # a taper over a fifth of the record: without it, the jump from end to start looks like excitation
    tapered = np.fft.rfft(force * tukey(len(force), 0.2))[1:]
    energy = np.convolve(np.abs(tapered) ** 2, np.ones(2 * _HALF + 1), "same")[middle]
    # a line below this part of the largest local energy is not excited
    middle = middle[energy > 1e-3 * energy.max()]
    middle = middle[:: max(-(-len(middle) // most), 1)]
    r = np.arange(-_HALF, _HALF + 1)
    powers = (r / _HALF)[:, None] ** np.arange(_DEGREE + 1)
    at = middle[:, None] + r
    design = np.concatenate([powers * u[at][..., None], np.broadcast_to(powers, (*at.shape, _DEGREE + 1))], -1)
    inverse = np.linalg.pinv(design, rcond=1e-8)  # of all lines at once: (lines, 6, 13)
    factors = (inverse @ y[at][..., None])[..., 0]
    residual = y[at] - (design @ factors[..., None])[..., 0]
    variance = (np.abs(residual) ** 2).sum(-1) / (len(r) - design.shape[-1])
    stderr = np.sqrt(variance * (np.abs(inverse[:, 0]) ** 2).sum(-1))
    value, drive = factors[:, 0], (np.abs(u[at]) ** 2).mean(-1)
    moved = np.abs(value) ** 2 * drive
    hz = (middle + 1) / ((2 * len(u) + 1) * dt)
    return hz, value, stderr, moved / np.maximum(moved + variance, 1e-300)

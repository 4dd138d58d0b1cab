"""Find a spectral line in every record's residual that does not depend on the input, such as mains hum.

    |E(f)|^2 has most of its energy within three bins of one f, the same in all records, while the inputs' F have not
    e = A_r sin(2 pi f t + phi_r) + rest,    f minimises  sum_r n_r log mean rest_r^2

The response to an input has the input's frequencies, so at least two inputs must differ from the line.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

_FRACTION = 0.8  # of an error's energy within three bins of one frequency: a line


@dataclass(frozen=True)
class Tone:
    """A tone in every recording: one frequency, with an amplitude and a phase for each.

    Attributes:
        frequency: Hz, and its standard error.
        amplitude: the mean over recordings, and its standard error.
        lines: the tone in every recording.
    """

    frequency: tuple[float, float]
    amplitude: tuple[float, float]
    lines: tuple[np.ndarray, ...]

    def taken_from(self, errors: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return errors without the tone."""
        return [e - line for e, line in zip(errors, self.lines, strict=True)]


def steady_tone(
    errors: Sequence[np.ndarray], voltages: Sequence[np.ndarray], intervals: Sequence[float]
) -> tuple[float, float] | None:
    """Return the line's frequency (Hz) and least fraction of a record's error energy; None without a line.

    Args:
        errors: residuals, zero where the output is missing.
        voltages: inputs, V.
        intervals: between samples, s.
    """
    lines = []
    for e, u, dt in zip(errors, voltages, intervals, strict=True):
        window = np.hanning(len(e))
        power = np.abs(np.fft.rfft((e - e.mean()) * window)) ** 2
        # not line 0, the mean
        k = int(np.argmax(power[1:])) + 1
        near = slice(max(k - 3, 0), k + 4)
        # of the force, because a squared input has lines that its voltage lacks
        squared = np.abs(np.fft.rfft((u**2 - np.mean(u**2)) * window)) ** 2
        driven = squared[near].sum() / max(squared.sum(), 1e-30)
        lines.append((k / (len(e) * dt), power[near].sum() / max(power.sum(), 1e-30), driven, 1 / (len(e) * dt)))
    hz, fraction, driven, width = np.array(lines).T
    if len(hz) < 3 or fraction.min() < _FRACTION or np.ptp(hz) > 2 * width.max() or np.count_nonzero(driven < 0.1) < 2:
        return None
    return float(np.median(hz)), float(fraction.min())


def fit_tone(errors: Sequence[np.ndarray], voltages: Sequence[np.ndarray], intervals: Sequence[float]) -> Tone | None:
    """Fit a `steady_tone` to the residuals of all recordings together; None without a line."""
    seen = steady_tone(errors, voltages, intervals)
    if seen is None:
        return None
    near, longest = seen[0], max(len(e) * dt for e, dt in zip(errors, intervals, strict=True))

    def cost(hz: float) -> float:
        rests = (e - _line(e, dt, hz)[0] for e, dt in zip(errors, intervals, strict=True))
        return float(sum(len(e) * np.log(np.mean(e**2) + 1e-300) for e in rests))

    # a grid first: between two bins the cost may have several minima
    start = min(near + np.linspace(-2, 2, 81) / longest, key=cost)
    half = 0.05 / longest  # one step of the grid
    minimum: Any = minimize_scalar(cost, bounds=(start - half, start + half), method="bounded")
    hz = float(minimum.x)
    lines, sizes, variance = [], [], []
    for e, dt in zip(errors, intervals, strict=True):
        line, size = _line(e, dt, hz)
        lines.append(line)
        sizes.append(size)
        # Cramer-Rao: of a frequency with unknown phase and amplitude
        seconds = len(e) * dt
        variance.append(6 * np.mean((e - line) ** 2) / (np.pi * seconds * size) ** 2 / len(e))
    amplitude = float(np.mean(sizes)), float(np.std(sizes) / np.sqrt(len(sizes)))
    return Tone((hz, float(1 / np.sqrt(np.sum(1 / np.maximum(variance, 1e-300))))), amplitude, tuple(lines))


def _line(error: np.ndarray, dt: float, hz: float) -> tuple[np.ndarray, float]:
    """Return the tone of this frequency in an error, by least squares beside its mean, and its amplitude."""
    turn = 2 * np.pi * hz * dt * np.arange(len(error))
    columns = np.stack([np.cos(turn), np.sin(turn), np.ones(len(error))], 1)
    c = np.linalg.lstsq(columns, error, rcond=None)[0]
    return columns[:, :2] @ c[:2], float(np.hypot(c[0], c[1]))

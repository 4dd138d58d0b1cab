"""The noise floor: what no model could explain, from the residual where neither drive nor gap has energy.

    P(f) = lower quartile over a band's bins of |E(f)|^2 / 0.2877, then the lower quartile over records
    sigma^2 = integral of P

The lower quartile (0.2877 of an exponential variable's mean) passes between the lines a periodic drive and a gap under
it leave, and keeps a hum a gap; noise is broad in frequency and alike in all records. Only the last 60 % of a record is
used, after its transients. Below a quarter of the resonance the level is held to at most twice what lies above: slow
residuals are creep and drift before they are noise. The 5th difference read 0.24 of the truth for AR(0.9) noise.

What strikes an actuator at random is as broad as noise, but passes through the actuator: it peaks at the resonance and
falls as 1/f^4 behind it, where AR(0.9) noise falls as 1/f^2 at most. `sensor` is what is left without such a peak: on
tuning seeds sigma / sensor is 1.00 for all of 40 healthy cases and 2.2 to 11 for 16 with impulses or dropouts.

Records without noise, as a simulation leaves them, are known to the rounding of the rollouts beside them: 2e-6 of
range for a nominal beside its own, which a floor of 2e-8 had called a gap.
"""

from dataclasses import dataclass

import numpy as np

from .case import Case
from .repeatability import scatter

_QUARTILE = -np.log(0.75)
_BINS = 24
_SHORT = 8  # times shorter than the longest record: its few bins would be everyone's
_CLEAR = 0.8  # of the spectrum's: cycles that repeat better than that are believed
_ROUNDING = 1e-5  # of the range: no floor is lower
STRUCK = 1.5  # sigma over sensor from where the actuator itself is disturbed


@dataclass(frozen=True)
class Noise:
    """Sensor noise of a set of records.

    Attributes:
        sigma: standard deviation in scaled displacement.
        sensor: the part of it that a sensor can make: without what peaks at the resonance.
        spectrum: (frequency in Hz, density) of the bands, shape (bands, 2).
        source: how it was found.
    """

    sigma: float
    sensor: float
    spectrum: np.ndarray
    source: str

    def floor_percent(self, span: float) -> float:
        """As e_rms_percent of a record with a scaled peak to peak `span`."""
        return 100 * self.sigma / span


def estimate(case: Case, errors: list[np.ndarray]) -> Noise:
    """From residuals (scaled, one per record of the case, finite)."""
    dt, long = case.dt, max(len(e) for e in errors) / _SHORT
    counted = [(e, s.weight > 0) for e, s in zip(errors, case.series, strict=True) if len(e) >= long]
    fewest = min(len(e) for e, _ in counted)
    edges = band_edges(int(0.6 * fewest), dt)
    levels = np.array([band_levels(e, seen, dt, edges) for e, seen in counted])
    bins = np.maximum(np.diff(edges) * 0.6 * fewest * dt, 4.0)
    spread = 2.0 / np.sqrt(bins)  # relative standard deviation of one record's quartile
    low = 0.67 if len(levels) > 3 else 1.0  # how many of them the quartile (the least of few) lies below the mean
    level = np.quantile(levels, 0.25 if len(levels) > 3 else 0.0, axis=0) / (1 - low * np.minimum(spread, 0.5))
    level = np.minimum(level, levels.mean(0))
    middle = np.sqrt(edges[:-1] * np.maximum(edges[1:], 1e-12))
    resonance = case.surroundings.omega / (2 * np.pi)
    slow = middle < resonance / 4
    if slow.any() and (~slow).any():
        level[slow] = np.minimum(level[slow], 2 * level[~slow][0])
    sigma, sensor = (
        float(np.sqrt(np.sum(v * np.diff(edges)))) for v in (level, _without_peak(middle, level, resonance))
    )
    source = "spectrum between the drive's lines"
    if sigma > STRUCK * sensor:
        source += ", which peaks at the resonance as no sensor's noise does: something strikes the actuator"
    repeats = scatter(case, errors)
    if repeats is not None and repeats < _CLEAR * sigma:
        level, sigma, sensor = level * (repeats / sigma) ** 2, repeats, min(sensor, repeats)
        source = "cycles of the drive that repeat"
    rounding = _ROUNDING * min(s.span for s in case.series)
    if sigma < rounding:
        level = level + (rounding**2 - sigma**2) / (edges[-1] - edges[0])
        sigma, sensor, source = rounding, rounding, "rounding of single precision"
    return Noise(sigma, sensor, np.stack([middle, level], -1), source)


def _without_peak(frequency: np.ndarray, level: np.ndarray, resonance: float) -> np.ndarray:
    """Levels below 4 resonances held to twice a rise as 1/f^2 from each band above."""
    near = frequency < 4 * resonance
    f = np.maximum(frequency[near], max(frequency[:2].max() / 2, 1e-9))  # a single band has its middle at zero
    above = np.triu(2 * level[near] * (f / f[:, None]) ** 2, 1) + np.tril(np.full((len(f), len(f)), np.inf))
    return np.concatenate([np.minimum(level[near], above.min(1)), level[~near]])


def band_edges(samples: int, dt: float) -> np.ndarray:
    """Bands of at least 24 bins and a fifth of their frequency."""
    width, top = _BINS / (samples * dt), 0.5 / dt
    edges = [0.0]
    while edges[-1] + width < top:
        edges.append(edges[-1] + max(width, 0.2 * edges[-1]))
    edges[-1:] = [top] if len(edges) > 1 else [0.0, top]
    return np.array(edges)


def band_levels(error: np.ndarray, counts: np.ndarray, dt: float, edges: np.ndarray) -> np.ndarray:
    """One-sided density of every band (per Hz)."""
    tail = error[int(0.4 * len(error)) :]
    seen = counts[int(0.4 * len(error)) :]
    tail = tail - tail[seen].mean() if seen.any() else tail
    window = np.hanning(len(tail)) * seen
    power = 2 * dt * np.abs(np.fft.rfft(tail * window)) ** 2 / max(np.sum(window**2), 1e-30)
    frequency = np.fft.rfftfreq(len(tail), dt)
    found = []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        bins = power[(frequency >= max(low, 1.5 / (len(tail) * dt))) & (frequency < high)]
        found.append(np.quantile(bins, 0.25) / _QUARTILE if len(bins) else 0.0)
    return np.array(found)

"""The noise floor: what no model could explain, from the residual where neither drive nor gap has energy.

    P(f) = S(f) lower quartile over a band's bins of |E|^2 / (0.2877 S), then the lower quartile over records
    sigma^2 = integral of P,     S: the colour, the lower quartile of |E|^2 over all records near f

The lower quartile (0.2877 of an exponential variable's mean) passes between the lines a periodic drive and a gap under
it leave, and keeps a hum a gap; noise is broad in frequency and alike in all records. Only the last 60 % of a record is
used, after its transients. The 5th difference read 0.24 of the truth for AR(0.9) noise.

Noise has a memory that the records outlast: its spectrum is flat at its low end. Where it still rises there as that of
a random walk does (by 7 from bins 6 to 14 to bins 2 to 5, AR(0.98) at 1 kHz in 10 s by 1.2), the level below a quarter
of the resonance is held to at most twice what lies above: slow residuals are creep and drift before they are noise.
Held so whatever its colour, AR(0.98) noise was read at two thirds of its size.

What strikes an actuator at random is as broad as noise, but passes through the actuator: it rises into the resonance,
by (2 zeta)^-2, and falls as 1/f^4 behind it, where AR(0.9) noise falls as 1/f^2 at most and a moving average has zeros
but no rise. `sensor` is what is left without such a peak: on tuning seeds sigma / sensor is 1.00 for all of 40 healthy
cases and 2.2 to 11 for 16 with impulses or dropouts.

A sensor that reads in steps of d is no better than d / sqrt(12), whatever the lines of a slow drive between them look
like. Records without noise, as a simulation leaves them, are known to the rounding of the rollouts beside them: 2e-6 of
range for a nominal beside its own, which a floor of 2e-8 had called a gap.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._numerics.noise_spectrum import band_edges, colour_of, levels_of, periodogram, rise_at_the_low_end
from .._record.repeatability import repeat_scatter
from .case import Case, Series

_SHORT = 8  # times shorter than the longest record: its few bins would be everyone's
_CLEAR = 0.8  # of the spectrum's: cycles that repeat better than that are believed
_COARSE = 0.1  # of the samples: with more values than that the steps are fine beside the noise
_SURE = 0.01  # relative standard deviation that no floor is below: bands are not quite flat
_ROUNDING = 1e-5  # of the range: no floor is lower
_FLAT = (
    3.0  # most by which noise rises to its low end: between 1.2 and 7, whose quartiles scatter by 0.45 of themselves
)
_RISE = 3.0  # of a level into the resonance: quartiles of two dozen bins scatter by 0.4; 14 at a damping ratio of 0.12
STRUCK = 1.5  # sigma over sensor from where the actuator itself is disturbed


@dataclass(frozen=True)
class Noise:
    """Sensor noise of a set of records.

    Attributes:
        sigma: standard deviation in scaled displacement.
        sensor: the part of it that a sensor can make: without what peaks at the resonance.
        spectrum: (frequency in Hz, density) of the bands, shape (bands, 2).
        source: how it was found.
        doubt: relative standard deviation of sigma.
    """

    sigma: float
    sensor: float
    spectrum: np.ndarray
    source: str
    doubt: float = 0.03

    def floor_percent(self, span: float) -> float:
        """As e_rms_percent of a record with a scaled peak to peak `span`."""
        return 100 * self.sigma / span


def estimate(case: Case, errors: list[np.ndarray]) -> Noise:
    """From residuals (scaled, one per record of the case, finite)."""
    dt, long = case.dt, max(len(e) for e in errors) / _SHORT
    counted = [(e, s.weight > 0) for e, s in zip(errors, case.series, strict=True) if len(e) >= long]
    fewest = min(len(e) for e, _ in counted)
    edges = band_edges(int(0.6 * fewest), dt)
    powers = [periodogram(e, seen, dt) for e, seen in counted]
    colour = colour_of(powers)
    levels = np.array([levels_of(*p, edges, colour) for p in powers])
    bins = np.maximum(np.diff(edges) * 0.6 * fewest * dt, 4.0)
    spread = 2.0 / np.sqrt(bins)  # relative standard deviation of one record's quartile
    low = 0.67 if len(levels) > 3 else 1.0  # how many of them the quartile (the least of few) lies below the mean
    least = 0.25 if len(levels) > 3 else 0.0
    level = np.quantile(levels, least, axis=0) / (1 - low * np.minimum(spread, 0.5))
    level = np.minimum(level, levels.mean(0))
    middle = np.sqrt(edges[:-1] * np.maximum(edges[1:], 1e-12))
    resonance = case.surroundings.omega / (2 * np.pi)
    slow = middle < resonance / 4
    if rise_at_the_low_end(powers) > _FLAT and slow.any() and (~slow).any():
        level[slow] = np.minimum(level[slow], 2 * level[~slow][0])
    sigma, sensor = (
        float(np.sqrt(np.sum(v * np.diff(edges)))) for v in (level, _without_peak(middle, level, resonance, colour))
    )
    source = "spectrum between the drive's lines"
    if sigma > STRUCK * sensor:
        source += ", which peaks at the resonance as no sensor's noise does: something strikes the actuator"
    parts = level * np.diff(edges)
    doubt = float(np.sqrt(np.sum((parts * spread) ** 2) / len(levels)) / max(2 * parts.sum(), 1e-300))
    repeats = scatter(case, errors)
    if repeats is not None and repeats < _CLEAR * sigma:
        level, sigma, sensor = level * (repeats / sigma) ** 2, repeats, min(sensor, repeats)
        source = "cycles of the drive that repeat"
    steps = max(_digit(s) for s in case.series) / case.model.scales.state[0] / np.sqrt(12)
    if sigma < steps:
        level = level + (steps**2 - sigma**2) / (edges[-1] - edges[0])
        sigma, sensor, source = steps, steps, "steps in which the sensor reads"
    rounding = _ROUNDING * min(s.span for s in case.series)
    if sigma < rounding:
        level = level + (rounding**2 - sigma**2) / (edges[-1] - edges[0])
        sigma, sensor, source = rounding, rounding, "rounding of single precision"
    return Noise(sigma, sensor, np.stack([middle, level], -1), source, max(doubt, _SURE))


def _without_peak(frequency: np.ndarray, level: np.ndarray, resonance: float, colour) -> np.ndarray:
    """Levels below 4 resonances held to twice a rise as 1/f^2 from each band above, where they rise into it."""
    there, below = (colour(resonance * np.geomspace(*ends, 9)) for ends in ((0.8, 1.2), (0.1, 0.6)))
    if there.max() < _RISE * below.mean():
        return level
    near = frequency < 4 * resonance
    f = np.maximum(frequency[near], max(frequency[:2].max() / 2, 1e-9))  # a single band has its middle at zero
    above = np.triu(2 * level[near] * (f / f[:, None]) ** 2, 1) + np.tril(np.full((len(f), len(f)), np.inf))
    return np.concatenate([np.minimum(level[near], above.min(1)), level[~near]])


def _digit(s: Series) -> float:
    """The step in which the output is read, in its unit; zero where it is fine."""
    values = np.unique(s.record.displacement[s.weight > 0])
    return float(np.median(np.diff(values))) if 1 < len(values) < _COARSE * np.count_nonzero(s.weight) else 0.0


def scatter(case: Case, errors: Sequence[np.ndarray]) -> float | None:
    """Standard deviation of what does not repeat (scaled displacement), middle of the records; None if none repeats."""
    found = [repeat_scatter(s.record, e, s.weight > 0) for s, e in zip(case.series, errors, strict=True)]
    found = [v for v in found if v is not None]
    return float(np.sqrt(np.median(found))) if found else None

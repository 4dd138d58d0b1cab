"""Estimate the noise spectrum of a residual that also has spectral lines, by lower quartiles.

    P(f) = S(f) lower quartile over a band's bins of |E|^2 / (0.2877 S)

S: the colour, the lower quartile of |E|^2 over all records near f; 0.2877: lower quartile of an exponential variable of
mean 1. Only the last 60 % of a record is used, after its transients.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

_QUARTILE = -np.log(0.75)  # P(E < q) = 1 - exp(-q) = 1/4: a bin of noise is exponential about its density
_BINS = 24  # in a band, at least: their lower quartile is the sixth smallest
_NEAR = 0.25  # in ln f: range of bins for the colour at f, a quarter of a band's distance to the next but one


def band_edges(samples: int, dt: float) -> np.ndarray:
    """Return band edges (Hz) from 0 to the Nyquist frequency; bands have at least 24 bins and a fifth of f."""
    width, top = _BINS / (samples * dt), 0.5 / dt
    edges = [0.0]
    while edges[-1] + width < top:
        edges.append(edges[-1] + max(width, 0.2 * edges[-1]))
    # the last band takes the remainder, which alone might have too few bins for a quartile
    edges[-1:] = [top] if len(edges) > 1 else [0.0, top]
    return np.array(edges)


def periodogram(error: np.ndarray, counts: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (Hz) and the one-sided density (per Hz) of the last 60 % of a residual."""
    tail = error[int(0.4 * len(error)) :]
    seen = counts[int(0.4 * len(error)) :]
    tail = tail - tail[seen].mean() if seen.any() else tail
    window = np.hanning(len(tail)) * seen  # samples that do not count have weight zero, here and in the divisor
    power = 2 * dt * np.abs(np.fft.rfft(tail * window)) ** 2 / max(np.sum(window**2), 1e-30)
    return np.fft.rfftfreq(len(tail), dt)[2:], power[2:]  # the window spreads the remaining mean into bin 1


def band_levels(error: np.ndarray, counts: np.ndarray, dt: float, edges: np.ndarray) -> np.ndarray:
    """Return the one-sided noise density (per Hz) of one record's residual in every band."""
    power = periodogram(error, counts, dt)
    return levels_of(*power, edges, colour_of([power]))


def colour_of(powers) -> Callable[[np.ndarray], np.ndarray]:
    """Return the shape S(f) of the noise spectrum as a function of frequency (Hz), from all records."""
    f, p = (np.concatenate(v) for v in zip(*powers, strict=True))
    order = np.argsort(f)
    place, p = np.log(f[order]), p[order]
    at = np.linspace(place[0], place[-1], 64)
    first, last = (np.searchsorted(place, at + side * _NEAR) for side in (-1, 1))
    few = np.maximum(_BINS - (last - first), 0) // 2 + 1  # as many as a band has, at least
    ends = zip(np.maximum(first - few, 0), last + few, strict=True)
    levels = np.log(np.maximum([np.quantile(p[a:b], 0.25) for a, b in ends], 1e-200))
    return lambda hz: np.exp(np.interp(np.log(hz), at, levels))


def levels_of(frequency: np.ndarray, power: np.ndarray, edges: np.ndarray, colour) -> np.ndarray:
    """Return the noise density of every band, from its bins and the shape `colour` of the spectrum."""
    shape, levels = colour(frequency), []
    for low, high in pairwise(edges):
        here = (frequency >= low) & (frequency < high)
        # divided by the colour first, because with falling noise a plain quartile would represent the band's far end
        bins = np.quantile(power[here] / shape[here], 0.25) / _QUARTILE if here.any() else 0.0
        levels.append(bins * shape[here].mean() if here.any() else 0.0)
    return np.array(levels)

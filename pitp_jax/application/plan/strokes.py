"""Predict the largest displacement under an input: with a model, with half its damping, and without a model.

    x'' + 2 zeta w x' + w^2 x = w^2 u^2        zeta = 0.01, any w of the band: without a model, up to one factor

Damping is the least certain parameter of a model and determines the stroke at the resonance. So an input is only
proposed if it stays within the allowed stroke with half of the damping as well.
"""

from collections.abc import Sequence

import numpy as np
from scipy.signal import cont2discrete, find_peaks, lfilter

from ...method.model.model import Model
from ...method.simulate.voltage_only import rollout

LEAST_DAMPING = 0.01  # of an actuator that has not been identified yet


def half_damped(model: Model) -> Model:
    """Return the model with half the damping of its oscillating poles and unchanged stiffness."""
    a = model.physical_coefficients
    poles = np.roots(a[::-1])
    rings = np.abs(poles.imag) > 0
    slower = np.where(rings, poles.real / 2, poles.real)
    # a pair keeps its magnitude |p|, and with it the stiffness
    turned = np.sign(poles.imag) * np.sqrt(np.maximum(np.abs(poles) ** 2 - slower**2, 0.0))
    moved = np.real(np.poly(np.where(rings, slower + 1j * turned, poles)))[::-1]
    return model.changed(moved / moved[0] * a[0] / a)


def strokes(model: Model, voltages: Sequence[np.ndarray], dt: float) -> np.ndarray:
    """Return the largest |x| (m) under each voltage, at full and at half the damping; infinite if it diverges.

    Args:
        model: any.
        voltages: V, from rest.
        dt: sampling interval, s.

    Returns:
        shape (voltages, 2).
    """
    both = model, half_damped(model)
    reached = np.array([[np.abs(rollout(m, u, dt)).max() for m in both] for u in voltages])
    return np.where(np.isfinite(reached), reached, np.inf)


def growth(voltages: Sequence[np.ndarray], dt: float, band: tuple[float, float]) -> np.ndarray:
    """Return by what factor each input's stroke may exceed those before it, without a model, shape (voltages,).

    Args:
        voltages: V, in the order of playing.
        dt: sampling interval, s.
        band: possible range of the resonance, Hz; resonances up to 50 % above it are also tried.
    """
    forces = [u * u for u in voltages]
    # at least five samples in a period: a faster resonance is distorted by its sampling
    places = np.geomspace(band[0], min(1.5 * band[1], 0.2 / dt), 40)
    # a resonance of damping 0.01 is narrower than the grid, so an input's own line could miss it
    places = np.unique(np.concatenate([places, *(_lines(f, dt, band) for f in forces)]))
    filters = [_sampled(hz, dt) for hz in places]
    reached = np.array([[np.abs(lfilter(b, a, f)).max() for b, a in filters] for f in forces])
    before = np.maximum.accumulate(reached, 0)[:-1]
    static = np.array([f.max() for f in forces])  # a resonance far above the band
    ratio = (reached[1:] / before).max(1)
    return np.append(np.inf, np.maximum(ratio, static[1:] / np.maximum.accumulate(static)[:-1]))


def _lines(force: np.ndarray, dt: float, band: tuple[float, float]) -> np.ndarray:
    """Return the frequencies (Hz) of the three strongest Fourier lines of an input (V^2), near the band."""
    size = np.abs(np.fft.rfft(force - force.mean()))
    hz = np.fft.rfftfreq(len(force), dt)
    peaks = find_peaks(size)[0]
    peaks = peaks[(hz[peaks] >= band[0]) & (hz[peaks] <= 1.5 * band[1])]
    return hz[peaks[np.argsort(size[peaks])[-3:]]]


def _sampled(hz: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return numerator and denominator of a sampled resonance at `hz` (unit static gain, damping 0.01, linear hold)."""
    w = 2 * np.pi * hz
    sampled = cont2discrete(([w * w], [1, 2 * LEAST_DAMPING * w, w * w]), dt, method="foh")
    b, a = (np.ravel(np.asarray(part)) for part in sampled[:2])  # pyright: ignore[reportIndexIssue]
    return b, a

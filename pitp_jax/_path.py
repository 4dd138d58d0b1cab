"""Trajectories for the inverse: derivatives of a target, ramps from and back to zero, and the limits of an amplifier.

    x^(i): quintic (order + 3) spline through the samples, differentiated
    ramp:  the polynomial of lowest degree from rest to the target's first state (minimum jerk for order 2)
    down:  u_end (1 + cos(pi t / T)) / 2,  T = pi u_end / (2 slew) at least
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BPoly, make_interp_spline

from ._errors import BadInput
from ._model.model import Model

_JUMP = 0.3  # a change of x^(n-1) in one sample by this share of its range is a corner, not motion


@dataclass(frozen=True)
class Path:
    """A target with its lead-in.

    Attributes:
        displacement: model coordinates, m, shape (M,), from rest.
        target: where the target itself lies.
        led_in: a ramp was put in front.
        start_moves: the target does not start at rest.
    """

    displacement: np.ndarray
    target: slice
    led_in: bool
    start_moves: bool
    period: float

    def ramp_down(self, voltage: float, limits, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Raised cosine from the last voltage to zero within the slew limit, and no saturation flags."""
        duration = max(np.pi * abs(voltage) / (2 * limits.slew), 2 * self.period)
        count = max(int(np.ceil(duration / dt)), 2)
        tail = voltage * 0.5 * (1 + np.cos(np.pi * np.arange(1, count + 1) / count))
        tail[-1] = 0.0
        return tail, np.zeros(count, bool)


def derivatives(x: np.ndarray, dt: float, order: int) -> np.ndarray:
    """[x, x', ..., x^(order)] of a sampled path, shape (T, order + 1), by an odd-degree interpolating spline."""
    degree = 2 * ((order + 3) // 2) + 1
    if len(x) <= degree:
        raise BadInput(f"the target has {len(x)} samples; order {order} needs more than {degree}")
    t = np.arange(len(x)) * dt
    spline = make_interp_spline(t, x, k=degree)
    return np.stack([x] + [spline.derivative(i)(t) for i in range(1, order + 1)], -1)


def extend(wanted: np.ndarray, dt: float, model: Model, limits) -> Path:
    """Put a ramp from rest in front of a target that does not start there.

    The ramp lasts 4 periods of the nominal resonance, doubled until the static voltage along it keeps half the slew
    limit (the rest is left for the dynamics).
    """
    order = model.order
    states = derivatives(wanted, dt, order)
    a = model.physical_coefficients
    period = 2 * np.pi / (a[0] / a[-1]) ** (1 / order)
    span = max(np.ptp(wanted), abs(wanted).max(), 1e-30)
    moves = abs(states[0, 0]) > 1e-3 * span or abs(states[0, 1]) > 1e-2 * max(np.abs(states[:, 1]).max(), 1e-30)
    if not moves:
        return Path(wanted, slice(0, len(wanted)), False, False, period)
    static = np.sqrt(max(a[0] * abs(states[0, 0]), 0.0)) if limits.low == 0 else a[0] * abs(states[0, 0])
    count = int(np.ceil(max(4 * period, 4 * static / limits.slew) / dt))
    end = count * dt
    ramp = BPoly.from_derivatives([0.0, end], [np.zeros(order + 1), states[0, : order + 1]])
    lead = ramp(np.arange(count) * dt)
    return Path(np.concatenate([lead, wanted]), slice(count, count + len(wanted)), True, True, period)


def limit_slew(voltage: np.ndarray, limits, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Clip to the voltage range, then to the slew rate, starting from zero volts or the first value if it is at rest.

    Returns:
        The voltage kept, and True where it differs from the voltage asked for.
    """
    kept = np.clip(voltage, limits.low, limits.high)
    most = limits.slew * dt * (1 + 1e-6)
    if np.isfinite(most) and (np.abs(np.diff(kept)) > most).any():
        for i in range(1, len(kept)):
            kept[i] = min(max(kept[i], kept[i - 1] - most), kept[i - 1] + most)
    return kept, np.abs(kept - voltage) > 1e-6 * max(abs(limits.high), 1e-30)


def rough_share(wanted: np.ndarray, dt: float, model: Model) -> float:
    """Share of samples where x^(n-1) jumps by more than 30 % of its range in one sample: corners and noise."""
    x = wanted
    for _ in range(model.order - 1):
        x = np.diff(x) / dt
    jumps = np.abs(np.diff(x))
    return float((jumps > _JUMP * max(np.ptp(x), 1e-300)).mean())

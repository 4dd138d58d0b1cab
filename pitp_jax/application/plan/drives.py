"""Turn points of frequency and voltage range into voltages that start and end at zero within the limits.

    u(t) = w(t) [ (h + l)/2 - (h - l)/2 cos(phi(t)) ],   phi' = 2 pi f,   (f, l, h) through points p_1 ... p_K
    w: smooth steps from 0 and back to 0;  swing shrunk about its mean until |u_{i+1} - u_i| <= slew dt

A point: frequency uniform in its logarithm; the highest force h^2 dense towards the largest (a fraction that grows as
the root of a uniform number); the lowest voltage is zero at three points of four, otherwise its force is uniform below
h^2 (benefit: docs/decisions/plan.md).
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from ...method.signal.record import sampling_interval
from .limits import Limits
from .waveforms import smooth_step


@dataclass(frozen=True)
class Planned:
    """One recording to take: its voltage, its purpose, and the stroke predicted for it.

    Attributes:
        name: of its file, in the order of playing.
        kind: sweep, sine, multisine or steps.
        purpose: its purpose, one sentence.
        time: in s, shape (T,).
        voltage: in V, shape (T,), from zero to zero.
        rest: seconds at 0 V after it.
        stroke: largest displacement predicted by a model, m; nan without a model.
        stroke_half_damped: the same with half of the model's damping.
        go_on: largest stroke (m) of the recordings before it at which it may follow; infinity without a limit.
    """

    name: str
    kind: str
    purpose: str
    time: np.ndarray
    voltage: np.ndarray
    rest: float
    stroke: float = float("nan")
    stroke_half_damped: float = float("nan")
    go_on: float = float("inf")

    @property
    def seconds(self) -> float:
        """Return the duration of the planned recording, s."""
        return len(self.time) * sampling_interval(self.time)

    @property
    def slew(self) -> float:
        """Return the largest rate of change of the voltage, V/s."""
        return float(np.abs(np.diff(self.voltage)).max()) / sampling_interval(self.time)


def space_filling(count: int, limits: Limits, seed: int) -> np.ndarray:
    """Draw points that fill frequency (Hz), lowest and highest voltage (V) evenly (Sobol), shape (count, 3)."""
    sobol = qmc.Sobol(3, seed=seed)  # pyright: ignore[reportCallIssue]
    drawn = sobol.random(1 << max(count - 1, 1).bit_length())[:count]  # balanced only for powers of two
    first, last = np.log(limits.band)
    least = 0.15  # of the largest force: the smallest peak of an input
    from_zero = 0.75  # of the points have the limits' lowest voltage, as most test inputs do
    force = least + (1 - least) * drawn[:, 1] ** 0.5  # more points near the largest force
    high = limits.high * np.sqrt(force)
    # the lowest force is at most 0.7 of the highest one
    bias = 0.7 * np.maximum(0.0, (drawn[:, 2] - from_zero) / (1 - from_zero))
    low = high * np.sqrt(bias) if limits.low == 0 else limits.low + bias * (high - limits.low)
    return np.stack([np.exp(first + (last - first) * drawn[:, 0]), low, high], 1)


def through(points: np.ndarray, seconds: float, limits: Limits) -> np.ndarray:
    """Return a sine that takes the frequency and extremes of each of K points for a K-th of the time, shape (T,)."""
    t = np.arange(round(seconds * limits.rate)) / limits.rate
    at = t / seconds * len(points)
    k = np.minimum(at.astype(int), len(points) - 1)
    after = np.minimum(k + 1, len(points) - 1)
    # mostly at the point itself, then a smooth change, because a jump would excite all modes
    mix = smooth_step((at - k - 0.7) / 0.3)[:, None]
    f, low, high = ((1 - mix) * points[k] + mix * points[after]).T
    phase = 2 * np.pi * np.concatenate([[0.0], np.cumsum(f)[:-1]]) / limits.rate
    return within((low + high) / 2, -(high - low) / 2 * np.cos(phase), limits)


def within(mean: np.ndarray | float, swing: np.ndarray, limits: Limits) -> np.ndarray:
    """Return mean + swing (V), shape (T,), with ramps at both ends and the swing reduced to the slew limit."""
    size, most = len(swing), 0.999 * limits.slew / limits.rate  # rounding in a file must not exceed the limit
    mean = np.broadcast_to(np.asarray(mean, np.float64), size)
    rise = max(int(np.ceil(limits.ramp(np.abs(mean + swing).max()) * limits.rate)), 1)
    t = np.arange(size)
    window = smooth_step(t / rise) * smooth_step((size - 1 - t) / rise)
    factor = 1.0
    for _ in range(60):
        voltage = window * (mean + factor * swing)
        if np.abs(np.diff(voltage)).max() <= most:
            return np.clip(voltage, limits.low, limits.high)
        factor *= 0.9
    # even 0.2 % of the swing is too steep, because the ramps alone are
    ramps = window * mean
    return np.clip(ramps * min(1.0, most / np.abs(np.diff(ramps)).max()), limits.low, limits.high)

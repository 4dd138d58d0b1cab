"""Compute waveforms, each as (time, values) sampled at t_i = i / rate, i = 0 .. round(T rate) - 1.

    sweep  A sin(pi ((f_end - f_start) t / T + 2 f_start) t - pi/2) + B            (paper, eq. 14)
    sine   A sin(2 pi f t - pi/2) + B                                              (paper, eq. 14)

Both start at B - A, which is zero only where A = B. The instantaneous frequency of the sweep is f_start +
(f_end - f_start) t / T. With `rise` > 0 (default 0: the paper) the values are multiplied by a smooth ramp,
twice continuously differentiable, from 0 at t = 0 to 1 at t = rise; with `rest_s` > 0 that many seconds of
zero are appended (an abrupt fall, as in the paper's rest intervals).
"""

from collections.abc import Sequence

import numpy as np
import scipy

Waveform = tuple[np.ndarray, np.ndarray]


def smooth_step(s: np.ndarray) -> np.ndarray:
    """Evaluate 6 s^5 - 15 s^4 + 10 s^3 for s in [0, 1], 0 before, 1 after: a step with continuous second derivative."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10.0 + s * (6.0 * s - 15.0))


def _clock(duration: float, rate: float) -> np.ndarray:
    count = round(max(0.0, duration) * max(0.0, rate))  # 0 for nan
    if count < 2:
        raise ValueError(f"duration {duration} s at {rate} Hz gives fewer than two samples; increase one of them")
    return np.arange(count) / rate


def _finish(time: np.ndarray, values: np.ndarray, rate: float, rise: float, rest_s: float) -> Waveform:
    """Multiply values by the initial ramp and append zeros at the end."""
    if rise < 0 or rest_s < 0:
        raise ValueError(f"rise {rise} s and rest_s {rest_s} s cannot be negative")
    if rise > 0:
        values = values * smooth_step(time / rise)
    # whole samples, on the same clock
    rest = round(rest_s * rate)
    return np.arange(len(time) + rest) / rate, np.concatenate([values, np.zeros(rest)])


def sweep(
    f_start: float,
    f_end: float,
    duration: float,
    rate: float,
    amplitude: float,
    offset: float,
    *,
    rise: float = 0.0,
    rest_s: float = 0.0,
) -> Waveform:
    """Return a linear frequency sweep (eq. 14 of the paper).

    Args:
        f_start: first frequency in Hz.
        f_end: last frequency in Hz.
        duration: T in s.
        rate: samples per second.
        amplitude: A_1 in V.
        offset: A_2 in V.
        rise: ramp at the start in s.
        rest_s: zeros at the end in s.

    Returns:
        time in s and values in V, shape (round(T rate) + round(rest_s rate),) each.
    """
    time = _clock(duration, rate)
    phase = np.pi * ((f_end - f_start) / duration * time + 2.0 * f_start) * time - np.pi / 2
    return _finish(time, amplitude * np.sin(phase) + offset, rate, rise, rest_s)


def sine(
    frequency: float,
    duration: float,
    rate: float,
    amplitude: float,
    offset: float,
    *,
    rise: float = 0.0,
    rest_s: float = 0.0,
) -> Waveform:
    """Return a sine (eq. 14 of the paper), which starts at its lowest value, offset - amplitude.

    Args:
        frequency: f in Hz.
        duration: in s.
        rate: samples per second.
        amplitude: A_3 in V.
        offset: A_4 in V.
        rise: ramp at the start in s.
        rest_s: zeros at the end in s.

    Returns:
        time in s and values in V.
    """
    time = _clock(duration, rate)
    return _finish(time, amplitude * np.sin(2 * np.pi * frequency * time - np.pi / 2) + offset, rate, rise, rest_s)


def triangle(
    frequency: float,
    duration: float,
    rate: float,
    amplitude: float,
    offset: float,
    *,
    rise: float = 0.0,
    rest_s: float = 0.0,
) -> Waveform:
    """Return a symmetric triangle between offset - amplitude (at t = 0) and offset + amplitude; see `sine`."""
    time = _clock(duration, rate)
    wave = scipy.signal.sawtooth(2 * np.pi * frequency * time, 0.5)  # pyright: ignore[reportArgumentType]
    return _finish(time, amplitude * wave + offset, rate, rise, rest_s)


def steps(levels: Sequence[float], hold: float, rate: float, *, rise: float, rest_s: float = 0.0) -> Waveform:
    """Return a staircase of voltage levels, starting at zero, each reached by a smooth step.

    Args:
        levels: in V.
        hold: seconds per level, its rise included.
        rate: samples per second.
        rise: seconds from one level to the next, 0 <= rise <= hold.
        rest_s: zeros at the end in s.

    Returns:
        time in s and values in V.
    """
    if not 0 <= rise <= hold or len(levels) == 0:
        raise ValueError(
            f"steps need a level and 0 <= rise <= hold, got {len(levels)} levels, rise {rise}, hold {hold}"
        )
    time = _clock(hold * len(levels), rate)
    values = np.asarray(levels, dtype=np.float64)
    before = np.concatenate([[0.0], values[:-1]])
    # index of the level; the margin allows for times slightly below a whole hold
    k = np.minimum((time / hold + 1e-9).astype(int), len(levels) - 1)
    share = smooth_step((time - k * hold) / rise) if rise > 0 else 1.0
    return _finish(time, before[k] + (values - before)[k] * share, rate, 0.0, rest_s)


def multisine(
    band: tuple[float, float],
    duration: float,
    rate: float,
    amplitude: float,
    offset: float,
    *,
    seed: int | np.random.Generator,
    crest: float | None = None,
    rise: float = 0.0,
    rest_s: float = 0.0,
) -> Waveform:
    """Return a random-phase multisine: all multiples of 1/duration in the band, at equal amplitudes.

    Args:
        band: lowest and highest frequency in Hz.
        duration: one period, in s.
        rate: samples per second.
        amplitude: peak deviation from the offset, in V.
        offset: mean in V.
        seed: of the phases; a generator is advanced.
        crest: wanted ratio of peak to RMS; phases are improved by clipping until it is reached or 100 rounds
            are over (about 1.7 for many tones). None keeps the random phases (about 3.5).
        rise: ramp at the start in s.
        rest_s: zeros at the end in s.

    Returns:
        time in s and values in V.
    """
    time = _clock(duration, rate)
    # lines of the period, so that the tones repeat exactly
    bins = np.arange(int(np.ceil(band[0] * duration - 1e-9)), int(np.floor(band[1] * duration + 1e-9)) + 1)
    # neither the mean nor the Nyquist line, which has no phase of its own
    bins = bins[(bins > 0) & (bins < len(time) / 2)]
    if len(bins) == 0:
        raise ValueError(f"no multiple of 1/{duration} Hz lies in the band {band} Hz; lengthen it or widen the band")
    phase = np.random.default_rng(seed).uniform(0.0, 2 * np.pi, len(bins))
    best = trial = _tones(bins, phase, len(time))
    for _ in range(100):
        if crest is None or _crest(best) <= crest:
            break
        # peaks are clipped and only the phases of the result kept (Van der Ouderaa)
        limit = 0.85 * np.abs(trial).max()
        phase = np.angle(np.fft.rfft(np.clip(trial, -limit, limit))[bins])
        trial = _tones(bins, phase, len(time))
        best = min(best, trial, key=_crest)
    return _finish(time, amplitude * best / np.abs(best).max() + offset, rate, rise, rest_s)


def _tones(bins: np.ndarray, phase: np.ndarray, count: int) -> np.ndarray:
    spectrum = np.zeros(count // 2 + 1, dtype=complex)
    spectrum[bins] = np.exp(1j * phase)
    return np.fft.irfft(spectrum, count)


def _crest(values: np.ndarray) -> float:
    return float(np.abs(values).max() / np.sqrt(np.mean(values**2)))


def complex_trajectory(
    frequency: float,
    duration: float,
    rate: float,
    amplitude: float,
    offset: float,
    *,
    seed: int | np.random.Generator,
    rise: float = 0.0,
    rest_s: float = 0.0,
) -> Waveform:
    """Return a smooth curve of changing amplitude and speed, similar to Fig. 18 of the paper.

    x(t) = sum_k a_k (1 + sin(2 pi f t g_k + p_k) / 2) sin(2 pi f r_k t + q_k)

    with r = 1, sqrt 2, 2.3, pi, so it never repeats.

    Args:
        frequency: f of the slowest part, in Hz; the fastest is about 3.4 f.
        duration: in s.
        rate: samples per second.
        amplitude: half its range, in V (or m).
        offset: middle of its range.
        seed: of the phases p and q; a generator is advanced.
        rise: ramp at the start in s.
        rest_s: zeros at the end in s.

    Returns:
        time in s and values in V (or m).
    """
    time = _clock(duration, rate)
    slow, fast = np.random.default_rng(seed).uniform(0.0, 2 * np.pi, (2, 4))
    values = np.zeros_like(time)
    # weight, frequency and beat of each part; no two frequencies have a common period
    parts = ((1.0, 1.0, 0.11), (0.7, np.sqrt(2.0), 0.17), (0.45, 2.3, 0.23), (0.3, np.pi, 0.29))
    for k, (weight, ratio, beat) in enumerate(parts):
        envelope = 1.0 + 0.5 * np.sin(2 * np.pi * frequency * beat * time + slow[k])
        values += weight * envelope * np.sin(2 * np.pi * frequency * ratio * time + fast[k])
    low, high = values.min(), values.max()
    # scaled to -1 ... 1, because the extremes depend on the phases
    values = (2.0 * values - low - high) / (high - low)
    return _finish(time, amplitude * values + offset, rate, rise, rest_s)

"""Reduce the sampling rate of oversampled records by block means, which preserve linear relations.

    F_k = mean_{t in block k} F_t,    y_k = mean over the observed t of block k of y_t
    size = floor(1 / (n f dt))        n: samples kept of a period,  f: the fastest motion that the records show

A mean is the anti-alias filter. It belongs to the middle of its block, so a model of the means takes its input as
linear between them. No other room averages samples.

With f of 98 % of the energy, a faster motion of a seventh of the amplitude is averaged away. Blocks are therefore only
as long as 99.9 % (of what is not noise) needs, unless more samples would remain than can be used.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..numerics.coloured_noise import block_means
from .checks import MIN_SAMPLES
from .initial_state import noise_std
from .preprocess import force_band
from .record import Record

_BAND, _WHOLE = 0.98, 0.999  # of the energy of force and motion
_WORTH = 3  # samples a block: below, all samples are kept if they can be used
_BEYOND = 3.0  # times the motion's band: a mode above does not move in these records


M = TypeVar("M", bound=Any)  # a model: it lies above this room


def reduce_rate(
    records: Sequence[Record], model: M, samples_per_period: float, usable: int
) -> tuple[Sequence[Record], M]:
    """Average records over blocks and convert the model to the new rate; return both unchanged if blocks are too small.

    Args:
        records: in base units, of one sampling rate.
        model: its modes count among the fastest motion; its coefficients stay valid for the records' own rate.
        samples_per_period: kept of the fastest motion, at least.
        usable: number of samples, of all records together, that the caller can use.
    """
    dt, lengths = records[0].dt, [r.samples for r in records]
    shortest, samples = min(lengths), sum(lengths)
    forces = [model.input_map.force(r.voltage) for r in records]
    poles = np.roots(model.physical_coefficients[::-1])
    ringing = np.abs(poles[np.abs(poles.imag) > np.abs(poles.real)])  # a damped pole makes no fast motion
    # a pole that turns less than 1 rad in the longest record integrates: the input moves the derivative
    integrators = sum(abs(p) * dt * max(lengths) < 1 for p in poles.tolist())
    fastest = fastest_hz(records, forces, ringing / (2 * np.pi), integrators)
    whole = fastest_hz(records, forces, np.zeros(0), integrators, _WHOLE * (1 - _noise_fraction(records)))
    longest, size = (block_size(dt, hz, samples_per_period, shortest) for hz in (fastest, whole))
    size = min(max(size, -(-samples // usable)), longest)
    if size < (2 if samples > usable else _WORTH):
        return records, model
    small = [_with_voltage(r, f, size, model) for r, f in zip(records, forces, strict=True)]
    return small, model.sampled(small[0].dt, "foh")


def fastest_hz(
    records: Sequence[Record], forces: Sequence[np.ndarray], modes: np.ndarray, derivative=0, share=_BAND
) -> float:
    """Return the highest relevant frequency (Hz): of motion caused by the input, or of a mode that oscillates near it.

    Force without motion and motion without force are ignored, and so is a mode far above the motion. The motion is this
    derivative of the displacement: an integrated motion hides its fast part.
    """
    dt = records[0].dt
    moved = force_band([np.diff(r.filled, derivative) for r in records if np.ptp(r.filled) > 0], dt, share)
    return max(min(force_band(forces, dt, share), moved), *modes[modes < _BEYOND * moved], 1e-12)


def _noise_fraction(records: Sequence[Record]) -> float:
    """Return the fraction of the motions' energy that is white sensor noise, at most a half."""
    noise = sum(r.samples * noise_std(r.displacement) ** 2 for r in records)
    return float(min(noise / max(sum(r.samples * np.nanvar(r.displacement) for r in records), 1e-300), 0.5))


def block_size(dt: float, hertz: float, samples_per_period: float, shortest: int) -> int:
    """Return the block size (samples) that keeps enough samples per period, and 64 blocks in the shortest record.

    Args:
        dt: sampling interval, s.
        hertz: of the period.
        samples_per_period: to keep.
        shortest: samples of the shortest record.
    """
    return max(1, min(int(1 / (samples_per_period * hertz * dt)), shortest // MIN_SAMPLES))


def averaged(record: Record, force: Float[np.ndarray, " time"], size: int) -> Record:
    """Average a record over blocks of `size` samples; the input (V^2 or V) takes the place of the voltage.

    The force is averaged because the mean of a square is not the square of the mean. A block is missing if less than
    half of it was observed.
    """
    count = record.samples // size
    y, observed = block_means(np.nan_to_num(record.displacement), record.observed.astype(float), size)
    y = np.where(observed >= 0.5, y, np.nan)  # a half or more of the block was observed
    # a mean belongs to the middle of its block
    middle = record.time[0] + record.dt * ((size - 1) / 2 + size * np.arange(count))
    return replace(record, time=middle, voltage=means(force, size), displacement=y)


def means(values: np.ndarray, size: int) -> np.ndarray:
    """Average values over whole blocks of `size` samples, shape (len(values) // size,)."""
    count = len(values) // size
    return values[: count * size].reshape(count, size).mean(1)


def samples_before(k: int, rest: bool) -> int:
    """Return how many samples at rest to put before a record, so that its first block mean contains only rest."""
    return k + k // 2 if rest and k > 1 else 0


def centred_means(series: np.ndarray, size: int, rest: bool) -> np.ndarray:
    """Average a series around every `size`-th sample, from the rest before it on; nan is ignored."""
    if size == 1:
        return series
    # an even size has no middle sample: half of either end
    weights = np.ones(size) if size % 2 else np.r_[0.5, np.ones(size - 1), 0.5]
    whole = np.concatenate([np.full(samples_before(size, rest), np.nan), series])
    there = np.isfinite(whole)
    sums = np.convolve(np.where(there, whole, 0.0), weights, "valid")[::size]
    share = np.convolve(there, weights, "valid")[::size] / size
    return np.where(share > 0.5, sums / size / np.maximum(share, 0.5), np.nan)


def _with_voltage(record: Record, force: np.ndarray, size: int, model: Any) -> Record:
    """Average a record over blocks; its voltage is that of the mean input, with the sign of the mean voltage."""
    mean, voltage = averaged(record, force, size), averaged(record, record.voltage, size).voltage
    back = np.asarray(model.input_map.voltage(jnp.asarray(mean.voltage)), np.float64)
    sign = np.where(voltage < 0, -1.0, 1.0) if model.input_map.one_sided else 1.0  # the square has lost the sign
    return replace(mean, voltage=sign * back)

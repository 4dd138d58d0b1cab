"""Interpolate a sampled voltage at fractions of a sample: v(t + f) = sum_k w_k(f) v_{t+k}.

zoh            w_0 = 1
foh            w_0 = 1 - f,  w_1 = f
bandlimited    w_k = sinc(f - k) kaiser((f - k) / 8), normalised, k = -7 ... 8

A signal generated below the Nyquist frequency is not linear between samples: foh weighs frequency f by sinc^2(f / fs),
so an input at a fifth of the sampling rate loses an eighth of its amplitude (docs/decisions/decoder.md).
"""

import numpy as np
from jaxtyping import Float

_HALF, _BETA = 8, 8.0  # taps on either side, and beta of their Kaiser window


def weights(hold: str, fractions: np.ndarray) -> Float[np.ndarray, "taps fractions"]:
    """Return the weights of the neighbouring samples for a voltage at fractions of a sample after sample t."""
    f = np.asarray(fractions, np.float64)[None]
    if hold != "bandlimited":
        f = f * (hold == "foh")  # a held voltage is that of the sample before
        return np.concatenate([1 - f, f])
    away = f - np.arange(1 - _HALF, _HALF + 1)[:, None]
    inside = np.clip(
        1 - (away / _HALF) ** 2, 0, None
    )  # at the window's edge rounding must not give the root of a negative number
    taps = np.sinc(away) * np.i0(_BETA * np.sqrt(inside)) / np.i0(_BETA)
    return taps / taps.sum(0)  # a constant voltage stays exactly constant, unlike with a truncated sinc


def between(voltage, hold: str, fractions: np.ndarray, xp):
    """Interpolate voltages (..., time) at every fraction of a sample after each sample, (..., time, fractions).

    Beyond its ends a voltage is constant. `xp` is the array's module: numpy or jax.numpy.
    """
    taps = weights(hold, fractions)
    half = len(taps) // 2
    # an amplifier holds its first and last value; padding with zeros would ring into the record
    padded = xp.pad(voltage, [(0, 0)] * (voltage.ndim - 1) + [(half - 1, half)], "edge")
    frame = xp.stack([padded[..., k : k + voltage.shape[-1]] for k in range(2 * half)], -1)
    return frame @ xp.asarray(taps, voltage.dtype)

"""Find a spectral line in every record's residual that does not depend on the input, such as mains hum.

    |E(f)|^2 has most of its energy within three bins of one f, the same in all records, while the inputs' F have not

The response to an input has the input's frequencies, so at least two inputs must differ from the line.
"""

from collections.abc import Sequence

import numpy as np

_FRACTION = 0.8  # of an error's energy within three bins of one frequency: a line


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

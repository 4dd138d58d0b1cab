"""Which records are sweeps: the drive's frequency climbs (or falls) steadily and by a factor of three at least."""

import numpy as np
from scipy.stats import spearmanr

from .record import Record

_SEGMENTS = 16


def is_sweep(record: Record) -> bool:
    """True when the zero crossings of the drive, counted in 16 segments, rise or fall (rank correlation > 0.9).

    The drive is taken about its own mid-range; a record with fewer than 16 crossings in all is no sweep.
    """
    u = record.voltage - (record.voltage.max() + record.voltage.min()) / 2
    crossings = np.flatnonzero(np.diff(np.signbit(u)))
    if len(crossings) < _SEGMENTS:
        return False
    counts = np.bincount(np.minimum(crossings * _SEGMENTS // record.samples, _SEGMENTS - 1), minlength=_SEGMENTS)
    if len(np.unique(counts)) < 4:
        return False
    trend = float(spearmanr(np.arange(_SEGMENTS), counts)[0])  # pyright: ignore[reportArgumentType]
    return abs(trend) > 0.9 and bool(counts.max() >= 3 * max(counts.min(), 1))

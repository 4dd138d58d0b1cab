"""Thin oversampled records before training: free runs hold a budget of samples, and a motion needs some 50 a period.

    size = floor(1 / (50 f dt)),    f: the faster of the drive's band and the nominal's oscillating modes

A Peano-HASEL recorded at 200 samples a period would be trained on 66 of its 115 s: every fourth sample brings the rest
(kept 1 and 11 Hz: 53 and 92 -> 22 and 45 % nrmse).
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from .._model.model import Model
from .._record.averaged import averaged
from .._record.preprocess import force_band
from .._record.record import Record

_PER_PERIOD = 50


def thinned(records: Sequence[Record], nominal: Model, budget: int) -> Sequence[Record]:
    """The records averaged over blocks where they hold more samples than `budget`; else as they are."""
    dt = records[0].dt
    if sum(r.samples for r in records) <= budget:
        return records
    forces = [np.asarray(nominal.input_map.force(r.voltage), np.float64) for r in records]
    roots = np.roots(nominal.physical_coefficients[::-1])
    ringing = np.abs(roots[np.abs(roots.imag) > np.abs(roots.real)])
    fastest = max(force_band(forces, dt), nominal.natural_frequency / (2 * np.pi), *ringing / (2 * np.pi))
    size = min(int(1 / (_PER_PERIOD * fastest * dt)), min(r.samples for r in records) // 64)
    if size < 2:
        return records
    return [_thinned(r, f, size, nominal) for r, f in zip(records, forces, strict=True)]


def _thinned(record: Record, force: np.ndarray, size: int, nominal: Model) -> Record:
    """The force's means as a voltage again, of the sign that the voltage has most."""
    mean, voltage = averaged(record, force, size), averaged(record, record.voltage, size).voltage
    back = np.asarray(nominal.input_map.voltage(jnp.asarray(mean.voltage)), np.float64)
    sign = np.where(voltage < 0, -1.0, 1.0) if nominal.input_map.one_sided else 1.0
    return Record(record.name, mean.time, sign * back, mean.displacement, source=record.source)

"""Thin oversampled records before training: free runs hold a budget of samples, and a motion needs some 50 a period.

    size = floor(1 / (50 f dt)),    f: the faster of the drive's band and the nominal's oscillating modes

A record of 200 samples a period would else be cut where the budget ends, and its later part never seen
(docs/decisions/training.md).
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
    """Average the records over blocks where they hold more samples than `budget`; else return them as they are."""
    dt = records[0].dt
    if sum(r.samples for r in records) <= budget:
        return records
    forces = [nominal.input_map.force(r.voltage) for r in records]
    roots = np.roots(nominal.physical_coefficients[::-1])
    ringing = np.abs(roots[np.abs(roots.imag) > np.abs(roots.real)])  # a well damped pole makes no fast motion
    fastest = max(force_band(forces, dt), nominal.natural_frequency / (2 * np.pi), *ringing / (2 * np.pi))
    # the shortest record must keep enough samples to be filtered
    size = min(int(1 / (_PER_PERIOD * fastest * dt)), min(r.samples for r in records) // 64)
    if size < 2:
        return records
    return [_thinned(r, f, size, nominal) for r, f in zip(records, forces, strict=True)]


def _thinned(record: Record, force: np.ndarray, size: int, nominal: Model) -> Record:
    """Turn the force's block means into a voltage again, of the sign of the mean voltage."""
    mean, voltage = averaged(record, force, size), averaged(record, record.voltage, size).voltage
    back = np.asarray(nominal.input_map.voltage(jnp.asarray(mean.voltage)), np.float64)
    sign = np.where(voltage < 0, -1.0, 1.0) if nominal.input_map.one_sided else 1.0  # the square has lost it
    return Record(record.name, mean.time, sign * back, mean.displacement, source=record.source)

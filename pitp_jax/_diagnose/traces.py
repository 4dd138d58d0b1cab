"""Every record with free runs of the nominal and of the returned model."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._model.model import Model
from .._record.record import Record
from .._simulate.prediction import predict


@dataclass(frozen=True)
class Trace:
    """One record in measured units: time (s), voltage (V), measured, nominal and augmented output; held out or not."""

    name: str
    heldout: bool
    time: np.ndarray
    voltage: np.ndarray
    measured: np.ndarray
    nominal: np.ndarray
    augmented: np.ndarray


def traces_of(nominal: Model, augmented: Model, records: Sequence[Record]) -> tuple[Trace, ...]:
    """Return every record with free runs of the nominal and of the returned model."""
    first = predict(nominal, records)
    second = first if augmented is nominal else predict(augmented, records)
    return tuple(
        Trace(
            r.name,
            len(records) > 1,
            r.time,
            r.voltage,
            np.where(p.scored, r.displacement, np.nan),
            levelled(p, r),
            levelled(q, r),
        )
        for r, p, q in zip(records, first, second, strict=True)
    )


def levelled(p, r: Record) -> np.ndarray:
    """Return a run with its offset fitted over the record."""
    seen = p.scored & np.isfinite(r.displacement) & np.isfinite(p.displacement)
    return p.displacement + (np.mean((r.displacement - p.displacement)[seen]) if seen.any() else 0.0)

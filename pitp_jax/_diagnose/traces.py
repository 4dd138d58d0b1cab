"""Every record beside free runs of the nominal and of the model that is handed back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._model.model import Model
from .._record.record import Record
from .._simulate.prediction import predict


@dataclass(frozen=True)
class Trace:
    """One record in rig units: time (s), voltage (V), measured, nominal and augmented output; held out or fitted."""

    name: str
    heldout: bool
    time: np.ndarray
    voltage: np.ndarray
    measured: np.ndarray
    nominal: np.ndarray
    augmented: np.ndarray


def traces_of(nominal: Model, augmented: Model, records: Sequence[Record]) -> tuple[Trace, ...]:
    """Every record beside the nominal and the model that is handed back."""
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
    """A run with its zero fitted over the record."""
    seen = p.scored & np.isfinite(r.displacement) & np.isfinite(p.displacement)
    return p.displacement + (np.mean((r.displacement - p.displacement)[seen]) if seen.any() else 0.0)

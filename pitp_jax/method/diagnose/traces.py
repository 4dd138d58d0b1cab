"""Simulate every record with the nominal model and with the returned model."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..model.model import Model
from ..signal.record import Record
from ..simulate.prediction import predict


@dataclass(frozen=True)
class Trace:
    """A record (s, V, measured unit) with the simulated outputs of the nominal and the returned model."""

    name: str
    heldout: bool
    time: np.ndarray
    voltage: np.ndarray
    measured: np.ndarray
    nominal: np.ndarray
    augmented: np.ndarray

    @property
    def span(self) -> float:
        """Return the measured range, in the measured unit."""
        return float(np.nanmax(self.measured) - np.nanmin(self.measured))


def traces_of(nominal: Model, augmented: Model, records: Sequence[Record]) -> tuple[Trace, ...]:
    """Simulate every record with the nominal model and with the returned model."""
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
    """Return a simulated output whose offset is fitted to the record."""
    seen = p.scored & np.isfinite(r.displacement) & np.isfinite(p.displacement)
    return p.displacement + (np.mean((r.displacement - p.displacement)[seen]) if seen.any() else 0.0)

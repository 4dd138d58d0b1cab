"""The validity range of a model: sampling interval, voltages and features of its training records.

Its numbers are `constants`: exact on the host, and not parameters of the model. The sampling interval is static: each
program has its own.
"""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import numpy as np

from ..signal.record import Record
from ..signal.sets import ABSOLUTE
from .constants import Constants, number, numbers


class Domain(Constants):
    """The range of the training records, within which a model is valid.

    Attributes:
        dt: sampling interval of the records, s.
        voltage_range: lowest and highest voltage, V.
        slew: highest slew of the voltage, V/s.
        region: lowest and highest value of every feature (S then memory, scaled); no row without training.
        clock: time of the records' clock at the start of their session, s; 0 unless it is absolute time.
        noise: sensor noise (rms, base unit); 0 where it is unknown.
    """

    dt: float = eqx.field(converter=number, static=True)
    voltage_range: tuple[float, float] = eqx.field(converter=numbers, default=(0.0, np.inf))
    slew: float = eqx.field(converter=number, default=np.inf)
    region: tuple[tuple[float, float], ...] = eqx.field(converter=numbers, default=())
    clock: float = eqx.field(converter=number, default=0.0)
    noise: float = eqx.field(converter=number, default=0.0)

    def age(self, time: float) -> float:
        """Convert a time of the records' clock to the time since the session began (s); 0 for another clock."""
        age = float(time) - float(self.clock)
        return age if abs(age) < ABSOLUTE else 0.0

    def driven_by(self, records: Sequence[Record]) -> "Domain":
        """Return the domain with its voltage range (V) and slew (V/s) widened to those of these records."""
        low, high = self.voltage_range
        return replace(
            self,
            voltage_range=(
                min(low, *(r.voltage.min() for r in records)),
                max(high, *(r.voltage.max() for r in records)),
            ),
            slew=max(self.slew, *(np.abs(np.diff(r.voltage)).max() / r.dt for r in records)),
        )

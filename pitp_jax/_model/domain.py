"""The domain of a model: how its records were sampled and driven, and which features they reached.

NumPy's float64, exact on the host; under jit they are arguments of the program, so models of any domain share it.
"""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .._record.record import Record
from .._record.sets import ABSOLUTE


def _pair(values) -> np.ndarray:
    return np.asarray(values, np.float64)


def _pairs(values) -> np.ndarray:
    return np.asarray(values, np.float64).reshape(-1, 2)


class Domain(eqx.Module):
    """What a model was shown, which is where it may be trusted.

    Attributes:
        dt: sampling interval of the records, s.
        voltage_range: lowest and highest drive voltage, V.
        slew: highest slew of the voltage, V/s.
        region: lowest and highest value of every feature (S then memory, scaled); no row where nothing was trained.
        clock: what the records' clock showed when their session began, s; 0 unless it shows absolute time.
    """

    dt: float = eqx.field(converter=np.float64)
    voltage_range: Float[np.ndarray | Array, "2"] = eqx.field(converter=_pair, default=(0.0, np.inf))
    slew: float = eqx.field(converter=np.float64, default=np.inf)
    region: Float[np.ndarray | Array, "features 2"] = eqx.field(converter=_pairs, default=())
    clock: float = eqx.field(converter=np.float64, default=0.0)

    def age(self, time: float) -> float:
        """How long the session had lasted when a clock showed this time, s; 0 by a clock of another kind."""
        age = float(time) - float(self.clock)
        return age if abs(age) < ABSOLUTE else 0.0

    def driven_by(self, records: Sequence[Record]) -> "Domain":
        """Widen range and slew of the voltage to those of these records."""
        low, high = self.voltage_range
        return replace(
            self,
            voltage_range=(
                min(low, *(float(r.voltage.min()) for r in records)),
                max(high, *(float(r.voltage.max()) for r in records)),
            ),
            slew=max(self.slew, *(float(np.abs(np.diff(r.voltage)).max()) / r.dt for r in records)),
        )

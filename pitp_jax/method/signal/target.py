"""A wanted motion over time: what an inverse is asked for."""

from dataclasses import dataclass

import numpy as np

from ...common.errors import refuse_traced
from .checks import check_wanted
from .record import Timed, own_column, range_in


@dataclass(frozen=True, eq=False)
class Target(Timed):
    """A wanted motion over time, input of the inverse model.

    Attributes:
        time: sample times in s, shape (T,), uniform to 1 % of a sample.
        displacement: wanted output in its base unit, shape (T,), no missing samples.
        displacement_unit: unit it had in its file.
        source: the file, for messages.

    Raises:
        BadInput: shapes differ, fewer than two samples, non-uniform time, a sample missing or infinite.
    """

    time: np.ndarray
    displacement: np.ndarray
    displacement_unit: str = "m"
    source: str = ""

    def __post_init__(self):
        """Refuse a target with gaps or a non-uniform time (`read_target` names the column and the line as well)."""
        refuse_traced("Target", "inverse with an array", self.time, self.displacement)
        for field in ("time", "displacement"):
            object.__setattr__(self, field, own_column(getattr(self, field), f"{self.source or 'target'}: {field}"))
        check_wanted(self.time, self.displacement, self.source or "target")

    def __repr__(self) -> str:
        span = range_in(self.displacement, self.displacement_unit)
        return f"Target({len(self.time)} samples at {1 / self.dt:.6g} Hz, {span})"

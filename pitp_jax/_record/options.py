"""What a caller says about the columns of record files: names, units, scales, sampling rate.

u = input_scale * column,    y = output_scale * column,    t_i = i / rate where a file has no time
"""

import math
from dataclasses import dataclass

from .._errors import BadInput
from .units import units_of

OPTIONS = {"time": "time", "voltage": "input", "displacement": "output"}  # quantity -> stem of its options


@dataclass(frozen=True)
class ReadOptions:
    """Columns, units and scales of record files; None leaves it to the file.

    Attributes:
        time_column, input_column, output_column: exact headers.
        time_unit, input_unit, output_unit: units of these columns, over what the file says.
        input_scale: V per V of the input column (an amplifier's monitor of 1 V per kV: 1000).
        output_scale: m per V of the output column (a laser of 2 mm per V: 0.002); of a length, a plain factor.
        rate: samples per second of files without time.

    Raises:
        BadInput: an unknown unit, a scale of zero, a rate that is not positive.
    """

    time_column: str | None = None
    input_column: str | None = None
    output_column: str | None = None
    time_unit: str | None = None
    input_unit: str | None = None
    output_unit: str | None = None
    input_scale: float | None = None
    output_scale: float | None = None
    rate: float | None = None

    def __post_init__(self):
        """Refuse what no file could be read with."""
        problems = []
        for quantity, stem in OPTIONS.items():
            unit = getattr(self, f"{stem}_unit")
            if unit is not None and unit not in units_of(quantity):
                problems.append(f"--{stem}-unit {unit!r} is not one of {', '.join(units_of(quantity))}")
        for name in ("input_scale", "output_scale", "rate"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value != 0 and (value > 0 or name != "rate")):
                kind = "positive number" if name == "rate" else "finite number other than 0"
                problems.append(f"--{name.replace('_', '-')} {value} is not a {kind}")
        if problems:
            raise BadInput("; ".join(problems))

    def column(self, quantity: str) -> str | None:
        """The header asked for."""
        return getattr(self, f"{OPTIONS[quantity]}_column")

    def unit(self, quantity: str) -> str | None:
        """The unit asked for."""
        return getattr(self, f"{OPTIONS[quantity]}_unit")

    def scale(self, quantity: str) -> float | None:
        """The scale asked for; None for the time."""
        return {"voltage": self.input_scale, "displacement": self.output_scale}.get(quantity)

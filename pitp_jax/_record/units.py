"""Units: the suffix of a column name and its factor to the base unit.

value in base unit = factor(unit) * value in the column,    base units: s, V, and m or V for the output
"""

from .._errors import BadInput

TIME_UNITS = {"s": 1.0, "ms": 1e-3}
INPUT_UNITS = {"V": 1.0, "kV": 1e3, "mV": 1e-3}
OUTPUT_UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "V": 1.0, "mV": 1e-3}

_UNITS = {"time": TIME_UNITS, "voltage": INPUT_UNITS, "displacement": OUTPUT_UNITS}


def column_names(quantity: str) -> tuple[str, ...]:
    """The exact column names a quantity may have, in the order they are documented.

    Args:
        quantity: `time`, `voltage` or `displacement`.
    """
    return tuple(f"{quantity}_{unit}" for unit in _UNITS[quantity])


def unit_of(column: str, quantity: str, source: str) -> str:
    """The unit a column name ends in: what follows its last underscore.

    Args:
        column: name of a column, for example `voltage_command_V`.
        quantity: `time`, `voltage` or `displacement`; decides which units are known.
        source: the file, for the message.

    Raises:
        BadInput: the name has no unit, or one this quantity cannot have.
    """
    stem, _, unit = column.rpartition("_")
    known = _UNITS[quantity]
    if stem and unit in known:
        return unit
    raise BadInput(
        f"{source}: column {column!r}: unknown unit {unit!r}; rename the column so that it ends in one of "
        f"{', '.join('_' + name for name in known)}"
    )


def factor(unit: str, quantity: str) -> float:
    """Base units per unit: multiply a column by this to get s, V or m.

    Args:
        unit: one of the units of the quantity.
        quantity: `time`, `voltage` or `displacement`.
    """
    return _UNITS[quantity][unit]


def to_base(values, unit: str, quantity: str):
    """Values in the base unit; sub-units divide by a whole number, so decimal times stay exact.

    Args:
        values: array in `unit`, any shape.
        unit: one of the units of the quantity.
        quantity: `time`, `voltage` or `displacement`.
    """
    scale = factor(unit, quantity)
    return values * scale if scale >= 1.0 else values / round(1.0 / scale)


def from_base(values, unit: str, quantity: str):
    """Values in `unit` from values in the base unit; the inverse of `to_base`.

    Args:
        values: array in the base unit, any shape.
        unit: one of the units of the quantity.
        quantity: `time`, `voltage` or `displacement`.
    """
    scale = factor(unit, quantity)
    return values / scale if scale >= 1.0 else values * round(1.0 / scale)


def base_unit(unit: str) -> str:
    """The base unit of an output unit: `m` for lengths, `V` for voltages."""
    return "V" if unit.endswith("V") else "m"

"""Parse numbers of the command line that may carry a unit: `3kV`, `20deg`, `5e4 V/s`.

Without a unit a voltage is in V and a length in mm, and any other quantity in the unit of the model's records.
"""

import math
import re
from typing import Any, NamedTuple

from ...common.errors import BadInput
from ...common.quantity import Quantity, Units
from ...common.units import kind_of, spelt, to_base, units_of_kind


class Amount(NamedTuple):
    """A number with its unit as the user wrote it; the unit is empty if there is none."""

    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value:g}{self.unit}"


def amount(text: str) -> Amount | None:
    """Split text such as `3kV` into number and unit; return None if it is not a finite number with a known unit."""
    match = re.fullmatch(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", text)
    if match is None or not math.isfinite(float(match[1])):
        return None
    known = not match[2] or any(
        kind_of(spelt(unit)) not in (None, "time") for unit in (match[2], _unit_of_rate(match[2]))
    )
    return Amount(float(match[1]), match[2]) if known else None


def in_base(given: Amount | None, option: str, quantity: Quantity, *, rate: bool = False) -> float | None:
    """Convert an option's value to base units (a rate: per second); None stays None.

    Args:
        given: the number with its unit.
        option: its name, for the message.
        quantity: its unit is taken for a number without one.
        rate: per second.

    Raises:
        BadInput: a unit of another kind.
    """
    if given is None:
        return None
    said = f"{option} {given}"
    unit = unit_of_kind(given.unit, said, quantity, rate=rate) if given.unit else quantity.unit
    return float(to_base(given.value, unit))


def unit_of_kind(text: str, said: str, quantity: Quantity, *, rate: bool = False) -> str:
    """Return the unit that a text spells.

    Args:
        text: the unit.
        said: what the user gave, for the message.
        quantity: the unit must be of its kind.
        rate: per second.

    Raises:
        BadInput: a unit of another kind.
    """
    unit = spelt(_unit_of_rate(text) if rate else text) or ""
    if unit not in units_of_kind(quantity.unit):
        units = [Quantity(u).rate if rate else u for u in units_of_kind(quantity.unit)]
        raise BadInput(f"{said}: wrong kind of unit; give it in {', '.join(units)}")
    return unit


def limits_in_base(units: Units, largest: Amount | None, steepest: Amount | None, farthest: Amount | None) -> dict:
    """Return the limits of input, slew and displacement in base units, by their names in `pitp.plan`."""
    return {
        "max_voltage": in_base(largest, units.max_input, units.input),
        "max_slew": in_base(steepest, units.max_rate, units.input, rate=True),
        "max_displacement": in_base(farthest, units.max_output, units.limit),
    }


def zero_in_base(zero: str | float, unit: str) -> Any:
    """Convert the option `--zero` to the base unit; `rest` and `sensor` stay."""
    return zero if isinstance(zero, str) else float(to_base(zero, unit))


def _unit_of_rate(unit: str) -> str:
    """Remove one `per second` from a unit: kV from kV/s, deg/s from deg/s2; empty if there is none."""
    match = re.fullmatch(r"(.*?)/s(\^?2|²)?", unit)
    if match is None:
        return ""
    return f"{match[1]}/s" if match[2] else match[1]

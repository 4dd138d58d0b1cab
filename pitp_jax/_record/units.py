"""Units: their spellings, how a header carries them, and their factors to the base units.

value in base unit = factor(unit) * value in the column,    base units: s, V, and m or V for the output
"""

import re
import unicodedata

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
INPUT_UNITS = {"V": 1.0, "kV": 1e3, "mV": 1e-3}
_LENGTHS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "cm": 1e-2, "nm": 1e-9}
OUTPUT_UNITS = {**_LENGTHS, "V": 1.0, "mV": 1e-3}

_UNITS = {"time": TIME_UNITS, "voltage": INPUT_UNITS, "displacement": OUTPUT_UNITS}
_ALL = {**TIME_UNITS, **INPUT_UNITS, **OUTPUT_UNITS}
_SPELLINGS = {
    **dict.fromkeys(("sec", "secs", "second", "seconds", "sekunde", "sekunden"), "s"),
    **dict.fromkeys(("msec", "millisecond", "milliseconds", "millisekunden"), "ms"),
    **dict.fromkeys(("usec", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("minute", "minutes"), "min"),
    **dict.fromkeys(("volt", "volts", "v"), "V"),
    **dict.fromkeys(("kilovolt", "kilovolts", "kv"), "kV"),
    **dict.fromkeys(("millivolt", "millivolts"), "mV"),
    **dict.fromkeys(("meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("micron", "microns", "micrometer", "micrometers", "micrometre", "micrometres"), "um"),
}
_IN_BRACKETS = re.compile(r"[(\[{<]\s*([^()\[\]{}<>]*?)\s*[)\]}>]")
_AT_THE_END = re.compile(r"^(.*\S)\s*(?:[/_,:;\s-]|\sin\s)\s*([^\s/_,:;()\[\]-]+)$")


def spelt(text: str) -> str | None:
    """The unit a text is a spelling of (`µm`, `Volts`, `kV`), or None."""
    plain = unicodedata.normalize("NFKC", text).strip().strip("()[]{}<>").replace("Âμ", "μ").replace("μ", "u")
    plain = plain.strip()
    if plain in _ALL:
        return plain
    lower = plain.lower()
    return _SPELLINGS.get(lower) or (lower if lower in ("s", "mm") else None)


def split_header(text: str) -> tuple[str, str | None]:
    """A header as (what is measured, its unit or None): `Weg [µm]`, `U/V`, `time_s`, `Time in ms`."""
    for found in _IN_BRACKETS.finditer(text):
        unit = spelt(found[1])
        if unit:
            return (text[: found.start()] + text[found.end() :]).strip(), unit
    found = _AT_THE_END.match(text.strip())
    unit = spelt(found[2]) if found else None
    return (found[1].removesuffix(" in").rstrip(" /_,:;-"), unit) if found and unit else (text.strip(), None)


def column_names(quantity: str) -> tuple[str, ...]:
    """The exact column names a quantity may have, in the order they are documented.

    Args:
        quantity: `time`, `voltage` or `displacement`.
    """
    return tuple(f"{quantity}_{unit}" for unit in _UNITS[quantity])


def units_of(quantity: str) -> tuple[str, ...]:
    """The units a quantity may have.

    Args:
        quantity: `time`, `voltage` or `displacement`.
    """
    return tuple(_UNITS[quantity])


def is_length(unit: str | None) -> bool:
    """Whether a unit is one of length."""
    return unit in _LENGTHS


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

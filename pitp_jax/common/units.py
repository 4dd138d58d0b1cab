"""Define units: their factors, their spellings, and the base unit of each kind.

value in base unit = factor(unit) * value in the column,    base units: SI (s, V, m, rad, Pa, ...)
"""

import math
import re
import unicodedata

_KINDS: dict[str, dict[str, float]] = {  # the first unit of a kind is its base
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0},
    "voltage": {"V": 1.0, "kV": 1e3, "mV": 1e-3, "uV": 1e-6},
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "cm": 1e-2, "nm": 1e-9, "inch": 0.0254},
    "current": {"A": 1.0, "mA": 1e-3, "uA": 1e-6},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "torque": {"N m": 1.0, "mN m": 1e-3},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "mbar": 1e2, "psi": 6894.757293168361},
    "angle": {"rad": 1.0, "deg": math.pi / 180, "rev": 2 * math.pi, "mrad": 1e-3, "urad": 1e-6},
    "angular speed": {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": 2 * math.pi / 60},
    "speed": {"m/s": 1.0, "mm/s": 1e-3, "um/s": 1e-6},
    "acceleration": {"m/s2": 1.0},
    "temperature": {"degC": 1.0},
    "absolute temperature": {"K": 1.0},
    "number": {"counts": 1.0, "percent": 1e-2},
}
# Symbols of units that are not listed above; a unit of them is kept as it is written, and is its own base.
_ATOM = (
    r"(?:[fpnumcdhkMGT]?(?:VA|Hz|Wb|Ohm|Pa|bar|rad|eV|mol|lm|lx|cd|[WJTFHSΩgtlLNmsAVK])"
    r"|min|h|d|deg|rev|dB|var|ppm|sccm|slpm|kgf|lbf|Oe|%|1)(?:\^?-?\d)?"
)
_WRITTEN = re.compile(rf"{_ATOM}(?:[/*·.]{_ATOM}){{0,3}}")
_LISTED = re.compile(r"[a-zA-Z]?(?:[VANKms]|Pa|bar|rad|deg|rev|min|h|d|1)\d?")  # alone: MV may be meant as mV


def written(text: str) -> str | None:
    """Return a unit made of symbols of SI, such as W or L/min, as it is written; None for any other text."""
    bare = plain(text).strip("()[]{}<> ")
    return bare if _WRITTEN.fullmatch(bare) and not _LISTED.fullmatch(bare) else None


class _Factors(dict[str, float]):
    """Factors to the base unit, by unit; a unit that is not listed but made of symbols of SI is its own base."""

    def __contains__(self, unit: object) -> bool:
        return super().__contains__(unit) or (isinstance(unit, str) and written(unit) == unit)

    def __missing__(self, unit: str) -> float:
        if unit in self:
            return 1.0
        raise KeyError(unit)


_KIND = {unit: kind for kind, units in _KINDS.items() for unit in units}
TIME_UNITS = _KINDS["time"]
INPUT_UNITS = OUTPUT_UNITS = _Factors(
    {unit: factor for kind, units in _KINDS.items() if kind != "time" for unit, factor in units.items()}
)

_WORDS = {
    "s": "s sec secs second seconds sekunde sekunden seconde secondes segundos secondi с сек 秒",
    "ms": "msec msecs millisec milliseconds millisecond millisekunden millis мс мсек ミリ秒 毫秒",
    "us": "usec usecs microsecond microseconds mikrosekunden micros мкс マイクロ秒 微秒",
    "ns": "nsec nanoseconds nanosecond",
    "min": "minute minutes minuten мин 分",
    "h": "hr hrs hour hours stunden ч 小时 時間",
    "d": "day days tage",
    "V": "v volt volts vdc vac в вольт ボルト 伏",
    "kV": "kv kilovolt kilovolts кв キロボルト 千伏",
    "mV": "millivolt millivolts мв",
    "m": "meter meters metre metres",
    "mm": "mm millimeter millimeters millimetre millimetres мм ミリ ミリメートル 毫米",
    "um": "um micron microns mikrometer micrometer micrometers micrometre micrometres мкм ミクロン 微米",
    "cm": "centimeter centimeters см 厘米",
    "nm": "nanometer nanometers нм 纳米",
    "inch": "inches",
    "A": "amp amps ampere amperes",
    "mA": "milliamp milliamps milliampere",
    "N": "newton newtons",
    "N m": "nm_ n·m n*m n.m newton-meter",
    "bar": "bar bars",
    "Pa": "pascal",
    "kPa": "kpa",
    "psi": "psi",
    "rad": "rad radian radians",
    "deg": "deg degree degrees ° grad",
    "rev": "rev revolution revolutions turn turns",
    "rad/s": "rad/sec",
    "deg/s": "°/s deg/sec",
    "rpm": "rpm u/min r/min rev/min 1/min min-1",
    "m/s2": "m/s^2 m/s/s m/s**2",
    "degC": "°c degc deg_c celsius",
    "K": "kelvin",
    "counts": "count counts cnt cnts cts inc ticks pulses",
    "percent": "% percent pct",
}
_SPELLINGS = {word: unit for unit, words in _WORDS.items() for word in words.split()}


def plain(text: str) -> str:
    """Write a text with plain characters (no full width, `㎜` or `²`) and u for micro."""
    return unicodedata.normalize("NFKC", text).replace("Âμ", "u").replace("µ", "u").replace("μ", "u").strip()


def spelt(text: str) -> str | None:
    """Return the unit that a text spells (`µm`, `Volts`, `кВ`); None if it spells none."""
    bare = plain(text).strip("()[]{}<>").strip().removesuffix(".")
    if bare in ("Nm", "mNm"):  # nm is a length
        return bare[:-1] + " m"
    # the exact symbol first, because mV is not MV, and Pa not PA
    return bare if bare in _KIND else _SPELLINGS.get(bare.lower())


def kind_of(unit: str | None) -> str | None:
    """Return the kind of a unit: `time`, `voltage`, ...; an unlisted unit is its own kind, no unit has none."""
    return _KIND.get(unit, unit) if unit is not None else None


def units_of_kind(unit: str) -> tuple[str, ...]:
    """Return the units of the same kind as `unit`, with `unit` first."""
    return (unit, *(other for other in _KINDS.get(_KIND.get(unit, ""), {}) if other != unit))


def column_name(quantity: str, unit: str) -> str:
    """Return the header of a column that pitp writes: `voltage_V`, `input_rad`, `displacement_m`, `output_deg`.

    Args:
        quantity: `voltage` (the input) or `displacement` (the output).
        unit: of its values.
    """
    usual, other = {"voltage": ("voltage", "input"), "displacement": ("length", "output")}[quantity]
    volts = quantity == "displacement" and kind_of(unit) == "voltage"  # an electronic output keeps its old name
    return f"{quantity if kind_of(unit) == usual or volts else other}_{unit.replace(' ', '')}"


def column_names(quantity: str) -> tuple[str, ...]:
    """Return the exact headers by which a quantity is recognised at once.

    Args:
        quantity: `time`, `voltage` or `displacement`.
    """
    if quantity == "time":
        return tuple(f"time_{unit}" for unit in TIME_UNITS)
    other = {"voltage": "input", "displacement": "output"}[quantity]
    return tuple(f"{stem}_{unit.replace(' ', '')}" for stem in (quantity, other) for unit in INPUT_UNITS)


def units_of(quantity: str) -> tuple[str, ...]:
    """Return the units that a column of a quantity may have.

    Args:
        quantity: `time`, `voltage` or `displacement`.
    """
    return tuple(TIME_UNITS if quantity == "time" else INPUT_UNITS)


def to_base(values, unit: str):
    """Convert values to the base unit; decimal fractions divide by a whole number, so that decimal times stay exact.

    Args:
        values: array in `unit`, any shape.
        unit: one of the table.
    """
    scale = _factor(unit)
    return values / round(1.0 / scale) if _parts(scale) else values * scale


def from_base(values, unit: str):
    """Convert values from the base unit to `unit`; the inverse of `to_base`.

    Args:
        values: array in the base unit, any shape.
        unit: one of the table.
    """
    scale = _factor(unit)
    return values * round(1.0 / scale) if _parts(scale) else values / scale


def _factor(unit: str) -> float:
    return TIME_UNITS[unit] if unit in TIME_UNITS else INPUT_UNITS[unit]


def _parts(scale: float) -> bool:
    """Return whether the base unit is a whole multiple of this unit (1000 mm are 1 m)."""
    return scale < 1 and abs(round(1 / scale) * scale - 1) < 1e-12


def base_unit(unit: str) -> str:
    """Return the base unit for a unit: `m` for lengths, `V` for voltages, `rad` for angles."""
    return next(iter(_KINDS.get(_KIND.get(unit, ""), {unit: 1.0})))

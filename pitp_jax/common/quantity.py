"""Define the units of a model in one place: words and factors for every command, page, file and export.

    input    V of a voltage, otherwise the unit of the model's records
    output   the unit of the model's records
    si       the output again, m of a length: coefficients and exported code
    force    input^2 behind a square, otherwise the input

Arrays within the package stay in base units (V, m, rad, A, ...): base value = factor * shown value.
"""

import re
from dataclasses import dataclass

from .units import from_base, kind_of, to_base


@dataclass(frozen=True)
class Quantity:
    """A physical quantity and the unit in which it is shown."""

    unit: str

    @property
    def factor(self) -> float:
        """Return the value of one shown unit in base units."""
        return float(to_base(1.0, self.unit))

    @property
    def rate(self) -> str:
        """Return the unit of the quantity's change per second."""
        return per_second(self.unit)

    def shown(self, base):
        """Convert values from the base unit to this unit; any shape."""
        return from_base(base, self.unit)

    def base(self, shown):
        """Convert values from this unit to the base unit; any shape."""
        return to_base(shown, self.unit)

    def text(self, base: float, digits: int = 4) -> str:
        """Write a value given in base units with the shown unit: `18.41 mm`."""
        return f"{float(self.shown(base)):.{digits}g} {self.unit}"

    def rate_text(self, base: float, digits: int = 4) -> str:
        """Write a rate given in base units per second: `2e+04 V/s`."""
        return f"{float(self.shown(base)):.{digits}g} {self.rate}"

    def range_text(self, low: float, high: float, digits: int = 4) -> str:
        """Write a range given in base units: `0 to 2500 V`."""
        return f"{float(self.shown(low)):.{digits}g} to {self.text(high, digits)}"


@dataclass(frozen=True)
class Units:
    """The units of a model's input and output, and units derived from them.

    Attributes:
        records_input, output: the units of the model's records.
        squared: the force is the square of the input.
    """

    records_input: Quantity = Quantity("V")
    output: Quantity = Quantity("m")
    squared: bool = True

    @property
    def input(self) -> Quantity:
        """Return the unit in which the input is shown: V for a voltage, otherwise the records' unit."""
        return Quantity("V") if kind_of(self.records_input.unit) == "voltage" else self.records_input

    @property
    def si(self) -> Quantity:
        """Return the output's unit in coefficients and exported code: m for a length, otherwise the records' unit."""
        return Quantity("m") if self.is_length else self.output

    @property
    def limit(self) -> Quantity:
        """Return the unit of output limits that are given without one: mm for a length, otherwise the records' unit."""
        return Quantity("mm") if self.is_length else self.output

    @property
    def is_length(self) -> bool:
        """Return whether the output is a length."""
        return kind_of(self.output.unit) == "length"

    @property
    def input_word(self) -> str:
        """Return the word for the input: `voltage`, otherwise `input`."""
        return "voltage" if self.input.unit == "V" else "input"

    @property
    def output_word(self) -> str:
        """Return the word for the output: `displacement` for a length, otherwise `output`."""
        return "displacement" if self.is_length else "output"

    @property
    def velocity_word(self) -> str:
        """Return the word for the output's rate: `velocity` for a length, otherwise `rate of the output`."""
        return "velocity" if self.is_length else "rate of the output"

    @property
    def max_input(self) -> str:
        """Return the command-line option that limits the input."""
        return f"--max-{self.input_word}"

    @property
    def max_rate(self) -> str:
        """Return the command-line option that limits the input's rate."""
        return "--max-slew" if self.input_word == "voltage" else "--max-input-rate"

    @property
    def max_output(self) -> str:
        """Return the command-line option that limits the output."""
        return f"--max-{self.output_word}"

    @property
    def force(self) -> str:
        """Return the unit of the input in the equation: input unit squared, or the input unit if the map is linear."""
        return f"{grouped(self.input.unit)}^2" if self.squared else self.input.unit

    @property
    def force_factor(self) -> float:
        """Return the value in base units (V^2, or V for a linear input) of one shown unit of the equation's input."""
        return self.input.factor ** (2 if self.squared else 1)

    def coefficient(self, i: int) -> tuple[float, str]:
        """Return the factor from base units to the shown unit of a_i in sum a_i x^(i) = F, and that unit."""
        seconds = ("", " s", f" s^{i}")[min(i, 2)]
        return self.si.factor / self.force_factor, f"{self.force}{seconds}/{grouped(self.si.unit)}"

    def parameter(self, template: str, force: float) -> tuple[float, str]:
        """Return the factor from base units to the shown unit of an effect's parameter, and that unit.

        Args:
            template: its unit, where V stands for the input and x for the output.
            force: power of the force in it, written V^2 in the template.
        """
        powers = _powers(template)
        by_force = self.force_factor ** (-force)
        by_input = self.input.factor ** (-(powers["V"] - 2 * force))
        unit = template
        if force and not self.squared:
            unit = unit.replace("V^2", "V")
        alone = unit in ("V", "x")
        for letter, shown in (("V", self.input.unit), ("x", self.si.unit)):
            unit = re.sub(rf"(?<![A-Za-z]){letter}(?![A-Za-z])", shown if alone else grouped(shown), unit)
        if template == "x/s":
            unit = self.si.rate
        return by_force * by_input * self.si.factor ** (-powers["x"]), unit


def _powers(unit: str) -> dict[str, float]:
    """Return the powers of the input V and the output x in a unit such as `V^2 s/x`."""
    powers = {"V": 0.0, "x": 0.0}
    for sign, part in zip((1, -1), unit.split("/", 1), strict=False):
        for name, power in re.findall(r"([A-Za-z]+)(?:\^(\(1/2\)|\d+))?", part):
            if name in powers:
                powers[name] += sign * (0.5 if power == "(1/2)" else float(power or 1))
    return powers


def grouped(unit: str) -> str:
    """Put a unit of several parts in brackets, for a denominator or a power."""
    return f"({unit})" if re.search(r"[ /]", unit) else unit


def per_second(unit: str, times: int = 1) -> str:
    """Return the unit of a quantity's time derivative: `V/s`; `deg/s^2` for a speed in deg/s."""
    if times == 0:
        return unit
    top, stroke, bottom = unit.partition("/")
    power = re.fullmatch(r"s\^?(\d*)", bottom)
    if stroke and power:
        unit, times = top, times + int(power[1] or 1)
    return f"{unit}/s{f'^{times}' if times > 1 else ''}"

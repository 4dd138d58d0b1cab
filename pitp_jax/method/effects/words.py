"""Write effects and their parameters in words and in units that are easy to read.

a limit is stored as its inverse, so that zero means no limit, and is shown as the limit itself
"""

import re
from collections.abc import Sequence

import numpy as np

from ...common.numbers import figure, shown_unit, with_error, with_interval
from ...common.quantity import Units, per_second
from ...common.units import base_unit, from_base
from . import CATALOGUE

PLAIN = {
    "parameter_change": "the model's own coefficients have changed",
    "steady_tone": "every recording contains an oscillation that no input contains (mains, a fan)",
} | {
    spec.name: spec.title[0].lower() + spec.title[1:].rstrip(".") for spec in reversed(CATALOGUE)
}  # reversed, so that a name's first form defines it
_FACTOR = " over given"  # of a parameter of the nominal that was refitted


def coefficient_meaning(i: int) -> str:
    """Return the name of coefficient a_i by its meaning: `stiffness (a0)`, `damping (a1)`, `inertia (a2)`, `a3`, ..."""
    return {0: "stiffness (a0)", 1: "damping (a1)", 2: "inertia (a2)"}.get(i, f"a{i}")


def plain_words(name: str, units: Units) -> str:
    """Return the meaning of an effect in a few plain words."""
    words = PLAIN.get(name, "")
    for word, own in (("voltage", units.input_word), ("displacement", units.output_word)):
        if own != word:  # input and output take another article
            words = re.sub(rf"\ba {word}", f"an {own}", words).replace(word, own)
    return words


def parameter(name: str, number: dict, length_unit: str) -> tuple[str, str]:
    """Return label and text of one parameter in a readable unit, such as `tau` and `12.3 ms (11.9 to 12.8)`.

    Args:
        name: of the parameter.
        number: its value and unit, and its `ci95` (None: not determined; upper end None: a lower bound) or `stderr`.
        length_unit: the displacement's unit, of the user's files.
    """
    value, times = number["value"], "× " if name.endswith(_FACTOR) else ""
    if "ci95" not in number:
        label, unit, (handy,) = _in_handy_units(name, number["unit"], (value,), length_unit)
        # relative errors of a limit and of its inverse are the same
        error = number["stderr"] * abs(handy / value) if number["stderr"] is not None and value else None
        return label, f"{times}{with_error(handy, error, unit)}"
    low, high = number["ci95"] or (value, value)
    values = (low,) if high is None else (value, low, high)
    label, unit, handy = _in_handy_units(name, number["unit"], values, length_unit)
    if high is None:
        return label, f"at least {figure(handy[0], 2)} {unit}"
    if number["ci95"] is None:
        return label, f"{times}{figure(handy[0], 2)} {unit}".rstrip() + " (these recordings do not determine it)"
    return label, f"{times}{with_interval(handy[0], min(handy), max(handy), unit)}"


def _in_handy_units(name: str, unit: str, values: Sequence[float], length_unit: str):
    """Return label, displayed unit and values of one parameter in a unit that is easy to read."""
    if name.endswith(_FACTOR):
        stem = name.removesuffix(_FACTOR)
        label = coefficient_meaning(int(stem[2:])) if stem in ("a_0", "a_1", "a_2") else stem
        return label, "", tuple(values)
    if name == "omega":  # of a mode: independent of an angle's unit
        return "frequency", "Hz", tuple(v / (2 * np.pi) for v in values)
    # a parameter stored as the inverse of the value shown here
    if name in ("inverse", "curvature") and all(values) and "/" in unit:
        top, _, bottom = unit.partition("/")
        bottom = re.sub(r"^\((.*)\)$", r"\1", bottom)  # of a unit such as 1/(deg/s)
        inside = per_second(bottom, {"1": 0, "s": 1, "s^2": 2}[top])
        factor, shown = _handy(1 / values[0], inside, length_unit)
        return "limit", shown_unit(shown), tuple(factor / v for v in values)
    factor, shown = _handy(values[0], unit, length_unit)
    return name, "" if shown == "1" else shown_unit(shown), tuple(factor * v for v in values)


def _handy(value: float, unit: str, length_unit: str) -> tuple[float, str]:
    """Return the factor to a unit in which a value is easy to read, and the name of that unit."""
    if unit == "s":
        return next(p for p in ((1.0, "s"), (1e3, "ms"), (1e6, "µs")) if abs(value) * p[0] >= 0.1 or p[0] > 1e3)
    base, slash, per = unit.partition("/")
    if base == base_unit(length_unit) and base != "V":
        return from_base(1.0, length_unit), f"{shown_unit(length_unit)}{slash}{per}"
    return 1.0, unit

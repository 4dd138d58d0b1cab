"""Words and numbers of a report: effects in plain language, parameters, and where a gap is concentrated.

a limit is fitted as its inverse, so that zero means no limit, and is shown as the limit itself
"""

import re
from collections.abc import Sequence

import numpy as np

from ....common.numbers import figure, percent, shown_unit, with_error, with_interval
from ....common.quantity import Units, per_second
from ....common.units import INPUT_UNITS, OUTPUT_UNITS, base_unit
from ....method.effects import CATALOGUE
from ....method.effects.spec import EffectSpec

PLAIN = {"parameter_change": "the model's own coefficients have changed"} | {
    spec.name: spec.title[0].lower() + spec.title[1:].rstrip(".") for spec in reversed(CATALOGUE)
}  # reversed, so that a name's first form defines it
_LIMITS = {"inverse": "limit", "curvature": "limit"}  # parameters stored as the inverse of the value shown here
_COEFFICIENTS = ("stiffness", "damping", "inertia")
_FACTOR = " over given"  # of a parameter of the nominal that was refitted
_GATHERED, _OVER = 0.6, 2.0  # a fraction that counts as concentrated, and its least ratio to the time spent there


def plain_words(name: str, units: Units) -> str:
    """Return the meaning of an effect in a few plain words."""
    words = PLAIN.get(name) or next((equation(c) for c in CATALOGUE if c.name == name), "")
    for word, own in (("voltage", units.input_word), ("displacement", units.output_word)):
        if own != word:  # input and output take another article
            words = re.sub(rf"\ba {word}", f"an {own}", words).replace(word, own)
    return words


def equation(form: EffectSpec) -> str:
    """Return the law of an effect's form in symbols."""
    return form.equation


def named(names: Sequence[str]) -> str:
    """Join names in a sentence: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def parameter(name: str, number: dict, length_unit: str) -> tuple[str, str]:
    """Return label and text of one parameter in a readable unit; an inverse is shown as the limit itself.

    Args:
        name: of the parameter.
        number: its value, unit and stderr.
        length_unit: the displacement's unit, of the user's files.
    """
    value, error = number["value"], number["stderr"]
    label, unit, values = _in_handy_units(name, number["unit"], (value,), length_unit)
    if error is not None:
        # relative errors of a limit and of its inverse are the same
        error = error * abs(values[0] / value) if value else None
    return label, f"{_cross(name)}{with_error(values[0], error, unit)}"


def parameter_between(name: str, number: dict, length_unit: str) -> tuple[str, str]:
    """Return name and text of a parameter with its 95 % interval, such as `3.1 kV (2.9 to 3.4)`.

    Args:
        name: of the parameter.
        number: its value, unit and ci95, whose upper end is None for a lower bound.
        length_unit: the displacement's unit, of the user's files.
    """
    if number["ci95"] is None:
        label, unit, (value,) = _in_handy_units(name, number["unit"], (number["value"],), length_unit)
        return label, f"{_cross(name)}{figure(value, 2)} {unit}".rstrip() + " (these recordings do not determine it)"
    low, high = number["ci95"]
    if high is None:
        label, unit, (value,) = _in_handy_units(name, number["unit"], (low,), length_unit)
        return label, f"at least {figure(value, 2)} {unit}"
    label, unit, values = _in_handy_units(name, number["unit"], (number["value"], low, high), length_unit)
    return label, f"{_cross(name)}{with_interval(values[0], min(values), max(values), unit)}"


def _cross(name: str) -> str:
    return "× " if name.endswith(_FACTOR) else ""


def _in_handy_units(
    name: str, unit: str, values: Sequence[float], length_unit: str
) -> tuple[str, str, tuple[float, ...]]:
    """Return label, displayed unit and values of one parameter in a unit that is easy to read."""
    if name.endswith(_FACTOR):
        stem = name.removesuffix(_FACTOR)
        label = f"{_COEFFICIENTS[int(stem[2:])]} ({stem.replace('_', '')})" if stem in ("a_0", "a_1", "a_2") else stem
        return label, "", tuple(values)
    if name == "omega":  # of a mode: independent of an angle's unit
        return "frequency", "Hz", tuple(v / (2 * np.pi) for v in values)
    if name in _LIMITS and all(values) and "/" in unit:
        top, _, bottom = unit.partition("/")
        bottom = re.sub(r"^\((.*)\)$", r"\1", bottom)  # of a unit such as 1/(deg/s)
        inside = per_second(bottom, {"1": 0, "s": 1, "s^2": 2}[top])
        factor, shown = _handy(1 / values[0], inside, length_unit)
        return _LIMITS[name], shown_unit(shown), tuple(factor / v for v in values)
    factor, shown = _handy(values[0], unit, length_unit)
    return name, "" if shown == "1" else shown_unit(shown), tuple(factor * v for v in values)


def _handy(value: float, unit: str, length_unit: str) -> tuple[float, str]:
    """Return the factor to a unit in which a value is easy to read, and the name of that unit."""
    if unit == "s":
        factor, unit = next(p for p in ((1.0, "s"), (1e3, "ms"), (1e6, "µs")) if abs(value) * p[0] >= 0.1 or p[0] > 1e3)
        return factor, unit
    base, slash, per = unit.partition("/")
    if base == base_unit(length_unit) and base != "V":
        return 1 / OUTPUT_UNITS[length_unit], f"{shown_unit(length_unit)}{slash}{per}"
    return 1.0, unit


def coefficient_name(i: int, order: int) -> str:
    """Return a coefficient's displayed name, such as `a0 (stiffness)` at order 2, otherwise `a0`."""
    return f"a{i} ({_COEFFICIENTS[i]})" if order == 2 else f"a{i}"


def gathers(where: dict, spent: dict[str, np.ndarray], units: Units) -> list[str]:
    """Describe where most of the gap lies within a rarely visited part of an axis, the clearest case first.

    Args:
        where: as `Diagnosis.where`.
        spent: fraction of time in every bin of an axis.
        units: of the model.
    """
    scale, shown = 1 / units.output.factor, shown_unit(units.output.unit)
    per_input, input_shown = drive_unit(units.input.unit)
    facts = []
    for axis, text, factor, key in (
        ("displacement", f"of the missing force acts at {units.output_word}s of {{}} to {{}} {shown}", scale, "range"),
        ("voltage", f"of the missing force acts at {{}} to {{}} {input_shown}", per_input, "range"),
        ("time", "of the error occurs between {} and {} % of a recording's length", 100.0, "part"),
    ):
        shares = [row["share"] for row in where[axis]]
        run = _narrowest(shares)
        if run:
            share, there = sum(shares[slice(*run)]), float(spent[axis][slice(*run)].sum())
            low, high = where[axis][run[0]][key][0], where[axis][run[1] - 1][key][1]
            words = text.format(figure(factor * low, 2), figure(factor * high, 2))
            rest = "" if axis == "time" else f", where {percent(there)} of the time is spent"
            if share >= _OVER * there:
                facts.append((there / share, f"{percent(share)} {words}{rest}."))
    return [text for _, text in sorted(facts)]


def drive_unit(unit: str) -> tuple[float, str]:
    """Return the factor from the input's base unit to the displayed unit (V for a voltage), and its name."""
    shown = "V" if base_unit(unit) == "V" else unit
    return 1 / INPUT_UNITS[shown], shown_unit(shown)


def _narrowest(shares: Sequence[float]) -> tuple[int, int] | None:
    """Return (first, last) of the shortest run of neighbouring bins that holds most of the gap."""
    runs = [
        (last - first, -sum(shares[first:last]), first, last)
        for first in range(len(shares))
        for last in range(first + 1, len(shares) + 1)
        if sum(shares[first:last]) >= _GATHERED
    ]
    return min(runs)[2:] if runs else None

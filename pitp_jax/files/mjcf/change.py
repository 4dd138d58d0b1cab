"""Describe changes of a MuJoCo file, and parameters that the file cannot hold."""

import math
from dataclasses import dataclass

from ...common.numbers import number


@dataclass(frozen=True)
class Change:
    """One attribute of a MuJoCo file with its old and new value.

    Attributes:
        element: `joint`, `actuator`, or `body` for one that is inserted.
        attribute: its name.
        old, new: values as the file spells them; old empty where the file's own element has none.
        text: the comment: from, to, interval, unit.
    """

    element: str
    attribute: str
    old: str
    new: str
    text: str


def interval(value: float, error: float | None, least: float = -math.inf) -> str:
    """Write a 95 % interval in parentheses, of which `least` is the lowest possible end; empty without an error."""
    if error is None:
        return ""
    return f" ({number(max(value - 1.96 * error, least))} to {number(value + 1.96 * error)})"


@dataclass(frozen=True)
class NotWritten:
    """A parameter that a MuJoCo file cannot hold: name, value, and the nearest substitute."""

    words: str
    value: str
    way: str

"""The coordinate of every displacement y in commands, pages and exports: 0 m at 0 V.

    y = s x,    s = 1 behind a square (y grows as the actuator extends), the sensor's direction behind a linear input
    reading = direction x + offset

x is the model's own displacement (m), `reading` is the sensor's. `predict` compares with recordings and therefore keeps
the sensor's readings.
"""

from typing import Any, Literal, TypeVar

import numpy as np
from jaxtyping import Array

from .model import Model

Values = TypeVar("Values", Array, np.ndarray, float)
Zero = (
    Literal["rest", "sensor"] | float
)  # where a displacement is 0: at 0 V, where the sensor reads 0, or its value there


def sign(model: Model) -> Any:
    """Return s = +1 or -1, by which the model's displacement x is multiplied to obtain the coordinate y."""
    return 1.0 if model.input_map.one_sided else model.output.polarity


def direction(model: Model) -> float:
    """Return +1 if the sensor's reading increases with the coordinate, -1 for a reversed sensor."""
    return model.output.polarity if model.input_map.one_sided else 1.0


def from_model(model: Model, x: Values, zero: Zero = "rest") -> Values:
    """Convert the model's displacement x (m) to the coordinate y (m), or to a displacement with another origin."""
    if zero == "sensor":
        return model.output.to_rig(x)
    return sign(model) * x + _at_rest(zero)


def to_model(model: Model, y: Values, zero: Zero = "rest") -> Values:
    """Convert a displacement (m) in the coordinate y, or with another origin, to the model's displacement x (m)."""
    if zero == "sensor":
        return model.output.to_model(y)
    return sign(model) * (y - _at_rest(zero))


def _at_rest(zero: Literal["rest"] | float) -> float:
    """Return the displacement at 0 V."""
    return 0.0 if zero == "rest" else zero

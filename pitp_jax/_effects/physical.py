"""Convert an effect's numbers to physical units, and to a model of other scales.

physical = stored * s_0^length s_1^speed s_2^acceleration f^force        s, f: the model's scales of state and force
"""

from collections.abc import Iterable

from .._model.fitted import Fitted, fitted_of
from .._model.model import Model
from .._table.units import base_unit
from .effect import Effect
from .spec import Parameter


def physical_factor(p: Parameter, state: Iterable[float], force: float) -> float:
    """Compute what takes a stored value to physical units, `state` and `force` being a model's scales."""
    s = (*state, 1.0, 1.0)  # a nominal of order 1 has no scale of x''
    return float(s[0] ** p.length * s[1] ** p.speed * s[2] ** p.acceleration * force**p.force)


def in_scales(effect: Effect, old: tuple, new: tuple) -> Effect:
    """Express the same effect in a model of other scales (state, force)."""
    return effect.times([physical_factor(p, *old) / physical_factor(p, *new) for p, _ in effect.numbers()])


def physical(model: Model | Fitted, p: Parameter, value: float) -> tuple[float, str]:
    """Convert a number stored in an effect to physical units."""
    origin = fitted_of(model).origin  # m and V where there is none
    unit = p.unit.replace("x", base_unit(origin.displacement_unit))
    if p.force:  # behind a linear input map the force is a voltage
        unit = unit.replace("V^2", model.input_map.unit)
    drive = base_unit(origin.voltage_unit)  # a robot's command is no voltage
    unit = unit.replace("V", drive) if drive != "V" else unit
    return value * physical_factor(p, model.scales.state, model.scales.force), unit

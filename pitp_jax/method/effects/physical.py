"""Convert the parameters of an effect to physical units, and to a model with other scales.

base value = stored * s_0^length s_1^speed s_2^acceleration f^force        s, f: the model's scales of state and force
"""

from collections.abc import Iterable

from ...common.quantity import Units
from ..model.fitted import Fitted
from ..model.model import Model
from ..model.units import units_of
from .effect import Effect
from .spec import Parameter


def physical_factor(p: Parameter, state: Iterable[float], force: float) -> float:
    """Return the factor from a stored parameter to physical units; `state`, `force`: the model's scales."""
    s = (*state, 1.0, 1.0)  # a nominal of order 1 has no scale of x''
    return float(s[0] ** p.length * s[1] ** p.speed * s[2] ** p.acceleration * force**p.force)


def in_scales(effect: Effect, old: tuple, new: tuple) -> Effect:
    """Convert an effect's parameters to a model with other scales (state, force)."""
    return effect.times([physical_factor(p, *old) / physical_factor(p, *new) for p, _ in effect.numbers()])


def physical(model: Model | Fitted, p: Parameter, value: float, units: Units | None = None) -> tuple[float, str]:
    """Convert a stored parameter of an effect to its model's units (`units_of`), or to other given units."""
    factor, unit = (units_of(model) if units is None else units).parameter(p.unit, p.force)
    return value * physical_factor(p, model.scales.state, model.scales.force) * factor, unit

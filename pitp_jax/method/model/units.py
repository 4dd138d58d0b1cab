"""Read the units of a model from its origin."""

from ...common.quantity import Quantity, Units
from ...common.units import base_unit
from .fitted import Fitted, fitted_of
from .model import Model


def units_of(given: Model | Fitted) -> Units:
    """Return the units of a model's input and displacement from its origin; V and m if unknown."""
    fitted = fitted_of(given)
    origin = fitted.origin
    return Units(Quantity(origin.voltage_unit), Quantity(origin.displacement_unit), fitted.model.input_map.one_sided)


def base_units(units: Units) -> Units:
    """Return the base units (such as V and m) of a model's input and displacement."""
    return Units(Quantity(base_unit(units.records_input.unit)), Quantity(base_unit(units.output.unit)), units.squared)

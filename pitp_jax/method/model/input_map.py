"""Input maps: convert the voltage u to the force F in input units (V^2, or V for a linear input), and back.

square:  F = u^2                 u = sqrt(max(F, 0))        (paper, eqs. 6 and 13)
linear:  F = u                   u = F                      (electronic benchmarks, piezo)
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...common.units import kind_of
from ..signal.record import Record

Values = TypeVar("Values", Array, np.ndarray)  # of any shape, traced or in float64 on the host


class AbstractInputMap(eqx.Module):
    """A memoryless, invertible map from a voltage to a force in input units, for arrays of any shape.

    Attributes:
        name: in files and options.
        unit: of the force.
        one_sided: whether it cannot produce a negative force.
    """

    name: ClassVar[str]
    unit: ClassVar[str]
    one_sided: ClassVar[bool]

    @abstractmethod
    def force(self, voltage: Values) -> Values:
        """Convert a voltage (V) to the force in input units (V^2, or V for a linear input)."""

    @abstractmethod
    def voltage(self, force: Float[Array, "..."]) -> Float[Array, "..."]:
        """Convert a force in input units to a voltage (V): non-negative behind a square, signed for a linear input."""

    @abstractmethod
    def infeasible(self, force: Float[Array, "..."]) -> Bool[Array, "..."]:
        """Return True where no voltage gives this force."""


class SquareInput(AbstractInputMap):
    """Maxwell stress: F = u^2 (eq. 6); a negative force is infeasible, because no voltage gives it."""

    name, unit, one_sided = "square", "V^2", True

    def force(self, voltage):
        """Compute the force F = u^2, in input units (V^2)."""
        return voltage * voltage

    def voltage(self, force):
        """Compute the voltage u = sqrt(max(F, 0)) (V) of a force (V^2), with a zero derivative (not nan) at F <= 0."""
        positive = force > 0  # used twice: the untaken branch of a `where` is differentiated too, and 0 * inf is nan
        return jnp.where(positive, jnp.sqrt(jnp.where(positive, force, 1.0)), 0.0)

    def infeasible(self, force):
        """Return True where F < 0, because the square of a voltage is never negative."""
        return force < 0


class LinearInput(AbstractInputMap):
    """F = u, for actuators whose input is not squared."""

    name, unit, one_sided = "linear", "V", False

    def force(self, voltage):
        """Return the force F = u, in input units (V)."""
        return voltage

    def voltage(self, force):
        """Return the voltage u = F (V), of either sign."""
        return force

    def infeasible(self, force):
        """Return False everywhere, because every force has a voltage."""
        return jnp.zeros(jnp.shape(force), bool)


INPUT_MAPS = {kind.name: kind for kind in (SquareInput, LinearInput)}


def forces_of(records: Sequence[Record], input_map: str) -> list[np.ndarray]:
    """Return the force of every record in input units (V^2 or V), shapes (T_r,)."""
    return [INPUT_MAPS[input_map]().force(r.voltage) for r in records]


def usual_input_map(record: Record) -> str:
    """Return the name of the input map that units suggest: square for a voltage with a length, otherwise linear."""
    kinds = kind_of(record.voltage_unit), kind_of(record.displacement_unit)
    return SquareInput.name if kinds == ("voltage", "length") else LinearInput.name

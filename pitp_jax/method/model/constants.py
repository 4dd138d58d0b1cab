"""Constants of a model that training does not change: scales, sampling interval, limits, sensor offset.

They are Python floats, so `eqx.is_inexact_array` skips them: the inexact arrays of a model are its parameters.
`jax.jit` traces them, Equinox's jit keeps them as constants, and the package's own programs take them as arguments
(`programs.jit`), so that models of any scale share one program.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

T = TypeVar("T")


class Constants(eqx.Module):
    """A part of a model that holds only constants: floats, or tuples of floats."""


def number(value) -> Any:
    """Convert a number to a float; a value that JAX traces stays unchanged."""
    return value if isinstance(value, Tracer) else float(value)


def numbers(values) -> tuple:
    """Convert an array of any shape to nested tuples of floats; traced values stay unchanged."""
    return tuple(numbers(v) if np.ndim(v) else number(v) for v in values)


class ConstantArray(Constants):
    """An array of constants, stored in model files as float32.

    Attributes:
        values: nested tuples of floats.
    """

    values: tuple = eqx.field(converter=numbers)

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the shape of the array."""
        return np.shape(self.values)

    def array(self, dtype) -> Float[Array, "..."]:
        """Return the constants as a JAX array of this precision."""
        return jnp.asarray(self.values, dtype)

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        """Convert the constants to a NumPy array on the host."""
        return np.asarray(self.values, dtype)


def constant_array(values) -> ConstantArray:
    """Convert an array to a `ConstantArray`, rounded to float32 as in model files."""
    if isinstance(values, ConstantArray):
        return values
    return ConstantArray(values if isinstance(values, Tracer) else np.asarray(values, np.float32))


def map_parameters(function: Callable[[Array], Any], tree: T) -> T:
    """Apply a function to the parameters of a pytree, its inexact arrays; other leaves stay."""
    return jax.tree.map(lambda a: function(a) if eqx.is_inexact_array(a) else a, tree)


def as_arguments(tree):
    """Convert the constants in a pytree to NumPy float64, so that a compiled program takes them as arguments."""
    return jax.tree.map(_as_arrays, tree, is_leaf=_is_constant)


def _is_constant(part) -> bool:
    return isinstance(part, Constants)


def _as_arrays(part):
    if not _is_constant(part):
        return part
    # the structure stays, so that a part from `eqx.partition` still fits its other half
    return jax.tree.map(lambda v: np.float64(v) if type(v) is float else v, part)

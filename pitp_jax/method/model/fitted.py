"""A fitted model: the model, a pure pytree, and its origin, which no compiled program contains.

    Fitted(model, origin)       gives:  load, identify, train, adapt, diagnose
                                takes:  every public function, and a bare Model as well

A program's key holds the static fields of its arguments. Static texts about its origin would give every model a new
program. So under a transformation (jit, vmap, tree.map, tree_at) a `Fitted` acts as its model, and `origin` is empty
afterwards.
"""

from abc import ABCMeta
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import numpy as np

from ...common.errors import BadInput
from .model import Model
from .origin import Origin


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Fitted:
    """A model and its origin. It has the attributes of the model (`fitted.order`), and its fields can be replaced.

    Attributes:
        model: the pure pytree.
        origin: its records and lineage; empty after a JAX transformation.

    Examples:
        >>> pitp.save(folder / "model.pitp", model)
        >>> fitted = pitp.load(folder / "model.pitp")
        >>> fitted.order, fitted.origin.displacement_unit
        (2, 'm')
        >>> isinstance(fitted, pitp.Model)
        True
    """

    model: Model
    origin: Origin = field(default_factory=Origin)

    def __init__(self, model: Model, origin: Origin | None = None, **changes: Any):
        """Store model and origin; `changes` are fields of the model, as `dataclasses.replace` takes them."""
        # A frozen dataclass with its own initialiser sets its fields in this way.
        object.__setattr__(self, "model", replace(model, **changes) if changes else model)
        object.__setattr__(self, "origin", origin or Origin())

    def __getattr__(self, name: str) -> Any:
        if name == "model" or name.startswith("__"):  # not set yet, or asked for by Python itself
            raise AttributeError(name)
        return getattr(self.model, name)

    def __repr__(self) -> str:
        return repr(self.model)

    def changed(self, factors: np.ndarray) -> "Fitted":
        """Return the model with its nominal coefficients multiplied by these factors, shape (n + 1,)."""
        origin = self.origin if np.all(np.asarray(factors) == 1) else self.origin.of_other_coefficients()
        return Fitted(self.model.changed(factors), origin)


# A Fitted must pass isinstance(..., pitp.Model). Equinox forbids `Model.register` to exclude classes that do not derive
# from a module; a Fitted forwards every attribute to its model.
ABCMeta.register(Model, Fitted)
# `register_dataclass(drop_fields=...)` would be equivalent, but JAX up to 0.9.0 misinterprets a string there.
jax.tree_util.register_pytree_with_keys(
    Fitted, lambda pair: (((jax.tree_util.GetAttrKey("model"), pair.model),), None), lambda _, parts: Fitted(*parts)
)


def model_of(given: object) -> Model:
    """Return the bare model of a `Fitted` or of a result that holds one; a bare model is returned unchanged.

    Raises:
        BadInput: the argument is not a model; the message names its type and the accepted types.
    """
    if isinstance(given, Model) and not isinstance(given, Fitted):
        return given
    return fitted_of(given).model


def fitted_of(given: object) -> Fitted:
    """Return the model with its origin, which is empty for a bare model.

    A result that holds a model (of `identify`, `train`, `adapt` or `diagnose`) counts as this model.

    Raises:
        BadInput: as `model_of`.
    """
    held = given if isinstance(given, Model | Fitted) else getattr(given, "model", None)
    if isinstance(held, Fitted):
        return held
    if isinstance(held, Model):
        return Fitted(held)
    raise BadInput(f"a {type(given).__name__} is not a model; give pitp.load(FILE) or identify(...).model")

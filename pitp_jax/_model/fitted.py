"""A fitted model: the model, a pure pytree, beside what it was made from, which no program sees.

    Fitted(model, origin)       gives:  load, identify, train, adapt, diagnose
                                takes:  every public function, and a bare Model as well

A program's key holds the static fields of its arguments. Texts and records of how a model came about would make a new
program of every model, so under a transformation (jit, vmap, tree.map, tree_at) a `Fitted` is its model: `origin` comes
back empty.
"""

from abc import ABCMeta
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import numpy as np

from .._errors import BadInput
from .model import Model
from .origin import Origin


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Fitted:
    """A model and its origin; it reads as the model (`fitted.order`), and its fields are replaced as the model's are.

    Attributes:
        model: the pure pytree.
        origin: what it was made from; empty once JAX has transformed the pair.

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
        """Put them side by side; `changes` (fields of the model) are what `dataclasses.replace` brings."""
        # frozen, as every dataclass here: this is how a frozen one with an initialiser of its own sets its fields
        object.__setattr__(self, "model", replace(model, **changes) if changes else model)
        object.__setattr__(self, "origin", Origin() if origin is None else origin)

    def __getattr__(self, name: str) -> Any:
        if name == "model" or name.startswith("__"):  # not there yet, or asked for by Python itself
            raise AttributeError(name)
        return getattr(self.model, name)

    def __repr__(self) -> str:
        return repr(self.model)

    def changed(self, factors: np.ndarray) -> "Fitted":
        """Multiply the nominal coefficients by these factors, shape (n + 1,); the origin stays."""
        return Fitted(self.model.changed(factors), self.origin)


# isinstance(pitp.load(file), pitp.Model), as it always was; equinox forbids `Model.register`, which would be the same,
# so that no module passes for what it does not derive from: here all that is asked of a model is passed on to one
ABCMeta.register(Model, Fitted)
# `register_dataclass(drop_fields=...)` would say the same, but JAX up to 0.9.0 reads it letter by letter.
jax.tree_util.register_pytree_with_keys(
    Fitted, lambda pair: (((jax.tree_util.GetAttrKey("model"), pair.model),), None), lambda _, parts: Fitted(*parts)
)


def model_of(given: Model | Fitted) -> Model:
    """Take the model alone.

    Raises:
        BadInput: what was given is none; saying what it is, and what to give.
    """
    if isinstance(given, Fitted):
        return given.model
    if isinstance(given, Model):
        return given
    inside = isinstance(getattr(given, "model", None), Model)
    kind = type(given).__name__
    remedy = f"give its .model (the {kind} holds one)" if inside else "give pitp.load(FILE) or identify(...).model"
    raise BadInput(f"a {kind} is no model: {remedy}")


def fitted_of(given: Model | Fitted) -> Fitted:
    """Take the model with its origin, an empty one where it has none.

    Raises:
        BadInput: as `model_of`.
    """
    return given if isinstance(given, Fitted) else Fitted(model_of(given))

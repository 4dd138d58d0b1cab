"""A fitted model: the model, a pure pytree, beside what it was made from, which no program sees.

    Fitted(model, origin)       gives:  load, identify, train, adapt, diagnose
                                takes:  every public function, and a bare Model as well

A program's key holds the static fields of its arguments. Texts and records of how a model came about would make a new
program of every model, so under a transformation a `Fitted` is its model: `origin` comes back empty.
"""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from .._errors import BadInput
from .._record.long_record import LongRecord
from .model import Model


@dataclass(frozen=True, eq=False)
class Origin:
    """What a model was made from.

    Attributes:
        displacement_unit, voltage_unit: units the user's files had.
        covariance: of ln a_0 ... ln a_n as identified, shape (n + 1, n + 1); empty where not known, or no longer true.
        stderr: of a_0 ... a_n as identified; empty likewise.
        misfit: rms of what the nominal left of its records over their noise; infinite where not known.
        level: e_rms of free runs of its own records, % of their range; nan where not known.
        identified_on: names of the records the nominal was identified on.
        long_record: the longest of them, which training holds creep to.
        training: summary of the training, JSON values.
        adapted: one entry for every `adapt`: its records, and what changed.
        lineage: one entry for every step that made the model (`_model_file.lineage`), oldest first.
    """

    displacement_unit: str = "m"
    voltage_unit: str = "V"
    covariance: Float[np.ndarray, "tokens tokens"] = field(default_factory=lambda: np.zeros((0, 0)))
    stderr: tuple[float, ...] = ()
    misfit: float = float("inf")
    level: float = float("nan")
    identified_on: tuple[str, ...] = ()
    long_record: LongRecord | None = None
    training: dict[str, Any] | None = None
    adapted: tuple[dict[str, Any], ...] = ()
    lineage: tuple[dict[str, Any], ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Fitted:
    """A model and its origin; attributes of the model are read through it (`fitted.order`).

    Attributes:
        model: the pure pytree.
        origin: what it was made from; empty once JAX has transformed the pair.

    Examples:
        >>> pitp.save(folder / "model.pitp", model)
        >>> fitted = pitp.load(folder / "model.pitp")
        >>> fitted.order, fitted.origin.displacement_unit
        (2, 'm')
    """

    model: Model
    origin: Origin = field(default_factory=Origin)

    def __getattr__(self, name: str) -> Any:
        if name == "model" or name.startswith("__"):  # not there yet, or asked for by Python itself
            raise AttributeError(name)
        return getattr(self.model, name)

    def __repr__(self) -> str:
        return repr(self.model)

    def but(self, **changes) -> "Fitted":
        """The same origin beside the model with some fields replaced."""
        return replace(self, model=replace(self.model, **changes))

    @property
    def provenance(self) -> SimpleNamespace:
        """Domain and origin in one, as before 0.3; deprecated: read `domain` or `origin`."""
        shown = {name: np.asarray(value).tolist() for name, value in vars(self.model.domain).items()}
        return SimpleNamespace(**vars(self.origin), **shown)


jax.tree_util.register_dataclass(Fitted, data_fields=["model"], meta_fields=[], drop_fields=["origin"])


def model_of(given: Model | Fitted) -> Model:
    """The model alone.

    Raises:
        BadInput: what was given is none; saying what it is, and what to give.
    """
    if isinstance(given, Fitted):
        return given.model
    if isinstance(given, Model):
        return given
    inside = isinstance(getattr(given, "model", None), Model | Fitted)
    kind = type(given).__name__
    remedy = f"give its .model (the {kind} holds one)" if inside else "give pitp.load(FILE) or identify(...).model"
    raise BadInput(f"a {kind} is no model: {remedy}")


def fitted_of(given: Model | Fitted) -> Fitted:
    """The model with its origin, an empty one where it has none.

    Raises:
        BadInput: as `model_of`.
    """
    return given if isinstance(given, Fitted) else Fitted(model_of(given))

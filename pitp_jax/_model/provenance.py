"""Domain and origin of a model in one, as `model.provenance` had them; deprecated, and gone with its last reader."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from .._record.record import Record
from .domain import Domain
from .origin import Origin


@dataclass(frozen=True, eq=False)
class Provenance:
    """A model's domain and origin; their fields are read through it, arrays as lists.

    Attributes:
        domain: what it was shown.
        origin: what it was made from.
    """

    domain: Domain
    origin: Origin = field(default_factory=Origin)

    def __getattr__(self, name: str) -> Any:
        if name in ("domain", "origin") or name.startswith("__"):  # not there yet, or asked for by Python itself
            raise AttributeError(name)
        value = getattr(self.domain if hasattr(self.domain, name) else self.origin, name)
        return value.tolist() if isinstance(value, np.ndarray | np.generic) else value

    def with_(self, **changes: Any) -> "Provenance":
        """Copy it with some fields replaced."""
        if "covariance" in changes:
            changes["covariance"] = np.asarray(changes["covariance"], float).reshape(2 * (len(changes["covariance"]),))
        shown = {name: changes.pop(name) for name in [*changes] if hasattr(self.domain, name)}
        return Provenance(replace(self.domain, **shown), replace(self.origin, **changes))

    def driven_by(self, records: Sequence[Record]) -> "Provenance":
        """Widen range and slew of the voltage to those of these records."""
        return Provenance(self.domain.driven_by(records), self.origin)

    def beside(self, model: Any) -> Any:
        """Put this origin beside a model of this domain."""
        from .fitted import Fitted  # which is made of models, as these are of provenances

        return Fitted(replace(model, domain=self.domain), self.origin)

    def noted(self) -> dict[str, Any]:
        """List the summaries of identification and training, as model files of version 1 had them."""
        o = self.origin
        identified = {
            "records": list(o.identified_on),
            "noise_std": o.noise if np.isfinite(o.noise) else None,
            "out_of_fold": o.out_of_fold and asdict(o.out_of_fold),
            "remarks": list(o.remarks),
        }
        summaries = {"identification": identified if o.identified_on else None, "training": o.training}
        lists = {"adapted": list(o.adapted), "lineage": list(o.lineage)}
        return {name: value for name, value in (summaries | lists).items() if value}

    @property
    def notes(self) -> str:
        """`noted` as JSON."""
        return json.dumps(self.noted())

"""Build the physical structure: the nominal model, refitted, with effects from the search of `method/diagnose`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from ...common.errors import ComputationFailed
from ..diagnose import rules
from ..diagnose.budget import Budget
from ..diagnose.data import build_case
from ..diagnose.fit import Fit, Fitter
from ..diagnose.gap import beside_noise
from ..diagnose.handing_back import is_bounded, package_error, stable
from ..diagnose.library import model_of
from ..diagnose.pieces import cut
from ..diagnose.search import Search
from ..model.coverage import with_excited
from ..model.fitted import Fitted, fitted_of
from ..model.lineage import descended
from ..model.model import Model
from ..signal.record import Record
from ..train.errors import judge
from ..train.training import Training

_EFFECTS = 3  # at most: with few excitations a fourth fits their noise
_STEPS = 14  # of a refit, which starts at the fit to all recordings


@dataclass(frozen=True)
class Physical:
    """The best set of effects of a search, fitted to all recordings, with the nominal model.

    Attributes:
        nominal: the model without them.
        search: the search, with its recordings.
        fit: of the best set of at most three effects.
        labels: their names.
    """

    nominal: Model
    search: Search
    fit: Fit
    labels: tuple[str, ...]

    def model(self, records: Sequence[Record]) -> Model:
        """Build the model fitted to all recordings; `records` are all recordings."""
        return self._made(self.fit, records)

    def without(self, records: Sequence[Record], left_out: set[str]) -> Model:
        """Refit the model without the recordings in `left_out` (names); `records` are the remaining ones."""
        case = self.search.case
        places = [k for name, some in case.recordings.items() if name not in left_out for k in some]
        fitter = Fitter(case.alone(places), self.search.budget)
        fitter.bounds = self.search.fitter.bounds
        fit = self.fit.again(starts=case.starts[places], residuals=[], jacobian=None, cost=np.inf, fold=None)
        (done,) = fitter.fit([fit], _STEPS)
        return self._made(done, records)

    def _made(self, fit: Fit, records: Sequence[Record]) -> Model:
        if not np.isfinite(fit.cost):
            raise ComputationFailed("the model with effects diverges")
        made, _ = model_of(self.search.case.nominal, fit.slots, self.nominal, self.search.scale)
        made = replace(made, domain=made.domain.driven_by(records))
        made, error = stable(made, records, package_error(self.nominal, records))
        if not np.isfinite(error) or not is_bounded(made, records):
            raise ComputationFailed("the model with effects diverges")
        return made


def find_physical(nominal: Model | Fitted, records: Sequence[Record], progress: Callable[[str], None]) -> Physical:
    """Search for effects on the recordings, with the nominal model's coefficients fitted as well.

    The search ends at the simulated steps of a diagnosis, not at a time: a loaded machine finds the same effects.

    Args:
        nominal: an identified model.
        records: those that move.
        progress: called with one line per step.
    """
    given = fitted_of(nominal)
    # a Fitted has the attributes of a Model
    model = cast(Model, Fitted(given.model.sampled(records[0].dt, given.hold), given.origin))
    pieces, _ = cut(model, records)
    case = build_case(model, pieces, (), records)
    search = Search(case, True, (), Budget(progress=progress), beside_noise(case, 0.0, case.thinned))
    if search.base.rms > rules.OWN * search.own:  # otherwise noise is all that the linear model leaves
        search.run()
    best = search.best()
    if len(best.names) > _EFFECTS:
        best = search.level(_EFFECTS)[0]
    return Physical(model, search, best.fit, best.labels)


def as_training(model: Model, nominal: Model | Fitted, records: Sequence[Record], seconds: float) -> Training:
    """Return a physical model in the form of a training result; `seconds`: the computing time."""
    compared, parent = judge(nominal, records)(model), fitted_of(nominal)
    notes = {
        "records": [r.name for r in records], "samples": sum(r.samples for r in records), "seconds": round(seconds, 1),
        "history": [], "left_out": [], "errors": {e.name: [e.nominal, e.trained] for e in compared.errors},
        "interrupted": False, "fallback": None,
    }  # fmt: skip
    origin = replace(parent.origin, covariance=np.zeros((0, 0)), misfit=np.inf, training=notes, level=compared.mean,
                     errors=())  # fmt: skip
    fitted = Fitted(fitted_of(model).model, with_excited(origin, records))
    return Training(descended(fitted, "fit", records, parent), (), False, notes, compared.errors)

"""How the voltage runs between samples, settled once the effect is known.

    u(t) constant over a sample ("zoh")   or   linear between samples ("foh"), half a sample earlier

A nominal identified on records with a lag took the hold that came nearest: half a sample of lag. Refitted under it, a
sensor's second-order lag of 8.00 ms read 7.57 +- 0.01; under a linear voltage 8.00, and it left less.
"""

from dataclasses import replace

from .._model.fitted import Fitted
from .._model.model import Model
from .batched_rollouts import Lanes
from .case import Case, build_case
from .evaluation import Judged, judge
from .fit import fit


def settled(case: Case, best: Judged, nominal: Model) -> tuple[Judged, Model]:
    """The refitted explanation and the nominal, under a linear voltage where that leaves less of every record."""
    if not best.candidate.refit or nominal.hold != "zoh":
        return best, nominal
    linear = replace(nominal, hold="foh")
    again = build_case(Fitted(linear, case.origin), [s.record for s in case.series], how=case.split, mesh=case.mesh)
    lanes = Lanes(again, [best.candidate.forms])
    (found,) = judge(lanes, fit(lanes, [best.candidate]))
    better = found.train < best.train and found.heldout < best.heldout
    return (found, linear) if better else (best, nominal)

"""What the nominal's own doubt adds to that of an effect's numbers: both were read off data with noise.

    dp/da = -(J'J)^-1 J' dr/da,     cov(p) += (dp/da) cov(a) (dp/da)'        J = dr/dp, r the residuals of the fit

A nominal whose gain is 0.2 % off, by one of its own standard errors, moved a sensor's gain by ten of the effect's.

In a refit the coefficients are fitted along, but not the hold: identified on delayed records, the nominal took a
zero-order hold, half a sample of delay, and a delay of 13 ms was then read as 12.502 +- 0.003.
"""

from dataclasses import replace

import numpy as np

from .._effects.kernels import DELAY
from .._model.model import Model
from .batched_rollouts import Lanes
from .case import Case
from .evaluation import Judged, sides
from .fit import Candidate, nudged, residuals, stacked


def doubted(case: Case, judged: Judged, nominal: Model) -> Judged:
    """The explanation with a covariance that knows the nominal's; as it is where that is not known."""
    c, spread = judged.candidate, np.asarray(nominal.provenance.covariance, np.float64)
    if c.refit and c.covariance.size:
        return replace(judged, candidate=replace(c, covariance=c.covariance + _of_the_hold(c, nominal, case.dt)))
    if not spread.size or not c.covariance.size:
        return judged
    lanes = Lanes(case, [c.forms])
    fitted, _ = sides(case)
    open_to_both = replace(c, refit=True)
    near = [nudged(open_to_both, k) for k in range(open_to_both.size - 1)]  # the zero stays
    first, *rows = residuals(lanes, [c, *(tried for tried, _ in near)], fitted)
    here = stacked(lanes, first, fitted)
    slopes = [(stacked(lanes, r, fitted) - here) / step for r, (_, step) in zip(rows, near, strict=True)]
    j = np.nan_to_num(np.stack(slopes, 1), posinf=0.0, neginf=0.0)
    moved = -np.linalg.lstsq(j[:, : c.size], j[:, c.size :], rcond=1e-9)[0]
    return replace(judged, candidate=replace(c, covariance=c.covariance + moved @ spread @ moved.T))


def _of_the_hold(c: Candidate, nominal: Model, dt: float) -> np.ndarray:
    """Half a sample of every delay's variance, where the nominal holds its voltage; delays are fitted by logarithms."""
    extra = np.zeros(len(c.covariance))
    if nominal.hold == "zoh":
        for k, (form, values) in enumerate(zip(c.forms, c.values, strict=True)):
            if form.kernel is DELAY:
                extra[sum(len(f.parameters) for f in c.forms[:k])] = (dt / 2 / values[0]) ** 2
    return np.diag(extra)

"""Adapt a model: find which parameters have changed, from a short recording of another day.

    offset, direction, initial state -> all factors by least squares -> a subset of them by evidence
    -> those alone, on the first half of the recording: kept if the held-out second half confirms them

`unchanged`: the model explains the recording about as well as its training records, and no factor improves the fit
significantly. `retrain`: the residual is above that level, so something changed that no factor describes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ...common.shown import Shown
from ..fit.factors import TILTS, TIMES, Factors, adapted, factors_of
from ..model.encoder import ConstantEncoder, plain
from ..model.fitted import Fitted, fitted_of
from ..model.lineage import descended
from ..model.model import Model
from ..model.sections import sections_of
from ..signal.initial_state import in_motion
from ..signal.record import Record
from ..signal.sets import check_set
from ..simulate.prediction import at_rate, begin
from .evidence import combined, covariance, directions, prior_of, select
from .free_runs import Fit, Problem, Session, session

Verdict = Literal["unchanged", "adapted", "retrain"]
_KEPT = 0.95  # largest fraction of its error on the held-out half after a real change
_FAR = 3.0  # times the model's own error level; a larger remaining error means another actuator
_SAME = 1.5  # times its own level: the error of an unchanged actuator under another excitation
_BLIND = 10.0  # % of range: a model with this error does not show which of its parts changed
_SURE = 0.25  # fraction of its level below which a model's own error is unknown
_MOVES = 0.2  # spread of a half relative to the whole below which it proves nothing


@dataclass(frozen=True)
class Changed:
    """The change of one parameter, with its 95 % interval.

    Attributes:
        factor, ci95: new over old, and the ends of its 95 % interval; nan where the model's own was practically zero.
        seconds, seconds_ci95: of a time: its present value and 95 % interval, s.
    """

    factor: float
    ci95: tuple[float, float]
    seconds: float | None = None
    seconds_ci95: tuple[float, float] | None = None

    @property
    def is_significant(self) -> bool:
        """Return whether the 95 % interval of the factor excludes 1."""
        return not self.ci95[0] <= 1.0 <= self.ci95[1]

    def as_json(self) -> dict:
        """Return the factor and its interval."""
        return {"factor": self.factor, "ci95": list(self.ci95)}


@dataclass(frozen=True, repr=False)
class Adaptation(Shown):
    """The verdict of an adaptation, with the changed parameters and the model to use from now on.

    Attributes:
        model: the given one if unchanged, otherwise with the changed parameters.
        verdict: "unchanged", "adapted" or "retrain".
        changed: the changed parameters, by name.
        before, after: e_rms in % of range of the model given and of the one returned.
        heldout: whether those are of the part of the recording that was not used for the fit.
        level: error on the model's own records, with this sensor's noise, in % of range.
        advice: recordings to make if the model must be trained again; otherwise empty.
    """

    model: Fitted
    verdict: Verdict
    changed: dict[str, Changed]
    before: float
    after: float
    heldout: bool
    level: float
    advice: str = ""

    def _rows(self) -> list[dict]:
        return [{"name": name, **vars(c), "significant": c.is_significant} for name, c in self.changed.items()]

    def as_json(self) -> dict:
        """Return the adaptation as the dict of `pitp adapt --json`."""
        changed = {name: c.as_json() for name, c in self.changed.items()}
        values = {"verdict": self.verdict, "changed": changed, "before": self.before, "after": self.after}
        return {**values, "heldout": self.heldout, "advice": [self.advice] if self.advice else []}


def adapt(model: Model | Fitted, records: Sequence[Record] | Record) -> Adaptation:
    """Test whether a model still holds for a recording, and find which of the model's parameters changed.

    Args:
        model: identified or trained, with any effects.
        records: one recording of at most about 10 s, or a few.

    Raises:
        BadInput: no record, none that moves, several sampling rates, or a model that diverges on one.

    Returns:
        the verdict, the changed parameters, and the model (a `Fitted`) to use from now on.

    Examples:
        >>> pitp.adapt(model, records[0]).verdict
        'unchanged'
    """
    records = [records] if isinstance(records, Record) else list(records)
    check_set(records)
    records, _ = in_motion(records)
    fitted = fitted_of(model)
    here = at_rate(fitted.model, records[0].dt)
    seen = session(here, records, *begin(here, records))
    middle = float(seen.target[seen.weight > 0].mean())
    factors = factors_of(here, max(r.samples for r in records) * records[0].dt, middle)
    # the day's sensor may be another one: its noise is not a change of the actuator
    # a model without a stated error is taken to have 1 % of range
    level = float(np.hypot(np.nan_to_num(fitted.origin.level, nan=1.0), np.sqrt(np.mean(seen.noise**2))))
    problem, whole = Problem(here, factors, seen, level), np.ones_like(seen.half)
    given = problem.at(np.zeros(len(factors.names)), whole)
    full = problem.fit(np.eye(len(factors.names)), whole, factors.prior, first=problem.guess())
    own = level * np.sqrt(1 - 1 / fitted.origin.misfit**2)
    spread = covariance(full.residual, full.jacobian, _model_error(full, seen, own))
    known = fitted.origin.covariance  # of the logarithms of the coefficients, which come first
    spread[: len(known), : len(known)] += known
    names = select(full.z, spread, factors)
    if not names:
        return _verdict(fitted, fitted, {}, e_rms(given, whole, seen), np.inf, False, level)
    moves, prior = directions(factors, names), prior_of(factors, names)
    first = combined(moves, full.z, spread)
    best = problem.fit(moves, whole, prior, first=first)
    halves = [seen.half, 1 - seen.half]
    heldout = all(_moves(seen, h) for h in halves)  # any model would explain a half that stands still
    if heldout:
        tried = problem.fit(moves, halves[0], prior, first=first)
        before, after = (e_rms(problem.at(z, halves[1]), halves[1], seen) for z in (given.z, tried.z))
    else:
        before, after = e_rms(given, whole, seen), e_rms(best, whole, seen)
    changed = _changed(factors, names, moves, best, spread)
    new = _made(fitted, factors, best.z, records, changed)
    return _verdict(fitted, new, changed, before, after, heldout, level)


def _verdict(model, new, changed, before: float, after: float, heldout: bool, level: float) -> Adaptation:
    """Accept a change if it lowers the error; advise a new training if the error stays far above its level."""
    verdict: Verdict = "unchanged"
    most, advice = min(_SAME * level, _BLIND), ""
    if after < _KEPT * before:
        verdict, model, most = "adapted", new, _FAR * level
    else:
        changed, after = {}, before
    if after > most:
        verdict, advice = "retrain", _ADVICE
    return Adaptation(model, verdict, changed, before, after, heldout, level, advice)


_ADVICE = (
    "no factor on a single part of the model explains this recording; record a sweep through the resonance and a few "
    "sines over the input range, then run `pitp diagnose` with this model, or `pitp fit` again"
)


def _model_error(fit: Fit, seen: Session, own: float) -> float:
    """Return the rms error of a fit without sensor noise, % of range; at least a fraction of `own`."""
    square = e_rms(fit, np.ones_like(seen.half), seen) ** 2 - float(np.mean(seen.noise**2))
    # a short record may be fitted by chance: its parameters are not more certain than the model was
    return max(square, (_SURE * own) ** 2) ** 0.5


def _moves(seen: Session, half: np.ndarray) -> bool:
    """Return whether the chosen half of each recording moves at least a fifth as much as the whole recording."""
    counts = seen.weight > 0
    spreads = [[float(np.std(x[c])) if c.sum() > 64 else 0.0 for c in (here, all_)]
               for x, here, all_ in zip(seen.target, counts & (half > 0), counts, strict=True)]  # fmt: skip
    return all(part > _MOVES * whole for part, whole in spreads)


def _changed(factors: Factors, names, moves, fit: Fit, spread) -> dict[str, Changed]:
    """Return the named parameters with intervals for which the other parameters may have any value.

    A parameter without a reported change is not known to be 1.
    """
    q, rows = np.linalg.lstsq(moves, fit.z, rcond=None)[0], {}
    inverse = np.linalg.pinv(moves)
    for k, name in enumerate(names):
        if name in TILTS:  # the named value is the mean over the stroke
            continue
        wide = 1.96 * float(np.sqrt(inverse[k] @ spread @ inverse[k]))
        low, at, high = (factors.factor(name, q[k] + by) for by in (-wide, 0.0, wide))
        times: tuple = (None, None)
        if name in TIMES:
            now, by = factors.own(name) + factors.unit * q[k], factors.unit * wide
            times = float(now), (float(max(now - by, 0.0)), float(now + by))
        rows[name] = Changed(at, (low, high), *times)
    return rows


def _made(fitted: Fitted, factors: Factors, z: np.ndarray, records: Sequence[Record], changed) -> Fitted:
    """Build the adapted model, and add the adaptation to its origin."""
    model = adapted(fitted.model, factors, z, records[0].dt)
    if model.order >= 3:
        # with an encoder the sections are the units of its logits, and keep their trained values
        sections = sections_of(model.physical_coefficients)
        if isinstance(plain(model.encoder), ConstantEncoder) and len(sections) == model.order:
            model = replace(model, scales=replace(model.scales, sections=sections))
    rows = {name: c.as_json() for name, c in changed.items()}
    # the covariance was of the old coefficients, and the misfit of the old records
    origin = replace(
        fitted.origin.of_other_coefficients(),
        misfit=float("inf"),
        adapted=(*fitted.origin.adapted, {"records": [r.name for r in records], "changed": rows}),
    )
    model = replace(model, domain=model.domain.driven_by(records))
    return descended(Fitted(model, origin), "adapt", records, fitted)


def e_rms(fit: Fit, weight: np.ndarray, seen: Session) -> float:
    """Compute e_rms of a fit in % of range, with equal weight for every record."""
    counts = (seen.weight > 0) * weight
    return float(np.sqrt(np.mean((fit.residual**2 * counts).sum(1) / np.maximum(counts.sum(1), 1))))

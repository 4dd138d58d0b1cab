"""Choose the model to return: the largest that surely predicts better than every smaller one and than the nominal.

The search sees means of several samples, so the model is fitted to all samples, and it counts only if the user's
rollout confirms it: its error is below the nominal model's, no recording's error grows by more than HARM, and it stays
bounded from rest under the largest voltage of the records and of the nominal. It then carries its own errors, so that
it can be the nominal of the next diagnosis.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from ...common.metrics import rms
from ..fit.sensor_offset import with_offset
from ..model.expected_error import error_table
from ..model.fitted import Fitted, fitted_of
from ..model.model import Model
from ..signal.initial_state import noise_of
from ..signal.record import Record
from ..simulate.decoder import rest_state
from ..simulate.model_runs import model_runs
from ..simulate.prediction import predicted_pairs
from ..simulate.voltage_only import rollout
from . import rules
from .data import Case, build_case
from .evidence import probability
from .fit import Fit, Fitter
from .library import CORE, FREE, SHIFT, model_of
from .own_error import geometric_mean, residual
from .search import DEPTH, PARAMETERS, STEPS, Hypothesis, Search
from .traces import Trace
from .verdict import Decision, rival_without

_DOUBLED = 4  # times at most that the steps a sample of a returned model are doubled
_SHIFT, _GROWN = 1e-9, 100.0  # scaled shift of an initial state; times that it may grow in a steady run


def hand_back(
    search: Search, decision: Decision, model: Model, records: Sequence[Record]
) -> tuple[Hypothesis, tuple, tuple[str, ...]]:
    """Return the largest hypothesis that surely predicts better, and beats the nominal in the package's simulation.

    Args:
        search, decision, model, records: of the diagnosis.

    Returns:
        hypothesis, (model, effects added with their slots), and its parts beyond the nominal.
    """
    alone, whole = decision.alone, cache(lambda: fitter_of_all(search.case, search.fitter))
    before = package_errors(model, records)
    sets = [decision.chosen]
    if decision.verdict != "no_gap":  # without a gap an effect would fit noise
        sets = [_largest(search, decision), *sets, *search.level(1)[:2]]
    for h in {id(h): h for h in (*sets, search.base, search.linear)}.values():
        if not h.fit.free or SHIFT.name in h.names or not surely_improves(h, search.given):
            continue
        # parameters shared by machines that differ predict none of them
        if alone is not None and probability(alone.bare, h.evidence.bare, 1 - rules.GAIN) >= rules.SURE:
            continue
        if search.case.thinned > 1:
            h = replace(h, fit=at_their_rate(h.fit, whole()))
        # in the package's own parts
        made, added = model_of(search.case.nominal, h.fit.slots, search.case.model, search.scale)
        # the offset decides where a law of x acts
        made = with_offset(replace(made, domain=made.domain.driven_by(records)), records)
        made, after = stable(made, records, geometric_mean(before))
        better = geometric_mean(after) < geometric_mean(before) and harms_none(before, after, records)
        if better and is_bounded(made, records):
            parts = [label for n, label in zip(h.names, h.labels, strict=True) if n not in (FREE, PARAMETERS)]
            parts += ["term"] if FREE in h.names else []
            parts += ["parameters"] if set(h.fit.free) & {*CORE} else []
            return h, (with_offset(made, records), added), tuple(dict.fromkeys(parts))
    return search.given, (model, []), ()


def fitter_of_all(case: Case, searcher: Fitter) -> Fitter:
    """Return a fitter that sees every sample of a case's recordings, with the bounds and the budget of another."""
    fitter = Fitter(build_case(case.model, [s.record for s in case.series], whole=True), searcher.budget)
    fitter.bounds = searcher.bounds
    return fitter


def at_their_rate(fit: Fit, fitter: Fitter) -> Fit:
    """Continue a fit to means with every sample; dry friction sticks elsewhere under the mean of an input."""
    (found,) = fitter.fit([fit.anew(starts=fitter.case.starts.copy(), residuals=[])], STEPS)
    return fit.again(slots=found.slots)


def surely_improves(h: Hypothesis, given: Hypothesis) -> bool:
    """Return whether a hypothesis beats the given model out of fold with the probability that every claim needs."""
    return probability(h.evidence.bare, given.evidence.bare) >= rules.SURE


def _largest(search: Search, decision: Decision) -> Hypothesis:
    """Return the largest set, from the judged one on, that predicts surely better by 1 - FIRST than the one before it.

    It may hold more parts than are named. Larger sets that are only a little better here are worse on other inputs: of
    a servo's elbow friction left 12 %, with a slew limit and a clip that its recordings reach once 38 %.
    """
    best = decision.chosen
    if SHIFT.name in best.names:  # a zero is not part of a model
        best = rival_without(search, best, {SHIFT.name})
    for depth in range(len(best.names) + 1, DEPTH + 1):
        sets = [h for h in search.level(depth, {SHIFT.name}) if {*decision.said} <= {*h.labels}]
        h = min(sets, key=lambda h: h.evidence.bare.rms, default=best)
        # a first part need only predict better
        if probability(h.evidence.bare, best.evidence.bare, rules.FIRST if depth > 1 else 1.0) >= rules.SURE:
            best = h
    return best


def stable(made: Model, records: Sequence[Record], most: float) -> tuple[Model, np.ndarray]:
    """Double the model's integration steps per sample until its error is below `most` and its runs are steady.

    It ends where the error no longer falls or after `_DOUBLED` times; a model that no step makes steady keeps its own.

    Returns:
        the model, and its errors (`package_errors`).
    """
    first = made, package_errors(made, records)
    errors = first[1]
    for _ in range(_DOUBLED):
        steady, error = is_steady(made, records), geometric_mean(errors)
        if steady and error < most:
            break
        finer = replace(made, substeps=2 * made.substeps)
        after = package_errors(finer, records)
        if steady and np.isfinite(error) and geometric_mean(after) > (1 - rules.GAIN) * error:
            break
        made, errors = finer, after
    return first if geometric_mean(first[1]) < most and not is_steady(made, records) else (made, errors)


def is_steady(model: Model, records: Sequence[Record]) -> bool:
    """Return whether a small shift of the initial state stays small in a run under every input.

    It grows where a force changes by more than a step can follow: then rounding decides the run, and exported code
    has another one.
    """
    start = np.asarray(rest_state(model), np.float64)
    shifted = np.stack([start, start + _SHIFT * np.eye(len(start))[0]])
    runs = (model_runs(model, np.tile(r.voltage, (2, 1)), r.dt, shifted)[1] for r in records)
    return all(np.abs(np.diff(x, axis=0)).max() < _GROWN * _SHIFT for x in runs)


def is_bounded(made: Model, records: Sequence[Record]) -> bool:
    """Return whether the model stays bounded from rest under every input, scaled up to the model's largest voltage."""
    own = [abs(v) for v in map(float, made.domain.voltage_range) if np.isfinite(v)]
    tops = [max(float(np.abs(r.voltage).max()), 1e-9) for r in records]
    played = ((r, max(own + tops) / top) for r, top in zip(records, tops, strict=True))
    return all(np.isfinite(rollout(made, r.voltage * up, r.dt, begins="rest")).all() for r, up in played)


def harms_none(before: np.ndarray, after: np.ndarray, records: Sequence[Record]) -> bool:
    """Return whether no recording has more than HARM times its error before, and all pooled have no more."""
    pooled = [np.sum((errors / [r.span for r in records]) ** 2) for errors in (after, before)]
    return bool(np.all(after <= rules.HARM * before) and pooled[0] <= pooled[1])


def with_own_errors(made: Model, traces: Sequence[Trace], records: Sequence[Record]) -> Fitted:
    """Return a model with its own misfit, noise, level and errors: those of its free runs over these recordings.

    Standard errors of coefficients that have changed, and other statements on the nominal, are left out.
    """
    errors = [residual(t.augmented, t) for t in traces]
    noise = float(np.median(noise_of(records)))
    left = np.sqrt([np.nanmean(e**2) for e in errors])
    fitted = fitted_of(made)
    return Fitted(
        fitted.model,
        replace(
            fitted.origin,
            covariance=np.zeros((0, 0)),
            stderr=(),
            misfit=max(rms(left) / noise, 1.0) if noise else float("inf"),
            noise=noise,
            level=100 * rms(left / [r.span for r in records]),
            out_of_fold=None,
            remarks=(),
            errors=error_table([t.augmented for t in traces], errors, records[0].dt),
        ),
    )


def package_errors(model: Model, records: Sequence[Record]) -> np.ndarray:
    """Return the free-run error of every record (rms, offset removed, base unit); infinite if it diverges."""
    errors = []
    for r, p in predicted_pairs(model, records):
        e = (p.displacement - r.displacement)[p.scored & np.isfinite(r.displacement)]
        errors.append(np.inf if p.diverged or not np.isfinite(e).all() else float(np.std(e)))
    return np.array(errors)

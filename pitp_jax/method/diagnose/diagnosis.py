"""Diagnose a model: where its error lies, which effect causes the error, and by how much it shrinks.

records -> thinned case -> candidate sets searched out of fold -> verdict, budget, and the best model that beats the
nominal
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar, cast

import numpy as np
from jax.sharding import Mesh

from ...common.errors import BadInput
from ..model.fitted import Fitted, fitted_of
from ..model.lineage import was_made_from
from ..model.model import Model
from ..signal.record import Record
from ..signal.sets import clock_start
from . import rules
from .before_search import answered
from .budget import Budget
from .clocks import Fault
from .data import FEWEST_FOLDS, Case, build_case, excitations
from .gap import (
    as_far_as_closed,
    beside_noise,
    explains_most,
    floor_percent,
    gap_of,
    out_of_fold,
    percent,
    spans,
)
from .handing_back import hand_back, with_own_errors
from .library import AHEAD, CHANGED, CORE, EARLY, FREE, INDEX, LATE, MONITOR, SHIFT
from .next_experiment import Experiment, separate
from .outcome import Diagnosis
from .own_error import own_error, own_misfit
from .parts import Parts, parts_of
from .result import Added, added_of, errors_of, factors_of, ranking_of
from .search import Hypothesis, Search, needed
from .select_records import usable
from .shares import budget as budget_of
from .term import term_of
from .traces import traces_of
from .verdict import Decision, decide, rival_without, separable
from .where import locate, motions, nowhere
from .words import result_line, verdict_lines

T = TypeVar("T")

_RUNS_AFTER = 6  # free runs of all recordings after a search
_NO_BETTER = (
    "In the package's own free runs the best set of effects is no better than the nominal model, so none of its "
    "effects is reported."
)
_OTHER = (
    "The model that is handed back predicts better than the best set of effects and lacks some of them, so none of its "
    "effects is reported."
)
_NOT_CERTAIN = "The model that is handed back predicts better, but these recordings do not make its effects certain."
_DISAGREE = (
    "The best set of effects lowers the error of some recordings and raises that of others as much, so none of its "
    "effects is reported."
)
_REFITTED = (
    "The nominal model was identified on these recordings, so its coefficients were also fitted (as with "
    "--refit-nominal)"
)
_IN_PARTS = (
    "With fewer than four recordings that show the gap, parts of each were left out in turn, so every fit had used "
    "other parts of the same recording"
)


def diagnose(
    model: Model | Fitted,
    records: Sequence[Record],
    *,
    refit_nominal: bool | None = None,
    exclude: Sequence[str] = (),
    seconds: float = np.inf,
    progress: Callable[[str], None] = lambda line: None,
    mesh: Mesh | None = None,
) -> Diagnosis:
    """Find the missing effect that causes the gap between a nominal model and recordings.

    Args:
        model: an identified linear model or a trained one.
        records: of one actuator, one sampling rate, best of several kinds of excitation.
        refit_nominal: fit the nominal's coefficients too, because it was identified on records with the effect. None:
            if the nominal was made from these recordings (by their checksums in its lineage), and for a note where no
            effect of the frozen nominal is certain.
        exclude: effects left out of the catalogue.
        seconds: of computing; then the best result so far is returned, and `notes` lists the untried steps.
        progress: called with one line per step.
        mesh: devices of this process (`records_mesh`); the runs of a diagnosis take the processor's cores.

    Returns:
        verdict, effects, budget, and the best model that beats the nominal out of fold. An interrupt (Ctrl-C) ends the
        search, and the result is the best so far (`interrupted`).

    Raises:
        BadInput: no records, of several rates, two of one name or none that moves; a nominal that diverges on one; a
            mesh over several processes.

    Examples:
        >>> print(pitp.diagnose(model, records))  # doctest: +SKIP
        no gap ...
    """
    model = cast(Model, fitted_of(model))  # a Fitted has the attributes of a Model
    if mesh is not None and mesh.is_multi_process:
        raise BadInput("a diagnosis runs in one process; give a mesh that holds only jax.local_devices()")
    refit = "asked" if refit_nominal else "no"
    if refit_nominal is None and was_made_from(model, records):
        refit = "automatic"
    records, notes = usable(records)
    model = replace(model, domain=replace(model.domain, clock=float(model.domain.clock) or clock_start(records)))
    limit = Budget(seconds, progress=progress)
    runs = own_error(model, records)
    if refit == "no" and (early := answered(model, records, runs, notes)) is not None:
        return early
    outcome, fault, records = _searched_without_fault(model, records, refit != "no", exclude, limit)
    notes = (*fault.remarks(records[0].dt), *notes)
    search, interrupted = outcome.search, outcome.interrupted
    case, own, source = search.case, outcome.own, outcome.source
    noise = beside_noise(case, 0.0, case.thinned)
    limit.begin("comparing the best set")
    decision, (handed, made, names_back) = _checked(
        search, decide(search, outcome.floor, noise, outcome.distinct, outcome.usual), model, records
    )
    failed: list[str] = []

    def attempt(what: str, make: Callable[[], T], otherwise: T) -> T:
        """Call `make` for a part that only describes the result; if it fails, note it and return `otherwise`."""
        try:
            return make()
        except Exception as error:
            failed.append(f"{what} failed ({type(error).__name__}: {error}); the rest of the result is complete")
            return otherwise

    traces, names = traces_of(model, made[0], records), tuple(s.record.name for s in case.series)
    gap = gap_of(search, decision, out_of_fold(search, handed), own, source)
    decision = replace(decision, verdict=as_far_as_closed(decision.verdict, gap))
    errors = errors_of(search, handed.fit)
    # effects that the verdict reports have their parameters in the model; otherwise the returned model is described
    effects = decision.said
    # of too many names none is reported, and all are listed
    many = (n for label, others in decision.tied.items() for n in (label, *others))
    equivalent = decision.tied.get(effects[0], ()) if effects else tuple(many)
    experiment = None
    if decision.verdict != "no_gap":
        experiment = attempt("the next experiment", lambda: _experiment(search, decision, limit), None)
    shift = _shift(case, handed.fit, model)
    limit.begin("comparing each part")
    listed = partial(attempt, "the list of parts", lambda: parts_of(search, decision, handed, made), Parts())
    try:
        parts = listed()
    except KeyboardInterrupt:  # rivals not searched are left out; a second interrupt ends the diagnosis
        if interrupted:
            raise
        interrupted = True
        limit.stop("rivals of some parts (interrupted)")
        parts = listed()
    experiment = experiment or next((p.experiment for p in parts if p.experiment is not None), None)
    term = None
    if FREE in decision.chosen.names:
        term = attempt("the equation of the term", lambda: term_of(search, decision, handed, made, errors, gap), None)
    where = attempt(
        "the place of the gap", lambda: locate(motions(case, search.scale), search.base.residuals), nowhere()
    )
    told: tuple[str, ...] = ()
    what = "a refit of the nominal model"
    if decision.verdict == "unknown" and refit == "no" and refit_nominal is None and limit.allows(what):
        limit.begin(what)
        try:
            told = attempt(what, lambda: _if_refitted(model, records, exclude, limit), ())
            limit.allows(f"{what} to its end")
        except KeyboardInterrupt:  # the diagnosis itself is complete
            interrupted = True
            limit.stop(f"{what} (interrupted)")
    notes = (
        *notes,
        *([_REFITTED] if refit == "automatic" else []),
        *([_IN_PARTS] if len(names) > 1 and (len(names) < FEWEST_FOLDS or case.blocks > 1) else []),
        *([decision.reason] if decision.verdict == "unknown" and decision.reason else []),
        *told,
        *limit.notes(),
        *failed,
    )
    raw = _raw(search)
    return Diagnosis(
        verdict=decision.verdict,
        effects=effects,
        equivalent=equivalent,
        added=added_of(search, made[0], made[1], handed.fit, errors) + _moved(search, handed, errors),
        gap=gap,
        ranking=ranking_of(search, floor_percent(spans(search), own)),
        where=where,
        next_experiment=experiment,
        fitted=names,
        heldout=names if len(names) > 1 else (),
        shift=shift,
        traces=traces,
        model=with_own_errors(made[0], traces, records) if names_back else fitted_of(made[0]),
        notes=notes,
        term=term,
        budget=budget_of(search, decision, raw),
        probability=decision.probabilities,
        folds=_folds(case) if len(names) > 1 else (),
        handed_back=names_back,
        parts=parts,
        refit=refit,
        reason=decision.reason if decision.verdict == "unknown" else "",
        lane_steps=limit.simulated_steps,
        clock_shift=fault.early,
        input_lag=fault.lag,
        interrupted=interrupted,
    )


def _if_refitted(model: Model, records: Sequence[Record], exclude: Sequence[str], limit: Budget) -> tuple[str, ...]:
    """Return what a diagnosis with a refitted nominal answers: its coefficients may be what no effect explains."""
    d = diagnose(model, records, refit_nominal=True, exclude=exclude, seconds=limit.remaining, progress=limit.progress)
    if d.interrupted:
        raise KeyboardInterrupt
    return (f"With --refit-nominal: {verdict_lines(d)[0]} {result_line(d)}",)


def _searched_without_fault(
    model: Model, records: Sequence[Record], refit: bool, exclude: Sequence[str], limit: Budget
) -> tuple["_Searched", Fault, Sequence[Record]]:
    """Search; if the output is certainly ahead of the input, correct the records and search again.

    In a refit a lead is no fault of the records, because the plant may have a zero; the verdict is then `unknown`.

    Returns:
        the search, the fault of the records, and the records without it.
    """
    outcome = _searched(model, records, refit, exclude, limit)
    fault, best = Fault(), outcome.search.best()
    if SHIFT.name in best.names and not outcome.interrupted:
        if needed(best, rival_without(outcome.search, best, {SHIFT.name})) >= rules.SURE:
            candidate = Fault(best.fit.value(EARLY) + best.fit.value(AHEAD), best.fit.value(MONITOR))
            # in a refit no other recording says that the plant has no zero, which does the same as this lag
            if refit and candidate.lag:
                return outcome, fault, records
            # beside a longer lag the output still follows the input, so a machine can be the cause
            late = sum(best.fit.value(k) - outcome.search.case.nominal[INDEX[k]] for k in LATE)
            if candidate.early + candidate.lag > late:
                fault, records = candidate, candidate.corrected(records)
        exclude = (*exclude, SHIFT.name)
        outcome = _searched(model, records, refit, exclude, limit)
    return outcome, fault, records


def _checked(search: Search, decision: Decision, model: Model, records: Sequence[Record]):
    """Choose the returned model; withdraw the reported effects if this model lacks them or is not better by GAIN."""
    handed = hand_back(search, decision, model, records)
    why, ranges = "", spans(search)
    if not set(decision.said) <= set(handed[0].labels):
        why = _OTHER if handed[0].names else _NO_BETTER
    elif percent(handed[0].evidence, ranges) > (1 - rules.GAIN) * percent(search.base.evidence, ranges):
        why = _DISAGREE
    if decision.said and why:
        decision = replace(decision, verdict="unknown", said=(), tied={}, reason=why)
        handed = hand_back(search, decision, model, records)
    if decision.verdict == "unknown" and handed[2] and not decision.chosen.names:
        decision = replace(decision, reason=_NOT_CERTAIN)
    return decision, handed


@dataclass(frozen=True)
class _Searched:
    """A finished search with its data and the nominal model's errors.

    Attributes:
        distinct: number of distinct excitations of the records that show the gap.
        own: the nominal's own error, 0 if unknown; source: its origin.
        floor: the error at OWN times which nothing is left to explain; below `own` if a first effect helps there.
        usual: the nominal's error on the records of its identification, in a refit too; 0 if it is no measure of noise.
        interrupted: whether the user interrupted the search.
    """

    search: Search
    distinct: int
    own: float
    floor: float
    usual: float
    source: str
    interrupted: bool


def _searched(model: Model, records: Sequence[Record], refit: bool, exclude, limit: Budget) -> _Searched:
    began = limit.elapsed
    case = build_case(model, records)
    # free runs of all recordings follow the search: of the best hypotheses, and for the report
    limit.reserve = min(_RUNS_AFTER * (limit.elapsed - began), limit.seconds / 2)
    # in a refit the nominal was made from these records, so its error on others is unknown
    known, source = own_misfit(model, records)
    known /= float(case.model.scales.state[0])
    misfit, source = (0.0, "not known in a refit") if refit else (known, source)
    own, noise, usual = (beside_noise(case, m, case.thinned) for m in (misfit, 0.0, known))
    usual = usual if explains_most([s.output[s.counts] for s in case.series], known) else 0.0
    search, distinct = Search(case, refit, exclude, limit, max(own, noise), misfit), excitations(case)
    own, interrupted = 0.0 if refit else own, False
    floor = own
    try:
        if own and search.given.reaches(own) and not search.given.reaches(own, rules.SETTLED):
            closer = Search(case, refit, exclude, limit, max(own, noise) / rules.OWN, misfit / rules.OWN)
            search, floor = (closer, own / rules.OWN) if closer.begins() else (search, own)
        if not search.given.reaches(floor):
            search.run()
            if (only := search.single()) is not None:
                in_parts = Search(case.in_parts(), refit, exclude, limit, search.own, search.misfit)
                in_parts.run()
                if in_parts.best().names:
                    search, distinct = in_parts, excitations(case.alone([only]))
    except KeyboardInterrupt:  # hypotheses scored so far are judged; a second interrupt ends the diagnosis
        interrupted = True
        limit.stop("the rest of the search (interrupted)")
    return _Searched(search, distinct, own, floor, usual, source, interrupted)


def _folds(case: Case) -> tuple[tuple[str, ...], ...]:
    """Return, for each fold, the names of the recordings that were left out together, or in parts."""
    names = [s.record.name for s in case.series]
    return tuple(dict.fromkeys(tuple(dict.fromkeys(names[k] for k in fold)) for fold in case.folds))


def _raw(search: Search):
    """Return the evidence of the nominal model before any offset or initial state is fitted."""
    case = search.case
    # with the initial states of the records, before any offset or start was fitted
    runs = case.simulator.run(np.tile(case.nominal, (len(case.series), 1)), range(len(case.series)), case.starts)
    rows = []
    for run, s, residual in zip(runs, case.series, search.given.residuals, strict=True):
        e = np.where(s.counts & np.isfinite(run), run - s.output, np.nan)
        rows.append(np.where(np.isfinite(residual), np.where(np.isfinite(e), e, residual), np.nan))
    return search.weigh(rows)


def _moved(search: Search, handed: Hypothesis, errors: dict) -> tuple[Added, ...]:
    rows = factors_of(search, handed.fit, errors)
    return (Added(CHANGED, "refitted coefficients", rows),) if rows and not search.refit else ()


def _shift(case: Case, fit, model: Model) -> np.ndarray:
    ratio = [fit.slots[INDEX[k]] / case.nominal[INDEX[k]] if case.nominal[INDEX[k]] > 0 else 1.0 for k in CORE]
    return np.array([*ratio, *[1.0] * max(model.order - 2, 0)])[: model.order + 1]


def _experiment(search: Search, decision: Decision, limit: Budget) -> Experiment | None:
    """Return an experiment that separates the tied effects, or the effects that prevented a verdict."""
    best, names = decision.chosen, decision.rivals
    if decision.said and (tied := separable(search, decision, decision.said[0])):
        names = decision.said[0], tied[0]
    if not names or not best.names or not limit.allows("an experiment that separates the tied names"):
        return None
    lacking = dict(zip(best.labels, best.names, strict=True)).get(names[0])
    # at most as large, because a larger set fits anything and separates nothing
    rivals = [
        h for h in search.every.values() if h.names and lacking not in h.names and len(h.names) <= len(best.names)
    ]
    return (
        separate(search.case, search.scale, best, min(rivals, key=lambda h: h.rms), (names[0], names[1]))
        if rivals
        else None
    )

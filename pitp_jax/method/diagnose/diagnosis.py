"""Diagnose a model: where its error lies, which effect causes the error, and by how much it shrinks.

records -> thinned case -> candidate sets searched out of fold -> verdict, budget, and the best model that beats the
nominal
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
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
from .budget import Budget
from .clocks import Fault
from .data import FEWEST_FOLDS, Case, build_case, excitations
from .gap import (
    Gap,
    as_far_as_closed,
    beside_noise,
    explains_most,
    floor_percent,
    gap_of,
    of_free_runs,
    on_pieces,
    out_of_fold,
    own_misfit,
    percent,
    spans,
)
from .handing_back import hand_back, package_error
from .library import AHEAD, CHANGED, CORE, EARLY, FREE, INDEX, MONITOR, SHIFT
from .next_experiment import Experiment, separate
from .parts import Parts, parts_of
from .pieces import Piece, cut
from .result import Added, Ranked, added_of, errors_of, factors_of, ranking_of
from .search import Hypothesis, Search
from .select_records import usable
from .shares import budget as budget_of
from .term import Term, term_of
from .traces import Trace, traces_of
from .verdict import Decision, decide, needed, rival_without, separable
from .where import locate, motions, nowhere
from .words import lines, summary

T = TypeVar("T")

_RUNS_AFTER = 6  # free runs of all recordings after a search
_NO_BETTER = (
    "In the package's own free runs the best set of effects is no better than the nominal model, so none of its "
    "effects is reported."
)
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


@dataclass(frozen=True)
class Diagnosis:
    """A verdict on the errors of a model, with the reported effects, their evidence and the improved model.

    Attributes:
        verdict: "explained", "partly", "no_gap" or "unknown".
        effects: reported effects, most important first; empty unless explained or partly.
        equivalent: effects that these data do not separate from effects[0].
        added: effects of the augmented model beyond the nominal, with form and parameters.
        budget, gap, ranking, where, next_experiment: see docs/contract.md.
        probability: per effect, P that the best set without it has a larger error.
        fitted, heldout: record names; every record is predicted by a fit without it (with fewer than four records,
            or one that shows the effect, every part by a fit without that part).
        folds: records left out together, or in parts.
        shift: in a refit, the refitted coefficients over the given ones, shape (n + 1,).
        traces: every record with the outputs of the nominal and the returned model.
        notes: one line for everything left out, not tried or not reported.
        model: the best model that beats the nominal out of fold, otherwise the nominal.
        handed_back: the returned model's parts beyond the nominal.
        parts: the same with parameters, intervals and certainty, under every verdict.
        refit: "asked", "automatic" or "no": whether the nominal's coefficients were refitted.
        reason: why the verdict is "unknown", one sentence.
        term: an unnamed force as an equation found in the data.
        lane_steps: the work of the search, samples x steps a sample x simulations.
        pieces: the pieces of a long set that the search used; None: all of it.
        clock_shift: time (s) by which the output column was ahead of the input column; removed before the diagnosis.
        input_lag: time constant (s) of the low pass behind which the input column was recorded; removed likewise.
        interrupted: the search was interrupted; the result is the best scored so far.
    """

    verdict: str
    effects: tuple[str, ...]
    equivalent: tuple[str, ...]
    added: tuple[Added, ...]
    gap: Gap
    ranking: tuple[Ranked, ...]
    where: dict
    next_experiment: Experiment | None
    fitted: tuple[str, ...]
    heldout: tuple[str, ...]
    shift: np.ndarray
    traces: tuple[Trace, ...]
    model: Fitted
    notes: tuple[str, ...] = ()
    term: Term | None = None
    budget: dict = field(default_factory=dict)
    probability: dict = field(default_factory=dict)
    folds: tuple[tuple[str, ...], ...] = ()
    handed_back: tuple[str, ...] = ()
    parts: Parts = Parts()
    refit: str = "no"
    reason: str = ""
    lane_steps: int = 0
    pieces: tuple[Piece, ...] | None = None
    clock_shift: float = 0.0
    input_lag: float = 0.0
    interrupted: bool = False

    @property
    def records(self) -> dict[str, list]:
        """Return the names of the records that were fitted, predicted out of fold, and left out together."""
        return {"fitted": list(self.fitted), "heldout": list(self.heldout), "folds": [list(f) for f in self.folds]}

    def as_json(self, csv: str | None = None) -> dict:
        """Return the diagnosis as the dict of docs/contract.md; `csv`: the file with the next experiment."""
        experiment = self.next_experiment
        return {
            "verdict": self.verdict,
            "effects": list(self.effects),
            "equivalent": list(self.equivalent),
            "budget": self.budget,
            "added": [vars(a) for a in self.added],
            "gap": vars(self.gap) | {"ci95": list(self.gap.ci95) if self.gap.ci95 else None},
            "ranking": [vars(r) | {"ci95": list(r.ci95) if r.ci95 else None} for r in self.ranking],
            "where": self.where,
            "next_experiment": None
            if experiment is None
            else {"separates": list(experiment.separates), "excitation": experiment.excitation, "csv": csv},
            "records": self.records,
            "pieces": None if self.pieces is None else [vars(p) for p in self.pieces],
            "handed_back": list(self.handed_back),
            "parts": self.parts.as_json(),
            "refit": self.refit,
            "clock_shift_s": self.clock_shift,
            "input_lag_s": self.input_lag,
            "coefficients_over_given": [float(v) for v in self.shift],
            "notes": list(self.notes),
            "term": self.term.as_json() if self.term else None,
        }

    def __repr__(self) -> str:
        """Return the first lines of the diagnosis, at most ten."""
        text = str(self).splitlines()
        more = [f"and {len(text) - 9} lines more (print it)"] if len(text) > 10 else text[9:10]
        return "\n".join([f"Diagnosis: {text[0]}", *text[1:9], *more])

    def _repr_html_(self) -> str:
        """Return the first screen of the diagnosis page as HTML."""
        return summary(self).first_screen()

    def __str__(self) -> str:
        """Return the diagnosis as a few lines for the terminal."""
        return "\n".join([*lines(self), *(f"note: {line}" for line in self.notes if line != self.reason)])


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
            if the nominal was made from these recordings (by their checksums in its lineage).
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
    automatic = refit_nominal is None and was_made_from(model, records)
    refit = "automatic" if automatic else "asked" if refit_nominal else "no"
    refit_nominal = refit != "no"
    records, notes = usable(records)
    model = replace(model, domain=replace(model.domain, clock=float(model.domain.clock) or clock_start(records)))
    limit = Budget(seconds, progress=progress)
    found, fault, records = _searched_without_fault(model, records, refit_nominal, exclude, limit)
    notes = (*fault.remarks(records[0].dt), *notes)
    search, pieces, before, interrupted = found.search, found.pieces, found.before, found.interrupted
    case, own, misfit, source = search.case, found.own, search.misfit, found.source
    noise = beside_noise(case, 0.0, case.thinned)
    limit.begin("comparing the best set")
    decision, (handed, made, names_back) = _checked(
        search, decide(search, own, noise, found.distinct, found.usual), model, records, before
    )
    failed: list[str] = []

    def told(what: str, make: Callable[[], T], otherwise: T) -> T:
        """Call `make` for a part that only describes the result; if it fails, note it and return `otherwise`."""
        try:
            return make()
        except Exception as error:
            failed.append(f"{what} failed ({type(error).__name__}: {error}); the rest of the result is complete")
            return otherwise

    traces, names = traces_of(model, made[0], records), tuple(case.recordings)
    if pieces is None:
        gap = gap_of(search, decision, out_of_fold(search, handed), own, source)
    else:
        whole = beside_noise(case, misfit, 1) if not refit_nominal else 0.0
        gap = gap_of(search, decision, of_free_runs(search, model, records, traces), whole, source)
    decision = replace(decision, verdict=as_far_as_closed(decision.verdict, gap))
    errors = errors_of(search, handed.fit)
    # effects that the verdict reports have their parameters in the model; otherwise the returned model is described
    effects = decision.said
    equivalent = decision.tied.get(effects[0], ()) if effects else ()
    experiment = None
    if decision.verdict != "no_gap":
        experiment = told("the next experiment", lambda: _experiment(search, decision, limit), None)
    shift = _shift(case, handed.fit, model)
    limit.begin("comparing each part")
    try:
        parts = told("the list of parts", lambda: parts_of(search, decision, handed, made), Parts())
    except KeyboardInterrupt:  # rivals not searched are left out; a second interrupt ends the diagnosis
        if interrupted:
            raise
        interrupted = True
        limit.stop("rivals of some parts (interrupted)")
        parts = told("the list of parts", lambda: parts_of(search, decision, handed, made), Parts())
    experiment = experiment or next((p.experiment for p in parts if p.experiment is not None), None)
    term = None
    if FREE in decision.chosen.names:
        term = told("the equation of the term", lambda: term_of(search, decision, handed, made, errors, gap), None)
    where = told("the place of the gap", lambda: locate(motions(case, search.scale), search.base.residuals), nowhere())
    notes = (
        *notes,
        *([_REFITTED] if automatic else []),
        *([_IN_PARTS] if len(names) > 1 and (len(names) < FEWEST_FOLDS or case.blocks > 1) else []),
        *([] if pieces is None else [on_pieces(pieces, records, traces)]),
        *([decision.reason] if decision.verdict == "unknown" and decision.reason else []),
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
        model=fitted_of(made[0]),
        notes=notes,
        term=term,
        budget=budget_of(search, decision, raw),
        probability=decision.probabilities,
        folds=_folds(case) if len(names) > 1 else (),
        handed_back=names_back,
        parts=parts,
        refit=refit,
        reason=decision.reason if decision.verdict == "unknown" else "",
        lane_steps=limit.lane_steps,
        pieces=pieces,
        clock_shift=fault.early,
        input_lag=fault.lag,
        interrupted=interrupted,
    )


def _searched_without_fault(
    model: Model, records: Sequence[Record], refit: bool, exclude: Sequence[str], limit: Budget
) -> tuple["_Searched", Fault, Sequence[Record]]:
    """Search; if the output is certainly ahead of the input, correct the records and search again.

    Returns:
        the search, the fault of the records, and the records without it.
    """
    found = _searched(model, records, refit, exclude, limit)
    fault, best = Fault(), found.search.best()
    if SHIFT.name in best.names and not found.interrupted:
        if needed(best, rival_without(found.search, best, {SHIFT.name})) >= rules.SURE:
            found_fault = Fault(best.fit.value(EARLY) + best.fit.value(AHEAD), best.fit.value(MONITOR))
            fault = found_fault if found_fault.is_acausal else fault
            records = fault.corrected(records)
        exclude, limit.most = (*exclude, SHIFT.name), limit.most + limit.lane_steps
        found = _searched(model, records, refit, exclude, limit)
    return found, fault, records


def _checked(search: Search, decision: Decision, model: Model, records: Sequence[Record], before: float):
    """Choose the returned model; withdraw the reported effects if this model lacks them or is not better by GAIN."""
    handed = hand_back(search, decision, model, records, before)
    why, ranges = "", spans(search)
    if not set(decision.said) <= set(handed[0].labels):
        why = _NO_BETTER
    elif percent(handed[0].evidence, ranges) > (1 - rules.GAIN) * percent(search.base.evidence, ranges):
        why = _DISAGREE
    if decision.said and why:
        decision = replace(decision, verdict="unknown", said=(), tied={}, reason=why)
        handed = hand_back(search, decision, model, records, before)
    return decision, handed


@dataclass(frozen=True)
class _Searched:
    """A finished search with its data and the nominal model's errors.

    Attributes:
        pieces: the pieces of the records that the search used; None: all of them.
        distinct: number of distinct excitations of the records that show the gap.
        before: the nominal's error in the package's free runs.
        own: the nominal's own error, 0 if unknown; source: its origin.
        usual: the nominal's error on the records of its identification, in a refit too; 0 if it is no measure of noise.
        interrupted: whether the user interrupted the search.
    """

    search: Search
    pieces: tuple[Piece, ...] | None
    distinct: int
    before: float
    own: float
    usual: float
    source: str
    interrupted: bool


def _searched(model: Model, records: Sequence[Record], refit: bool, exclude, limit: Budget) -> _Searched:
    searched, pieces = cut(model, records)
    case = build_case(model, searched, records)
    began = limit.elapsed
    before = package_error(model, records)
    # free runs of all recordings follow the search: of the best hypotheses, and for the report
    limit.reserve = min(_RUNS_AFTER * (limit.elapsed - began), limit.seconds / 2)
    # in a refit the nominal was made from these records, so its error on others is unknown
    known, source = own_misfit(case)
    misfit, source = (0.0, "not known in a refit") if refit else (known, source)
    own, noise, usual = (beside_noise(case, m, case.thinned) for m in (misfit, 0.0, known))
    usual = usual if explains_most([s.output[s.counts] for s in case.series], known) else 0.0
    search, distinct = Search(case, refit, exclude, limit, max(own, noise), misfit), excitations(case)
    own, interrupted = 0.0 if refit else own, False
    if not search.given.reaches(own):
        try:
            search.run()
            if (only := search.single()) is not None:
                limit.most += limit.lane_steps
                in_parts = Search(case.in_parts(), refit, exclude, limit, max(own, noise), misfit)
                in_parts.run()
                if in_parts.best().names:
                    search, distinct = in_parts, excitations(case.alone([only]))
        except KeyboardInterrupt:  # hypotheses scored so far are judged; a second interrupt ends the diagnosis
            interrupted = True
            limit.stop("the rest of the search (interrupted)")
    return _Searched(search, pieces, distinct, before, own, usual, source, interrupted)


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

"""The diagnosis: where the gap lies, which effect causes it, how far it shrinks (docs/contract.md).

records -> thinned case -> sets of effects searched out of fold -> verdict, budget, and the best model that beats the
nominal
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar, cast

import numpy as np
from jax.sharding import Mesh

from .._errors import BadInput
from .._model.fitted import Fitted, fitted_of
from .._model.model import Model
from .._record.initial_state import noise_std
from .._record.record import Record
from .._record.sets import clock_start
from .._report.numbers import figure, of_range
from .._simulate.prediction import predict
from .._simulate.voltage_only import rollout
from . import rules
from .budget import Budget
from .data import FEWEST_FOLDS, Case, build_case, excitations
from .evidence import probability
from .library import CHANGED, CORE, FREE, INDEX, model_of
from .next_experiment import Experiment, separate
from .pieces import Piece, cut
from .result import (
    Added,
    Gap,
    Ranked,
    Trace,
    added_of,
    closed,
    errors_of,
    factors_of,
    interval,
    percent,
    ranking_of,
    traces_of,
)
from .search import PARAMETERS, Hypothesis, Search
from .select_records import usable
from .shares import budget as budget_of
from .term import Term, term_of
from .verdict import Decision, decide
from .where import locate, motions, nowhere

T = TypeVar("T")

_RUNS_AFTER = 6  # free runs of all recordings behind a search
_DOUBLED = 4  # times at most that the steps a sample of a model handed back are doubled
_NO_BETTER = "the set that pays does no better than the nominal in the package's own free runs, so no name is said"
_IN_PARTS = "fewer than four records: parts of each were left out in turn, so other parts of every drive had been seen"
_DISAGREE = "the set that pays lowers the error of some records and raises that of others as much, so no name is said"


@dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found.

    Attributes:
        verdict: "explained", "partly", "no_gap" or "unknown".
        effects: names said, most important first; empty unless explained or partly.
        equivalent: names these data cannot tell from effects[0].
        added: what the augmented model has beyond the nominal, with form and parameters.
        budget, gap, ranking, where, next_experiment: as docs/contract.md names them.
        probability: per name, P that the best set without it leaves more.
        fitted, heldout: record names; every record is predicted by a fit that did not see it (of fewer than four
            records, every part by one that did not see that part).
        folds: records left out together, or in parts.
        shift: in a refit, the nominal's coefficients over those given, shape (n + 1,).
        traces: every record beside the nominal and the model that is handed back.
        notes: one line for whatever was left out, not tried or not said.
        model: the best model that beats the nominal out of fold, else the nominal.
        handed_back: its parts beyond the nominal.
        term: a force without a name as an equation found in the data.
        lane_steps: the work of the search, samples x steps a sample x simulations.
        pieces: where the search worked on pieces of a long set; None: on all of it.
        interrupted: the search was interrupted; the result is the best of what it had scored.
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
    lane_steps: int = 0
    pieces: tuple[Piece, ...] | None = None
    interrupted: bool = False

    @property
    def records(self) -> dict[str, list]:
        """Which records were fitted, which were predicted by fits that did not see them, and left out together."""
        return {"fitted": list(self.fitted), "heldout": list(self.heldout), "folds": [list(f) for f in self.folds]}

    def as_json(self, csv: str | None = None) -> dict:
        """The dict of docs/contract.md; `csv` is where the next experiment was written."""
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
            "coefficients_over_given": [float(v) for v in self.shift],
            "notes": list(self.notes),
            "term": self.term.as_json() if self.term else None,
        }

    def __repr__(self) -> str:
        """Its first three lines."""
        return "\n".join(["Diagnosis, " + str(self).splitlines()[0], *str(self).splitlines()[1:3]])

    def __str__(self) -> str:
        """A few lines for the terminal."""
        from .report.words import lines

        return "\n".join([*lines(self), *(f"note: {line}" for line in self.notes)])


def diagnose(
    model: Model | Fitted,
    records: Sequence[Record],
    *,
    refit_nominal: bool = False,
    exclude: Sequence[str] = (),
    seconds: float = np.inf,
    progress: Callable[[str], None] = lambda line: None,
    mesh: Mesh | None = None,
) -> Diagnosis:
    """Find the unmodelled effect behind the gap between a nominal model and real recordings.

    Args:
        model: an identified linear model or a trained one.
        records: of one actuator, one sampling rate, best of several kinds of excitation.
        refit_nominal: the nominal was identified on records that carry the effect: its coefficients are fitted along.
        exclude: names left out of the catalogue.
        seconds: of computing; then the best so far is told, and in `notes` what was not tried.
        progress: called with one line per step.
        mesh: devices of this process that share the runs (`records_mesh`); default one device.

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
    model = cast(Model, fitted_of(model))  # reads as one
    if mesh is not None and mesh.is_multi_process:
        raise BadInput("a diagnosis runs in one process: its mesh may only hold jax.local_devices()")
    records, notes = usable(records)
    model = replace(model, domain=replace(model.domain, clock=float(model.domain.clock) or clock_start(records)))
    limit = Budget(seconds, progress=progress)
    searched, pieces = cut(model, records)
    case = build_case(model, searched, tuple(mesh.devices.flat) if mesh is not None else (), records)
    began = limit.elapsed
    before = _package_error(model, records)
    # free runs of all recordings follow the search: of the best hypotheses, and for the report
    limit.reserve = min(_RUNS_AFTER * (limit.elapsed - began), seconds / 2)
    misfit, source = own_misfit(case) if not refit_nominal else (0.0, "unknown in a refit")
    noise = _thinned(case, 0.0)
    # in a refit the nominal was made from these records: what it left of others is not known
    own = _thinned(case, misfit) if not refit_nominal else 0.0
    search = Search(case, refit_nominal, exclude, limit, max(own, noise), misfit)
    interrupted = False
    if not search.given.rms <= rules.OWN * own:
        try:
            search.run()
        except KeyboardInterrupt:  # what was scored so far is judged; a second interrupt ends it
            interrupted = True
            limit.stop("the rest of the search (interrupted)")
    distinct = excitations(case)
    limit.begin("which of them is sure")
    decision = decide(search, own, noise, distinct)
    handed, made, parts = hand_back(search, decision, model, records, before)
    why = ""
    if not set(decision.said) <= set(handed.labels):
        why = _NO_BETTER
    elif percent(search, handed) > (1 - rules.GAIN) * percent(search, search.base):
        why = _DISAGREE
    if decision.said and why:
        decision = replace(decision, verdict="unknown", said=(), tied={}, reason=why)
        handed, made, parts = hand_back(search, decision, model, records, before)
    failed: list[str] = []

    def told(what: str, make: Callable[[], T], otherwise: T) -> T:
        """Make what only describes the result; its failure is a note."""
        try:
            return make()
        except Exception as error:
            failed.append(f"{what} failed ({type(error).__name__}: {error}); the rest of the result is complete")
            return otherwise

    # told in % of range, as the gap is
    low = _floor(search, own)
    gap = _gap(search, decision, handed, low, source)
    errors = errors_of(search, handed.fit)
    # names that a verdict says stand in the model with their numbers; else what was handed back is told as it is
    effects = decision.said
    equivalent = decision.tied.get(effects[0], ()) if effects else ()
    experiment = None
    if decision.verdict != "no_gap":
        experiment = told("the next experiment", lambda: _experiment(search, decision, limit), None)
    shift = _shift(case, handed.fit, model)
    term = None
    if FREE in decision.chosen.names:
        term = told("the equation of the term", lambda: term_of(search, decision, handed, made, errors, gap), None)
    where = told("the place of the gap", lambda: locate(motions(case, search.scale), search.base.residuals), nowhere())
    traces, names = traces_of(model, made[0], records), tuple(case.recordings)
    notes = (
        *notes,
        *([_IN_PARTS] if 1 < len(names) < FEWEST_FOLDS else []),
        *([] if pieces is None else [_on_pieces(pieces, records, traces)]),
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
        ranking=ranking_of(search, low),
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
        handed_back=parts,
        lane_steps=limit.lane_steps,
        pieces=pieces,
        interrupted=interrupted,
    )


def _folds(case: Case) -> tuple[tuple[str, ...], ...]:
    """Names of the recordings that were left out together, or in parts."""
    names = [s.record.name for s in case.series]
    return tuple(dict.fromkeys(tuple(dict.fromkeys(names[k] for k in fold)) for fold in case.folds))


def _on_pieces(pieces: Sequence[Piece], records: Sequence[Record], traces: Sequence[Trace]) -> str:
    """Say on what the search worked, and the errors over all recordings and over what it left out."""
    searched = {r.name: np.zeros(r.samples, bool) for r in records}
    for p in pieces:
        time = next(r.time for r in records if r.name == p.record)
        searched[p.record] |= (time - time[0] >= p.from_s) & (time - time[0] <= p.to_s)
    every = [np.ones(r.samples, bool) for r in records]
    others = [~searched[t.name] for t in traces]
    (before, after), (_, left) = (
        [_traced(traces, which, places) for which in ("nominal", "augmented")] for places in (every, others)
    )
    part = 100 * sum(map(np.sum, searched.values())) / sum(r.samples for r in records)
    return (
        f"the search worked on {len(pieces)} pieces, {figure(part, 2)} % of the samples; over all recordings the model "
        f"handed back leaves {of_range(after)} of range (the nominal {of_range(before)}), over what was left out "
        f"{of_range(left)}"
    )


def _traced(traces: Sequence[Trace], which: str, places: Sequence[np.ndarray]) -> float:
    """Free-run error (% of range) of "nominal" or "augmented" at some samples, pooled over recordings."""
    squares = []
    for t, here in zip(traces, places, strict=True):
        e = (getattr(t, which) - t.measured)[here]
        if np.isfinite(e).any():
            squares.append(np.nanmean(e**2) / np.ptp(t.measured[np.isfinite(t.measured)]) ** 2)
    return 100 * float(np.sqrt(np.mean(squares))) if squares else float("nan")


def own_misfit(case: Case) -> tuple[float, str]:
    """What the nominal leaves beyond the noise of the records it was identified on (scaled), and where that is from.

    M^2 = rms^2 - noise_0^2 = (misfit^2 - 1) noise_0^2

    It does not grow with the noise of other records: a simulator without noise has a misfit of thousands, and its
    robot's noise times that hid any gap.
    """
    origin, scale = fitted_of(case.model).origin, float(case.model.scales.state[0])
    if not np.isfinite(origin.misfit):
        return 0.0, "the sensor's noise: the nominal carries no error of its own"
    noise = origin.noise / scale if origin.noise > 0 else _noise(case)
    return float(noise * np.sqrt(max(origin.misfit**2 - 1, 0.0))), "what the nominal leaves where nothing is wrong"


def _noise(case: Case) -> float:
    """The sensor's white noise, scaled; geometric mean over records."""
    scale = float(case.model.scales.state[0])
    each = [float(noise_std(s.record.displacement)) / scale for s in case.series]
    return float(np.exp(np.mean(np.log(np.maximum(each, 1e-12)))))


def _thinned(case: Case, lacking: float) -> float:
    """An error beside the noise, as thinned records show it.

    (OWN own)^2 = OWN^2 (M^2 + noise^2) - noise^2 + noise^2 / k:   averaging k samples takes the white part off on
    either side of the comparison, which stays that of the full rate.
    """
    noise, own = _noise(case), rules.OWN
    return float(np.sqrt((own * lacking) ** 2 + (own**2 - 1 + 1 / case.thinned) * noise**2) / own)


def _floor(search: Search, own: float) -> float:
    """The nominal's own error in % of range."""
    spans = [s.span for s in search.case.series]
    return 100 * own * float(np.sqrt(np.mean([1 / s**2 for s in spans]))) if own else 0.0


def _gap(search: Search, decision: Decision, handed: Hypothesis, low: float, source: str) -> Gap:
    before, after = percent(search, search.base), percent(search, handed)
    # of all that was tried, names or none: how far down any explanation came
    best = min(search.every.values(), key=lambda h: h.rms)
    room = min(percent(search, best), before * float(np.exp((decision.bar.score - search.base.evidence.score) / 2)))
    known = low > 0
    return Gap(
        before, after, percent(search, search.given), low if known else None, source, closed(before, after, low),
        interval(search, search.base, handed, low), min(room, before),
    )  # fmt: skip


def _raw(search: Search):
    """The nominal's residuals with zeros and starts as the records' beginnings say."""
    case = search.case
    # as the records begin, before any zero or start was fitted
    runs = case.simulator.run(np.tile(case.nominal, (len(case.series), 1)), range(len(case.series)), case.starts)
    rows = []
    for run, s, residual in zip(runs, case.series, search.given.residuals, strict=True):
        e = np.where(s.counts & np.isfinite(run), run - s.output, np.nan)
        rows.append(np.where(np.isfinite(residual), np.where(np.isfinite(e), e, residual), np.nan))
    return search.weigh(rows)


def hand_back(
    search: Search, decision: Decision, model: Model, records, before: float
) -> tuple[Hypothesis, tuple, tuple[str, ...]]:
    """The best hypothesis that beats the nominal with P >= SURE and whose model does so in the package's own free runs.

    Args:
        search, decision, model, records: of the diagnosis.
        before: the nominal's error in these free runs, `_package_error`.

    Returns:
        hypothesis, (model, effects added with their slots), and its parts beyond the nominal.
    """
    given, error, alone = search.given.evidence.bare, _error, decision.alone
    # a set that is not judged may predict better than the one that was
    deeper = sorted((h for h in search.every.values() if error(h) < error(decision.chosen)), key=error)
    tried = [decision.chosen]
    if decision.verdict != "explained":
        chosen, said = decision.chosen.evidence.bare, set(decision.said)
        sure = [h for h in deeper if said <= set(h.labels) and probability(h.evidence.bare, chosen) >= rules.SURE]
        tried = [*sure[:3], *tried]
    tried += [h for h in search.level(1)[:2] if h not in tried] + [search.base, search.linear]
    for h in tried:
        if not h.fit.free or probability(h.evidence.bare, given) < rules.SURE:
            continue
        # numbers shared by machines that differ foresee none of them
        if alone is not None and probability(alone.bare, h.evidence.bare, 1 - rules.GAIN) >= rules.SURE:
            continue
        # in the package's own parts
        made, added = model_of(search.case.nominal, h.fit.slots, model, search.scale)
        made = replace(made, domain=made.domain.driven_by(records))
        made, after = _stable(made, records, before)
        if after < before and _bounded(made, records):
            parts = [label for n, label in zip(h.names, h.labels, strict=True) if n not in (FREE, PARAMETERS)]
            parts += ["term"] if FREE in h.names else []
            parts += ["parameters"] if set(h.fit.free) & {*CORE} else []
            return h, (made, added), tuple(dict.fromkeys(parts))
    return search.given, (model, []), ()


def _error(h: Hypothesis) -> float:
    return h.evidence.bare.rms


def _stable(made: Model, records: Sequence[Record], most: float) -> tuple[Model, float]:
    """The model with as many steps a sample as its effects need, and its error: their poles are in no coefficient.

    Where it leaves `most` or more its steps are doubled until that gains nothing.
    """
    error = _package_error(made, records)
    for _ in range(_DOUBLED):
        if error < most:
            break
        finer = replace(made, substeps=2 * made.substeps)
        before, error = error, _package_error(finer, records)
        if np.isfinite(before) and error > (1 - rules.GAIN) * before:
            return made, before
        made = finer
    return made, error


def _bounded(made: Model, records: Sequence[Record]) -> bool:
    """Whether no drive of the records runs away at the widest of their voltages, from rest."""
    top = max(float(np.abs(r.voltage).max()) for r in records)
    played = ((r, top / max(float(np.abs(r.voltage).max()), 1e-9)) for r in records)
    return all(np.isfinite(rollout(made, r.voltage * up, r.dt, begins="rest")).all() for r, up in played)


def _package_error(model: Model, records: Sequence[Record]) -> float:
    """Geometric mean over records of the free run's error, zero fitted; infinite where one diverges."""
    total = []
    for p, r in zip(predict(model, records), records, strict=True):
        seen = p.scored & np.isfinite(r.displacement)
        e = (p.displacement - r.displacement)[seen]
        if p.diverged or not np.isfinite(e).all():
            return np.inf
        total.append(np.log(np.std(e) + 1e-300))
    return float(np.exp(np.mean(total)))


def _moved(search: Search, handed: Hypothesis, errors: dict) -> tuple[Added, ...]:
    rows = factors_of(search, handed.fit, errors)
    return (Added(CHANGED, "refitted coefficients", rows),) if rows and not search.refit else ()


def _shift(case: Case, fit, model: Model) -> np.ndarray:
    ratio = [fit.slots[INDEX[k]] / case.nominal[INDEX[k]] if case.nominal[INDEX[k]] > 0 else 1.0 for k in CORE]
    return np.array([*ratio, *[1.0] * max(model.order - 2, 0)])[: model.order + 1]


def _experiment(search: Search, decision: Decision, limit: Budget) -> Experiment | None:
    """What separates the names tied, or those that no verdict could tell apart."""
    best, names = decision.chosen, decision.rivals
    if decision.said and decision.tied.get(decision.said[0]):
        names = decision.said[0], decision.tied[decision.said[0]][0]
    if not names or not best.names or not limit.allows("an experiment that separates the tied names"):
        return None
    lacking = dict(zip(best.labels, best.names, strict=True)).get(names[0])
    # as large at most: a larger set fits anything, and separates nothing
    rivals = [
        h for h in search.every.values() if h.names and lacking not in h.names and len(h.names) <= len(best.names)
    ]
    return (
        separate(search.case, search.scale, best, min(rivals, key=lambda h: h.rms), (names[0], names[1]))
        if rivals
        else None
    )

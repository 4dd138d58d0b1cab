"""The diagnosis: where the gap lies, which effect causes it, how far it shrinks (docs/contract.md).

records -> case -> candidates fitted and judged -> `verdict`;   again the other way round where few drives show it
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, cast

import numpy as np
from jax.sharding import Mesh

from .._errors import BadInput
from .._model.fitted import Fitted, fitted_of
from .._model.model import Model
from .._record.record import Record
from .._record.sets import clock_start
from .budget import Budget
from .case import Case, Split, build_case, split
from .effect_selection import Attribution, attribute
from .evaluation import augmented, floor, sides
from .hold import settled
from .next_experiment import Experiment, separate
from .parameter_uncertainty import doubted
from .result import Added, Gap, Ranked, Trace, added_of, gap_of, ranking_of, trace_of
from .select_records import usable
from .term import Term, found_term
from .verdict import DOUBT, HELPS, rezeroed, verdict
from .where import locate


@dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found.

    Attributes:
        verdict: "explained", "no_gap" or "unknown".
        effects: added, most important first; empty unless explained.
        equivalent: names these data cannot tell from effects[0].
        added: the same effects with form and parameters, as the augmented model carries them.
        gap, ranking, where, next_experiment: as docs/contract.md names them.
        fitted, heldout: record names; where nothing was held out, effects are judged on what they were fitted on.
        shift: in a refit, the nominal's coefficients over those given, shape (n + 1,).
        traces: every record beside the nominal and the best explanation.
        notes: one line for whatever recordings were left out or cut.
        model: the nominal with the effects (or the term) added (and its coefficients refitted where asked for).
        term: where no name fits, the missing force as an equation found in the data.
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
    model: Model | Fitted
    notes: tuple[str, ...] = ()
    term: Term | None = None

    @property
    def records(self) -> dict[str, list[str]]:
        """Which records effects were fitted on and which they were judged on."""
        return {"fitted": list(self.fitted), "heldout": list(self.heldout)}

    def as_json(self, csv: str | None = None) -> dict:
        """The dict of docs/contract.md; `csv` is where the next experiment was written."""
        experiment = self.next_experiment
        return {
            "verdict": self.verdict,
            "effects": list(self.effects),
            "equivalent": list(self.equivalent),
            "added": [vars(a) for a in self.added],
            "gap": vars(self.gap) | {"ci95": list(self.gap.ci95) if self.gap.ci95 else None},
            "ranking": [vars(r) | {"ci95": list(r.ci95) if r.ci95 else None} for r in self.ranking],
            "where": self.where,
            "next_experiment": None
            if experiment is None
            else {"separates": list(experiment.separates), "excitation": experiment.excitation, "csv": csv},
            "records": self.records,
            "coefficients_over_given": [float(v) for v in self.shift],
            "notes": list(self.notes),
            "term": self.term.as_json() if self.term else None,
        }

    def __repr__(self) -> str:
        """Its first three lines."""
        return "\n".join(["Diagnosis, " + str(self).splitlines()[0], *str(self).splitlines()[1:3]])

    def __str__(self) -> str:
        """A few lines for the terminal."""
        g = self.gap
        lines = [f"verdict: {self.verdict}" + (f" by {' and '.join(self.effects)}" if self.effects else "")]
        if self.equivalent:
            lines.append(f"cannot be told from: {', '.join(self.equivalent)}")
        closed = "" if g.closed_fraction is None else f", {max(100 * g.closed_fraction, 0):.0f} % of the gap closed"
        known = "unknown" if g.noise_floor is None else f"{g.noise_floor:.2f} %"
        side = "held-out" if self.heldout else "fitted"
        lines.append(f"{side} error {g.before:.2f} -> {g.after:.2f} % of range (noise floor {known}){closed}")
        if self.term is not None:
            share = 100 * (self.term.closed_fraction or 0.0)
            lines.append(f"{self.term.equation}: closes {share:.0f} %, -> {self.term.after:.2f} % of range")
        if self.verdict != "no_gap":
            lines.append(self.where["summary"])
        lines += [f"note: {line}" for line in self.notes]
        return "\n".join(lines)


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
        exclude: names left out of the catalogue, and with electrode_rc the slew limit that has a lag.
        seconds: of computing; then the best so far is told, and in `notes` what was not tried.
        progress: called with one line per step.
        mesh: devices of this process that share the rollouts of all candidates (`records_mesh`); default one device.

    Returns:
        verdict, effects, gap, ranking, and the model with the effects added.

    Raises:
        BadInput: no records, of several rates, two of one name or none that moves; a nominal that diverges on one; a
            mesh over several processes.

    Examples:
        >>> print(pitp.diagnose(model, records))  # doctest: +SKIP
        verdict: no_gap ...
    """
    model = cast(Model, fitted_of(model))  # reads as one, with the origin that `model.provenance` looks into
    if mesh is not None and mesh.is_multi_process:
        raise BadInput("a diagnosis runs in one process: its mesh may only hold jax.local_devices()")
    records, notes = usable(records)
    model = replace(model, provenance=model.provenance.with_(clock=model.provenance.clock or clock_start(records)))
    budget = Budget(seconds)
    options = {"refit": refit_nominal, "exclude": exclude, "progress": progress, "budget": budget}
    case, found, gap, name, level = _over_splits(model, records, mesh, options)
    _, judged = sides(case)
    if name == "explained":
        best, model = settled(case, found.best, model)
        found = replace(found, best=doubted(case, best, model))
        gap = gap_of(case, found, found.best, gap.noise_floor or 0.0, judged)
    if name == "no_gap" and gap.before > DOUBT * (gap.noise_floor or 0.0):
        notes += (
            f"{gap.before:.2g} % of range are left, {level:.2g} % beside each record's own zero: rezero the sensor",
        )
    effects = found.best.names if name == "explained" else ()
    added = augmented(case, found.best if name == "explained" else found.base, model)
    where = locate(case, [e * s.span / 100 for e, s in zip(found.base.errors, case.series, strict=True)], found.noise)
    experiment = None
    tied = found.equivalent if name != "no_gap" and (gap.closed_fraction or 0.0) > HELPS else ()
    if tied and budget.allows("an experiment that separates the tied names"):
        progress("looking for an experiment that separates the tied names")
        experiment = separate(case, found.best, found.rivals[0], found.noise)
    described, shown = None, found
    wide = name == "unknown" and gap.before > DOUBT * (gap.noise_floor or 0.0)
    if wide and budget.allows("a term found in the data"):
        described = found_term(case, found, model, progress)
    if described is not None:
        shown, added = replace(found, best=described[1]), described[2]
    return Diagnosis(
        verdict=name,
        effects=effects,
        equivalent=tied,
        added=added_of(case, found.best) if effects else (),
        gap=gap,
        ranking=ranking_of(case, found, gap.noise_floor or 0.0, judged),
        where=where,
        next_experiment=experiment,
        fitted=tuple(s.record.name for s in case.fitted),
        heldout=tuple(s.record.name for s in case.heldout),
        shift=np.asarray((found.best if effects else found.base).candidate.factors),
        traces=tuple(trace_of(case, shown, k) for k in range(len(case.series))),
        model=added,
        notes=notes + budget.notes(),
        term=described[0] if described else None,
    )


class _Said(NamedTuple):
    """What one split of the records says."""

    case: Case
    found: Attribution
    gap: Gap
    verdict: str
    rezeroed: float


def _over_splits(model: Model, records, mesh: Mesh | None, options: dict) -> _Said:
    """Split one way; then the other, where an effect may act in few drives; then not at all."""

    def said(how: Split) -> _Said:
        case = build_case(model, records, how=how, mesh=mesh)
        found = attribute(case, **options)
        _, judged = sides(case)
        gap = gap_of(case, found, found.best, floor(case, found.noise, judged), judged)
        own, level = case.model.provenance.misfit, rezeroed(case, found.base, judged)
        return _Said(case, found, gap, verdict(gap, found, own, level), level)

    first, progress, budget = said("first"), options["progress"], options["budget"]
    elsewhere = first.verdict == "no_gap" and _fitted_show_it(first.case, first.found)
    if not elsewhere and first.verdict != "unknown":
        return first
    tried = [first]
    others_fitted = split(records, "first") != split(records, "second")
    worth = others_fitted and (elsewhere or not _hopeless(first.case, first.found))
    if worth and budget.allows("the other half of the drives fitted"):
        progress("once more, fitted on the drives that were held out: what acts in few of them may act there")
        tried.append(said("second"))
        if tried[1].verdict == "explained":
            return tried[1]
    one_sided = elsewhere or any(_on_one_side(s) for s in tried)
    if one_sided and budget.allows("all drives fitted, none held out"):
        progress("once more, with nothing held out: the gap is in drives of one side alone")
        everywhere = said("none")
        return everywhere if elsewhere or everywhere.verdict == "explained" else first
    return first


def _on_one_side(s: _Said) -> bool:
    """A gap in the records that were fitted and none in those that were held out, or the other way round."""
    held_show_it = s.gap.before > DOUBT * (s.gap.noise_floor or 0.0)
    return held_show_it != _fitted_show_it(s.case, s.found)


def _fitted_show_it(case: Case, found: Attribution) -> bool:
    """Whether the records that were fitted show a gap."""
    fitted, _ = sides(case)
    return found.base.train > DOUBT * floor(case, found.noise, fitted)


def _hopeless(case: Case, found: Attribution) -> bool:
    """The fitted records have a gap, and no effect takes a tenth off it: the other way round it is the same."""
    least = min(j.train for j in (*found.ranking, found.best))
    return _fitted_show_it(case, found) and least > 0.9 * found.base.train

"""The diagnosis: where the gap lies, which effect causes it, how far it shrinks (CONTRACT.md).

closed fraction = 1 - sqrt(max(after^2 - floor^2, 0) / (before^2 - floor^2)),   held-out, pooled over records
no_gap      before <= 1.1 floor, or <= 1.4 floor where no effect closes a fifth (the floor itself is an estimate)
unknown     less than half closed, less than 80 % where after > 1.5 floor, or more than three names tied
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from .._effects import CATALOGUE
from .._effects.base import Parameter
from .._model.input_map import SquareInput
from .._model.model import Model
from .._record.record import Record
from .attribute import Attribution, Judged, attribute, bootstrap, floor, sides
from .case import Case, build_case
from .next import Experiment, separate
from .where import locate

_GAP, _FAR, _CLOSED, _TIES = 1.1, 1.5, 0.8, 3
_DOUBT = 1.4  # how far off the floor may be: AR(0.9) noise in records of 1500 samples reads 15 % low
_HALF = 0.5  # what closes less explains nothing, however high the floor
_HELPS = 0.2  # a best candidate that closes less explains nothing, and what is tied with it neither
_FLOOR_DOUBT = 0.03  # relative standard deviation of the noise floor's estimate


@dataclass(frozen=True)
class Gap:
    """Held-out figures in % of range, pooled over records, and the share that was closed with its 95 % interval."""

    before: float
    after: float
    unrefitted: float
    noise_floor: float | None
    floor_from: str
    closed_fraction: float | None
    ci95: tuple[float, float] | None


@dataclass(frozen=True)
class Ranked:
    """One name's best form.

    Attributes:
        effect, family, form: as in the catalogue.
        parameters: name to value, unit and standard error (None where it was only screened).
        train, heldout: error left, % of range.
        closed_fraction, ci95: as in `Gap`.
        screened: True where the figures come from screening, not from whole rollouts.
    """

    effect: str
    family: str
    form: str
    parameters: dict
    train: float
    heldout: float
    closed_fraction: float | None
    ci95: tuple[float, float] | None
    screened: bool


@dataclass(frozen=True)
class Added:
    """One effect of the augmented model: name, form, and parameters as in `Ranked`."""

    effect: str
    form: str
    parameters: dict


@dataclass(frozen=True)
class Trace:
    """One record in rig units: time (s), voltage (V), measured, nominal and augmented output; held out or fitted."""

    name: str
    heldout: bool
    time: np.ndarray
    voltage: np.ndarray
    measured: np.ndarray
    nominal: np.ndarray
    augmented: np.ndarray


@dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found.

    Attributes:
        verdict: "explained", "no_gap" or "unknown".
        effects: added, most important first; empty unless explained.
        equivalent: names these data cannot tell from effects[0].
        added: the same effects with form and parameters, as the augmented model carries them.
        gap, ranking, where, next_experiment: as CONTRACT.md names them.
        fitted, heldout: record names.
        shift: in a refit, the nominal's coefficients over those given, shape (n + 1,).
        traces: every record beside the nominal and the best explanation.
        model: the nominal with the effects added (and its coefficients refitted where asked for).
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
    model: Model

    @property
    def records(self) -> dict[str, list[str]]:
        """Which records effects were fitted on and which they were judged on."""
        return {"fitted": list(self.fitted), "heldout": list(self.heldout)}

    def as_json(self, csv: str | None = None) -> dict:
        """The dict of CONTRACT.md; `csv` is where the next experiment was written."""
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
        }

    def __str__(self) -> str:
        """A few lines for the terminal."""
        g = self.gap
        lines = [f"verdict: {self.verdict}" + (f" by {' and '.join(self.effects)}" if self.effects else "")]
        if self.equivalent:
            lines.append(f"cannot be told from: {', '.join(self.equivalent)}")
        closed = "" if g.closed_fraction is None else f", {abs(100 * g.closed_fraction):.0f} % of the gap closed"
        known = "unknown" if g.noise_floor is None else f"{g.noise_floor:.2f} %"
        lines.append(f"held-out error {g.before:.2f} -> {g.after:.2f} % of range (noise floor {known}){closed}")
        if self.verdict != "no_gap":
            lines.append(self.where["summary"])
        return "\n".join(lines)


def diagnose(
    model: Model,
    records: Sequence[Record],
    *,
    refit_nominal: bool = False,
    exclude: Sequence[str] = (),
    progress: Callable[[str], None] = lambda line: None,
) -> Diagnosis:
    """Find the unmodelled effect behind the gap between a nominal model and real recordings.

    Args:
        model: an identified linear model or a trained one.
        records: of one actuator, one sampling rate, best of several kinds of excitation.
        refit_nominal: the nominal was identified on records that carry the effect: its coefficients are fitted along.
        exclude: names left out of the catalogue.
        progress: called with one line per step.

    Raises:
        BadInput: no records, or a nominal that diverges on one.
    """
    case = build_case(model, records)
    found = attribute(case, refit=refit_nominal, exclude=exclude, progress=progress)
    fitted, held = sides(case)
    low = floor(case, found.noise, held)
    gap = _gap(case, found, found.best, low, held)
    verdict = _verdict(gap, found)
    effects = found.best.names if verdict == "explained" else ()
    added = augmented(case, found.best if verdict == "explained" else found.base, model)
    where = locate(case, [e * s.span / 100 for e, s in zip(found.base.errors, case.series, strict=True)], found.noise)
    experiment = None
    tied = found.equivalent if verdict != "no_gap" and (gap.closed_fraction or 0.0) > _HELPS else ()
    if tied:
        progress("looking for an experiment that separates the tied names")
        rival = next(r for r in found.ranking if r.names[0] == tied[0])
        experiment = separate(case, found.best, rival, found.noise)
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        equivalent=tied,
        added=_added(case, found.best) if effects else (),
        gap=gap,
        ranking=_ranking(case, found, low, held),
        where=where,
        next_experiment=experiment,
        fitted=tuple(case.series[k].record.name for k in fitted),
        heldout=tuple(case.series[k].record.name for k in held),
        shift=np.asarray((found.best if effects else found.base).candidate.factors),
        traces=tuple(_trace(case, found, k) for k in range(len(case.series))),
        model=added,
    )


def _verdict(gap: Gap, found: Attribution) -> str:
    low = gap.noise_floor or 0.0
    share = gap.closed_fraction or 0.0
    if gap.before <= _GAP * low or (gap.before <= _DOUBT * low and share < _HELPS):
        return "no_gap"
    if share < _HALF or (gap.after > _FAR * low and share < _CLOSED) or len(found.equivalent) > _TIES:
        return "unknown"
    return "explained"


def closed(before: float, after: float, low: float) -> float | None:
    """The closed fraction; None where there was nothing to close."""
    if before <= _GAP * low:
        return None
    return float(1 - np.sqrt(max(after**2 - low**2, 0.0) / (before**2 - low**2)))


def _interval(case: Case, base: Judged, after: Judged, low: float, held) -> tuple[float, float] | None:
    """Blocks drawn anew for both errors, the floor within its own doubt."""
    if base.heldout <= _GAP * low or not np.isfinite(after.heldout):
        return None
    first = bootstrap(case, held, lambda k: base.errors[k] ** 2)
    second = bootstrap(case, held, lambda k: after.errors[k] ** 2)
    doubt = np.random.default_rng(1).standard_normal(len(first))
    floors = (low * (1 + _FLOOR_DOUBT * doubt)) ** 2
    draws = 1 - np.sqrt(np.maximum(second - floors, 0) / np.maximum(first - floors, 1e-12))
    here = closed(base.heldout, after.heldout, low) or 0.0
    return float(min(np.quantile(draws, 0.025), here)), float(max(np.quantile(draws, 0.975), here))


def _gap(case: Case, found: Attribution, after: Judged, low: float, held) -> Gap:
    before = found.base.heldout
    return Gap(
        before=before, after=min(after.heldout, before) if before <= _GAP * low else after.heldout,
        unrefitted=found.given.heldout, noise_floor=low, floor_from=found.noise.source,
        closed_fraction=closed(before, after.heldout, low), ci95=_interval(case, found.base, after, low, held),
    )  # fmt: skip


def physical(case: Case, p: Parameter, value: float) -> tuple[float, str]:
    """A stored number in physical units."""
    s = [*case.model.scales.state, 1.0, 1.0]
    factor = s[0] ** p.length * s[1] ** p.speed * s[2] ** p.acceleration * case.model.scales.force**p.force
    base = "V" if case.model.provenance.displacement_unit.endswith("V") else "m"
    unit = p.unit.replace("x", base)
    if p.force and not isinstance(case.model.input_map, SquareInput):
        unit = unit.replace("V^2", "V")
    return value * factor, unit


def _added(case: Case, judged: Judged) -> tuple[Added, ...]:
    """Form by form, with the standard errors of the joint fit."""
    c, found, k = judged.candidate, [], 0
    errors = np.sqrt(np.maximum(np.diag(c.covariance), 0)) if c.covariance.size else None
    for form, values, start in zip(c.forms, c.values, c.starts, strict=True):
        told = {}
        for p, v, low, high in zip(form.PARAMETERS, values, start.low, start.high, strict=True):
            value, unit = physical(case, p, v)
            error = None
            if high > low:
                if errors is not None:
                    error = abs(float(errors[k] * (value if p.positive else value / v if v else 0.0)))
                k += 1
            told[p.name] = {"value": float(value), "unit": unit, "stderr": error or None}
        found.append(Added(form.name, form.form, told))
    if not c.forms:
        told = {
            f"a_{i} over given": {"value": float(f), "unit": "1", "stderr": e}
            for i, (f, e) in enumerate(zip(c.factors, _relative(c, errors), strict=True))
        }
        found.append(Added("parameter_change", "refitted coefficients", told))
    return tuple(found)


def _relative(c, errors) -> list:
    """Standard errors of the coefficients' factors, where they were fitted."""
    if errors is None or not c.refit:
        return [None] * len(c.factors)
    return [float(e * f) or None for e, f in zip(errors[-len(c.factors) :], c.factors, strict=True)]


def _ranking(case: Case, found: Attribution, low: float, held) -> tuple[Ranked, ...]:
    rows, seen = [], set()
    for j in found.ranking:
        form = j.candidate.forms[0] if j.candidate.forms else None
        seen.add(j.names[0])
        rows.append(
            Ranked(
                j.names[0],
                form.family if form else "parametric",
                form.form if form else "refitted coefficients",
                _added(case, j)[0].parameters,
                j.train,
                j.heldout if np.isfinite(j.heldout) else j.train,
                closed(found.base.heldout, j.heldout, low),
                _interval(case, found.base, j, low, held),
                False,
            )  # fmt: skip
        )
    for s in found.screened:
        form = s.forms[0]
        if form.name in seen:
            continue
        seen.add(form.name)
        numbers = zip(form.PARAMETERS, s.values[0], strict=True)
        told = {
            p.name: dict(zip(("value", "unit"), physical(case, p, v), strict=True)) | {"stderr": None}
            for p, v in numbers
        }
        held_error = float(np.sqrt(max(s.heldout, 0)))
        rows.append(
            Ranked(
                form.name,
                form.family,
                form.form,
                told,
                float(np.sqrt(max(s.train, 0))),
                held_error,
                closed(found.base.heldout, held_error, low),
                None,
                True,
            )  # fmt: skip
        )
    order = {c.name: k for k, c in enumerate(CATALOGUE)}
    return tuple(sorted(rows, key=lambda r: (r.screened, r.heldout, order.get(r.effect, 0))))


def augmented(case: Case, judged: Judged, model: Model) -> Model:
    """The nominal with a candidate's effects, its coefficients, and the substeps it was fitted with."""
    c = judged.candidate
    pairs = sorted(zip(c.forms, c.values, strict=True), key=lambda fv: CATALOGUE.index(fv[0]))
    effects = tuple(f(*(jnp.asarray(v, jnp.float32) for v in values)) for f, values in pairs)
    coefficients = (np.asarray(model.coefficients, np.float64) * c.factors).astype(np.float32)
    substeps = max(case.model.substeps, model.substeps) if effects else model.substeps
    return replace(model, effects=(*model.effects, *effects), coefficients=jnp.asarray(coefficients), substeps=substeps)


def _trace(case: Case, found: Attribution, k: int) -> Trace:
    s = case.series[k]
    scale, to_rig = case.model.scales.state[0], case.model.output.to_rig
    seen = np.where(s.weight > 0, (s.run - s.error) * scale, np.nan)
    rows = [to_rig((s.run - s.error + j.errors[k] * s.span / 100) * scale) for j in (found.base, found.best)]
    return Trace(s.record.name, not s.fitted, s.record.time, s.record.voltage, to_rig(seen), *rows)

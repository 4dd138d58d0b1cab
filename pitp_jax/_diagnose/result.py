"""What a diagnosis found, in physical units: the gap, the ranking, the added effects, the traces.

closed fraction = 1 - sqrt(max(after^2 - floor^2, 0) / (before^2 - floor^2)),   held-out, pooled over records
"""

from dataclasses import dataclass

import numpy as np

from .._effects import CATALOGUE
from .._effects.physical import physical
from .bootstrap import means
from .case import Case
from .effect_selection import Attribution
from .evaluation import Judged
from .regress import Screened

GAP = 1.1  # times the floor: no gap up to there


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
        train, heldout: error left, % of range; of one that fell far behind, where its fit was given up.
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


def closed(before: float, after: float, low: float) -> float | None:
    """The closed fraction; None where there was nothing to close."""
    if before <= GAP * low:
        return None
    return float(1 - np.sqrt(max(after**2 - low**2, 0.0) / (before**2 - low**2)))


def _interval(case: Case, base: Judged, after: Judged, low: float, held, doubt: float) -> tuple[float, float] | None:
    """Blocks drawn anew for both errors, the floor within its own relative standard deviation `doubt`."""
    if base.heldout <= GAP * low or not np.isfinite(after.heldout):
        return None
    first, second = means(case, held, lambda k: np.stack([base.errors[k], after.errors[k]]) ** 2)
    floors = (low * (1 + doubt * np.random.default_rng(1).standard_normal(len(first)))) ** 2
    draws = 1 - np.sqrt(np.maximum(second - floors, 0) / np.maximum(first - floors, 1e-12))
    here = closed(base.heldout, after.heldout, low) or 0.0
    return float(min(np.quantile(draws, 0.025), here)), float(max(np.quantile(draws, 0.975), here))


def gap_of(case: Case, found: Attribution, after: Judged, low: float, held) -> Gap:
    before = found.base.heldout
    return Gap(
        before=before, after=min(after.heldout, before) if before <= GAP * low else after.heldout,
        unrefitted=found.given.heldout, noise_floor=low, floor_from=found.noise.source,
        closed_fraction=closed(before, after.heldout, low), 
        ci95=_interval(case, found.base, after, low, held, found.noise.doubt),
    )  # fmt: skip


def added_of(case: Case, judged: Judged) -> tuple[Added, ...]:
    """Form by form, with the standard errors of the joint fit."""
    c, found, k = judged.candidate, [], 0
    errors = np.sqrt(np.maximum(np.diag(c.covariance), 0)) if c.covariance.size else None
    for form, values, start in zip(c.forms, c.values, c.starts, strict=True):
        told = {}
        for p, v, low, high in zip(form.parameters, values, start.low, start.high, strict=True):
            value, unit = physical(case.model, p, v)
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
    return [float(e * f) or None for e, f in zip(errors[-1 - len(c.factors) : -1], c.factors, strict=True)]


def ranking_of(case: Case, found: Attribution, low: float, held) -> tuple[Ranked, ...]:
    """Every name's best form: those fitted on whole rollouts, the preferred one first, then those only screened."""
    stable = [j for k, j in enumerate(found.ranking) if k == 0 or np.isfinite(j.heldout)]  # not what ran away there
    rows = [_fitted(case, found, j, low, held) for j in stable]
    seen = {r.effect for r in rows}
    for s in found.screened:
        if s.names[0] not in seen:
            seen.add(s.names[0])
            rows.append(_screened(case, found, s, low))
    order = {c.name: k for k, c in enumerate(CATALOGUE)}
    first = found.ranking[0].names[0]
    return tuple(sorted(rows, key=lambda r: (r.screened, r.effect != first, r.heldout, order.get(r.effect, 0))))


def _fitted(case: Case, found: Attribution, j: Judged, low: float, held) -> Ranked:
    form = j.candidate.forms[0] if j.candidate.forms else None
    return Ranked(
        effect=j.names[0],
        family=form.family if form else "parametric",
        form=form.form if form else "refitted coefficients",
        parameters=added_of(case, j)[0].parameters,
        train=j.train,
        heldout=j.heldout,
        closed_fraction=closed(found.base.heldout, j.heldout, low),
        ci95=_interval(case, found.base, j, low, held, found.noise.doubt),
        screened=False,
    )


def _screened(case: Case, found: Attribution, s: Screened, low: float) -> Ranked:
    form, told = s.forms[0], {}
    for p, v in zip(form.parameters, s.values[0], strict=True):
        value, unit = physical(case.model, p, v)
        told[p.name] = {"value": value, "unit": unit, "stderr": None}
    train, heldout = (float(np.sqrt(max(e, 0))) for e in (s.train, s.heldout))
    return Ranked(
        effect=form.name,
        family=form.family,
        form=form.form,
        parameters=told,
        train=train,
        heldout=heldout,
        closed_fraction=closed(found.base.heldout, heldout, low),
        ci95=None,
        screened=True,
    )


def trace_of(case: Case, found: Attribution, k: int) -> Trace:
    s = case.series[k]
    scale, to_rig = case.model.scales.state[0], case.model.output.to_rig
    seen = np.where(s.weight > 0, (s.run - s.error) * scale, np.nan)
    rows = [to_rig((s.run - s.error + j.errors[k] * s.span / 100) * scale) for j in (found.base, found.best)]
    return Trace(s.record.name, not s.fitted, s.record.time, s.record.voltage, to_rig(seen), *rows)

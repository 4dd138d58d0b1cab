"""Results of a diagnosis in physical units: ranked effects, added effects, and their parameters."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects.physical import physical
from ..model.model import Model
from .evidence import probability
from .fit import Fit
from .gap import closed, interval, percent, spans
from .library import CORE, DELAY, FILTER, INDEX, LAG, LOGARITHM, OFFSET, effects_of, family
from .search import Search

_BLOCKS = 30  # of all records together; errors within one are correlated
_LEAST = 1e-10  # of the largest eigenvalue: below it, numerical slopes hold no information
_LOST = 0.01  # of a parameter, in directions without information: above it the parameter is not determined
_PLAIN = {DELAY: "delay", LAG: "lag", FILTER: "filter", OFFSET: "input offset"}  # as the page names them


@dataclass(frozen=True)
class Ranked:
    """One effect added alone to the linear model, in its best form, with its errors.

    Attributes:
        effect, family, form: as in the catalogue.
        parameters: name to value, unit and standard error.
        train, heldout: error, % of range, of the fit to all records and out of fold.
        closed_fraction, ci95: as in `Gap`.
        probability: P that it beats the linear model.

    `heldout` and `probability` are nan, and `closed_fraction` and `ci95` None, for a candidate that was not refitted
    without each fold: its fit to all records has a larger error than the third-best candidate out of fold.
    """

    effect: str
    family: str
    form: str
    parameters: dict
    train: float
    heldout: float
    closed_fraction: float | None
    ci95: tuple[float, float] | None
    probability: float


@dataclass(frozen=True)
class Added:
    """One effect that the augmented model has beyond the nominal model, with its parameters as in `Ranked`."""

    effect: str
    form: str
    parameters: dict


def errors_of(search: Search, fit: Fit) -> dict[str, float]:
    """Return standard errors of the free parameters (of logarithms if positive), from blocks of residuals.

    Infinite if the records contain no information about a parameter.
    """
    if not fit.free:
        return {}
    if fit.jacobian is None:
        search.fitter.differentiate([fit])
    h, _ = search.fitter.normal(fit)
    meat, count = np.zeros_like(h), 0
    assert fit.jacobian is not None
    total = sum(s.counts.sum() for s in search.case.series)
    for k, s in enumerate(search.case.series):
        r = np.nan_to_num(fit.residuals[k])
        weight = 1 / (np.mean(r[s.counts] ** 2) + search.floors[k])
        blocks = max(3, round(_BLOCKS * s.counts.sum() / total))
        # scores of whole blocks, because residuals within one are correlated
        for j, e in zip(np.array_split(fit.jacobian[k], blocks), np.array_split(r, blocks), strict=True):
            score = weight * j.T @ e
            meat += np.outer(score, score)
            count += 1
    inverse, known = _inverse(h)
    plain = np.diag(inverse)  # not below the value for independent residuals
    wide = count / max(count - len(fit.free), 1)
    variance = np.maximum(np.diag(inverse @ meat @ inverse) * wide, plain)
    errors = np.where(known, np.sqrt(np.maximum(variance, 0)), np.inf)
    return dict(zip(fit.free, errors.tolist(), strict=True))


def _inverse(h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Invert a normal matrix in the directions with information; return also which parameters are determined."""
    d = np.sqrt(np.maximum(np.diag(h), 0))
    unit = np.where(d > 0, d, 1.0)
    value, axes = np.linalg.eigh(h / np.outer(unit, unit))
    good = value > _LEAST * max(value[-1], 1e-300)
    inverse = (axes[:, good] / value[good]) @ axes[:, good].T / np.outer(unit, unit)
    return inverse, (d > 0) & ((axes[:, ~good] ** 2).sum(1) < _LOST)


def longest_time(search: Search, port: str) -> float:
    """Return the longest time constant (s) of an effect at this port whose end the recordings show.

    It is a third of the longest recording, or of the session for a drift.
    """
    longest = max(float(s.record.time[-1] - s.record.time[0]) for s in search.case.series)
    return (max(search.scale.session, longest) if port == "T" else longest) / 3


def _in_units(search: Search, model: Model, effect, names: Sequence[str], fit: Fit, errors: dict) -> dict:
    """Return `in_units`, without a standard error of time constants whose end the recordings do not show."""
    rows, longest = in_units(model, effect, names, fit, errors), longest_time(search, effect.port)
    unknown = {"stderr": None}
    return {k: row | unknown if row["unit"] == "s" and row["value"] > longest else row for k, row in rows.items()}


def in_units(model: Model, effect, names: Sequence[str], fit: Fit, errors: dict[str, float]) -> dict:
    """Return an effect's parameters in physical units, with standard errors; `names`: their names in the fit."""
    rows = {}
    for slot, (p, value) in zip(names, effect.numbers(), strict=True):
        if float(value) == p.off:  # a term that is off
            continue
        number, unit = physical(model, p, float(value))
        error = None
        if np.isfinite([number, errors.get(slot, np.inf)]).all():
            size = 1.0 if LOGARITHM[INDEX[slot]] else 1 / max(abs(fit.value(slot)), 1e-300)
            error = abs(number) * size * errors[slot]
        rows[p.name] = {"value": float(number), "unit": unit, "stderr": error}
    return rows


def added_of(search: Search, model: Model, added: Sequence[tuple], fit: Fit, errors: dict) -> tuple[Added, ...]:
    """Return the effects that the model adds to the nominal model, with parameters in physical units."""
    return tuple(Added(e.name, e.form, _in_units(search, model, e, names, fit, errors)) for e, names in added)


def factors_of(search: Search, fit: Fit, errors: dict[str, float]) -> dict:
    """Return the linear model's refitted parameters, divided by the given ones, with standard errors."""
    nominal, rows = search.case.nominal, {}
    for k in search.movable:
        if k in fit.free:
            value, error = fit.value(k) / nominal[INDEX[k]], errors.get(k, np.inf)
            stderr = value * error if np.isfinite(error) else None
            rows[factor_name(k)] = {"value": float(value), "unit": "1", "stderr": stderr}
    return rows


def factor_name(slot: str) -> str:
    """Return the displayed name of a linear model's parameter that is divided by its given value."""
    return f"{slot[0]}_{slot[1]} over given" if slot in CORE else f"{_PLAIN[slot]} over given"


def ranking_of(search: Search, low: float) -> tuple[Ranked, ...]:
    """Return every effect added alone to the linear model, in its best form; the best effect comes first."""
    rows = []
    ranges, base = spans(search), search.base.evidence
    before = percent(base, ranges)
    hypotheses = search.level(1)
    others = sorted((f for f in search.waiting.values() if len(f.names) == 1), key=lambda f: f.cost)
    for fit, label in [(h.fit, h.labels[0]) for h in hypotheses] + [(f, search.labels(f)[0]) for f in others]:
        mine = next(iter(effects_of(fit.slots, search.scale, only=fit.names[0])), None)
        # each needs its own slopes: for the first three, which a reader compares
        errors = errors_of(search, fit) if len(rows) < 3 else {}
        numbers = _in_units(search, search.case.model, *mine, fit, errors) if mine else factors_of(search, fit, errors)
        form = mine[0].form if mine else "refitted coefficients"
        row = Ranked(label, family(label), form, numbers, _train(search, fit), float("nan"), None, None, float("nan"))
        if len(rows) < len(hypotheses):
            h = hypotheses[len(rows)]
            after, sure = percent(h.evidence, ranges), probability(h.evidence, base)
            ci95, fraction = interval(base, h.evidence, ranges, low), closed(before, after, low)
            fraction = fraction and max(fraction, -1.0)  # where its interval ends; None without a gap
            row = replace(row, heldout=after, closed_fraction=fraction, ci95=ci95, probability=sure)
        rows.append(row)
    return tuple(rows)


def _train(search: Search, fit: Fit) -> float:
    squares = [np.nanmean(r**2) / s.span**2 for r, s in zip(fit.residuals, search.case.series, strict=True)]
    return 100 * float(np.sqrt(np.mean(squares)))

"""A term found in the data where no name fits: the missing force as an equation, with units and intervals.

    sum_i a_i x^(i) = F - f,   f = sum_j c_j phi_j(x, x', F, z)        (`_effects.found_term`)

It is judged as an effect is and acts as one; it describes, and names no cause.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .._effects.effect import Effect
from .._effects.found_term import LIBRARY, NAMES, sparse_term
from .._effects.physical import physical
from .._model.model import Model
from .case import Case
from .effect_selection import Attribution
from .evaluation import Judged, augmented, floor, sides
from .fit import Candidate
from .parameter_uncertainty import doubted
from .result import closed, gap_of
from .term_regression import Point, evaluated
from .term_search import CLOSE, LEAST, NEAR, search
from .where import missing_force

_BINS, _DOTS = 30, 500  # of the curve and the scatter


class Drawn(NamedTuple):
    """The term over its main variable ("displacement", "velocity" or "voltage", in base units).

    Forces in % of the largest force of the film: `measured`, what the nominal lacks at `at`; `curve`, the term at
    `along`, the mean of what it is at that value of the variable.
    """

    variable: str
    at: np.ndarray
    measured: np.ndarray
    along: np.ndarray
    curve: np.ndarray


@dataclass(frozen=True)
class Term:
    """The force that is missing, as an equation.

    Attributes:
        equation: sum_i a_i x^(i) = F - (this), with the parameters' names.
        parameters: name to value, unit, stderr and 95 % interval.
        closed_fraction, ci95: as those of a gap.
        after: held-out error with it, %.
        effect: what the augmented model carries.
        drawn: for a figure.
    """

    equation: str
    parameters: dict
    closed_fraction: float | None
    ci95: tuple[float, float] | None
    after: float
    effect: Effect
    drawn: Drawn | None = None

    def as_json(self) -> dict:
        """As docs/contract.md has it."""
        told = {"equation": self.equation, "parameters": self.parameters, "closed_fraction": self.closed_fraction}
        return told | {"ci95": list(self.ci95) if self.ci95 else None}


def found_term(
    case: Case, found: Attribution, model: Model, progress: Callable[[str], None] = lambda line: None
) -> tuple[Term, Judged, Model] | None:
    """The term, what it leaves and `model` with it; None where no sum of functions pays on the records held out.

    Looked for beside the nominal, and beside the best candidate of the catalogue where that closes a part of the gap.
    """
    low, best = floor(case, found.noise, sides(case)[1]), found.base
    for base in (found.base, found.best):
        known = (closed(found.base.heldout, base.heldout, low) or 0.0) >= LEAST
        if base is not found.base and not (known and base.candidate.forms and best.heldout > NEAR * low):
            continue
        tried = search(case, base, low, progress)
        best = tried if tried is not None and tried.heldout * CLOSE <= best.heldout else best
    if best is found.base:
        return None
    best = doubted(case, best, model)
    return told(case, found, best), best, augmented(case, best, model)


def told(case: Case, found: Attribution, best: Judged) -> Term:
    """Equation and parameters in physical units, with what they close."""
    c, (_, held) = best.candidate, sides(case)
    effect = sparse_term(c.values[-1])
    before = sum(h > low for s in c.starts[:-1] for low, h in zip(s.low, s.high, strict=True))
    errors = np.sqrt(np.maximum(np.diag(c.covariance), 0.0))[before:] if c.covariance.size else []
    names = [f"c{k + 1}" for k in range(len(effect.spec.functions))]
    names += [p.name for p, _ in effect.numbers()[len(names) :]]
    rows = {}
    for k, (name, (p, value)) in enumerate(zip(names, effect.numbers(), strict=True)):
        number, unit = physical(case.model, p, float(value))
        spread = abs(float(errors[k]) * (number if p.positive else number / float(value))) if len(errors) else None
        near = [number - 1.96 * spread, number + 1.96 * spread] if spread else None
        rows[name] = {"value": number, "unit": unit, "stderr": spread or None, "ci95": near}
    gap = gap_of(case, found, best, floor(case, found.noise, held), held)
    line = equation(effect, c.forms[:-1], case.model.input_map.one_sided)
    return Term(line, rows, gap.closed_fraction, gap.ci95, best.heldout, effect, _drawn(case, c))


def _drawn(case: Case, c: Candidate) -> Drawn:
    """Of the records held out; the main variable is the one that most of the term's variance goes with."""
    values, scale, (_, held) = c.values[-1], case.model.scales.state, sides(case)
    present = [k for k in range(len(NAMES)) if values[k] != 0]
    points = [Point(NAMES[k], values[len(NAMES) + (LIBRARY[NAMES[k]].knee or 0)]) for k in present]
    chosen = [case.series[k] for k in held]
    top = max(float(np.abs(s.force).max()) for s in case.series) / 100
    whole = np.concatenate([evaluated(s, points, case.dt) @ [values[k] for k in present] for s in chosen]) / top
    lacks = np.concatenate([missing_force(s, c.factors) for s in chosen]) / top
    axes = {"displacement": (0, scale[0]), "velocity": (1, scale[1])}
    spread = {name: np.concatenate([s.motion[:, k] for s in chosen]) * by for name, (k, by) in axes.items()}
    spread["voltage"] = np.concatenate([s.voltage for s in chosen])
    curves = {name: _binned(v, whole) for name, v in spread.items()}
    main = max(curves, key=lambda name: curves[name][2])
    dots = np.linspace(0, len(whole) - 1, min(_DOTS, len(whole))).astype(int)
    return Drawn(main, spread[main][dots], lacks[dots], *curves[main][:2])


def _binned(at: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Middles of equal bins that hold something, the mean force in them, and the share of its variance that it is."""
    place = np.clip(((at - at.min()) / max(np.ptp(at), 1e-30) * _BINS).astype(int), 0, _BINS - 1)
    count = np.bincount(place, minlength=_BINS)
    mean = np.bincount(place, force, _BINS) / np.maximum(count, 1)
    middle = at.min() + (np.arange(_BINS) + 0.5) / _BINS * np.ptp(at)
    share = float(np.var(mean[place]) / max(np.var(force), 1e-30))
    return middle[count > 0], mean[count > 0], share


def equation(effect: Effect, beside: tuple, square: bool) -> str:
    """`missing force = c1 x x' + c2 x^3`, with what stands beside it."""
    terms = " + ".join(f"c{k + 1} {written(name, square)}" for k, name in enumerate(effect.spec.functions))
    memory = ", tau z' = x - z" if any(LIBRARY[name].knee == 3 for name in effect.spec.functions) else ""
    others = f", beside {' and '.join(f'{f.name} ({f.form})' for f in beside)}" if beside else ""
    return f"missing force = {terms}{memory}{others}"


def written(name: str, square: bool) -> str:
    """A function with the voltage in it."""
    if not square:
        return name.replace("F", "V")
    return name.replace("F^2", "V^4").replace("|F|", "V^2").replace("F", "V^2").replace("U", "|V|")

"""A term found in the data where no name fits: the missing force as an equation, judged as an effect is.

    sparse regression -> whole free runs of the best sums (Levenberg-Marquardt) -> the fewest functions that pay

A function stays as long as it pays on drives the fit never saw. What is found describes, it names no cause.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .._effects.base import Start
from .._effects.found_term import LIBRARY, NAMES, FoundTerm, held_knees
from .._model.model import Model
from .batched_rollouts import Lanes
from .case import Case
from .effect_selection import Attribution, bootstrap, moved
from .evaluation import Judged, augmented, floor, judge, sides
from .fit import Candidate, fit
from .parameter_uncertainty import doubted
from .result import closed, gap_of, physical
from .term_regression import Subset, numbers, subsets

_TRIED = ((3, 5), (4, 3))  # sums of one and two functions fitted on whole runs; of three and four
_CLOSE = 1.05  # within this factor of the least held-out error fewer functions win
_NEAR = 1.1  # floors: nothing is left to find
_LEAST = 0.2  # of the gap: what closes less is not told, as with a name
_SETTLED = 8  # iterations: regression begins near


@dataclass(frozen=True)
class Term:
    """The force that is missing, as an equation.

    Attributes:
        equation: sum_i a_i x^(i) = F - (this), with the parameters' names.
        parameters: name to value, unit, stderr and 95 % interval.
        closed_fraction, ci95: as those of a gap.
        after: held-out error with it, %.
        effect: what the augmented model carries.
    """

    equation: str
    parameters: dict
    closed_fraction: float | None
    ci95: tuple[float, float] | None
    after: float
    effect: FoundTerm

    def as_json(self) -> dict:
        """As docs/contract.md has it."""
        told = {"equation": self.equation, "parameters": self.parameters, "closed_fraction": self.closed_fraction}
        return told | {"ci95": list(self.ci95) if self.ci95 else None}


def found_term(
    case: Case, found: Attribution, model: Model, progress: Callable[[str], None] = lambda line: None
) -> tuple[Term, Model] | None:
    """The term and `model` with it; None where no sum of functions pays on the records held out."""
    best = search(case, found.base, floor(case, found.noise, sides(case)[1]), progress)
    if best is None:
        return None
    best = doubted(case, best, model)
    return told(case, found, best), augmented(case, best, model)


def search(case: Case, base: Judged, low: float, progress=lambda line: None) -> Judged | None:
    """The sparse sum that pays, beside a base without effects, or None; `low`: floor of the held-out records, %."""
    start, refit = base.candidate, base.candidate.refit
    around = moved(case, start.factors) if refit else case
    progress("looking for an equation of the missing force")
    by_size = subsets(around, refit)
    lanes, rivals = Lanes(case, [(FoundTerm,)]), [base]
    for stage, counts in enumerate(_TRIED):
        chosen = [s for few, n in zip(by_size[2 * stage :], counts, strict=False) for s in few[:n]]
        rivals += _fitted(lanes, [_candidate(case, s, start) for s in chosen], progress)
        if min(r.heldout for r in rivals) <= _NEAR * low:
            break
    best = _fewest(rivals)
    while _size(best) > 1:
        rivals += _fitted(lanes, [_without(best.candidate, k) for k in _present(best.candidate)], progress)
        fewer = _fewest(rivals)
        if _size(fewer) >= _size(best):
            break
        best = fewer
    return best if _size(best) and _pays(case, base, best, low) else None


def _fitted(lanes: Lanes, candidates: list[Candidate], progress) -> list[Judged]:
    def seen(step: int, least: float) -> None:
        progress(f"term: step {step}, {np.sqrt(least):.3f} %")

    done = fit(lanes, candidates, most=_SETTLED, progress=seen)
    return [j for j in judge(lanes, done) if np.isfinite(j.heldout)]


def _candidate(case: Case, subset: Subset, base: Candidate) -> Candidate:
    """The regression's numbers as a start; what is not in the sum is held at zero."""
    (wide,) = FoundTerm.starts(case.surroundings)
    values = numbers(subset)
    used = {NAMES.index(p.name) for p in subset.points}
    used |= {len(NAMES) + k for k in held_knees(tuple(p.name for p in subset.points))}
    return _held(base, np.clip(values, wide.low, wide.high), wide, used)


def _held(base: Candidate, values, wide: Start, used: set[int]) -> Candidate:
    """A candidate with all numbers but those used held where they are."""
    values = tuple(map(float, values))
    ends = [tuple(b[k] if k in used else values[k] for k in range(len(values))) for b in (wide.low, wide.high)]
    return replace(base, forms=(FoundTerm,), values=(values,), starts=(Start(values, *ends),))


def _present(c: Candidate) -> list[int]:
    """Places of the functions in a sum."""
    return [k for k in range(len(NAMES)) if c.forms and c.values[0][k] != 0]


def _size(j: Judged) -> int:
    return len(_present(j.candidate))


def _without(c: Candidate, place: int) -> Candidate:
    """The sum without one function, and the knees that only this one had."""
    values, start = list(c.values[0]), c.starts[0]
    values[place] = 0.0
    left = tuple(NAMES[k] for k in _present(c) if k != place)
    used = {NAMES.index(name) for name in left} | {len(NAMES) + k for k in held_knees(left)}
    return _held(c, values, start, used)


def _fewest(rivals: list[Judged]) -> Judged:
    """The fewest functions within a few per cent of the least held-out error."""
    least = min(r.heldout for r in rivals)
    return min((r for r in rivals if r.heldout <= _CLOSE * least), key=lambda r: (_size(r), r.heldout))


def _pays(case: Case, base: Judged, best: Judged, low: float) -> bool:
    """It closes a fifth of the gap and more, and on blocks drawn anew it is better."""
    _, held = sides(case)
    gains = bootstrap(case, held, lambda k: base.errors[k] ** 2 - best.errors[k] ** 2)
    return (closed(base.heldout, best.heldout, low) or 0.0) >= _LEAST and bool(np.quantile(gains, 0.025) > 0)


def told(case: Case, found: Attribution, best: Judged) -> Term:
    """Equation and parameters in physical units, with what they close."""
    c, (_, held) = best.candidate, sides(case)
    low = floor(case, found.noise, held)
    effect = FoundTerm.of(c.values[0])
    errors = np.sqrt(np.maximum(np.diag(c.covariance), 0.0)) if c.covariance.size else np.zeros(len(effect.numbers()))
    names = [f"c{k + 1}" for k in range(len(effect.functions))]
    names += [p.name for p, _ in effect.numbers()[len(names) :]]
    rows = {}
    for name, (p, value), error in zip(names, effect.numbers(), errors, strict=False):
        number, unit = physical(case.model, p, float(value))
        spread = abs(float(error) * (number if p.positive else number / float(value)))
        near = [number - 1.96 * spread, number + 1.96 * spread]
        rows[name] = {"value": number, "unit": unit, "stderr": spread or None, "ci95": near if spread else None}
    square = case.model.input_map.one_sided
    sum_ = " + ".join(f"c{k + 1} {written(n, square)}" for k, n in enumerate(effect.functions))
    memory = ", tau z' = x - z" if any(LIBRARY[n].knee == 3 for n in effect.functions) else ""
    gap = gap_of(case, found, best, low, held)
    return Term(f"missing force = {sum_}{memory}", rows, gap.closed_fraction, gap.ci95, best.heldout, effect)


def written(name: str, square: bool) -> str:
    """A function with the voltage in it."""
    if not square:
        return name.replace("F", "V")
    return name.replace("F^2", "V^4").replace("|F|", "V^2").replace("F", "V^2").replace("U", "|V|")

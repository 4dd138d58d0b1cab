"""The sparse sum that pays: sums that regression proposes, fitted on whole runs and judged on records held out.

    sums of one and two functions, then of three and four -> Levenberg-Marquardt -> one function after another left out

The fewest functions within a few per cent of the least held-out error are kept, if they are worth it at all.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .._effects import FOUND_TERM
from .._effects.found_term import NAMES, held_knees
from .._effects.spec import Start
from .batched_rollouts import Lanes
from .bootstrap import means
from .case import Case, build_case
from .effect_selection import moved
from .evaluation import Judged, augmented, judge, sides
from .fit import Candidate, fit
from .result import closed
from .term_regression import Subset, numbers, subsets

_TRIED = ((3, 5), (4, 3), (2, 2))  # sums of one and two functions fitted on whole runs; of three and four; of more
CLOSE, _SLIGHT = 1.05, 0.02  # of the least held-out error, and of the base's: within both together fewer functions win
NEAR = 1.1  # floors: nothing is left to find
LEAST = 0.2  # of the gap: what closes less is not told, as with a name
_MUCH = 0.1  # of the base's error, which sums of more than four functions are tried for
_SETTLED = 8  # iterations: regression begins near


def search(case: Case, base: Judged, low: float, progress: Callable[[str], None] = lambda line: None) -> Judged | None:
    """The sparse sum that pays beside a base, or None; `low`: floor of the held-out records, %."""
    start = base.candidate
    around = moved(case, start.factors) if start.refit else case
    if start.forms:
        model = augmented(case, base, case.model)
        around = build_case(model, [s.record for s in case.series], how=case.split, mesh=case.mesh)
    progress("looking for an equation of the missing force")
    by_size = _needed(subsets(around, start.refit))
    lanes, rivals = Lanes(case, [(*start.forms, FOUND_TERM)]), [base]
    for stage, counts in enumerate(_TRIED):
        chosen = [s for few, n in zip(by_size[2 * stage :], counts, strict=False) for s in few[:n]]
        if not chosen:
            break
        rivals += _fitted(lanes, [_candidate(case, s, start) for s in chosen], progress)
        left = min(r.heldout for r in rivals)
        if left <= NEAR * low or (stage and left <= np.hypot(NEAR * low, _MUCH * base.heldout)):
            break
    best = _fewest(rivals)
    while _size(best) > 1:
        rivals += _fitted(lanes, [_without(start, best.candidate, k) for k in _present(best.candidate)], progress)
        fewer = _fewest(rivals)
        if fewer.candidate.size >= best.candidate.size:
            break
        best = fewer
    return best if _size(best) and _pays(case, base, best, low) else None


def _needed(by_size: list[list[Subset]]) -> list[list[Subset]]:
    """Sums of as many functions as regression needs: free runs near a fold are too sensitive to say."""
    least = CLOSE**2 * min(s.train for few in by_size for s in few)
    return by_size[: 1 + next(k for k, few in enumerate(by_size) if few[0].train <= least)]


def _fitted(lanes: Lanes, candidates: list[Candidate], progress) -> list[Judged]:
    def seen(step: int, least: float) -> None:
        progress(f"term: step {step}, {np.sqrt(least):.3f} %")

    done = fit(lanes, candidates, most=_SETTLED, progress=seen)
    return [j for j in judge(lanes, done) if np.isfinite(j.heldout)]


def _candidate(case: Case, subset: Subset, base: Candidate) -> Candidate:
    """The regression's numbers as a start."""
    (wide,) = FOUND_TERM.start(case.surroundings)
    return _held(base, np.clip(numbers(subset), wide.low, wide.high), wide, tuple(p.name for p in subset.points))


def _held(base: Candidate, values, wide: Start, names: tuple[str, ...]) -> Candidate:
    """A base with the sum of these functions; all other numbers are held where they are."""
    used = {NAMES.index(name) for name in names} | {len(NAMES) + k for k in held_knees(names)}
    values = tuple(float(v) for v in values)
    ends = [tuple(b[k] if k in used else values[k] for k in range(len(values))) for b in (wide.low, wide.high)]
    forms, numbers_, starts = (*base.forms, FOUND_TERM), (*base.values, values), (*base.starts, Start(values, *ends))
    return replace(base, forms=forms, values=numbers_, starts=starts)


def _present(c: Candidate) -> list[int]:
    """Places of the functions in a sum."""
    return [k for k in range(len(NAMES)) if FOUND_TERM in c.forms and c.values[-1][k] != 0]


def _size(j: Judged) -> int:
    return len(_present(j.candidate))


def _without(base: Candidate, c: Candidate, place: int) -> Candidate:
    """The sum without one function, and the knees that only this one had."""
    values = list(c.values[-1])
    values[place] = 0.0
    return _held(base, values, c.starts[-1], tuple(NAMES[k] for k in _present(c) if k != place))


def _fewest(rivals: list[Judged]) -> Judged:
    """The fewest numbers within a few per cent of the least held-out error, and of the base's (the first's)."""
    most = np.hypot(CLOSE * min(r.heldout for r in rivals), _SLIGHT * rivals[0].heldout)
    return min((r for r in rivals if r.heldout <= most), key=lambda r: (r.candidate.size, r.heldout))


def _pays(case: Case, base: Judged, best: Judged, low: float) -> bool:
    """It closes a fifth of the gap and more, and on blocks drawn anew it is better."""
    _, held = sides(case)
    gains = means(case, held, lambda k: base.errors[k] ** 2 - best.errors[k] ** 2)
    return (closed(base.heldout, best.heldout, low) or 0.0) >= LEAST and bool(np.quantile(gains, 0.025) > 0)

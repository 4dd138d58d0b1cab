"""Fit every candidate (order, delay, hold) and choose: the fewest parameters whose held-out score is near the best.

    score(order, delay, hold)  by `heldout`;    near: within 3 % of the best, nothing below 0.1 % of the output counting
    fewest poles and delays;  of as many the lower order within 1 %, else the better score;  of those the better hold

Every order stands under its own best hold (in sample: as many parameters), since half a sample of lag is a pole:
compared under one hold, a plant of order 2 behind a held voltage becomes one of order 3. More than 3 % would take zoh
for half a sample of delay (+6.5 %); no delay is kept that buys nothing held out (two servo joints: 7 to 14 % in sample,
-8 % on other records).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from .._model.model import Hold
from .frequency_fit import fit_response
from .frequency_response import FrequencyResponse
from .heldout import HeldOut, held_out
from .linear_ode import logs_from_roots
from .output_error import Problem, Structure, least_squares
from .starts import best_starts, guesses, one_more

NEAR, TIE, LEAST = 1.03, 1.01, 1e-3
_ALWAYS = 3  # orders that are tried in any case; one more since a mode is two; then while the last wins
_NO_WORSE = 1.001  # an order holds every lower one: a higher cost means that the search stopped short
_STEPS, _LEAST_STEP = 40, 1e-5  # of a fit that is only to be compared; the chosen one goes on
_DELAY = 0.05  # samples: a shorter delay is none; to start from, since none has no slope

Ending = tuple[np.ndarray, float, bool]  # parameters, cost, converged


@dataclass(frozen=True)
class Candidate:
    """One structure, its parameters, what it leaves in sample (mean square of the output's), and held out."""

    structure: Structure
    params: np.ndarray
    cost: float
    converged: bool
    heldout: HeldOut

    @property
    def score(self) -> float:
        """Held out, with what no record resolves."""
        return float(np.hypot(self.heldout.score, LEAST))


def search(
    problem: Problem,
    response: FrequencyResponse,
    pair: np.ndarray | None,
    *,
    orders: Sequence[int],
    holds: Sequence[Hold],
    delays: Sequence[bool],
    progress: Callable[[str], None],
) -> list[Candidate]:
    """All candidates that could be fitted, in ascending order; `pair`: poles of order 2 known beforehand (rad/s)."""
    told = fit_response(response, problem.fine, orders, delays) if response.rich else {}
    roots = cache(lambda order: guesses(order, problem) + _with_pair(pair, order))
    found: list[Candidate] = []
    for order in orders:
        if (
            order > _ALWAYS
            and len(orders) > 1
            and choose(found).structure.order < order - (2 if order == _ALWAYS + 1 else 1)
        ):
            break
        here: list[Candidate] = []
        for delayed in delays:
            ends: list[tuple[Structure, Ending]] = []
            for hold in holds:
                structure = Structure(order, hold, delayed)
                end = _fitted(structure, problem, told, roots, found + here, ends[0][1] if ends else None)
                ends += [] if end is None else [(structure, end)]
            if not ends:
                continue
            structure, (params, cost, converged) = min(ends, key=lambda e: e[1][1])
            if not delayed or len(delays) == 1 or np.exp(params[-1]) > _DELAY * problem.fine:
                with np.errstate(all="ignore"):
                    here.append(Candidate(structure, params, cost, converged, held_out(params, structure, problem)))
        if not here:
            continue
        found += here
        best = min(here, key=lambda c: c.score)
        progress(f"order {order}: {100 * best.score:.3g} % of the output's deviation left on blocks left out")
    return found


def _fitted(structure: Structure, problem: Problem, told, roots, found: Sequence[Candidate], other) -> Ending | None:
    """Where the fit ends from where the frequency response leads; where that tells nothing, from the best of others."""
    order, delayed = structure.order, structure.delayed
    known = {(c.structure.order, c.structure.delayed): c for c in found}
    lower, prompt = known.get((order - 1, delayed)), known.get((order, False)) if delayed else None
    start, short = told.get((order, delayed)), np.log(_DELAY * problem.fine)
    if other is not None:  # under another hold: what is best there is near
        start = other[0]
    elif start is not None and delayed:
        start = np.append(start[:-1], max(start[-1], short))
    ends = [] if start is None else [least_squares(start, structure, problem, _STEPS, _LEAST_STEP)]
    bound = _NO_WORSE * min((c.cost for c in (lower, prompt) if c is not None), default=np.inf)
    if lower is None and order > 1 and other is None and len(problem.drive) > 1:
        bound = -np.inf  # asked for alone: the lines of several sines together pass for a sweep's
    if not ends or min(e[1] for e in ends) > bound:
        sets = roots(order) + ([] if lower is None else one_more(lower.params[: order - 1]))
        some = best_starts(structure, problem, sets, most=2)
        some += [np.append(prompt.params, short)] if prompt is not None else []
        ends += [least_squares(s, structure, problem, _STEPS, _LEAST_STEP) for s in some]
    ends = [e for e in ends if np.isfinite(e[1])]
    return min(ends, key=lambda e: e[1]) if ends else None


def _with_pair(pair: np.ndarray | None, order: int) -> list[np.ndarray]:
    if pair is None or order not in (2, 3):
        return []
    return [pair] if order == 2 else one_more(logs_from_roots(pair))


def choose(candidates: Sequence[Candidate]) -> Candidate:
    """The rule at the head of this file."""
    best = min(c.score for c in candidates)
    near = [c for c in candidates if c.score <= NEAR * best]
    fewest = min(c.structure.complexity for c in near)
    near = [c for c in near if c.structure.complexity == fewest]
    least = min(c.score for c in near)
    order = min(c.structure.order for c in near if c.score <= TIE * least)
    return min((c for c in near if c.structure.order == order), key=lambda c: c.score)

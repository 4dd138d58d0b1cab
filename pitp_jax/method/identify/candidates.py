"""Fit every candidate (order, delay, hold) and choose the fewest parameters whose held-out error is near the smallest.

    score(order, delay, hold)  by `heldout`;    near: within 3 % of the best, or 0.1 % of the output
    fewest poles and delays;  if equal, the lower order within 1 %, otherwise the better score

Every order is compared under its own best hold (in sample: equally many parameters), because half a sample of lag acts
like a pole: under one common hold, a plant of order 2 behind a held voltage becomes one of order 3. A tolerance above
3 % would take zoh for half a sample of delay (+6.5 %). A delay is kept only if it improves the held-out score (two
servo joints: 7 to 14 % in sample, -8 % on other records).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from ..model.model import Hold
from .frequency_fit import fit_response
from .frequency_response import FrequencyResponse
from .heldout import Candidate, held_out
from .order_fit import identifiable
from .output_error import Fit, OutputError, Problem, Structure, least_squares
from .starts import best_starts, guesses, one_more

ORDERS = tuple(range(1, 7))
NEAR = 1.03
_ALWAYS = 3  # orders that are always tried; then one more, because a mode is two poles; then while the last one wins
_NO_WORSE = 1.001  # an order contains every lower one, so a higher cost means that the search stopped early
HALF = 0.5  # fraction of the output's deviation; as a cost, a fraction of the residual's mean square
_DELAY = 0.05  # samples: a shorter delay counts as none; a delay also starts here, because 0 has no slope


def search(
    problem: Problem,
    response: FrequencyResponse,
    *,
    orders: Sequence[int],
    holds: Sequence[Hold],
    delays: Sequence[bool],
    progress: Callable[[str], None],
) -> list[Candidate]:
    """Fit and return all candidates in ascending order."""
    by_response = fit_response(response, problem.fine, orders, delays) if response.rich else {}
    roots = cache(lambda order: guesses(order, problem))
    candidates: list[Candidate] = []
    for order in orders:
        if order > _ALWAYS and len(orders) > 1 and not _worth_trying(order, candidates):
            break
        here: list[Candidate] = []
        for delayed in delays:
            if here and order > _ALWAYS and not here[0].known:
                break  # if the poles are unknown without a delay, they are unknown with one
            ends: list[Fit] = []
            for hold in holds:
                if ends and delayed and problem.fine < problem.dt:
                    break  # of block means, holds differ by half a sample of delay
                structure = Structure(order, hold, delayed)
                if ends:
                    end = _short(_under(hold, ends[0], problem), structure, problem)
                else:
                    end = _fitted(structure, problem, by_response, roots, candidates + here)
                if np.isfinite(end.cost):
                    ends.append(end)
            if not ends:
                continue
            end = _best(ends)
            if delayed and np.exp(end.params[-1]) <= _DELAY * problem.fine:
                # no delay, but a start that the order without one did not have
                if not here or end.cost * _NO_WORSE >= here[0].cost:
                    continue
                end = _short(end.params[:-1], here.pop().structure, problem)
            here.append(_scored(end, problem))
        if not here:
            continue
        candidates += here
        best = min(here, key=lambda c: c.score)
        progress(f"order {order}: error {100 * best.score:.3g} % of the output's deviation on held-out blocks")
    return candidates


def without_spring(candidates: Sequence[Candidate], problem: Problem, holds: Sequence[Hold]) -> list[Candidate]:
    """Return a candidate with a pole at 0 for each whose slowest pole turns less than 1 rad in the records."""
    found = []
    for c in candidates:
        known = c.on(problem).poles
        slowest = np.argmin(np.abs(known))
        if np.abs(known[slowest]) * problem.seconds > 1:
            continue
        rest = np.delete(known, slowest)
        rest = np.where(np.isclose(rest, np.conj(known[slowest])), -np.abs(rest), rest)  # half of a pair is real
        ends: list[Fit] = []
        for hold in holds:
            structure = replace(c.structure, integrates=True, hold=hold)
            roots = [rest, *(guesses(structure.moved, problem) if structure.moved else [])]
            starts = [_under(hold, end, problem) for end in ends] or best_starts(structure, problem, roots, most=2)
            ends += [_short(start, structure, problem) for start in starts]
        if ends:
            found.append(_scored(_best(ends), problem))
    return found


def _best(ends: Sequence[Fit]) -> Fit:
    return min(ends, key=lambda end: end.cost)


def _scored(end: Fit, problem: Problem) -> Candidate:
    error = OutputError(end.params, end.structure, problem)
    with np.errstate(all="ignore"):
        return Candidate(*end, held_out(end.params, end.structure, problem), known=identifiable(error, end.converged))


def _worth_trying(order: int, earlier: Sequence[Candidate]) -> bool:
    """Return whether an order is worth fitting: the best model so far is of the last order (or one less, at order 4).

    It also does if no order explains half of the output yet, or the last one halved the in-sample cost: three poles for
    two modes explain no held-out block.
    """
    known = [c for c in earlier if c.known]
    costs = [min((c.cost for c in known if c.structure.order < n), default=np.inf) for n in (order - 1, order)]
    if not known:
        return False
    first, best = order == _ALWAYS + 1, choose(known)
    unexplained = first and best.score > HALF
    return unexplained or best.structure.order >= order - 1 - first or costs[1] < HALF * costs[0]


def _under(hold: Hold, other: Fit, problem: Problem) -> np.ndarray:
    """Return initial parameters from a fit with another hold of the input; a delay shifts by half a sample."""
    structure, params = other.structure, other.params
    if structure.delayed and hold != structure.hold:
        moved = (0.5 if structure.hold == "zoh" else -0.5) * problem.fine
        params = np.append(params[:-1], np.log(max(np.exp(params[-1]) + moved, _DELAY * problem.fine)))
    return params


def _fitted(structure: Structure, problem: Problem, by_response, roots, earlier: Sequence[Candidate]) -> Fit:
    """Fit one candidate from the frequency response, and from more initial guesses if a simpler model fits better."""
    order, delayed = structure.order, structure.delayed
    known, short = {(c.structure.order, c.structure.delayed): c for c in earlier}, np.log(_DELAY * problem.fine)
    lower, prompt = known.get((order - 1, delayed)), known.get((order, False)) if delayed else None
    bound = _NO_WORSE * min((c.cost for c in (lower, prompt) if c is not None), default=np.inf)
    if lower is None and order > 1 and len(problem.drive) > 1:
        bound = -np.inf  # asked for alone: the lines of several sines together look like a sweep

    def fitted(starts) -> list[Fit]:
        return [_short(start, structure, problem) for start in starts]

    known_starts = [by_response[order, delayed]] if (order, delayed) in by_response else []
    if delayed:
        known_starts = [np.append(start[:-1], max(start[-1], short)) for start in known_starts]
    ends, nested = fitted(known_starts), []
    if prompt is not None:
        nested.append(np.append(prompt.params, short))
    if lower is not None:
        nested += best_starts(structure, problem, one_more(lower.params[: order - 1]), most=1)
    if ends and not _settled(ends, bound, problem):
        ends, nested = ends + fitted(nested), []
    if not ends or not _settled(ends, bound, problem):
        ends += fitted(best_starts(structure, problem, roots(order), most=2) + nested)
    return _best([*ends, Fit(structure, np.zeros(0), np.inf, False)])


def _settled(ends: Sequence[Fit], bound: float, problem: Problem) -> bool:
    """Return whether more initial guesses are unnecessary: the fit is good, was found twice, or has no delay."""
    structure, params, least, _ = _best(ends)
    # two fits that differ by less found the same minimum
    again = sum(end.cost <= (1 + 1e-4) * least for end in ends) > 1
    none = structure.delayed and np.exp(params[-1]) <= _DELAY * problem.fine
    return bool(np.isfinite(least) and bound > 0 and (least <= bound or again or none))


def _short(start: np.ndarray, structure: Structure, problem: Problem) -> Fit:
    return least_squares(start, structure, problem, 40, 1e-5)  # the chosen fit is continued


def choose(candidates: Sequence[Candidate]) -> Candidate:
    """Return the candidate with the fewest parameters whose held-out error is within 3 % of the smallest.

    The rules for ties are at the head of this file.
    """
    best = min(c.score for c in candidates)
    near = [c for c in candidates if c.score <= NEAR * best]
    fewest = min(c.structure.complexity for c in near)
    near = [c for c in near if c.structure.complexity == fewest]
    least = min(c.score for c in near)
    order = min(c.structure.order for c in near if c.score <= 1.01 * least)
    return min((c for c in near if c.structure.order == order), key=lambda c: c.score)

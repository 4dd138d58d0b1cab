"""A second effect: the pair that explains what no single one does, if it pays.

    pairs of names by screening -> whole-rollout fits -> other forms of the near ones -> judged as singles are
    where one leaves ten floors:   screening around the best single ones -> fits beside them

It stays only if it takes off a good part of what the first one left. On a Peano-HASEL whose cycles repeat to 0.1 %
of range the best single effect left 4.1 %. Screened around it a slack leads by a factor of two to three; screened as
pairs, the first one's numbers on their grid, a slack beside the exponential coupling was not among the foremost.
"""

from dataclasses import replace

import numpy as np

from .._model.fitted import Fitted
from .batched_rollouts import Lanes
from .budget import Budget
from .case import Case, build_case
from .evaluation import Judged, augmented, floor, judge, parsimonious, sides, tried
from .noise import Noise
from .regress import Screened, Screening, pairs, singles
from .screen import screen

# pairs of names; those foremost, within this factor of the least error, show other forms, that many each: an end stop
# behind an electrode was first seen with the electrode's worse form, and lost to a slew limit
_PAIRS, _FOREMOST, _NEAR, _FORM_PAIRS = 8, 4, 2.0, 4
# a second effect must remove at least that share of the gap's energy, and leave little of what one left (or less than
# it, where the share is large)
_LEAST, _LITTLE, _LESS, _MUCH = 0.01, 0.35, 0.7, 0.1
# what one leaves is a gap of its own from so many floors on, and the least share is then enough; of 92 single effects
# on tuning seeds one leaves more (a slack, 10.7)
_PLAIN = 10.0
_HALF = 0.5  # of the error: what takes off less is no first effect to look around
_AROUND, _PARTNERS, _WITHIN = 2, 2, 1.1  # single effects screened around, names and forms tried beside each


def second(
    case: Case,
    catalogue,
    screening: Screening,
    first: Judged,
    rivals: list[Judged],
    base: Judged,
    noise: Noise,
    refit: bool,
    progress,
    budget: Budget,
):
    """The best pair and its rivals, if it pays, else None; screened as pairs, for one may hide the other.

    `first`: the best of the single ones, `rivals`.
    """
    _, held = sides(case)
    low = floor(case, noise, held)
    whole = max(base.heldout**2 - low**2, 1e-30)
    if first.heldout <= 1.15 * low or base.heldout <= 1.1 * low or first.heldout**2 - low**2 < _LEAST * whole:
        return None  # no gap, or less of it left than a second effect must remove
    if not budget.allows("two effects at once"):
        return None
    chosen = pairs(screening, _PAIRS)
    if not chosen:
        return None

    def fitted(some: list[Screened]) -> list[Judged]:
        return tried(case, catalogue, some, refit, [], progress, first.candidate.train, budget)

    judged = fitted(chosen)
    done = {frozenset(j.candidate.forms) for j in judged}
    foremost = sorted(judged, key=lambda j: j.train)[:_FOREMOST]
    foremost = [j for j in foremost if j.train <= _NEAR * foremost[0].train]
    others = [s for j in foremost for s in pairs(screening, _FORM_PAIRS, frozenset(j.names))]
    others = [s for s in others if frozenset(s.forms) not in done]
    if others and foremost[0].train < first.train and budget.allows("other forms of two effects"):
        judged += fitted(others)
    plain = _PLAIN * low < first.heldout < _HALF * base.heldout
    if plain and budget.allows("effects around the best ones"):
        progress("screening around the best effects")
        around = _around(case, catalogue, rivals, refit)
        judged += fitted(around) if around else []
    best = parsimonious(judged)
    left = np.sqrt(max(best.heldout**2 - low**2, 0.0) / max(first.heldout**2 - low**2, 1e-30))
    share = (first.heldout**2 - best.heldout**2) / whole
    said = " and ".join(best.names)
    progress(f"{said}: leaves {100 * left:.0f} % of what one left, removes {100 * share:.2g} % of the gap")
    less = left <= _LESS and (plain or share >= _MUCH)
    pays = share >= _LEAST and (left <= _LITTLE or less) and best.train < first.train
    return (_foremost_first(case, best), judged) if pays else None


def _around(case: Case, catalogue, rivals: list[Judged], refit: bool) -> list[Screened]:
    """Pairs of a fitted effect and what screens best around a nominal that has it."""
    least = min(r.heldout for r in rivals)
    near: dict[tuple[str, ...], Judged] = {}
    for r in sorted(rivals, key=lambda r: r.heldout):
        if r.candidate.forms and r.heldout <= _WITHIN * least:
            near.setdefault(r.names, r)
    found = []
    for r in list(near.values())[:_AROUND]:
        model, c = augmented(case, r, case.model), r.candidate
        beside = build_case(Fitted(model, case.origin), [s.record for s in case.series], how=case.split, mesh=case.mesh)
        partners = [s for s in singles(screen(beside, catalogue, c.factors, refit=refit)) if s.names != r.names]
        for name in list(dict.fromkeys(s.names for s in partners))[:_PARTNERS]:
            for s in [s for s in partners if s.names == name][:_PARTNERS]:
                forms, values, limits = (*c.forms, *s.forms), (*c.values, *s.values), (*c.starts, *s.starts)
                found.append(Screened(forms, values, limits, s.factors, s.train, s.heldout))
    return found


def _foremost_first(case: Case, pair: Judged) -> Judged:
    """The pair with the effect first that leaves more behind when it is taken away."""
    c = pair.candidate
    lanes = Lanes(case, [c.forms])
    alone = [
        replace(c, forms=(f,), values=(v,), starts=(s,)) for f, v, s in zip(c.forms, c.values, c.starts, strict=True)
    ]
    left = [j.heldout for j in judge(lanes, alone)]
    if left[0] <= left[1]:
        return pair
    free = [sum(h > low for low, h in zip(s.low, s.high, strict=True)) for s in c.starts]
    order = np.r_[free[0] : free[0] + free[1], : free[0], free[0] + free[1] : len(c.covariance)]
    turned = replace(
        c,
        forms=c.forms[::-1],
        values=c.values[::-1],
        starts=c.starts[::-1],
        covariance=c.covariance[np.ix_(order, order)],
    )
    return replace(pair, candidate=turned)

"""A second effect: the pair that explains what no single one does, if it pays.

    pairs of names by screening -> whole-rollout fits -> other forms of the near ones -> judged as singles are

It stays only if it takes off a good part of what the first one left.
"""

from dataclasses import replace

import numpy as np

from .case import Case
from .judged import Judged, floor, in_order, judge, parsimonious, sides, tried
from .lanes import Lanes
from .noise import Noise
from .regress import Screening, pairs

# pairs of names; those foremost, within this factor of the least error, show other forms, that many each: an end stop
# behind an electrode was first seen with the electrode's worse form, and lost to a slew limit
_PAIRS, _FOREMOST, _NEAR, _FORM_PAIRS = 8, 4, 2.0, 4
# a second effect must remove at least that share of the gap's energy, and leave little of what one left (or less than
# it, where the share is large)
_LEAST, _LITTLE, _LESS, _MUCH = 0.005, 0.35, 0.7, 0.1


def second(
    case: Case,
    catalogue,
    screening: Screening,
    first: Judged,
    base: Judged,
    noise: Noise,
    refit: bool,
    factors,
    progress,
):
    """The best pair and its rivals, if it pays, else None; screened as pairs, for one may hide the other."""
    _, held = sides(case)
    low = floor(case, noise, held)
    if first.heldout <= 1.15 * low or base.heldout <= 1.1 * low:
        return None
    chosen = pairs(screening, _PAIRS)
    if not chosen:
        return None
    judged = tried(case, catalogue, chosen, factors, refit, [], progress)
    done = {frozenset(j.candidate.forms) for j in judged}
    foremost = sorted(judged, key=lambda j: j.train)[:_FOREMOST]
    foremost = [j for j in foremost if j.train <= _NEAR * foremost[0].train]
    others = [s for j in foremost for s in pairs(screening, _FORM_PAIRS, frozenset(j.names))]
    others = [s for s in others if frozenset(s.forms) not in done]
    if others:
        judged += tried(case, catalogue, others, factors, refit, [], progress)
    best = parsimonious(judged)
    left = np.sqrt(max(best.heldout**2 - low**2, 0.0) / max(first.heldout**2 - low**2, 1e-30))
    share = (first.heldout**2 - best.heldout**2) / max(base.heldout**2 - low**2, 1e-30)
    said = " and ".join(best.names)
    progress(f"{said}: leaves {100 * left:.0f} % of what one left, removes {100 * share:.2g} % of the gap")
    pays = share >= _LEAST and (left <= _LITTLE or (left <= _LESS and share >= _MUCH)) and best.train < first.train
    return (_foremost_first(case, catalogue, best), judged) if pays else None


def _foremost_first(case: Case, catalogue, pair: Judged) -> Judged:
    """The pair with the effect first that leaves more behind when it is taken away."""
    c = pair.candidate
    lanes = Lanes(case, in_order(catalogue, c.forms))
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

"""When a gap is explained: the rule and its thresholds, for the diagnosis and for the page that tells of it.

no_gap      before, or what is left of it once every record's zero and direction are fitted, <= GAP floors; or <= DOUBT
            floors, of which no effect closes ENOUGH
unknown     no gap, but the floor is more than a sensor makes; less than HALF closed; less than ENOUGH where more than
            LITTLE floors are left, less than MOST where more than MUCH floors or LARGE % of range are; more than
            TOO_LARGE % of range left; no less left than by zeros and directions alone; more than TIES names tied; an
            effect that can be written in one way only leaves more than ONLY times what the healthy nominal left
explained   else

All figures held out. A confident wrong name costs a laboratory a week, `unknown` an hour.
"""

from collections.abc import Sequence

import numpy as np

from .case import Case
from .effect_selection import Attribution
from .evaluation import CLOSE, Judged
from .noise import STRUCK
from .result import GAP, Gap, closed

TIES = 3  # a list of four and more names is no answer
DOUBT = 1.4  # how far off the floor may be: AR(0.9) noise in records of 1500 samples reads 15 % low
HELPS = 0.2  # a best candidate that closes less explains nothing, and what is tied with it neither
HALF = 0.5  # what closes less explains nothing, however high the floor
# Tuning seeds: true names of another form close 0.81 at least (0.76 at 2.1 floors after a refit), a curved sensor, of
# which no form was known, 0.67. With the true name left out (seeds 100 and 101, not fresh in this) what stands in
# closes 0.69 to 0.89, and what of it lies below 0.8 leaves 4.9 floors at least
LITTLE, ENOUGH = 1.5, 0.72
MUCH, MOST = 3.0, 0.80
LARGE, TOO_LARGE = 5.0, 10.0  # % of range: what a laboratory would not call explained (docs/effects.md)
ONLY = 2.0  # with the true name left out, a charge leak passed for a voltage offset (77 % closed, 4.9 floors left)


def verdict(gap: Gap, found: Attribution, own: float, rezeroed: float = np.inf) -> str:
    """`own`: what the nominal left where nothing was wrong, over the noise; `rezeroed` as below."""
    low = gap.noise_floor or 0.0
    share = gap.closed_fraction or 0.0
    level = min(gap.before, rezeroed)
    if level <= GAP * low or (level <= DOUBT * low and (closed(level, gap.after, low) or 0.0) < ENOUGH):
        return "unknown" if found.noise.sigma > STRUCK * found.noise.sensor else "no_gap"
    least = max(HALF, ENOUGH * (gap.after > LITTLE * low), MOST * (gap.after > min(MUCH * low, LARGE)))
    worse = gap.after > TOO_LARGE or CLOSE * gap.after > rezeroed
    if share < least or worse or len(found.equivalent) > TIES:
        return "unknown"
    no_excuse = all(f.only for f in found.best.candidate.forms)  # a parameter change has no form at all
    return "unknown" if no_excuse and gap.after > ONLY * own * low > 0 else "explained"


def rezeroed(case: Case, base: Judged, which: Sequence[int]) -> float:
    """What the nominal leaves of these records where the zero and direction of each are fitted, pooled, % of range."""
    squares = []
    for k in which:
        s, error = case.series[k], base.errors[k]
        counts, twice = s.weight > 0, 200 * (s.run - s.error) / s.span
        squares.append(min(np.var(error[counts]), np.var((error + twice)[counts])))
    return float(np.sqrt(np.mean(squares)))

"""Attribution: which effect, and which others the data cannot tell from it.

    screen all forms -> whole-rollout fits of the best names' forms -> judge on held-out records -> a second effect

Judged on drives the fit never saw; within 3 % of the least error the fewest numbers win. Names are tied where a paired
block bootstrap of the held-out difference holds zero, or where neither reaches the floor and both stay equally far.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .._effects import CATALOGUE, REMAINDERS
from .._effects.memory import BORDER
from .bootstrap import means
from .budget import Budget
from .case import Case, build_case
from .effect_pairs import second
from .evaluation import CLOSE, Judged, floor, parsimonious, sides, tried
from .fit import Candidate
from .noise import Noise, estimate
from .regress import Screened, singles
from .screen import screen

_NAMES, _FORMS = 5, 12  # finalists
# what a change of all coefficients holds as one number: no candidates of a refit, where a gain's column, the nominal's
# run, less the coefficients' is the whole error, so that it stood first in every screening and half of every pair.
# And the most floors that a nominal is granted of its own: one a twentieth off its noise left a sensor's gain 0.306 %,
# and all three coefficients, which mended it as well, 0.292
_WITHIN, _OWN = ("added_mass", "sensor_gain"), 2.0


@dataclass(frozen=True)
class Attribution:
    """Everything a diagnosis concludes from.

    Attributes:
        given: the nominal as given; base: refitted where that was asked for, else the same.
        ranking: every name's best single form, the one preferred first, then by held-out error.
        screened: the screening of all forms.
        best: the chosen explanation (one or two effects, or the parameter change).
        equivalent: names these data cannot tell from the first effect; rivals: what they stand for, in their order.
        noise: the floor.
    """

    given: Judged
    base: Judged
    ranking: tuple[Judged, ...]
    screened: tuple[Screened, ...]
    best: Judged
    equivalent: tuple[str, ...]
    rivals: tuple[Judged, ...]
    noise: Noise


def attribute(
    case: Case,
    *,
    refit: bool,
    exclude: Sequence[str] = (),
    progress: Callable[[str], None] = lambda line: None,
    budget: Budget | None = None,
) -> Attribution:
    """Fit, judge and compare every effect of the catalogue but the excluded names, and what holds one as its rest."""
    budget = budget or Budget()
    without = {*exclude, *(_WITHIN if refit else ())}
    catalogue = tuple(
        c for c in CATALOGUE if c.name not in without and not (c in REMAINDERS and REMAINDERS[c][0].name in without)
    )
    noise = estimate(case, [s.error for s in case.series])
    ones = np.ones(case.model.order + 1)
    progress("screening every form")
    screening = screen(case, catalogue, ones, refit=refit)
    screened = singles(screening)
    bare = [Candidate((), (), (), ones, False), Candidate((), (), (), ones, True)]
    given, changed, *rivals = tried(case, catalogue, finalists(screened), refit, bare, progress, budget=budget)
    base = changed if refit else given
    least = min([changed, *rivals], key=lambda r: r.train)
    again = refit and least.train > 1.15 * floor(case, noise, sides(case)[0])
    if again and budget.allows("a screening from the refitted nominal"):
        progress("screening again from the refitted nominal")
        factors = least.candidate.factors
        screening = screen(moved(case, factors), catalogue, factors, refit=True)
        screened = singles(screening)
        rivals += tried(case, catalogue, finalists(screened), True, [], progress, least.candidate.train, budget)
    if not refit and "parameter_change" not in exclude:
        rivals.append(changed)
    _, held = sides(case)
    best = _part_of_a_change(parsimonious(rivals), rivals, floor(case, noise, held), case.model.provenance.misfit)
    noise = _lower(noise, estimate(case, _scaled_errors(case, best)))
    ranking = tuple(sorted(_by_name(rivals), key=lambda j: (j.names != best.names, j.heldout)))
    pair = second(case, catalogue, screening, best, rivals, base, noise, refit, progress, budget)
    if pair:
        best, rivals = pair[0], [r for r in pair[1] if pair[0].names[1] in r.names]
    equal = equivalents(case, best, rivals, noise, held)
    return Attribution(given, base, ranking, tuple(screened), best, *equal, noise)


def _part_of_a_change(best: Judged, rivals: Sequence[Judged], low: float, own: float) -> Judged:
    """For a changed nominal the one number it stands for, where what that leaves more was the nominal's before."""
    if best.candidate.forms or not np.isfinite(own):
        return best
    most = (CLOSE * best.heldout) ** 2 + (min(own, _OWN) ** 2 - 1) * low**2
    within = [r for r in rivals if r.names[0] in _WITHIN and len(r.names) == 1 and r.heldout**2 <= most]
    return min(within, key=lambda r: r.heldout, default=best)


def moved(case: Case, factors: np.ndarray) -> Case:
    """The case around a nominal with other coefficients: a filter far from the plant misleads the screening."""
    return build_case(case.model.changed(factors), [s.record for s in case.series], how=case.split, mesh=case.mesh)


def finalists(screened: list[Screened]) -> list[Screened]:
    """The forms worth a rollout: up to three of each of the best names."""
    names, found = [], []
    for s in screened:
        if s.names[0] not in names:
            names.append(s.names[0])
    for name in names[:_NAMES]:
        forms = [s for s in screened if s.names[0] == name]
        found += forms[:3]  # all of them: the true form of a pure lag screened at three times the error of a ladder
    return sorted(found, key=lambda s: s.train)[:_FORMS]


def _by_name(rivals: Sequence[Judged]) -> list[Judged]:
    best: dict[frozenset[str], Judged] = {}
    for r in rivals:
        names = frozenset(r.names)
        if names not in best or r.heldout < best[names].heldout:
            best[names] = r
    return list(best.values())


def _scaled_errors(case: Case, judged: Judged) -> list[np.ndarray]:
    return [e * s.span / 100 for e, s in zip(judged.errors, case.series, strict=True)]


def _lower(first: Noise, second: Noise) -> Noise:
    """Contamination only adds: the lower of two estimates."""
    return second if 0 < second.sigma < first.sigma else first


def equivalents(case: Case, best: Judged, rivals: Sequence[Judged], noise: Noise, held) -> tuple[tuple, tuple]:
    """Names whose best form is tied with the first effect of `best` (beside the same second one), and those forms."""
    low, found = floor(case, noise, held), []
    for r in _by_name(rivals):
        if set(r.names) == set(best.names) or r.candidate.size > best.candidate.size + 1:
            continue  # what takes more numbers to say the same is no rival: they win by parsimony, or not at all
        difference = means(case, held, lambda k, r=r: r.errors[k] ** 2 - best.errors[k] ** 2)
        excess = max(best.heldout**2 - low**2, (0.1 * low) ** 2)
        near = r.heldout**2 - low**2 < 1.3**2 * excess and best.heldout > 1.1 * low
        if np.quantile(difference, 0.025) <= 0 or near or _same_family_border(case, best, r, low):
            found.append((r.heldout, next(n for n in r.names if n not in best.names[1:]), r))
    found.sort(key=lambda row: row[:2])
    return tuple(name for _, name, _ in found), tuple(r for *_, r in found)


def _same_family_border(case: Case, best: Judged, other: Judged, low: float) -> bool:
    """Creep and relaxation within 30 % of the border between them."""
    if len(best.names) != 1 or {*best.names, *other.names} != {"creep", "relaxation"}:
        return False
    tau = list(best.candidate.values)[0][1] * case.surroundings.omega
    return abs(np.log(tau / BORDER)) < np.log(1.3) and other.heldout < 2 * max(best.heldout, low)

"""Attribution: which effect, and which others the data cannot tell from it.

    screen all forms -> whole-rollout fits of the best names' forms -> judge on held-out records -> a second effect

Judged on drives the fit never saw; within 3 % of the least error the fewest numbers win. A second effect stays only if
it takes off a good part of what the first one left. Names are tied where a paired block bootstrap of the held-out
difference holds zero, or where neither reaches the floor and both stay equally far from it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from .._effects import CATALOGUE, REMAINDERS
from .._effects.base import Start
from .._effects.viscoelastic import BORDER
from .case import Case, build_case
from .fit import Candidate, fit, mean_square, residuals
from .lanes import Lanes
from .noise import Noise, estimate
from .regress import Screened, pairs, singles
from .screen import screen

_NAMES, _FORMS = 5, 12  # finalists
_CLOSE = 1.03
# pairs of names; those foremost, within this factor of the least error, show other forms, that many each: an end stop
# behind an electrode was first seen with the electrode's worse form, and lost to a slew limit
_PAIRS, _FOREMOST, _NEAR, _FORM_PAIRS = 8, 4, 2.0, 4
# a second effect must remove at least that share of the gap's energy, and leave little of what one left (or less than
# it, where the share is large)
_LEAST, _LITTLE, _LESS, _MUCH = 0.005, 0.35, 0.7, 0.1
_BLOCKS, _DRAWS = 20, 400


@dataclass(frozen=True)
class Judged:
    """A fitted candidate with what it leaves.

    Attributes:
        candidate: forms and numbers.
        errors: per record y - y_measured in % of range (zero where it does not count).
        train, heldout: rms over records, %.
    """

    candidate: Candidate
    errors: tuple[np.ndarray, ...]
    train: float
    heldout: float

    @property
    def names(self) -> tuple[str, ...]:
        """Effects it adds."""
        return self.candidate.names

    @property
    def overall(self) -> float:
        """Rms over all records, %."""
        return float(np.sqrt(np.mean([np.mean(e**2) for e in self.errors])))


@dataclass(frozen=True)
class Attribution:
    """Everything a diagnosis concludes from.

    Attributes:
        given: the nominal as given; base: refitted where that was asked for, else the same.
        ranking: every name's best single form, best first; those not fitted keep their screening figures.
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


def floor(case: Case, noise: Noise, which: Sequence[int]) -> float:
    """Pooled noise floor of records in %."""
    return float(np.sqrt(np.mean([noise.floor_percent(case.series[k].span) ** 2 for k in which])))


def sides(case: Case) -> tuple[list[int], list[int]]:
    """Indices of fitted and of held-out records (the fitted ones again where none is held out)."""
    fitted = [k for k, s in enumerate(case.series) if s.fitted]
    held = [k for k, s in enumerate(case.series) if not s.fitted]
    return fitted, held or fitted


def attribute(
    case: Case,
    *,
    refit: bool,
    exclude: Sequence[str] = (),
    progress: Callable[[str], None] = lambda line: None,
) -> Attribution:
    """Fit, judge and compare every effect of the catalogue but the excluded names."""
    catalogue = tuple(c for c in CATALOGUE if c.name not in exclude)
    noise = estimate(case, [s.error for s in case.series])
    ones = np.ones(case.model.order + 1)
    progress("screening every form")
    screening = screen(case, catalogue, refit=refit)
    screened = singles(screening)
    bare = [Candidate((), (), (), ones, False), Candidate((), (), (), ones, True)]
    given, changed, *rivals = _tried(case, catalogue, finalists(screened), ones, refit, bare, progress)
    base = changed if refit else given
    least = min([changed, *rivals], key=lambda r: r.train)
    if refit and least.train > 1.15 * floor(case, noise, sides(case)[0]):
        progress("screening again from the refitted nominal")
        factors = least.candidate.factors
        screening = screen(moved(case, factors), catalogue, refit=True)
        screened = singles(screening)
        rivals += _tried(case, catalogue, finalists(screened), factors, True, [], progress)
    if not refit and "parameter_change" not in exclude:
        rivals.append(changed)
    best = parsimonious(rivals)
    noise = _lower(noise, estimate(case, _scaled_errors(case, best)))
    _, held = sides(case)
    ranking = tuple(sorted(_by_name(rivals), key=lambda j: j.heldout))
    factors = best.candidate.factors if refit else ones  # what one changed nominal absorbs of two effects misleads
    pair = _second(case, catalogue, screening, best, base, noise, refit, factors, progress)
    if pair:
        best, rivals = pair[0], [r for r in pair[1] if pair[0].names[1] in r.names]
    equal = equivalents(case, best, rivals, noise, held)
    return Attribution(given, base, ranking, tuple(screened), best, *equal, noise)


def _tried(case: Case, catalogue, chosen, factors, refit, bare, progress) -> list[Judged]:
    """The bare candidates and the chosen forms (or pairs of them), fitted and judged."""
    chosen = _with_remainders(chosen, catalogue)
    lanes = Lanes(case, _in_order(catalogue, [f for s in chosen for f in s.forms]))
    alone = [Candidate(s.forms, s.values, s.starts, factors, refit) for s in chosen]
    progress(f"fitting {len(alone)} forms of {len({s.names for s in chosen})} effects or pairs")
    fitted = fit(lanes, [*bare, *alone], progress=lambda k, b: progress(f"fit: step {k}, {np.sqrt(b):.3f} %"))
    return judge(lanes, fitted)


def _with_remainders(chosen: Sequence[Screened], catalogue) -> list[Screened]:
    """Beside a form with a limit, what it is where the limit is out of reach."""
    found = list(chosen)
    for s in chosen:
        for k, form in enumerate(s.forms):
            simple, stay = REMAINDERS.get(form, (None, ()))
            forms = (*s.forms[:k], simple, *s.forms[k + 1 :])
            if simple not in catalogue or any(set(f.forms) == set(forms) for f in found):
                continue
            kept = [
                tuple(row[i] for i in stay)
                for row in (s.values[k], s.starts[k].values, s.starts[k].low, s.starts[k].high)
            ]
            values, starts = list(s.values), list(s.starts)
            values[k], starts[k] = kept[0], Start(*kept[1:])
            found.append(replace(s, forms=forms, values=tuple(values), starts=tuple(starts)))
    return found


def moved(case: Case, factors: np.ndarray) -> Case:
    """The case around a nominal with other coefficients: a filter far from the plant misleads the screening."""
    coefficients = jnp.asarray(np.asarray(case.model.coefficients, np.float64) * factors, jnp.float32)
    nominal = replace(case.model, coefficients=coefficients)
    return build_case(nominal, [s.record for s in case.series], other=case.other, mesh=case.mesh)


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


def _in_order(catalogue, forms) -> list:
    """In the catalogue's order: velocity and friction see all that comes before them."""
    return [c for c in catalogue if c in forms]


def judge(lanes: Lanes, candidates: Sequence[Candidate]) -> list[Judged]:
    """What candidates leave on every record."""
    fitted, held = sides(lanes.case)
    found = []
    for c, rows in zip(candidates, residuals(lanes, candidates, range(len(lanes.case.series))), strict=True):
        left = [float(np.sqrt(mean_square(lanes, [rows[k] for k in side], side))) for side in (fitted, held)]
        found.append(Judged(c, tuple(rows), *left))
    return found


def parsimonious(rivals: Sequence[Judged]) -> Judged:
    """The fewest numbers among those within a few per cent of the least held-out error."""
    least = min(r.heldout for r in rivals)
    close = [r for r in rivals if r.heldout <= _CLOSE * least]
    return min(close, key=lambda r: (r.candidate.size, r.heldout))


def _by_name(rivals: Sequence[Judged]) -> list[Judged]:
    best: dict[tuple[str, ...], Judged] = {}
    for r in rivals:
        if r.names not in best or r.heldout < best[r.names].heldout:
            best[r.names] = r
    return list(best.values())


def _scaled_errors(case: Case, judged: Judged) -> list[np.ndarray]:
    return [e * s.span / 100 for e, s in zip(judged.errors, case.series, strict=True)]


def _lower(first: Noise, second: Noise) -> Noise:
    """Contamination only adds: the lower of two estimates."""
    return second if 0 < second.sigma < first.sigma else first


def _second(case: Case, catalogue, screening, first, base: Judged, noise: Noise, refit, factors, progress):
    """The best pair and its rivals, if it pays, else None; screened as pairs, for one may hide the other."""
    _, held = sides(case)
    low = floor(case, noise, held)
    if first.heldout <= 1.15 * low or base.heldout <= 1.1 * low:
        return None
    chosen = pairs(screening, _PAIRS)
    if not chosen:
        return None
    judged = _tried(case, catalogue, chosen, factors, refit, [], progress)
    done = {frozenset(j.candidate.forms) for j in judged}
    foremost = sorted(judged, key=lambda j: j.train)[:_FOREMOST]
    foremost = [j for j in foremost if j.train <= _NEAR * foremost[0].train]
    others = [s for j in foremost for s in pairs(screening, _FORM_PAIRS, frozenset(j.names))]
    others = [s for s in others if frozenset(s.forms) not in done]
    if others:
        judged += _tried(case, catalogue, others, factors, refit, [], progress)
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
    lanes = Lanes(case, _in_order(catalogue, c.forms))
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


def equivalents(case: Case, best: Judged, rivals: Sequence[Judged], noise: Noise, held) -> tuple[tuple, tuple]:
    """Names whose best form is tied with the first effect of `best` (beside the same second one), and those forms."""
    low, found = floor(case, noise, held), []
    for r in _by_name(rivals):
        if set(r.names) == set(best.names) or r.candidate.size > best.candidate.size + 1:
            continue  # what takes more numbers to say the same is no rival: they win by parsimony, or not at all
        difference = bootstrap(case, held, lambda k, r=r: r.errors[k] ** 2 - best.errors[k] ** 2)
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


def bootstrap(case: Case, which: Sequence[int], square: Callable[[int], np.ndarray], draws: int = _DRAWS) -> np.ndarray:
    """Draws of the mean over records of the mean of `square`, by blocks within records; shape (draws,)."""
    rng = np.random.default_rng(0)
    total = np.zeros(draws)
    for k in which:
        values = square(k) * (case.series[k].weight > 0)
        blocks = np.array([b.mean() for b in np.array_split(values, _BLOCKS)])
        total += blocks[rng.integers(0, _BLOCKS, (draws, _BLOCKS))].mean(1) / len(which)
    return total

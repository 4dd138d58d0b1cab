"""Attribution: which effect, and which others the data cannot tell from it.

    screen all forms -> whole-rollout fits of the best names' forms -> judge on held-out records -> a second effect

Judged on drives the fit never saw; within 3 % of the least error the fewest numbers win. A second effect stays only if
it takes off a good part of what the first one left. Names are tied where a paired block bootstrap of the held-out
difference holds zero, or where neither reaches the floor and both stay equally far from it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._effects import CATALOGUE
from .._effects.viscoelastic import BORDER
from .case import Case
from .fit import Candidate, fit, mean_square, nudged, residuals
from .lanes import Lanes
from .noise import Noise, estimate
from .screen import Screened, screen

_NAMES, _FORMS = 5, 10  # finalists
_CLOSE = 1.03
_SECOND_LEFT, _SECOND_SHARE = 0.8, 0.01  # a second effect leaves at most that much, and removes that share of the gap
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


@dataclass(frozen=True)
class Attribution:
    """Everything a diagnosis concludes from.

    Attributes:
        given: the nominal as given; base: refitted where that was asked for, else the same.
        ranking: every name's best single form, best first; those not fitted keep their screening figures.
        screened: the screening of all forms.
        best: the chosen explanation (one or two effects, or the parameter change).
        equivalent: names these data cannot tell from the first effect.
        noise: the floor.
    """

    given: Judged
    base: Judged
    ranking: tuple[Judged, ...]
    screened: tuple[Screened, ...]
    best: Judged
    equivalent: tuple[str, ...]
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
    nothing = Candidate((), (), (), ones, False)
    progress("screening every form")
    screened = screen(case, catalogue, refit=refit)
    chosen = finalists(screened)
    lanes = Lanes(case, _in_order(catalogue, [s.effect for s in chosen]))
    singles = [Candidate((s.effect,), (s.values,), (s.start,), ones, refit) for s in chosen]
    changed = Candidate((), (), (), ones, True)
    progress(f"fitting {len(singles)} forms of {len({s.effect.name for s in chosen})} effects")
    fitted = fit(lanes, [*singles, changed], progress=lambda k, b: progress(f"fit: step {k}, {np.sqrt(b):.3f} %"))
    given, *judged = judge(lanes, [nothing, *fitted])
    base = judged[-1] if refit else given
    rivals = judged[:-1] if refit else judged
    rivals = [r for r in rivals if "parameter_change" not in exclude or r.candidate.forms]
    best = parsimonious(rivals, noise, case)
    noise = _lower(noise, estimate(case, _scaled_errors(case, best)))
    pairs = _second(case, catalogue, lanes, best, base, noise, refit, progress)
    if pairs:
        best = pairs
    _, held = sides(case)
    ranking = tuple(sorted(_by_name(rivals), key=lambda j: j.heldout))
    equal = equivalents(case, best, rivals, noise, held, singles_only=len(best.candidate.forms) < 2)
    return Attribution(given, base, ranking, tuple(screened), best, equal, noise)


def finalists(screened: list[Screened]) -> list[Screened]:
    """The forms worth a rollout: of the best names, those not far behind their name's best."""
    names, found = [], []
    for s in screened:
        if s.effect.name not in names:
            names.append(s.effect.name)
    for name in names[:_NAMES]:
        forms = [s for s in screened if s.effect.name == name]
        found += [s for s in forms if s.train < 6 * forms[0].train][:3]
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


def parsimonious(rivals: Sequence[Judged], noise: Noise, case: Case) -> Judged:
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


def _second(case: Case, catalogue, lanes: Lanes, first: Judged, base: Judged, noise: Noise, refit, progress):
    """The best pair, if it pays; else None."""
    _, held = sides(case)
    low = floor(case, noise, held)
    if not first.candidate.forms or first.heldout <= 1.1 * low or not np.isfinite(first.heldout):
        return None
    progress(f"a second effect beside {first.names[0]}")
    errors = _scaled_errors(case, first)
    beside = replace(
        case,
        series=tuple(replace(s, error=e, run=s.run - s.error + e) for s, e in zip(case.series, errors, strict=True)),
    )
    slopes = _slopes(lanes, first.candidate)
    screened = screen(beside, catalogue, refit=refit, extra=slopes, skip=first.names)
    chosen = finalists(screened)[:7]
    both = Lanes(case, _in_order(catalogue, [first.candidate.forms[0], *[s.effect for s in chosen]]))
    c = first.candidate
    pairs = [
        Candidate((*c.forms, s.effect), (*c.values, s.values), (*c.starts, s.start), c.factors, refit) for s in chosen
    ]
    fitted = fit(both, pairs, progress=lambda k, b: progress(f"pairs: step {k}, {np.sqrt(b):.3f} %"))
    best = parsimonious(judge(both, fitted), noise, case)
    left = max(best.heldout**2 - low**2, 0.0) / max(first.heldout**2 - low**2, 1e-30)
    share = (first.heldout**2 - best.heldout**2) / max(base.heldout**2 - low**2, 1e-30)
    pays = left <= _SECOND_LEFT**2 and share >= _SECOND_SHARE and best.train < first.train
    return best if pays else None


def _slopes(lanes: Lanes, candidate: Candidate) -> list[np.ndarray]:
    """Per record the scaled response to the first effect's own numbers, shape (T, Q)."""
    which = range(len(lanes.case.series))
    near = [nudged(candidate, k) for k in range(candidate.size - (len(candidate.factors) if candidate.refit else 0))]
    here, *others = residuals(lanes, [candidate, *[c for c, _ in near]], which)
    return [
        np.stack(
            [(o[k] - here[k]) / step * lanes.case.series[k].span / 100 for o, (_, step) in zip(others, near, strict=True)],
            -1,
        )
        for k in which
    ]


def equivalents(case: Case, best: Judged, rivals: Sequence[Judged], noise: Noise, held, *, singles_only: bool):
    """Names whose best form is tied with the first effect of `best`."""
    if not singles_only:
        return ()
    low, found = floor(case, noise, held), []
    for r in _by_name(rivals):
        if r.names == best.names or r.candidate.size > best.candidate.size + 1:
            continue  # what takes more numbers to say the same is no rival: they win by parsimony, or not at all
        difference = bootstrap(case, held, lambda k, r=r: r.errors[k] ** 2 - best.errors[k] ** 2)
        excess = max(best.heldout**2 - low**2, (0.1 * low) ** 2)
        near = r.heldout**2 - low**2 < 1.3**2 * excess and best.heldout > 1.1 * low
        if np.quantile(difference, 0.025) <= 0 or near or _same_family_border(case, best, r, low):
            found.append((r.heldout, r.names[0]))
    return tuple(name for _, name in sorted(found))


def _same_family_border(case: Case, best: Judged, other: Judged, low: float) -> bool:
    """Creep and relaxation within 30 % of the border between them."""
    if {best.names[0], other.names[0]} != {"creep", "relaxation"}:
        return False
    tau = best.candidate.values[0][1] * case.surroundings.omega
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

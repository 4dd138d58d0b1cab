"""Judged candidates: what fitted explanations leave on every record, those that were fitted and those held out.

chosen forms (and what a form is where its limit is out of reach) -> whole-rollout fits -> errors on both sides
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._effects import EFFECTS, FOUND_TERM, REMAINDERS
from .._effects.found_term import sparse_term
from .._effects.spec import Start
from .._model.model import Model
from .batched_rollouts import Lanes
from .budget import Budget
from .case import Case
from .fit import Candidate, fit, mean_square, residuals
from .noise import Noise
from .regress import Screened

CLOSE = 1.03  # within this factor of the least error the fewest numbers win


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


def floor(case: Case, noise: Noise, which: Sequence[int]) -> float:
    """Pooled noise floor of records in %."""
    return float(np.sqrt(np.mean([noise.floor_percent(case.series[k].span) ** 2 for k in which])))


def sides(case: Case) -> tuple[list[int], list[int]]:
    """Indices of fitted and of held-out records (the fitted ones again where none is held out)."""
    fitted = [k for k, s in enumerate(case.series) if s.fitted]
    held = [k for k, s in enumerate(case.series) if not s.fitted]
    return fitted, held or fitted


def tried(
    case: Case, catalogue, chosen, refit, bare, progress, beat: float = np.inf, budget: Budget | None = None
) -> list[Judged]:
    """The bare candidates and the chosen forms (or pairs of them), fitted and judged; `beat` as in `fit`."""
    chosen = _with_remainders(chosen, catalogue)
    groups: dict[frozenset[str], list] = {}
    for s in chosen:
        groups.setdefault(frozenset(s.names), []).extend(s.forms)
    lanes = Lanes(case, list(groups.values()) or [()])
    alone = [Candidate(s.forms, s.values, s.starts, s.factors, refit) for s in chosen]
    progress(f"fitting {len(alone)} forms of {len({s.names for s in chosen})} effects or pairs")

    def told(step: int, least: float) -> None:
        progress(f"fit: step {step}, {np.sqrt(least):.3f} %")

    return judge(lanes, fit(lanes, [*bare, *alone], beat=beat, budget=budget, progress=told))


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
    close = [r for r in rivals if r.heldout <= CLOSE * least]
    return min(close, key=lambda r: (r.candidate.size, r.heldout))


def augmented(case: Case, judged: Judged, model: Model) -> Model:
    """The nominal with a candidate's effects, its coefficients and zero, and the substeps it was fitted with."""
    c = judged.candidate
    pairs = sorted(zip(c.forms, c.values, strict=True), key=lambda fv: EFFECTS.index(fv[0]))
    effects = tuple(sparse_term(values) if f is FOUND_TERM else f(*values) for f, values in pairs)
    substeps = max(case.model.substeps, model.substeps) if effects else model.substeps
    output = replace(model.output, offset=float(model.output.to_rig(c.zero * model.scales.state[0])))
    return replace(
        model.changed(c.factors), effects=(*model.effects, *effects), substeps=substeps, output=output,
        provenance=model.provenance.driven_by([s.record for s in case.series]),
    )  # fmt: skip

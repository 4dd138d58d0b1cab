"""List the effects that the returned model adds to the nominal model, with their parameters and certainty.

    certain   the verdict reports it
    tied      the verdict reports it, with effects that these recordings do not separate from it
    likely    P >= LIKELY against the best hypothesis without it, LISTED of the closed error, and a strength whose
              interval excludes its value without the part
    none      otherwise; also coefficients that are refitted together with every effect, and those beside which a
              black-box model on the unchanged nominal model fits better by 1 - FIRST (P >= SURE)

A parameter's interval is 1.96 standard errors wide on either side. The standard error is the larger of two: from blocks
of residuals, and from the refits without each fold (a jackknife over recordings):

    var = (F - 1) / F sum_f (theta_f - mean theta)^2,

The interval includes the values of equally good hypotheses. Recordings do not show the end of a memory that lasts
longer than a third of the longest one: such a time constant has a lower bound and no upper one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...common.shown import Shown
from ..effects.effect import Effect
from ..model.model import Model
from . import rules
from .evidence import probability
from .library import CHANGED, FREE, INDEX, LOGARITHM, ROWS, SHAPE, group, slots_of_row
from .next_experiment import Experiment, separate
from .result import errors_of, factor_name, factors_of, in_units, longest_time
from .search import PARAMETERS, Hypothesis, Search, needed
from .verdict import Decision, closing_fractions, rival_without

_NORMAL = 1.96  # standard deviations in half of a 95 % interval
_FARTHEST = 5.0  # of a logarithm's error: a factor of e^10 is not a usable estimate
_ANOTHER = "an excitation of another kind than those recorded"


@dataclass(frozen=True)
class Part:
    """One effect that the returned model adds to the nominal model, with its parameters and certainty.

    Attributes:
        effect, form: as in the catalogue; "parameter_change" for the nominal's coefficients.
        parameters: name to value, unit and 95 % interval (upper end None: only a lower bound; None: not determined).
        fraction: of the error removed by the model, in the order in which its parts were added.
        probability: P that the best hypothesis without it has a larger error; None if not computed.
        certainty: "certain", "tied", "likely" or "none".
        tied: effects that these recordings do not separate from it.
        recording: the recording that would make a likely part certain, in words.
        experiment: the same as a voltage; None if no excitation within the recorded limits separates it from its best
            rival.
    """

    effect: str
    form: str
    parameters: dict[str, dict]
    fraction: float
    probability: float | None
    certainty: str
    tied: tuple[str, ...] = ()
    recording: str | None = None
    experiment: Experiment | None = None


@dataclass(frozen=True, repr=False)
class Parts(Shown):
    """The effects that the returned model adds, largest first; `frame()` has a row for each parameter."""

    parts: tuple[Part, ...] = field(default=())

    def __iter__(self) -> Iterator[Part]:
        return iter(self.parts)

    def __len__(self) -> int:
        return len(self.parts)

    def __getitem__(self, place: int) -> Part:
        return self.parts[place]

    def as_json(self) -> list[dict]:
        """Return the parts as the list of docs/contract.md."""
        rows = [vars(p) | {"tied": list(p.tied)} for p in self.parts]
        return [{k: v for k, v in one.items() if k != "experiment"} for one in rows]

    def _rows(self) -> list[dict[str, Any]]:
        rows = []
        for p in self.parts:
            for name, number in p.parameters.items():
                low, high = number["ci95"] or (None, None)
                one = {"effect": p.effect, "form": p.form, "parameter": name, "value": number["value"]}
                one |= {"unit": number["unit"], "low": low, "high": high, "fraction": p.fraction}
                one |= {"probability": p.probability, "certainty": p.certainty, "tied": ", ".join(p.tied)}
                rows.append(one)
        return rows


Factors = dict[str, tuple[float, float] | None]


def parts_of(search: Search, decision: Decision, handed: Hypothesis, made: tuple[Model, list]) -> Parts:
    """List the effects that the returned model adds to the nominal model, with their parameters and certainty.

    Args:
        search, decision: of the diagnosis.
        handed: the returned hypothesis.
        made: its model, and the added effects with their slots.
    """
    if not handed.fit.free:
        return Parts()
    numbers = _Numbers(search, handed, made[0])
    effects = [(_search_name(slots), effect, slots) for effect, slots in made[1]]
    taken, drafts = closing_fractions(search, handed), []
    for name, label in zip(handed.names, handed.labels, strict=True):
        mine = [(e, slots) for n, e, slots in effects if n == name]
        form = " and ".join(dict.fromkeys(e.form for e, _ in mine)) or "refitted coefficients"
        values = numbers.of(mine) if mine else numbers.coefficients(_own_slots(search, name))
        drafts.append(Part(label, form, values, taken[name], decision.probabilities.get(label), "none"))
    changed = [numbers.is_changed(_strengths(search, n)) for n in handed.names]
    parts = [_rate_part(search, decision, handed, *one) for one in zip(handed.names, drafts, changed, strict=True)]
    parts.sort(key=lambda p: -p.fraction)
    # coefficients refitted with every effect close nothing of the refitted model's error; the nominal's own lag is none
    beside = [(e, slots) for n, e, slots in effects if n not in handed.names and {*slots} & {*handed.fit.free}]
    along = [Part(e.name, e.form, numbers.of([(e, slots)]), 0.0, None, "none") for e, slots in beside]
    claimed = {k for name in handed.names for k in _own_slots(search, name)}
    moved = numbers.coefficients([k for k in search.movable if k not in claimed])
    if moved:
        along = [Part(CHANGED, "refitted coefficients", moved, 0.0, None, "none"), *along]
    return Parts((*parts, *along))


def _own_slots(search: Search, name: str) -> list[str]:
    """Return the names of the linear model's parameters that an effect of the search changes."""
    if name == PARAMETERS:
        return list(search.movable)
    return [k for form in search.library if form.name == name for k in form.start if k in search.movable]


def _strengths(search: Search, name: str) -> list[str]:
    """Return the names of the parameters that switch an effect of the search on, or of the coefficients it changes."""
    if name == PARAMETERS:
        return list(search.movable)
    started = dict.fromkeys(k for form in search.library if form.name == name for k in form.start)
    return [k for k in started if not SHAPE[INDEX[k]]]


def _search_name(slots: Sequence[str]) -> str:
    """Return the search name of the effect with these parameter names."""
    return next((group(r.name) for r in ROWS if slots_of_row(r) == tuple(slots)), "")


def _rate_part(search: Search, decision: Decision, handed: Hypothesis, name: str, part: Part, changed: bool) -> Part:
    """Return the part with its certainty; for a likely part also the recording that would make it certain."""
    if part.effect in decision.said:
        tied = decision.tied.get(part.effect, ())
        return replace(part, certainty="tied" if tied else "certain", tied=tied)
    if part.fraction < rules.LISTED or name == FREE or not changed:
        return part
    # coefficients change with every effect that is missing
    flexible = decision.unchanged if name == PARAMETERS else None
    if flexible is not None and probability(flexible, handed.evidence, rules.FIRST) >= rules.SURE:
        return part
    rival = rival_without(search, handed, {name})
    part = replace(part, probability=needed(handed, rival))
    if (part.probability or 0.0) < rules.LIKELY:
        return part
    other = " and ".join(rival.labels) or "the model without it"
    experiment: Experiment | None = None
    if search.budget.allows(f"the recording that separates {part.effect} from {other}"):
        experiment = separate(search.case, search.scale, handed, rival, (part.effect, other))
    if experiment is None or experiment.difference < 1:
        return replace(part, certainty="likely", recording=f"{_ANOTHER} (to separate it from {other})")
    words = f"{experiment.excitation}, {experiment.time[-1] - experiment.time[0]:.2g} s (to separate it from {other})"
    return replace(part, certainty="likely", recording=words, experiment=experiment)


class _Numbers:
    """The parameters of a hypothesis with their 95 % intervals."""

    def __init__(self, search: Search, h: Hypothesis, model: Model):
        self.search, self.h, self.model = search, h, model
        self.factors = _interval_factors(search, h)

    def of(self, effects: Sequence[tuple[Effect, Sequence[str]]]) -> dict[str, dict]:
        """Return the parameters of one part's effects; those of a second effect have the suffix 2."""
        table: dict[str, dict] = {}
        for effect, slots in effects:
            rows = in_units(self.model, effect, slots, self.h.fit, {})
            for (p, _), slot in zip(effect.numbers(), slots, strict=True):
                if p.name in rows and not p.fixed:
                    row = self._with_interval(rows[p.name], slot)
                    limit = longest_time(self.search, effect.port)
                    if row["unit"] == "s" and row["value"] > limit:
                        row["ci95"] = [min([limit, *(row["ci95"] or [])[:1]]), None]
                    table[f"{p.name} 2" if p.name in table else p.name] = row
        return table

    def is_changed(self, slots: Sequence[str]) -> bool:
        """Return whether the interval of any of these parameters excludes the nominal model's value."""
        mine = [k for k in slots if k in self.h.fit.free]
        return not mine or any(self._excludes_nominal(k) for k in mine)

    def _excludes_nominal(self, slot: str) -> bool:
        ends, value = self.factors.get(slot), self.h.fit.value(slot)
        before = float(self.search.case.nominal[INDEX[slot]])
        if ends is None:
            return False
        if LOGARITHM[INDEX[slot]] and before <= 0:  # a logarithm does not reach zero: the same interval on either side
            return ends[0] > 1 / np.e
        low, high = sorted(value * f for f in ends)
        return not low <= before <= high

    def coefficients(self, slots: Sequence[str]) -> dict[str, dict]:
        """Return the linear model's refitted coefficients, divided by the given ones, with intervals."""
        rows, names = factors_of(self.search, self.h.fit, {}), {factor_name(k): k for k in slots}
        return {name: self._with_interval(row, names[name]) for name, row in rows.items() if name in names}

    def _with_interval(self, row: dict, slot: str) -> dict:
        ends = self.factors.get(slot)
        ci95 = None if ends is None else sorted(row["value"] * f for f in ends)
        return {"value": row["value"], "unit": row["unit"], "ci95": ci95}


def _interval_factors(search: Search, h: Hypothesis) -> Factors:
    """Return the ends of each fitted parameter's 95 % interval, divided by its value; None if undetermined."""
    errors, places = errors_of(search, h.fit), [INDEX[k] for k in h.fit.free]
    folds = _coordinates(h.without, places) if len(h.without) else np.zeros((1, len(places)))
    jackknife = np.sqrt((len(folds) - 1) * np.var(folds, 0))
    alike = [other for other in search.every.values() if other is not h and _is_as_good(other, h)]
    factors: Factors = {}
    for n, (slot, place) in enumerate(zip(h.fit.free, places, strict=True)):
        here = float(_coordinates(h.fit.slots, [place])[0])
        error = max(errors[slot], jackknife[n])
        if not np.isfinite(error) or (LOGARITHM[place] and error > _FARTHEST):
            factors[slot] = None
            continue
        others = [float(_coordinates(o.fit.slots, [place])[0]) for o in alike if slot in o.fit.free]
        low, high = min(here - _NORMAL * error, *others, here), max(here + _NORMAL * error, *others, here)
        if LOGARITHM[place]:
            factors[slot] = float(np.exp(low - here)), float(np.exp(high - here))
        else:
            factors[slot] = (low / here, high / here) if here else None
    return factors


def _coordinates(slots: np.ndarray, places: Sequence[int]) -> np.ndarray:
    """Convert parameters to the optimiser's coordinates: logarithms of the positive ones."""
    values = slots[..., list(places)]
    return np.where(LOGARITHM[list(places)], np.log(np.maximum(values, 1e-300)), values)


def _is_as_good(other: Hypothesis, h: Hypothesis) -> bool:
    """Return whether another hypothesis with effects is not certainly worse than the returned one, by GAIN."""
    return bool(other.names) and needed(h, other) < rules.SURE

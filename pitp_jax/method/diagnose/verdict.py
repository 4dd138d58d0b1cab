"""Decide which effects of the best hypothesis are reported, with which ties, and how certain they are.

no_gap     the nominal's error is at most OWN times that on its own records; or it is at most OWN times the sensor's
           noise or USUAL times that on its own records (refitted or not), and neither a set nor the reference is
           likely better by 1 - FIRST (P >= LIKELY)
explained  every effect beats, with P >= SURE, the best hypothesis of the same size searched without it (or the first is
           tied); a flexible model is not better (P < LIKELY), and added to the hypothesis it closes nothing more
partly     the first does, but a further one does not; or a flexible model is better by less than 1 - FIRST, or closes
           more if it is added
unknown    otherwise: a flexible model is better by 1 - FIRST with P >= SURE, an unnamed force, a zero of the plant or
           an undecided effect is part of it, a larger hypothesis has less than HALF the error and does not need all of
           its effects, or few excitations and a rival within TWICE the error

A wrong effect reported with confidence costs a laboratory a week; `unknown` costs an hour.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...common.numbers import number
from . import rules
from .evidence import Evidence, probability
from .library import CHANGED, COMMUTING, FREE, HIDDEN, LONE, MONITOR, SHIFT, TWINS, names_of
from .reference import reference
from .search import PARAMETERS, Hypothesis, Search, needed

_DIFFERS = (
    "Separate linear models for each recording predict better than any common model. Were all recordings made on the "
    "same machine?"
)
_FLEXIBLE = "A general black-box model fits better, so no single cause can be named with confidence."
_LARGER = "A larger set of effects leaves less than half of the error, and does not need some of these effects."
_ZERO = (
    "The plant has a zero with a time constant of {} ms, or the input column is behind a low pass with this time "
    "constant; these recordings do not separate the two, and no effect of the catalogue describes a zero."
)


@dataclass(frozen=True)
class Decision:
    """The verdict of a diagnosis with its evidence.

    Attributes:
        verdict: as above.
        chosen: the last set that improves the fit significantly; otherwise the base.
        said: reported effects, most important first; empty unless explained or partly.
        tied: per reported effect, or of one with too many, the effects that the records do not separate from it.
        probabilities: per effect with at least the fraction LISTED of the closed error, P that it is needed.
        fractions: per effect of the set, fraction of the closed error.
        bar: the reference added to the base; above: added to the chosen set.
        more: P that the reference added to the set closes more.
        reason: why no effect is reported, in words.
        rivals: effects that no verdict could separate.
        alone: error of separate linear models of few records.
        unchanged: the reference added to the base without changed coefficients.
    """

    verdict: str
    chosen: Hypothesis
    said: tuple[str, ...]
    tied: dict[str, tuple[str, ...]]
    probabilities: dict[str, float]
    fractions: dict[str, float]
    bar: Evidence
    above: Evidence
    more: float
    reason: str = ""
    rivals: tuple[str, ...] = ()
    alone: Evidence | None = None
    unchanged: Evidence | None = None


def decide(search: Search, own: float, noise: float, distinct: int, usual: float = 0.0) -> Decision:
    """Judge a search: choose the verdict and the reported effects.

    `own`: the nominal's own error (0: unknown, as in a refit), `noise`: the sensor's, `distinct`: number of distinct
    excitations, `usual`: the nominal's own error on the recordings of its identification, in a refit too.
    """
    base, chosen = search.base, search.best()
    case, floors = search.case, search.floors
    # in a refit also for every linear structure, because a reference on a poor one would be a low bar
    bars = [reference(case, h, floors) for h in ([base, *search.linears] if search.refit else [base, search.linear])]
    bar = min(bars, key=lambda e: e.score)
    above = reference(case, chosen, floors) if chosen.names else bar
    # a flexible model's gain counts if it is GAIN of the gap's energy, not of the small remaining error
    worth = 1 - rules.GAIN * (base.rms / chosen.rms) ** 2
    more = probability(above, chosen.evidence, np.sqrt(worth)) if worth > 0 else 0.0
    alone = search.each_alone()
    settled = chosen.reaches(max(own, noise))

    def answer(verdict, said=(), tied=None, reason="", rivals=(), p=None, fractions=None):
        return Decision(verdict, chosen, tuple(said), tied or {}, p or {}, fractions or {}, bar, above, more, reason,
                        tuple(rivals), alone, bars[0])  # fmt: skip

    if search.given.reaches(own):
        return answer("no_gap", reason="The nominal model has no larger error than on its own recordings.")
    if not chosen.names:
        # near the noise, of any colour, and nothing is likely to improve the fit, the reference neither
        least = min((bar, *(h.evidence for h in search.every.values())), key=lambda e: e.score)
        near = base.rms <= max(rules.OWN * noise, rules.USUAL * usual)
        if near and probability(least, base.evidence, rules.FIRST) < rules.LIKELY:
            return answer("no_gap", reason="The remaining error is noise: no model of the input predicts it.")
        return answer("unknown", reason="No effect in the catalogue improves the fit significantly.")
    taken = closing_fractions(search, chosen)
    # two effects of the search may have one name, such as a loop that hardly yields beside a friction
    pairs = tuple(zip(chosen.names, chosen.labels, strict=True))
    fractions = {label: sum(taken[n] for n, other in pairs if other == label) for label in chosen.labels}
    p, rivals = _without_each(search, chosen, fractions)
    if settled and chosen.names == (PARAMETERS,):  # they reach the nominal's own error: nothing is left to name
        p[CHANGED] = probability(chosen.evidence, search.given.evidence)
    seen: dict[str, Any] = {"p": p, "fractions": fractions}
    if SHIFT.name in chosen.names:
        return answer("unknown", reason=_ZERO.format(number(1e3 * chosen.fit.value(MONITOR), 3)), **seen)
    # a reference on the refitted linear model includes changed coefficients, so the one on the base is their rival
    moved = set(chosen.names) <= {PARAMETERS, *LONE}
    flexible = bars[0] if moved else bar
    if not settled and probability(flexible, chosen.evidence, rules.FIRST) >= rules.SURE:
        return answer("unknown", reason=_FLEXIBLE, **seen)
    if alone is not None and not settled and probability(alone, chosen.evidence, 1 - rules.GAIN) >= rules.SURE:
        return answer("unknown", reason=_DIFFERS, **seen)
    if FREE in chosen.names:
        return answer(
            "unknown",
            reason="The best model contains a force that is not in the catalogue, so no cause is certain.",
            **seen,
        )
    deeper = [h for h in search.every.values() if len(h.names) > len(chosen.names) and h.rms < rules.HALF * chosen.rms]
    deepest = min(deeper, key=lambda h: h.rms, default=None)
    if not settled and deepest is not None and not _still_needed(search, chosen, deepest):
        return answer("unknown", reason=_LARGER, **seen)
    said, tied, separated = [], {}, True
    # the effect that closes most comes first; a further one that these recordings do not separate from others may stand
    # for what the form of the first lacks, as changed coefficients do, and is only a part of the model
    order = sorted(pairs, key=lambda n: (-fractions[n[1]], n[0] == PARAMETERS))
    for name, label in order:
        if fractions[label] < rules.LISTED or label in said:
            continue
        few = distinct < rules.EXCITATIONS and not settled and rivals[name].rms < rules.TWICE * chosen.rms
        certain = p[label] >= rules.SURE and not few
        if said and (name == PARAMETERS or not certain):
            separated = False
            continue
        equal = () if p[label] >= rules.SURE else _tie(search, chosen, name, label)
        if equal is None or few:
            rival = "+".join(rivals[name].labels)
            why = "hold too few kinds of excitation to" if few else "do not"
            reason = f"These recordings {why} separate {label} from {rival or 'the model without it'}."
            return answer("unknown", reason=reason, rivals=(label, rival), **seen)
        if FREE in equal:  # not a name either
            separated = False
            continue
        # a narrow band cannot separate these, so they are reported as tied however certain the set is
        twins = TWINS.get(label, ())
        if label not in COMMUTING:
            twins = tuple(t for t in twins if not _beats_twin(search, chosen, name, t))
        if search.refit and label not in LONE:
            twins = ()
        others = dict.fromkeys((*equal, *twins, *_other_names(search, chosen, name, label)))
        others |= dict.fromkeys(t for n in (label, *others) for t in _hidden_twins(search, chosen, name, n))
        if len(others) >= rules.TIED:
            reason = f"These recordings do not separate {label} from {', '.join(others)}."
            tied = {label: tuple(others)}
            return answer("unknown", tied=tied, reason=reason, rivals=(label, next(iter(others))), **seen)
        said.append(label)
        tied[label] = tuple(others)
    if not said:
        return answer("unknown", reason="No single effect makes up a tenth of the reduction.", **seen)
    complete = more < rules.SURE and deepest is None and probability(flexible, chosen.evidence) < rules.LIKELY
    if search.structural and not (settled or complete):  # a lag then stands in for what no form describes
        return answer("unknown", reason=_FLEXIBLE, **seen)
    verdict = "explained" if separated and (settled or complete) else "partly"
    return answer(verdict, said, tied, **seen)


def _without_each(search: Search, chosen: Hypothesis, fractions: dict[str, float]):
    """Search again without each effect that may be reported, because its alternative may not have been tried yet.

    Returns:
        the probability that each effect is needed, by label, and the best set without it, by search name.
    """
    p, rivals = {}, {}
    for name, label in zip(chosen.names, chosen.labels, strict=True):
        # a smaller one is never reported; a third of a joint's diagnosis went into these searches
        if fractions[label] >= rules.LISTED:
            rivals[name] = rival_without(search, chosen, {name})
            p[label] = needed(chosen, rivals[name])
    return p, rivals


def _still_needed(search: Search, chosen: Hypothesis, deepest: Hypothesis) -> bool:
    """Return whether each effect of the chosen set is also needed (P >= SURE) in the larger set `deepest`."""
    for name in chosen.names:
        if name not in deepest.names:
            return False
        rival = rival_without(search, deepest, {name})
        if needed(deepest, rival) < rules.SURE:
            return False
    return True


def _nested(h: Hypothesis, chosen: Hypothesis) -> bool:
    """Return whether `h` refits all linear parameters while the chosen set has an effect on one of them."""
    return PARAMETERS in h.names and bool(set(LONE) & set(chosen.names)) and PARAMETERS not in chosen.names


def rival_without(search: Search, chosen: Hypothesis, without: set) -> Hypothesis:
    """Search again without some effects; return the best set that is no larger than the chosen one."""
    search.without(without, len(chosen.names))
    labels = {label for n, label in zip(chosen.names, chosen.labels, strict=True) if n in without}
    lacking = [
        h
        for h in search.every.values()
        if not without & set(h.names) and not labels & set(h.labels) and len(h.names) <= len(chosen.names)
    ]
    fair = [h for h in lacking if not _nested(h, chosen) and not _nested(chosen, h)] or lacking
    return min(fair, key=lambda h: h.rms)


def closing_fractions(search: Search, chosen: Hypothesis) -> dict[str, float]:
    """Return each effect's fraction of the removed error (rms) in the order added, by search name.

    An effect that halves a remaining fifth of the error closes 11 % of the error, but 3 % of its energy.

    The loss without an effect is less informative: if two effects can replace each other, the loss of either is small.
    """
    whole, before, fractions = search.base.rms - chosen.rms, search.base, {}
    for h in search.steps(chosen)[1 if search.refit else 0 :]:
        new = [n for n in h.names if n not in before.names]
        for n in new:
            fractions[n] = float(np.clip((before.rms - h.rms) / len(new) / max(whole, 1e-300), 0.0, 1.0))
        before = h
    return fractions


def _beats_twin(search: Search, chosen: Hypothesis, name: str, twin: str) -> bool:
    """Return whether the set fits significantly better than with an equivalent effect instead of this one."""
    other = search.hypothesis_of({*chosen.names} - {name} | {twin})
    return other is not None and probability(chosen.evidence, other.evidence, rules.FURTHER) >= rules.SURE


def _hidden_twins(search: Search, chosen: Hypothesis, name: str, label: str) -> tuple[str, ...]:
    """Return the twin of `label` that the search does not add, such as a lag of the force, if it fits as well.

    Behind the square a linear plant with a lag of its force is the same as with a lag of its sensor.
    """
    row = HIDDEN.get(label)
    if row is None or (row.squares and not search.case.simulator.square):
        return ()
    other = search.exchanged(chosen, name, row)
    beaten = other is not None and probability(chosen.evidence, other.evidence, rules.FURTHER) >= rules.SURE
    return () if beaten else (row.name,)


def separable(search: Search, decision: Decision, label: str) -> tuple[str, ...]:
    """Return the effects tied with a reported one that another recording may separate from it."""
    excluded = {label}
    name = dict(zip(decision.chosen.labels, decision.chosen.names, strict=True)).get(label, label)
    if label in COMMUTING:
        excluded |= {t for t in TWINS[label] if _beats_twin(search, decision.chosen, name, t)}
    excluded |= {HIDDEN[n].name for n in excluded if n in HIDDEN}
    return tuple(other for other in decision.tied.get(label, ()) if other not in excluded)


def _other_names(search: Search, chosen: Hypothesis, name: str, label: str) -> tuple[str, ...]:
    """Return the other names of an effect: of a second memory, or in refits without a fold, if sizes decide."""
    rows = (chosen.fit.slots, *chosen.without)
    others = dict.fromkeys(other for slots in rows for other in names_of(name, slots, search.scale, rules.LISTED))
    return tuple(other for other in others if other != label)


def _tie(search: Search, chosen: Hypothesis, name: str, label: str) -> tuple[str, ...] | None:
    """Return the labels of effects that can replace one effect; None if there are too many."""
    group, labels = {name}, []
    while len(group) < rules.TIED + 1:
        rival = rival_without(search, chosen, group)
        if needed(chosen, rival) >= rules.SURE:
            return tuple(labels)
        # a tie replaces one effect by one; two would be another hypothesis
        new = set(rival.names) - set(chosen.names)
        if len(new) != 1 or len(group) == rules.TIED:
            return None
        group |= new
        labels += [label for n, label in zip(rival.names, rival.labels, strict=True) if n in new]
    return None

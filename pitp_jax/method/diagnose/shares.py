"""Divide the energy of the error by cause, out of fold, with intervals; all fractions sum to 1.

    E(h) = mean over records of MSE_r / range_r^2,   fraction of a part = (E before it - E after it) / E of the nominal

nuisance | parameters | every effect | explainable without an effect | not explainable. The gains of two effects in one
set are averaged over both orders.
"""

from collections.abc import Sequence

import numpy as np

from . import rules
from .evidence import Evidence, resampled
from .search import PARAMETERS, Hypothesis, Search
from .verdict import Decision

_DRAWS = 1000  # of the bootstrap, for 95 % intervals


def energies(sets: Sequence[Evidence], spans: np.ndarray) -> np.ndarray:
    """Return the error energy of every hypothesis: the estimate, then bootstrap draws, shape (sets, 1 + draws)."""
    first = sets[0]
    number = len(np.unique(first.records))
    energy = np.zeros((len(sets), 1 + _DRAWS))
    for r, times, place, often in resampled(first, _DRAWS, seed=1):
        drawn = np.vstack([np.ones(len(place)), often])
        weight = np.concatenate([[1.0], times]) / number
        count = np.maximum(drawn @ first.sizes[place], 1)
        for k, s in enumerate(sets):
            energy[k] += weight * (drawn @ s.squares[place]) / count / spans[r] ** 2
    return energy


def budget(search: Search, decision: Decision, raw: Evidence) -> dict:
    """Return the energy fractions as the `budget` of docs/contract.md; `raw`: the nominal model before any fit."""
    chosen, spans = decision.chosen, np.array([s.span for s in search.case.series])
    steps = search.steps(chosen)
    more = decision.above if decision.more >= rules.SURE else chosen.evidence
    # from the given nominal to the smallest error reached, one step each
    path = [raw, search.given.evidence, *[h.evidence for h in steps], more]
    e = energies(path, spans)
    whole = np.maximum(e[:2].max(0), 1e-300)
    # steps telescope, so that all fractions add up to one in every draw
    gains = (e[:-1] - e[1:]) / whole
    gains[0] = (whole - e[1]) / whole
    parts: dict[str, np.ndarray] = {"nuisance": gains[0], "parameters": np.zeros(e.shape[1])}
    before: Hypothesis = search.given
    named: dict[str, np.ndarray] = {}
    for k, h in enumerate(steps):
        new = [label for n, label in zip(h.names, h.labels, strict=True) if n not in before.names and n != PARAMETERS]
        key = new[0] if new else "parameters"
        if key == "parameters":
            parts["parameters"] = parts["parameters"] + gains[1 + k]
        else:
            named[key] = named.get(key, np.zeros(e.shape[1])) + gains[1 + k]
        before = h
    if len(chosen.names) == 2 and set(named) == set(chosen.labels) <= set(decision.said):
        named = _both_orders(search, chosen, named, spans, whole)
    said = {n: v for n, v in named.items() if n in decision.said}
    unnamed = gains[-1] + sum((v for n, v in named.items() if n not in said), np.zeros(e.shape[1]))
    rest = 1 - parts["nuisance"] - parts["parameters"] - sum(said.values(), np.zeros(e.shape[1])) - unnamed
    names = {
        n: _fraction(v) | {"probability": decision.probabilities.get(n), "equivalent": list(decision.tied.get(n, ()))}
        for n, v in said.items()
    }
    return {
        "nuisance": _fraction(parts["nuisance"]), "parameters": _fraction(parts["parameters"]), "effects": names,
        "unnamed": _fraction(unnamed), "unexplainable": _fraction(rest),
    }  # fmt: skip


def without_effects(effects: dict[str, dict]) -> dict:
    """Return the `budget` of errors that only these entries explain; the rest cannot be predicted."""
    nothing = {"share": 0.0, "ci95": [0.0, 0.0]}
    rest = 1.0 - sum(row["share"] for row in effects.values())
    entry = {"share": rest, "ci95": [rest, rest]}
    return dict.fromkeys(("nuisance", "parameters", "unnamed"), nothing) | {"effects": effects, "unexplainable": entry}


def _both_orders(search, chosen, named, spans, whole) -> dict[str, np.ndarray]:
    alone = [search.hypothesis_of({n}) for n in chosen.names]
    if any(h is None for h in alone):
        return named
    e = energies([search.base.evidence, *[h.evidence for h in alone if h is not None], chosen.evidence], spans) / whole
    # the mean of an effect's gain alone and of its gain as the second
    first = (e[0] - e[1] + e[2] - e[3]) / 2
    return dict(zip(chosen.labels, (first, e[0] - e[3] - first), strict=True))


def _fraction(draws: np.ndarray) -> dict:
    low, high = np.quantile(draws[1:], (0.025, 0.975))
    here = float(draws[0])
    return {"share": here, "ci95": [float(np.clip(min(low, here), -1, 1)), float(np.clip(max(high, here), -1, 1))]}

"""The order of a search: what is refitted without folds, and what its first steps must not drop."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pitp_jax._diagnose.budget import Budget
from pitp_jax._diagnose.evidence import evidence
from pitp_jax._diagnose.fit import Fit
from pitp_jax._diagnose.search import Hypothesis, Search

SAMPLES = 1000


def fit_of(*names, cost=np.inf):
    return Fit(names, (), np.zeros(1), np.zeros((1, 2)), cost=cost, residuals=[np.full(SAMPLES, cost)])


def bare_search() -> Any:
    """A search without a case, in which a residual's size is its error."""
    search: Any = object.__new__(Search)
    search.every, search.waiting, search._climbed, search.exclude = {}, {}, set(), set()
    search.samples, search.budget, search.refit = SAMPLES, Budget(), False
    search.weigh = lambda rows: evidence(rows, np.zeros(1))
    search.labels = lambda fit: fit.names
    return search


def hypothesis(fit, error) -> Hypothesis:
    return Hypothesis(fit, fit.names, [], evidence([np.full(SAMPLES, error)], np.zeros(1)))


@pytest.mark.parametrize("seed", range(5))
def test_the_best_three_out_of_fold_are_found_without_refitting_all(seed):
    """Fits leave more out of fold than in sample, each by a factor of its own."""
    rng = np.random.default_rng(seed)
    inside = rng.uniform(1.0, 10.0, 30)
    outside = dict(enumerate(inside * rng.uniform(1.0, 1.3, 30)))
    search, refitted = bare_search(), []

    def scored(fits):
        refitted.extend(f.names[0] for f in fits)
        return [hypothesis(f, outside[int(f.names[0])]) for f in fits]

    search._scored = scored
    search.waiting = {frozenset([str(k)]): fit_of(str(k), cost=e) for k, e in enumerate(inside)}
    search.judge(1)
    wanted = sorted(outside, key=lambda k: outside[k])[:3]
    assert [int(h.names[0]) for h in search.level(1)[:3]] == wanted
    assert len(refitted) < 15
    # of those that lack the best the three best as well
    best = search.level(1)[0].names[0]
    search.judge(1, {best})
    wanted = sorted(outside, key=lambda k: outside[k])[1:4]
    assert [int(h.names[0]) for h in search.level(1, {best})[:3]] == wanted


def test_the_best_four_go_to_their_optimum_whatever_their_first_steps_gain():
    """Six hypotheses; after the first steps all leave more than the base, at their optimum all leave less."""
    search, to_the_end = bare_search(), []
    search.every = {frozenset(): hypothesis(fit_of(cost=0.0), 1.0)}
    search.every[frozenset()].fit.residuals = [np.ones(SAMPLES)]
    search.floors, search.misfit, search.samples = np.zeros(1), 0.0, SAMPLES

    def fitted(fits, iterations):
        for f in fits:
            f.cost = float(f.names[0]) * (1 if iterations < 14 else -1)
            f.residuals = [np.full(SAMPLES, np.exp(0.5 * f.cost))]
        if iterations == 14:
            to_the_end.extend(f.names[0] for f in fits)

    search.fitter = SimpleNamespace(fit=fitted)
    search._climb({frozenset([n]): [fit_of(n)] for n in "615243"})
    assert sorted(to_the_end) == list("1234")
    assert set(search.waiting) == {frozenset(n) for n in "1234"}

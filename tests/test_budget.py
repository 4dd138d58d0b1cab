"""Computing time is kept: the best so far is told, with what was not tried."""

import time

import numpy as np
import pytest

from pitp_jax.method.diagnose.budget import Budget


def test_what_a_budget_does_not_reach_is_noted_once():
    budget = Budget(100.0)
    assert budget.allows("this")
    budget.reserve = 200.0
    assert not budget.allows("that") and not budget.allows("that")
    assert budget.notes() == ("The search stopped after 100 s (--seconds) and did not try: that",)
    assert Budget(reserve=1e9).allows("anything") and Budget().notes() == ()
    assert Budget(0.0).remaining < 0 and np.isinf(Budget().remaining)


def test_what_follows_a_search_has_its_reserve():
    assert Budget(100.0, reserve=60.0).allows("this") and not Budget(50.0, reserve=60.0).allows("this")


@pytest.mark.parametrize(("seconds", "said"), [(np.inf, "6 s elapsed"), (100.0, "6 of at most 100 s elapsed")])
def test_a_line_every_few_seconds_says_how_long_the_search_has_taken(monkeypatch, seconds, said):
    now, lines = [0.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    budget = Budget(seconds, run_steps=1000, progress=lines.append, began=0.0)
    budget.begin("sets of 1")
    for _ in range(4):
        now[0] += 2.0
        budget.count(3_600_000)
    assert lines == ["sets of 1", f"sets of 1: {said}"]

"""Computing time is kept: the best so far is told, with what was not tried."""

import numpy as np

from pitp_jax._diagnose.budget import Budget


def test_what_a_budget_does_not_reach_is_noted_once():
    budget = Budget(100.0)
    assert budget.allows("this") and not budget.allows("that", 200.0) and not budget.allows("that", 200.0)
    assert budget.notes() == ("stopped after 100 s (--seconds), not tried: that",)
    assert Budget().allows("anything", 1e9) and Budget().notes() == ()
    assert Budget(0.0).remaining < 0 and np.isinf(Budget().remaining)

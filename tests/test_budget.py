"""Computing time is kept: the best so far is told, with what was not tried."""

import time
from dataclasses import replace

import numpy as np
import pytest
from played import nominal_of, play

import pitp_jax as pitp
from pitp_jax._diagnose.budget import Budget
from pitp_jax._effects import CATALOGUE, effect

OTHERS = sorted({c.name for c in CATALOGUE} - {"electrode_rc", "delay"})


def test_what_a_budget_does_not_reach_is_noted_once():
    budget = Budget(100.0)
    assert budget.allows("this") and not budget.allows("that", 200.0) and not budget.allows("that", 200.0)
    assert budget.notes() == ("stopped after 100 s (--seconds), not tried: that",)
    assert Budget().allows("anything", 1e9) and Budget().notes() == ()
    assert Budget(0.0).left < 0 and np.isinf(Budget().left)


@pytest.fixture(scope="module")
def slow(linear):
    """Two effects in the records, and what is left of a diagnosis in no time."""
    nominal = nominal_of(linear)
    records = play(replace(nominal, effects=(effect("electrode_rc", tau=0.02),)))
    return nominal, records


def test_out_of_time_the_best_so_far_is_told(slow):
    began = time.monotonic()
    found = pitp.diagnose(*slow, exclude=OTHERS, seconds=1e-3)
    assert time.monotonic() - began < 60
    assert found.ranking and np.isfinite(found.gap.after) and found.gap.after <= found.gap.before
    (note,) = found.notes
    assert note.startswith("stopped after 0.001 s") and "the last steps of a fit" in note

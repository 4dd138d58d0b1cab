"""Computing time is kept: the best so far is told, with what was not tried."""

import time

import numpy as np

from pitp_jax.method.diagnose.budget import Budget


def test_what_a_budget_does_not_reach_is_noted_once():
    budget = Budget(100.0)
    assert budget.allows("this") and not budget.allows("that", 200.0) and not budget.allows("that", 200.0)
    assert budget.notes() == ("The search stopped after 100 s (--seconds) and did not try: that",)
    assert Budget().allows("anything", 1e9) and Budget().notes() == ()
    assert Budget(0.0).remaining < 0 and np.isinf(Budget().remaining)


def test_what_follows_a_search_has_its_reserve():
    budget = Budget(100.0, reserve=60.0)
    assert budget.allows("this", 30.0) and not budget.allows("that", 50.0)


def test_a_line_every_few_seconds_says_what_is_left(monkeypatch):
    """Two seconds a block of a tenth of the longest search: after six seconds 14 s are left."""
    now, lines = [0.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    budget = Budget(run_steps=1000, progress=lines.append, began=0.0)
    budget.begin("sets of 1")
    for _ in range(6):
        now[0] += 2.0
        budget.count(3_600_000)
    assert lines[0] == "sets of 1"
    assert lines[1:] == [
        "sets of 1: 6 s elapsed, at most 14 s left",
        "sets of 1: 12 s elapsed, at most 8 s left",
    ]


def test_no_time_left_is_printed_while_programs_are_compiled(monkeypatch):
    """A ten-thousandth of the steps in six seconds of compiling would give 60,000 s."""
    now, lines = [0.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    budget = Budget(run_steps=1000, progress=lines.append, began=0.0)
    for steps in (3_600, 17_996_400):
        now[0] += 6.0
        budget.count(steps)
    assert ["left" in line for line in lines] == [False, True]


def test_the_option_is_named_where_minutes_are_left_and_no_limit_is_set(monkeypatch):
    now, lines = [0.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    for run_steps, seconds in ((100, np.inf), (100_000, np.inf), (100_000, 100.0)):
        budget = Budget(seconds, run_steps=run_steps, progress=lines.append, began=now[0])
        now[0] += 6.0
        budget.count(1_000_000)
    assert ["--seconds" in line for line in lines] == [False, True, False]

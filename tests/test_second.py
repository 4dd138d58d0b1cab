"""A floor from cycles that repeat, and a second effect found around the first: what a quiet rig's diagnosis needs."""

from dataclasses import replace

import numpy as np
import pytest
from played import SAMPLES, TIME, nominal_of, play

from pitp_jax._diagnose.batched_rollouts import Lanes
from pitp_jax._diagnose.case import build_case
from pitp_jax._diagnose.effect_pairs import _around
from pitp_jax._diagnose.evaluation import judge
from pitp_jax._diagnose.fit import Candidate, fit
from pitp_jax._diagnose.noise import estimate, scatter
from pitp_jax._effects import CATALOGUE, effect, lookup

QUIET = 1e-3


@pytest.fixture(scope="module")
def nominal(linear):
    return nominal_of(linear)


def bursts(case, hz):
    """The case with sines in three bursts of growing height for drives; `hz` one a record."""
    size = SAMPLES // 3
    steps = np.repeat([0.3, 0.6, 1.0], size)
    played = [600 * steps * (1 - np.cos(2 * np.pi * f * TIME)) for f in hz]
    rows = [
        replace(s, record=replace(s.record, voltage=u)) for s, u in zip(case.series[: len(hz)], played, strict=True)
    ]
    return replace(case, series=tuple(rows))


def test_bursts_leave_the_floor_of_their_cycles(nominal):
    """A gap that follows the drive has no gaps between its lines, and drops out where the drive comes back."""
    case = bursts(build_case(nominal, play(nominal, noise=0.0)), (2.5, 3.1))  # 100 and 80.6 samples
    rng, errors = np.random.default_rng(0), []
    for s in case.series:
        follows = (s.record.voltage / 600) ** 2 + (s.record.voltage / 600) ** 4
        errors.append(0.1 * follows + QUIET * rng.standard_normal(SAMPLES))
    found = estimate(case, errors)
    assert found.sigma == pytest.approx(QUIET, rel=0.1)
    assert found.source == "cycles of the drive that repeat" and found.sensor <= found.sigma
    assert np.trapezoid(found.spectrum[:, 1], found.spectrum[:, 0]) == pytest.approx(QUIET**2, rel=0.5)


def test_a_wander_slower_than_a_period_is_seen(nominal):
    """Over up to eight periods: from one to the next it would hide."""
    case = bursts(build_case(nominal, play(nominal, noise=0.0)), (12.5,))  # 20 samples
    rng = np.random.default_rng(1)
    wander = np.convolve(rng.standard_normal(SAMPLES + 200), np.hanning(120) / 6.7, "valid")[:SAMPLES] * QUIET
    next_one = np.sqrt(np.mean((wander[20:] - wander[:-20]) ** 2) / 2)
    assert next_one < 0.4 * wander.std()
    assert scatter(case, [wander]) > 0.7 * wander.std()


def test_no_drive_that_repeats_no_floor_from_it(nominal):
    case = build_case(nominal, play(nominal, noise=0.0))
    broad = [k for k, s in enumerate(case.series) if s.record.name in ("sweep", "steps")]
    only = replace(case, series=tuple(case.series[k] for k in broad))
    assert scatter(only, [s.error for s in only.series]) is None


@pytest.mark.slow
def test_the_second_effect_is_what_screens_best_around_the_first(nominal):
    """A coupling that zips up beside dry friction: around the fitted coupling, friction leads."""
    force = 600.0**2 / nominal.scales.force
    both = (
        effect("coulomb_friction", level=0.08 * force),
        effect("stretch_coupling", form="exponential", b=-1.5 / build_case(nominal, play(nominal)).surroundings.reach),
    )
    case = build_case(nominal, play(replace(nominal, effects=both), noise=1e-7))
    form = lookup("stretch_coupling", "exponential")
    starts = form.start(case.surroundings)
    begin = [Candidate((form,), (s.values,), (s,), np.ones(3), False) for s in starts]
    lanes = Lanes(case, [(form,)])
    first = min(judge(lanes, fit(lanes, begin)), key=lambda j: j.heldout)
    pairs = _around(case, CATALOGUE, [first], False)
    first_two = [pair.names for pair in pairs[:2]]  # a dead band has flat tops too; fits tell them apart
    assert ("stretch_coupling", "coulomb_friction") in first_two
    assert all(pair.values[0] == first.candidate.values[0] for pair in pairs)
    assert len({s.names for s in pairs}) > 1 and all(len(set(s.names)) == 2 for s in pairs)

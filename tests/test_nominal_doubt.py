"""What is not known of the nominal: its numbers, and in a refit its zero and its hold."""

from dataclasses import replace

import numpy as np
import pytest
from played import DT, FEW, nominal_of, play
from typed import some

import pitp_jax as pitp
from pitp_jax._diagnose.batched_rollouts import Lanes
from pitp_jax._diagnose.case import build_case
from pitp_jax._diagnose.evaluation import Judged, judge
from pitp_jax._diagnose.fit import Candidate, fit
from pitp_jax._diagnose.hold import settled
from pitp_jax._diagnose.parameter_uncertainty import doubted
from pitp_jax._effects import CATALOGUE, effect, lookup
from pitp_jax._model import Fitted, Origin


@pytest.fixture(scope="module")
def nominal(linear):
    return nominal_of(linear)


@pytest.mark.slow
def test_the_nominals_own_doubt_widens_an_effects_interval(nominal):
    """All coefficients off by one common 1 % are a gain off by 1 %: that much the sensor's gain is not known."""
    told = Fitted(nominal, Origin(covariance=np.full((3, 3), 1e-4)))
    records = play(replace(nominal, effects=(effect("sensor_gain", d=0.3),)))
    sure, unsure = (pitp.diagnose(m, records, exclude=FEW).added[0].parameters["d"] for m in (nominal, told))
    assert sure["stderr"] < 1e-3 and unsure["value"] == sure["value"]
    assert unsure["stderr"] == pytest.approx(0.01 * 1.3, rel=0.02)


@pytest.mark.slow
def test_a_refit_reads_the_sensors_zero_anew(nominal):
    """A nominal whose zero is 4 um off, twice the noise, as one that was identified without the effect."""
    off = replace(nominal, output=replace(nominal.output, offset=4e-6))
    planted = replace(nominal, effects=(effect("voltage_offset", offset=60.0),))
    found = pitp.diagnose(off, play(planted), refit_nominal=True, exclude=FEW)
    assert found.effects == ("voltage_offset",)
    told = found.added[0].parameters["offset"]
    assert abs(told["value"] - 60.0) < 3 * told["stderr"] < 6.0
    assert found.model.output.offset == pytest.approx(0.0, abs=5e-7)
    np.testing.assert_allclose(found.shift, 1.0, rtol=0.01)


def test_a_refit_does_not_know_the_hold(nominal):
    """A zero-order hold is half a sample of delay: so little is a delay known behind one, and no more."""
    held = replace(nominal, hold="zoh")
    case = build_case(held, play(nominal))
    begin = Candidate((lookup("delay"),), ((0.02,),), (lookup("delay").start(case.surroundings)[0],), np.ones(3), True)
    judged = Judged(replace(begin, covariance=np.zeros((5, 5))), (), 1.0, 1.0)
    told = doubted(case, judged, held).candidate.covariance
    np.testing.assert_allclose(np.sqrt(np.diag(told)) * 0.02, [DT / 2, 0, 0, 0, 0])
    np.testing.assert_array_equal(doubted(case, judged, nominal).candidate.covariance, 0.0)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_a_refit_settles_the_hold_once_the_effect_is_known(nominal, hold):
    """A nominal that took its hold from lagged records: under the wrong one tau was read half a sample short."""
    held = replace(nominal, hold="zoh")
    lag = effect("sensor_lag", tau=0.02)
    records = play(replace(nominal, hold=hold, effects=(lag,)))
    case = build_case(held, records)
    begin = Candidate(
        (lookup("sensor_lag"),), ((0.015,),), (lookup("sensor_lag").start(case.surroundings)[0],), np.ones(3), True
    )
    lanes = Lanes(case, [(lookup("sensor_lag"),)])
    (best,) = judge(lanes, fit(lanes, [begin]))
    found, model = settled(case, best, held)
    assert model.hold == hold
    assert found.candidate.values[0][0] == pytest.approx(0.02, rel=5e-3)


@pytest.mark.slow
def test_what_has_one_form_has_no_excuse_for_what_it_leaves(nominal):
    """A sensor's lag passes for a delay in part only: excused for a nominal of unknown quality, not for a good one."""
    lag = replace(nominal, effects=(effect("sensor_lag", tau=0.015),))
    others = {c.name for c in CATALOGUE if c.name != "delay"} | {"parameter_change"}
    records = play(lag)
    known = pitp.identify(play(nominal, seed=1), order=2).model
    excused, not_excused = (pitp.diagnose(m, records, exclude=sorted(others)) for m in (nominal, known))
    assert excused.effects == ("delay",) and excused.gap.after > 2.5 * some(excused.gap.noise_floor)
    assert not_excused.verdict == "unknown" and some(not_excused.gap.closed_fraction) > 0.72

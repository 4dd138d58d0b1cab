"""The feedforward keeps every limit, swings in from rest, and says what to expect of it."""

import numpy as np
import pytest
from motions import DT, HIGH, SAMPLES, SLEW, TIME, hump, respond, swing, swing_force
from scipy.signal import lsim

from pitp_jax import BadInput, Target, e_rms_percent, feedforward
from pitp_jax.method.invert.advice import on_reach
from pitp_jax.method.invert.limits import limits_of
from pitp_jax.method.model.input_map import LinearInput


def slew_of(found, dt=DT):
    return np.abs(np.diff(found.voltage, prepend=0.0)).max() / dt


def others(found):
    """Warnings but for the one that a target begins high, which most of these do."""
    return [line for line in found.warnings if "the target's first sample needs" not in line]


# ---- limits ----


def test_a_voltage_limit_is_kept_and_flagged(actuator):
    x = swing(2e-3, 1e-3, 2.0)
    found = feedforward(actuator, Target(TIME, x), max_voltage=1500.0, max_slew=1e9, shots=0)
    free = feedforward(actuator, Target(TIME, x), max_slew=1e9, shots=0)
    assert free.voltage.max() > 1600
    assert not free.saturated.any()
    assert found.voltage.max() <= 1500.0
    assert found.voltage.min() >= 0.0
    wanted = np.sqrt(swing_force(actuator, 2e-3, 1e-3, 2.0))
    sure = np.abs(wanted - 1500.0) > 1.0
    np.testing.assert_array_equal(found.saturated[found.target][sure], wanted[sure] > 1500.0)
    begins, line = found.warnings
    assert f"{100 * np.mean(wanted > 1500.0):.0f} % of the target" in line
    assert "1500 V" in line
    assert free.warnings == (begins,) and "the target's first sample needs" in begins


@pytest.mark.slow
def test_a_target_that_asks_for_a_push_says_how_much_of_it_does(actuator):
    """Twice as fast as the resonance, the force swings about that of rest by three times the motion: below zero."""
    found = feedforward(actuator, Target(TIME, swing(3e-4, 3e-4, 10.0)))
    assert 0.05 < (share := found.infeasible[found.target].mean()) < 0.95
    assert any(f"{100 * share:.0f} % of the target needs a force" in line for line in found.warnings)


@pytest.mark.slow
def test_a_jump_of_acceleration_at_the_start_is_led_in(actuator):
    """x'' of this target jumps at its first sample: the voltage is at its hundreds of volts by then, from 0 V."""
    target = Target(TIME, 1e-3 * (1 - np.cos(4 * np.pi * TIME)))
    found = feedforward(actuator, target)
    first = int(np.argmax(found.target))
    assert found.voltage[0] == found.voltage[-1] == 0
    a, w = actuator.physical_coefficients, 4 * np.pi
    assert found.voltage[first] == pytest.approx(np.sqrt(a[2] * 1e-3 * w**2), rel=0.02)
    assert any("the target's first sample needs" in line for line in found.warnings)
    assert np.abs(respond(actuator, found.voltage)[:, 0]).min() > -1e-4


def test_a_cut_names_the_origin_of_its_slew_limit(actuator):
    """The model's recordings where the user gave no limit; only the value otherwise."""
    default, given = (limits_of(actuator, None, slew, None)[0] for slew in (None, 4e4))
    between, cut = np.full(10, 700.0), np.arange(10) < 5
    (line,), (shorter,) = (on_reach(0.0, between, cut, limits) for limits in (default, given))
    assert "5e+04 V/s (the largest of the model's recordings; --max-slew sets another); ask for" in line
    assert "4e+04 V/s; ask for" in shorter
    assert default.text == "0 to 2000 V, at most 5e+04 V/s (voltage and rate of the model's recordings)"
    assert given.text == "0 to 2000 V, at most 4e+04 V/s (voltage of the model's recordings)"


@pytest.mark.parametrize(("low", "high", "named"), [
    (0.5, 0.0, "the lower limit 0 V; ask"), (0.0, 0.5, "by 2000 V; ask"), (0.3, 0.3, "the lower limit 0 V and 2000 V;"),
])  # fmt: skip
def test_a_cut_names_only_the_limits_that_are_met(actuator, low, high, named):
    place = np.linspace(0, 1, 100, endpoint=False)
    at_low, at_high = place < low, place >= 1 - high
    (line,) = on_reach(0.0, np.select([at_low, at_high], [0.0, 2e3], 700.0), at_low | at_high,
                       limits_of(actuator, None, None, None)[0])  # fmt: skip
    assert named in line and "V/s" not in line


def test_the_linear_maps_limit_holds_both_ways(linear, bounded):
    model = bounded(linear(2, input_map=LinearInput()), -2e6, 2e6, 1e9)
    found = feedforward(model, Target(TIME, swing(0.0, 2e-3, 2.0)), max_voltage=1e6)
    assert np.abs(found.voltage).max() <= 1e6
    assert found.voltage.min() == -1e6
    assert 0.1 < found.saturated[found.target].mean() < 0.9


@pytest.mark.slow
@pytest.mark.parametrize("slew", [5e4, 1e4, 5e3, 1e3, 200.0])
@pytest.mark.parametrize("kind", ["moving", "resonant", "hump", "corners"])
def test_every_sample_keeps_the_slew_limit(actuator, kind, slew):
    targets = {
        "moving": swing(1e-3, 9e-4, 2.0),
        "resonant": swing(3e-4, 1e-3, 5.0, -np.pi / 2),
        "hump": hump(seconds=SAMPLES * DT - DT).displacement,
        "corners": 1e-3 * np.abs(2 * ((2 * TIME) % 1) - 1),
    }
    found = feedforward(actuator, Target(TIME, targets[kind]), max_slew=slew)
    assert slew_of(found) <= slew * (1 + 1e-6)
    assert found.voltage[-1] == 0
    assert found.voltage.max() <= HIGH
    if slew <= 1e3:  # all of these need more: the flags must say so
        assert found.saturated.any()


def test_a_higher_voltage_than_trained_warns(actuator):
    target = Target(TIME, swing(2e-3, 1e-3, 2.0))
    (line,) = others(feedforward(actuator, target, max_voltage=2500.0))
    assert "2500 V" in line
    assert "2000 V" in line
    assert others(feedforward(actuator, target, max_voltage=HIGH)) == []


@pytest.mark.parametrize("name", ["max_voltage", "max_slew"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_a_limit_that_is_not_positive_is_refused(actuator, name, value):
    with pytest.raises(BadInput, match=name.replace("_", "-")):
        feedforward(actuator, hump(), **{name: value})


def test_an_endless_voltage_is_refused(actuator):
    with pytest.raises(BadInput, match="finite"):
        feedforward(actuator, hump(), max_voltage=float("inf"))


# ---- the way in and out ----


@pytest.mark.parametrize(
    ("mid", "amplitude", "hz", "phase"),
    [(1e-3, 5e-4, 2.0, 0.0), (1e-3, 5e-4, 5.0, -np.pi / 2), (3e-4, 1e-3, 5.0, -np.pi / 2)],
)
def test_the_lead_in_swings_from_rest_to_the_targets_first_state(actuator, mid, amplitude, hz, phase):
    found = feedforward(actuator, Target(TIME, swing(mid, amplitude, hz, phase)))
    first = int(np.argmax(found.target))
    assert found.voltage[0] <= SLEW * DT
    assert found.voltage[-1] == 0
    assert not found.infeasible.any()
    assert not found.saturated.any()
    state = respond(actuator, found.voltage[: first + 1])[-1]
    w = 2 * np.pi * hz
    wanted = mid + amplitude * np.sin(phase), amplitude * w * np.cos(phase)
    assert state[0] == pytest.approx(wanted[0], abs=2e-4 * amplitude)
    assert state[1] == pytest.approx(wanted[1], abs=1e-3 * amplitude * w)  # the last one starts below zero


@pytest.mark.slow
def test_a_first_state_out_of_the_amplifiers_reach_is_told(actuator):
    """A metre off, at a tenth of the slowest resonance; within reach nothing is said."""

    def told(top):
        found = feedforward(actuator, Target(TIME, swing(top, 0.1 * top, 1.0)))
        return [w for w in found.warnings if "initial state" in w]

    assert told(1e-3) == []
    (line,) = told(1.0)
    assert "no voltage within the limits" in line


def test_a_single_time_constant_is_led_in_along_a_few_of_it(linear, bounded):
    """It has no resonance to be rocked at: five periods of 1 / (2 pi tau) would take 31 tau.

    Three time constants, or twice that where no more force is to be used than the first sample needs.
    """
    tau = 1 / (2 * np.pi * 2.5)
    model = bounded(linear(1, 5.0), 0.0, 1800.0, slew=1e5)
    found = feedforward(model, Target(TIME, swing(1e-3, 2e-4, 1.0)))
    assert 2 * tau < TIME[0] - found.time[0] < 7 * tau
    a0, a1 = model.physical_coefficients
    force = found.voltage[: int(np.argmax(found.target)) + 1] ** 2
    x = lsim(([1.0], [a1, a0]), force, DT * np.arange(len(force)))[1][-1]
    assert x == pytest.approx(1e-3, rel=1e-3)


def test_a_target_at_rest_has_no_lead_in_and_its_own_clock(actuator):
    target = hump()
    found = feedforward(actuator, target)
    assert found.target[0]
    assert found.target.sum() == len(target.time)
    assert found.voltage[-1] == 0
    np.testing.assert_allclose(found.time[found.target], target.time, atol=1e-12)


def test_the_clock_runs_back_into_the_lead_in(actuator):
    found = feedforward(actuator, Target(TIME + 7.0, swing(1e-3, 5e-4, 2.0)))
    np.testing.assert_allclose(found.time[found.target], TIME + 7.0, atol=1e-9)
    np.testing.assert_allclose(np.diff(found.time), DT, rtol=1e-6)
    assert found.time[0] < 7.0 - DT
    assert {len(v) for v in (found.time, found.voltage, found.infeasible, found.saturated)} == {len(found.target)}


# ---- advice ----


def test_corners_warn_and_a_smooth_target_does_not(actuator):
    triangle = 1e-3 + 5e-4 * (2 * np.abs(2 * ((2 * TIME) % 1) - 1) - 1)
    assert any("not smooth enough" in line for line in feedforward(actuator, Target(TIME, triangle)).warnings)
    assert others(feedforward(actuator, Target(TIME, swing(1e-3, 5e-4, 2.0)))) == []


def test_a_coarser_target_warns_and_is_still_inverted(actuator):
    time = np.arange(500) * 2e-3
    target = Target(time, swing(1e-3, 5e-4, 2.0, time=time))
    found = feedforward(actuator, target)
    (line,) = others(found)
    assert "coarser" in line
    assert found.time[1] - found.time[0] == pytest.approx(DT)  # along a spline, on the model's step
    x = respond(actuator, found.voltage)[found.target, 0][::2]
    assert e_rms_percent(x, target.displacement) < 0.01


def test_a_target_outside_the_trained_region_warns_with_the_share(linear, bounded):
    speed = 2 * np.pi * 5 * 1e-3  # scale of x'
    region = ((0.0, 1.2), (-1.0, 1.0))  # in mm, and in units of that
    model = bounded(linear(2), region=region)
    x = swing(1e-3, 5e-4, 2.0)
    velocity = 5e-4 * 2 * np.pi * 2 * np.cos(2 * np.pi * 2 * TIME)
    assert np.abs(velocity / speed).max() < 1
    found = feedforward(model, Target(TIME, x), shots=0)
    outside = float((x * 1e3 > 1.2 + 0.05 * 1.2).mean())
    assert 0.3 < outside < 0.4
    assert found.outside_training_share == pytest.approx(outside, abs=2e-3)
    (line,) = others(found)
    assert f"{100 * found.outside_training_share:.0f} %" in line
    assert feedforward(model, Target(TIME, swing(6e-4, 2e-4, 2.0))).outside_training_share == 0


@pytest.mark.slow
def test_a_limit_of_a_linear_input_holds_both_ways_for_both_signs_only(linear, bounded):
    """Noise about zero volts does not make a rig bipolar."""
    wanted = Target(TIME, swing(0.0, 2e-3, 1.0) * (1 - np.exp(-((5 * (TIME - TIME[0])) ** 3))))
    both = feedforward(bounded(linear(2, input_map=LinearInput()), -1e6, 1e6, slew=1e12), wanted, max_voltage=5e6)
    assert not both.saturated.any() and both.voltage.min() < -1.5e6 and both.voltage.max() > 1.5e6
    one = feedforward(bounded(linear(2, input_map=LinearInput()), -1e4, 1e6, slew=1e12), wanted, max_voltage=5e6)
    assert one.voltage.min() == pytest.approx(-1e4)
    assert any("clipped by the lower limit -1e+04 V" in line for line in one.warnings)

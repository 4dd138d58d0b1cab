"""A plan on the clock of a DAQ: faster by straight lines, slower along the target's spline."""

import numpy as np
import pytest

from pitp_jax import BadInput, Feedforward, Target, feedforward
from pitp_jax.method.invert.lead_in import led_in
from pitp_jax.method.invert.limits import Limits
from pitp_jax.method.invert.motion import wanted_motion
from pitp_jax.method.invert.playback import at_faster_rate
from pitp_jax.method.invert.target import at_rate_of_model, at_slower_rate

TIME = -0.3 + 1e-3 * np.arange(1301)


def plan():
    u = 1000 * np.sin(np.pi * np.arange(1301) / 1300) ** 2
    flags = np.arange(1301) % 100 < 50
    return Feedforward(TIME, u, flags, ~flags, TIME > -5e-4, TIME, 0.0, 1.0, 2.0, ())


@pytest.mark.parametrize("rate", [1500.0, 10000.0, 44100.0])
def test_a_faster_clock_gets_straight_lines(rate):
    found = at_faster_rate(plan(), rate)
    np.testing.assert_allclose(np.diff(found.time), 1 / rate, rtol=1e-6)
    assert found.time[0] == TIME[0] and TIME[-1] - 1e-9 <= found.time[-1] < TIME[-1] + 1 / rate
    np.testing.assert_allclose(found.voltage, np.interp(found.time, TIME, plan().voltage), atol=1e-9)
    before = np.clip(np.floor((found.time - TIME[0]) * 1e3 + 1e-6).astype(int), 0, 1300)
    np.testing.assert_array_equal(found.infeasible, plan().infeasible[before])
    assert found.voltage[-1] == pytest.approx(0, abs=1e-9)


def test_a_slower_clock_gets_the_targets_spline():
    target = Target(TIME, np.sin(9 * TIME))
    found = at_slower_rate(target, 130.0)
    assert found.dt == pytest.approx(1 / 130)
    np.testing.assert_allclose(found.displacement, np.sin(9 * found.time), atol=1e-9)


def test_a_slower_clock_gets_no_rounding():
    """At 4 kHz, 1 nm is more than the whole acceleration of this target."""
    time = np.arange(10_000) / 1e4
    found = at_slower_rate(Target(time, np.round(5e-4 * (1 - np.cos(np.pi * time)), 9)), 4000.0)
    rate, truth = np.diff(found.displacement, 2) * 4000.0**2, 5e-4 * np.pi**2 * np.cos(np.pi * found.time[1:-1])
    np.testing.assert_allclose(rate, truth, atol=0.02 * np.abs(truth).max())


@pytest.mark.parametrize("rate", [None, 1000.0])
def test_the_same_clock_changes_nothing(rate):
    target, made = Target(TIME, np.sin(9 * TIME)), plan()
    assert at_slower_rate(target, rate) is target and at_faster_rate(made, rate) is made


@pytest.mark.parametrize("rate", [2.0, 1e9])
def test_a_clock_for_nothing_is_refused(rate):
    with pytest.raises(BadInput, match="--rate"):
        at_slower_rate(Target(TIME, np.sin(9 * TIME)), rate)


@pytest.mark.parametrize(("count", "power"), [(2, 1), (3, 1), (40, 3)])
def test_way_points_are_met_and_joined_smoothly_on_the_clock_of_the_model(count, power):
    """A cubic (or, of two points, a line) is met everywhere, not at the way points alone."""
    time = 0.1 * np.arange(count)
    made = at_rate_of_model(Target(time, time**power - time), 0.0049)
    assert made.dt <= 0.0049 * 1.01 and made.time[-1] == time[-1]
    np.testing.assert_allclose(made.displacement, made.time**power - made.time, atol=1e-12)
    assert at_rate_of_model(made, 0.0049) is made and at_rate_of_model(made, 0.1) is made


def test_the_plan_of_way_points_is_that_of_their_spline(linear):
    model, time = linear(2), 0.1 * np.arange(8)
    target = Target(time, 1e-3 * np.sin(4 * time) ** 2)
    found = feedforward(model, target, shots=0, max_voltage=5000, max_slew=1e7)
    fine = feedforward(model, at_rate_of_model(target, 1e-3), shots=0, max_voltage=5000, max_slew=1e7)
    np.testing.assert_array_equal(found.voltage, fine.voltage)
    (told,) = set(found.warnings) - set(fine.warnings)
    assert "every 0.1 s, coarser than the model's 0.001 s, and was interpolated by a cubic spline" in told


@pytest.mark.parametrize(("order", "damping"), [(2, 0.05), (2, 0.3), (2, 1.2), (3, 0.3), (3, 1.2)])
def test_the_way_to_a_held_displacement_asks_no_more_than_that_does(linear, order, damping):
    """The force of the ODE on the way in, by difference quotients, lies between 0 and the force at its end."""
    model, dt = linear(order, damping=damping), 1e-3
    target = Target(dt * np.arange(800), np.full(800, 1e-3))
    path = led_in(wanted_motion(model, target, target), Limits(0.0, 1e4, 1e9))
    lead = path.displacement[: path.target.start + 20]
    force, state = np.zeros_like(lead), lead
    for a in np.asarray(model.physical_coefficients):
        force, state = force + a * state, np.gradient(state, dt)
    force = force[order:-order] / (float(model.physical_coefficients[0]) * 1e-3)
    assert path.reached and path.slew_kept
    assert force[-1] == pytest.approx(1, abs=1e-6)
    assert -0.02 < force.min() and force.max() < 1.04

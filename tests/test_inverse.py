"""The feedforward against closed forms and an independent integration."""

import re
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motions import DT, SAMPLES, TIME, hump, respond, swing, swing_force

import pitp_jax as pitp
from pitp_jax import BadInput, Target, e_rms_percent, feedforward, rest_state
from pitp_jax.method.invert.equation import invert_path
from pitp_jax.method.invert.steps import inverse as inverse_sample
from pitp_jax.method.invert.target import last_digit, without_rounding
from pitp_jax.method.model.coordinate import Zero
from pitp_jax.method.model.input_map import LinearInput
from pitp_jax.method.numerics.spline_derivative import derivatives
from pitp_jax.method.simulate.decoder import rollout

# ---- eq. 13 ----


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_eq_13_is_the_closed_form_force_of_a_sine(linear, double, order):
    with jax.enable_x64(True):
        model = double(linear(order))
        x = swing(1e-3, 5e-4, 3.0, 0.3)
        equation = derivatives(x, DT, order) / np.asarray(model.scales.state)
        force, voltage, features = invert_path(model, jnp.asarray(equation), DT)
        truth = swing_force(model, 1e-3, 5e-4, 3.0, 0.3)
        assert truth.min() > 0
        error = np.abs(np.asarray(force) * model.scales.force - truth) / truth.max()
        assert error[20:-20].max() < 1e-8
        assert error.max() < 1e-6  # one-sided at the ends of the spline
        np.testing.assert_allclose(np.asarray(voltage)[20:-20], np.sqrt(truth)[20:-20], rtol=1e-8)
        assert features.shape == (SAMPLES, order)


def standing_at_zero(model):
    """The model without the force that random weights ask for at zero: it rests there at 0 V, as trained ones do."""
    past = model.encoder.past
    bias = past.readout.bias - past(jnp.zeros(past.hidden.in_features))
    return eqx.tree_at(lambda m: m.encoder.past.readout.bias, model, bias)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "hold", "coarsest", "order_in_dt"),
    [
        ("linear", "foh", 4e-3, 2),  # a voltage linear between samples against the true force
        ("linear", "zoh", 4e-3, 1),  # half a sample late
        ("square", "foh", 4e-3, 2),
        ("nonlinear", "foh", 4e-3, 2),  # tokens frozen over a step, as read at its drifted middle
        ("drag", "foh", 5e-4, 1),  # tokens that see x' too, read at the step's beginning: less than the rest until here
    ],
)
def test_eq_13_falls_at_its_order_and_shooting_removes_the_rest(
    linear, nonlinear, bounded, double, kind, hold, coarsest, order_in_dt
):
    eq_13 = []
    for dt in (coarsest, coarsest / 2, coarsest / 4):
        options = {"dt": dt, "hold": hold} | ({} if kind == "square" else {"input_map": LinearInput()})
        with jax.enable_x64(True):
            varying = kind in ("nonlinear", "drag")
            model = nonlinear(2, key=3, drag=kind == "drag", **options) if varying else linear(2, **options)
            limits = (0.0, 3e3) if kind == "square" else (-3e6, 3e6)
            model = double(standing_at_zero(model) if varying else model)
            found = feedforward(bounded(model, *limits, slew=1e12), hump(dt))
        eq_13.append(found.equation_e_rms_percent)
        assert found.self_check_e_rms_percent < 0.1 * found.equation_e_rms_percent
        assert not found.saturated.any()
    measured = np.log2(np.array(eq_13[:-1]) / np.array(eq_13[1:]))
    np.testing.assert_allclose(measured, order_in_dt, atol=0.1)


def test_without_shots_eq_13_alone_is_played(actuator):
    found = feedforward(actuator, hump(), shots=0)
    assert found.self_check_e_rms_percent == found.equation_e_rms_percent
    assert feedforward(actuator, hump()).equation_e_rms_percent == found.equation_e_rms_percent


def test_an_independent_integration_of_the_ode_follows_the_target(actuator):
    target = Target(TIME, swing(1e-3, 5e-4, 3.0, 0.5))
    found = feedforward(actuator, target)
    x = respond(actuator, found.voltage)[found.target, 0]
    assert e_rms_percent(x, target.displacement) < 2e-3  # the decoder's RK4 steps differ from the ODE by as much
    assert found.self_check_e_rms_percent < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("shots", [0, 6])
def test_the_self_check_is_the_models_rollout_of_the_returned_voltage(nonlinear, bounded, shots):
    model, target = bounded(nonlinear(2, key=3)), hump()
    found = feedforward(model, target, shots=shots)
    states = eqx.filter_jit(rollout)(model, jnp.asarray(found.voltage, jnp.float32), DT, rest_state(model))
    x = np.asarray(states[:, 0], np.float64)[found.target] * model.scales.state[0]
    again = e_rms_percent(x, target.displacement)
    assert found.self_check_e_rms_percent == pytest.approx(again, rel=0.02, abs=1.2e-5)  # abs: 100 eps in %


@pytest.mark.slow
def test_vmapped_inverse_is_the_loop(nonlinear):
    model = nonlinear(2, key=5)
    paths = [swing(1e-3, 4e-4, hz) for hz in (2.0, 3.0, 4.0)]
    batch = jnp.stack([jnp.asarray(derivatives(x, DT, 2) / model.scales.state, jnp.float32) for x in paths])
    together = jax.vmap(lambda e: invert_path(model, e, DT))(batch)
    for k, equation in enumerate(batch):
        for one, many in zip(invert_path(model, equation, DT), together, strict=True):
            np.testing.assert_allclose(many[k], one, rtol=2e-5, atol=2e-5 * float(jnp.abs(one).max()))


# ---- what no voltage does ----


@pytest.mark.parametrize("shots", [0, pytest.param(6, marks=pytest.mark.slow)])
def test_samples_are_infeasible_where_the_analytic_force_is_negative(actuator, shots):
    found = feedforward(actuator, Target(TIME, swing(1e-3, 9e-4, 8.0)), shots=shots, max_slew=1e9)
    negative = swing_force(actuator, 1e-3, 9e-4, 8.0) < 0
    assert 0.2 < negative.mean() < 0.3
    assert (found.infeasible[found.target] == negative).mean() > 0.995
    if shots == 0:  # the nearest motion may pull there too
        assert (found.voltage[found.infeasible] == 0).all()


def test_a_target_that_rests_is_feasible(actuator):
    x = 1e-3 * np.where(TIME > 0.3, np.sin(np.pi * (TIME - 0.3) / 0.7) ** 4, 0.0)
    found = feedforward(actuator, Target(TIME, x))
    assert not found.infeasible.any()
    assert not found.saturated.any()


@pytest.mark.parametrize(("needed", "flagged"), [(-1e-9, False), (-5e-4, False), (-5e-3, True)])
def test_rest_is_feasible_within_the_force_of_the_sensors_noise(nonlinear, bounded, needed, flagged):
    """The offset token of a trained model at rest has either sign; noise of 1 um bears 1e-3 of the force."""
    model = bounded(standing_at_zero(nonlinear(2, key=3)))
    bias = model.encoder.past.readout.bias + needed
    model = eqx.tree_at(lambda m: m.encoder.past.readout.bias, model, bias)
    model = replace(model, domain=replace(model.domain, noise=1e-6))
    still = np.zeros(400)
    plan = feedforward(model, Target(TIME[:400], still))
    step = inverse_sample(model, DT)
    masks = {
        "closed form": pitp.inverse(model, still)[1],
        "discrete": pitp.inverse(model, still, kind="discrete")[1],
        "plan": plan.infeasible[plan.target],
        "stream": next(iter(pitp.invert_stream(model, [still], DT))).infeasible,
        "export": [jax.jit(step.run)(step.start(jnp.zeros(()), jnp.zeros(())), jnp.zeros(3))[1][1]],
    }
    assert {name: float(np.mean(mask)) for name, mask in masks.items()} == dict.fromkeys(masks, float(flagged))
    assert not plan.saturated.any()


def test_the_linear_map_pulls_both_ways(linear, bounded):
    model = bounded(linear(2, input_map=LinearInput()), -2e6, 2e6, 1e9)
    target = Target(TIME, swing(0.0, 1e-3, 3.0))
    found = feedforward(model, target)
    assert not found.infeasible.any()
    force = swing_force(model, 0.0, 1e-3, 3.0)
    np.testing.assert_allclose(found.voltage[found.target][20:-20], force[20:-20], atol=2e-3 * force.max())
    assert found.voltage.min() < -0.9 * np.abs(force).max()
    assert e_rms_percent(respond(model, found.voltage)[found.target, 0], target.displacement) < 2e-3


# ---- the user's coordinates ----


def test_a_reversed_sensor_changes_its_own_readings_alone(linear, bounded, actuator):
    """From 0 V a target grows as the actuator extends, whatever the sensor's direction."""
    x = swing(1e-3, 5e-4, 3.0)
    reversed_ = bounded(linear(2, offset=7e-3, polarity=-1.0))
    plain = feedforward(actuator, Target(TIME, x))
    cases: tuple[tuple[Zero, np.ndarray], ...] = (("rest", x), ("sensor", 7e-3 - x), (2e-3, 2e-3 + x))
    for zero, wanted in cases:
        found = feedforward(reversed_, Target(TIME, wanted), zero=zero)
        np.testing.assert_allclose(found.voltage, plain.voltage, atol=0.05)
        assert found.self_check_e_rms_percent < 1e-3
        np.testing.assert_array_equal(found.wanted[found.target], wanted)
        assert np.isnan(found.wanted[~found.target]).all()
        played = pitp.rollout(reversed_, found.voltage, DT, begins="rest", zero=zero)
        assert e_rms_percent(played[found.target], wanted) < 1e-3


def test_behind_a_linear_input_a_displacement_has_the_sensors_sign(linear, bounded):
    """A positive input moves a reversed sensor's reading down, and that is the coordinate."""
    model = bounded(linear(2, input_map=LinearInput(), offset=3e-3, polarity=-1.0), -2e6, 2e6, 1e9)
    found = feedforward(model, Target(TIME, swing(-5e-4, 4e-4, 3.0)))
    force = swing_force(model, 5e-4, -4e-4, 3.0)
    np.testing.assert_allclose(found.voltage[found.target][20:-20], force[20:-20], atol=2e-3 * force.max())


@pytest.mark.parametrize(
    ("zero", "remedy"), [("rest", "give --zero sensor"), ("sensor", "leave out --zero sensor"), (1e-3, "--zero sensor")]
)
def test_a_target_on_the_side_that_cannot_be_reached_is_refused(linear, bounded, zero, remedy):
    x, at_rest = swing(1e-3, 5e-4, 3.0), {"rest": 0.0, "sensor": 7e-3}.get(zero, zero)
    model = bounded(linear(2, offset=7e-3))
    with pytest.raises(BadInput, match=f"100 % of the target .*change the sign of the target.*{remedy}"):
        feedforward(model, Target(TIME, at_rest - x), zero=zero)


def test_a_target_out_of_reach_on_both_sides_is_planned(actuator):
    """Far above the resonance half of a swing about zero needs a push, and half of its negative as well."""
    found = feedforward(actuator, Target(TIME, swing(-1e-4, 1e-3, 12.0)), shots=0, max_slew=1e9)
    assert 0.4 < found.infeasible[found.target].mean()


@pytest.mark.parametrize("held", [0.0, 3e5])
def test_a_file_begins_and_ends_at_the_input_that_holds_the_machine(linear, bounded, held):
    """Exactly; from there a linear machine swings about where it stands as another does about 0."""
    model = bounded(linear(2, input_map=LinearInput()), -2e6, 2e6, 1e9)
    stands = held / model.physical_coefficients[0]
    found = feedforward(model, Target(TIME, stands + swing(0.0, 5e-4, 3.0)), start_input=held)
    plain = feedforward(model, Target(TIME, swing(0.0, 5e-4, 3.0)))
    assert found.voltage[0] == found.voltage[-1] == held
    np.testing.assert_allclose(found.voltage, held + plain.voltage, atol=2e-3 * np.abs(plain.voltage).max())


def test_a_fast_lag_beside_the_resonance_shortens_no_way_out(linear, bounded):
    """Order 3: what swings after the end is at most the target's last velocity, rung down over three periods."""
    model = bounded(linear(3, 5.0, 0.1, substeps=4), slew=1e6)
    found = feedforward(model, Target(TIME, swing(4e-4, 2.5e-4, 3.0)), shots=0)
    assert found.voltage[0] == found.voltage[-1] == 0
    still = np.append(found.voltage, np.zeros(400))
    x = np.asarray(rollout(model, jnp.asarray(still, jnp.float32), DT, rest_state(model))[:, 0])
    swings = 0.25 * 3.0 / 5.0  # mm: v / w of the target's end, on a resonance of 5 Hz
    assert np.abs(x[-400:]).max() < swings * np.exp(-0.1 * 2 * np.pi * 3)


@pytest.mark.parametrize(("order", "rate"), [(2, 10_000), (3, 1000)])
def test_a_rounded_file_is_planned_as_the_motion_that_it_holds(linear, bounded, order, rate):
    """Its last digit, differentiated, is thousands of volts: at the first sample, and as a push at every second one."""
    model, time = bounded(linear(order, dt=1 / rate), 0.0, 4000.0, 1e6), np.arange(rate) / rate
    wanted = 5e-4 * (1 - np.cos(np.pi * time))
    found = feedforward(model, Target(time, np.round(wanted, 9)), shots=0)
    a, w = model.physical_coefficients, np.pi
    force = a[0] * 5e-4 - 5e-4 * np.real(np.polyval(a[::-1], 1j * w) * np.exp(1j * w * time))
    assert np.sqrt(force[0]) < 100 and force.min() > 0
    np.testing.assert_allclose(found.voltage[found.target][1:], np.sqrt(force)[1:], atol=5)
    assert not found.infeasible.any()
    assert not any("first sample needs" in line or "not smooth" in line for line in found.warnings)
    rough = derivatives(np.round(wanted, 9), 1 / rate, order) @ a
    assert (rough[:100] < 0).mean() > 0.2


def test_a_target_stays_within_its_last_digit_and_unchanged_without_one():
    wanted = swing(1e-3, 5e-4, 2.0)
    rounded = Target(TIME, np.round(1e3 * wanted, 4) / 1e3, "mm")
    assert last_digit(rounded) == pytest.approx(1e-7)
    smooth = without_rounding(rounded, 5).displacement
    assert np.abs(smooth - rounded.displacement).max() <= 1e-7
    rate, truth = np.diff(smooth, 2) / DT**2, -5e-4 * (4 * np.pi) ** 2 * np.sin(4 * np.pi * TIME[1:-1])
    assert np.abs(rate - truth).max() < 0.05 * np.abs(truth).max()
    exact = Target(TIME, wanted)
    assert last_digit(exact) == 0 and without_rounding(exact, 5) is exact
    steps = 1e-4 * np.abs(np.arange(SAMPLES) % 20 - 10)  # ten steps of the range are the user's choice
    assert last_digit(Target(TIME, steps)) == 0


@pytest.mark.parametrize("samples", [2, 3, 5])
def test_a_target_too_short_for_the_order_is_refused(actuator, samples):
    with pytest.raises(BadInput, match=f"{samples} samples"):
        feedforward(actuator, Target(np.arange(samples) * DT, np.zeros(samples)))


def test_a_target_held_still_is_reached_though_eq_15_has_no_normaliser(actuator):
    found = feedforward(actuator, Target(TIME, np.full(SAMPLES, 1e-3)))
    assert np.isnan(found.self_check_e_rms_percent)
    assert float(re.findall(r"differs from it by ([\d.e-]+) m$", found.warnings[-1])[0]) < 1e-10
    np.testing.assert_allclose(respond(actuator, found.voltage)[found.target, 0], 1e-3, rtol=1e-4)


@pytest.mark.parametrize(
    ("time", "wanted", "told"),
    [
        (TIME, np.where(np.arange(SAMPLES) == 7, np.nan, 1e-3), "target: column 'displacement', sample 7: the target"),
        (TIME, np.zeros(SAMPLES - 1), f"sample {SAMPLES - 1}: {SAMPLES - 1} samples"),
        (TIME[:1], np.zeros(1), "1 in all"),
        (TIME**2, np.zeros(SAMPLES), "not uniform"),
    ],
)
def test_a_target_that_cannot_be_played_says_so(time, wanted, told):
    with pytest.raises(BadInput, match=told):
        Target(time, wanted)

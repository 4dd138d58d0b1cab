"""The feedforward against closed forms, an independent integration, and every promise it makes about limits."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from pitp_jax._decode import rest_state, rollout
from pitp_jax._errors import BadInput
from pitp_jax._inverse import feedforward, invert_path
from pitp_jax._metrics import e_rms_percent
from pitp_jax._model.input_map import LinearInput
from pitp_jax._path import derivatives
from pitp_jax._record.reading import Target

DT, SAMPLES = 1e-3, 1000
TIME = np.arange(SAMPLES) * DT
HIGH, SLEW = 2000.0, 5e4


@pytest.fixture(scope="module")
def bounded():
    """fn(model, voltage range, slew, region): the model as if trained within those limits."""

    def make(model, low=0.0, high=HIGH, slew=SLEW, region=()):
        known = model.provenance.with_(voltage_range=(low, high), slew=slew, region=region)
        return replace(model, provenance=known)

    return make


@pytest.fixture(scope="module")
def actuator(linear, bounded):
    """F = u^2, 5 Hz, damping 0.1, 1 mm at 1000 V; trained up to 2000 V and 50 kV/s, sampled at 1 kHz."""
    return bounded(linear(2))


def swing(mid, amplitude, hz, phase=0.0, time=TIME):
    return mid + amplitude * np.sin(2 * np.pi * hz * time + phase)


def swing_force(model, mid, amplitude, hz, phase=0.0):
    """Force of `swing` in V^2, in closed form: a_0 mid + Im(amplitude sum_i a_i (j w)^i e^(j(w t + phase)))."""
    a, w = model.physical_coefficients, 2 * np.pi * hz
    return a[0] * mid + amplitude * np.imag(np.polyval(a[::-1], 1j * w) * np.exp(1j * (w * TIME + phase)))


def hump(dt=DT, top=1e-3, hz=2.0, seconds=1.0):
    """Humps of sin^4: three derivatives start at zero."""
    time = np.arange(round(seconds / dt) + 1) * dt
    return Target(time, top * np.sin(np.pi * hz * time) ** 4)


def respond(model, voltage, dt=DT, finer=8):
    """States [x, x'] of the linear ODE of order 2 from rest: exact steps of dt / 8 under the linear voltage."""
    a0, a1, a2 = model.physical_coefficients
    chained = np.array([[0, 1, 0, 0], [-a0 / a2, -a1 / a2, 1 / a2, 0], [0, 0, 0, finer / dt], [0, 0, 0, 0]])
    exact = expm(chained * dt / finer)
    fine = np.interp(np.arange((len(voltage) - 1) * finer + 1) / finer, np.arange(len(voltage)), voltage)
    force = np.asarray(model.input_map.force(fine))
    states = np.zeros((len(force), 2))
    for k in range(len(force) - 1):
        now = np.array([*states[k], force[k], force[k + 1] - force[k]])
        states[k + 1] = exact[:2] @ now
    return states[::finer]


def slew_of(found, dt=DT):
    return np.abs(np.diff(found.voltage)).max() / dt


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


@pytest.mark.parametrize(
    ("kind", "hold", "coarsest", "order_in_dt"),
    [
        ("linear", "foh", 4e-3, 2),  # a voltage linear between samples against the true force
        ("linear", "zoh", 4e-3, 1),  # half a sample late
        ("square", "foh", 4e-3, 2),
        ("nonlinear", "foh", 4e-3, 2),  # tokens frozen over a step, as read at its drifted middle
        ("drag", "foh", 1e-3, 1),  # tokens that see x' too, read at the step's beginning: less than the rest until here
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
            found = feedforward(bounded(double(model), *limits, slew=1e12), hump(dt))
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


def test_the_self_check_is_the_models_rollout_of_the_returned_voltage(nonlinear, bounded):
    model, target = bounded(nonlinear(2, key=3)), hump()
    found = feedforward(model, target)
    states = eqx.filter_jit(rollout)(model, jnp.asarray(found.voltage, jnp.float32), DT, rest_state(model))
    x = np.asarray(states[:, 0], np.float64)[found.target] * model.scales.state[0]
    again = e_rms_percent(x, target.displacement)
    assert found.self_check_e_rms_percent == pytest.approx(again, rel=0.02, abs=2e-6)  # float32, another compilation


def test_vmapped_inverse_is_the_loop(nonlinear):
    model = nonlinear(2, key=5)
    paths = [swing(1e-3, 4e-4, hz) for hz in (2.0, 3.0, 4.0)]
    batch = jnp.stack([jnp.asarray(derivatives(x, DT, 2) / model.scales.state, jnp.float32) for x in paths])
    together = jax.vmap(lambda e: invert_path(model, e, DT))(batch)
    for k, equation in enumerate(batch):
        for one, many in zip(invert_path(model, equation, DT), together, strict=True):
            np.testing.assert_allclose(many[k], one, rtol=2e-5, atol=2e-5 * float(jnp.abs(one).max()))


# ---- what no voltage does ----


@pytest.mark.parametrize("shots", [0, 6])
def test_samples_are_infeasible_where_the_analytic_force_is_negative(actuator, shots):
    found = feedforward(actuator, Target(TIME, swing(1e-3, 9e-4, 8.0)), shots=shots, max_slew=1e9)
    negative = swing_force(actuator, 1e-3, 9e-4, 8.0) < 0
    assert 0.2 < negative.mean() < 0.3
    assert (found.infeasible[found.target] == negative).mean() > 0.995
    assert (found.voltage[found.infeasible] == 0).all()


def test_a_target_that_rests_is_feasible(actuator):
    x = 1e-3 * np.where(TIME > 0.3, np.sin(np.pi * (TIME - 0.3) / 0.7) ** 4, 0.0)
    found = feedforward(actuator, Target(TIME, x))
    assert not found.infeasible.any()
    assert not found.saturated.any()


def test_the_linear_map_pulls_both_ways(linear, bounded):
    model = bounded(linear(2, input_map=LinearInput()), -2e6, 2e6, 1e9)
    target = Target(TIME, swing(0.0, 1e-3, 3.0))
    found = feedforward(model, target)
    assert not found.infeasible.any()
    force = swing_force(model, 0.0, 1e-3, 3.0)
    np.testing.assert_allclose(found.voltage[found.target][20:-20], force[20:-20], atol=2e-3 * force.max())
    assert found.voltage.min() < -0.9 * np.abs(force).max()
    assert e_rms_percent(respond(model, found.voltage)[found.target, 0], target.displacement) < 2e-3


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
    assert found.warnings == ()


def test_the_linear_maps_limit_holds_both_ways(linear, bounded):
    model = bounded(linear(2, input_map=LinearInput()), -2e6, 2e6, 1e9)
    found = feedforward(model, Target(TIME, swing(0.0, 2e-3, 2.0)), max_voltage=1e6)
    assert np.abs(found.voltage).max() <= 1e6
    assert found.voltage.min() == -1e6
    assert 0.1 < found.saturated[found.target].mean() < 0.9


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
    (line,) = feedforward(actuator, target, max_voltage=2500.0).warnings
    assert "2500 V" in line
    assert "2000 V" in line
    assert feedforward(actuator, target, max_voltage=HIGH).warnings == ()


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
    assert feedforward(actuator, Target(TIME, swing(1e-3, 5e-4, 2.0))).warnings == ()


def test_a_coarser_target_warns_and_is_still_inverted(actuator):
    time = np.arange(500) * 2e-3
    target = Target(time, swing(1e-3, 5e-4, 2.0, time=time))
    found = feedforward(actuator, target)
    (line,) = found.warnings
    assert "coarser" in line
    x = respond(actuator, found.voltage, dt=2e-3)[found.target, 0]
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
    (line,) = found.warnings
    assert f"{100 * found.outside_training_share:.0f} %" in line
    assert feedforward(model, Target(TIME, swing(6e-4, 2e-4, 2.0))).outside_training_share == 0


# ---- the user's coordinates ----


def test_offset_and_polarity_are_undone(linear, bounded, actuator):
    x = swing(1e-3, 5e-4, 3.0)
    mirrored = bounded(linear(2, offset=7e-3, polarity=-1.0))
    plain = feedforward(actuator, Target(TIME, x))
    found = feedforward(mirrored, Target(TIME, 7e-3 - x))
    np.testing.assert_allclose(found.voltage, plain.voltage, atol=0.05)
    assert found.self_check_e_rms_percent < 1e-3


@pytest.mark.parametrize("samples", [2, 3, 5])
def test_a_target_too_short_for_the_order_is_refused(actuator, samples):
    with pytest.raises(BadInput, match=f"{samples} samples"):
        feedforward(actuator, Target(np.arange(samples) * DT, np.zeros(samples)))


def test_a_target_held_still_is_reached_though_eq_15_has_no_normaliser(actuator):
    found = feedforward(actuator, Target(TIME, np.full(SAMPLES, 1e-3)))
    assert np.isnan(found.self_check_e_rms_percent)
    np.testing.assert_allclose(respond(actuator, found.voltage)[found.target, 0], 1e-3, rtol=1e-4)

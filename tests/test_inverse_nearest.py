"""The nearest motion within the limits: its parts against SciPy and differences, its plans against the bars."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from motions import DT, TIME, hump, swing
from scipy.optimize import lsq_linear, minimize

from pitp_jax.method.effects import effect
from pitp_jax.method.invert import change_programme
from pitp_jax.method.invert.change_programme import _Cut, _readings
from pitp_jax.method.invert.feedforward_plan import feedforward
from pitp_jax.method.invert.limits import travel
from pitp_jax.method.invert.nearest_motion import Wish
from pitp_jax.method.invert.self_check import play
from pitp_jax.method.invert.stage_qp import StageQP, solve_stage_qp
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.input_map import LinearInput
from pitp_jax.method.signal.target import Target
from pitp_jax.method.simulate.decoder import rest_state, rollout


def lagging(model, tau=5e-3):
    return eqx.tree_at(lambda m: m.drive, model, ElectrodeLag(jnp.asarray(np.log(tau), jnp.float32)))


# ---- the parts ----


def test_the_programme_is_the_one_scipy_solves():
    """Random stages, bounds and budget: by SLSQP over the controls."""
    rng, stages, n = np.random.default_rng(1), 9, 3
    A = 0.6 * rng.standard_normal((stages, n, n))
    A[0], A[:, -1], A[:, -1, -1] = 0.0, 0.0, 1.0
    C = rng.standard_normal((stages, n))
    q, b, G = rng.standard_normal((stages, n)), 0.1 * rng.standard_normal(stages), rng.standard_normal((stages, 1, n))
    wide = np.full((stages, 1), 0.4)
    h = 0.1 * rng.standard_normal(stages)
    parts = A, np.einsum("ki,kj->kij", C, C), q, b, 0.5, G, -wide, wide, np.ones(stages), h, 0.9
    z = solve_stage_qp(StageQP(*parts))

    def states(w):
        out = [np.zeros(n)]
        for k in range(stages - 1):
            out.append(A[k] @ out[-1] + np.append(np.zeros(n - 1), w[k]))
        return np.array(out)

    def cost(w):
        z = states(w)
        return 0.5 * ((C * z).sum(1) ** 2).sum() + (q * z).sum() + 0.25 * ((w + b[:-1]) ** 2).sum()

    def slack(w):
        value = np.einsum("krn,kn->kr", G, states(w))[:, 0]
        spent = np.abs(states(w)[:, -1] + h).sum()
        return np.concatenate([0.4 - value, 0.4 + value, [0.9 - spent]])

    found = minimize(cost, np.zeros(stages - 1), constraints={"type": "ineq", "fun": slack}, method="SLSQP",
                     options={"maxiter": 500, "ftol": 1e-12})  # fmt: skip
    w = z[1:, -1] - np.einsum("kn,kn->k", A[:-1, -1], z[:-1])
    assert cost(w) == pytest.approx(found.fun, abs=1e-4)
    assert slack(w).min() > -1e-5


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["order 1", "order 2", "order 3", "lag", "zoh", "delay"])
@pytest.mark.parametrize("length", [1, 4])
def test_a_small_change_of_the_voltage_does_what_the_stages_say(nonlinear, double, monkeypatch, kind, length):
    monkeypatch.setattr(change_programme, "_FLOOR", 0.0)
    order = int(kind[-1]) if kind.startswith("order") else 2
    with jax.enable_x64(True):
        model = double(nonlinear(order, key=2, hold="zoh" if kind == "zoh" else "foh"))
        model = double(lagging(model)) if kind == "lag" else model
        late = 7 if kind == "delay" else 0
        if late:
            model = replace(model, effects=(effect("delay", time=late * DT),))
        count, stages = 120, 120 // length
        u = 300 + 250 * np.sin(60 * DT * np.arange(count)) ** 2
        wish = Wish(
            np.zeros(count),
            np.ones(count, bool),
            DT,
            np.zeros(count),
            np.full(count, 2e3),
            1e5,
            1e9,
            np.asarray(rest_state(model)),
        )
        knots = np.append(0.0, np.random.default_rng(3).standard_normal(stages))
        change = np.interp(np.arange(count) / length, np.arange(stages + 1), knots)
        moved = [play(model, u + sign * 0.05 * change, DT, wish.start).reading for sign in (1, -1)]
        truth = (moved[0] - moved[1]) / (0.1 / wish.unit)
        onward, reading = _readings(model, wish, play(model, u, DT, wish.start), _Cut(stages, length), late)
        z, found = np.zeros(onward.shape[-1]), []
        for k in range(stages):
            z[-1] = (knots[k + 1] - knots[k]) / length
            found.append(reading[k] @ z)
            z = onward[k] @ z
    found = np.concatenate(found)[: count - late]
    np.testing.assert_allclose(found, truth[late:], atol=2e-4 * np.abs(truth).max())


# ---- the plans ----


def keeps_the_bars(model, target, **limits):
    """Within the limits, as smooth and as near as eq. 13 cut at the limits; both plans."""
    cut, found = feedforward(model, target, shots=0, **limits), feedforward(model, target, **limits)
    u, high, slew = found.voltage, limits["max_voltage"], limits["max_slew"]
    assert u.max() <= high and u.min() >= 0 and u[0] == u[-1] == 0
    assert np.abs(np.diff(u)).max() <= slew * target.dt * (1 + 1e-9)
    assert travel(u) <= 1.2 * travel(cut.voltage) * (1 + 1e-6)
    assert found.self_check_e_rms_percent <= cut.self_check_e_rms_percent
    x = np.asarray(rollout(model, jnp.asarray(u, jnp.float32), target.dt, rest_state(model))[:, 0], np.float64)
    left = 1e-3 * x[found.target] - target.displacement
    again = 100 * np.sqrt((left**2).mean()) / np.ptp(target.displacement)
    assert found.self_check_e_rms_percent == pytest.approx(again, rel=0.05, abs=1e-3)
    return cut, found


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2, 3])
@settings(
    max_examples=5,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    derandomize=True,
)
@given(
    key=st.integers(0, 30), hz=st.floats(0.5, 9.0), mid=st.floats(2e-4, 1.2e-3), swings=st.floats(0.3, 1.0),
    high=st.floats(500.0, 2000.0), slew=st.floats(5e3, 1e5),
)  # fmt: skip
def test_every_plan_keeps_the_limits_and_turns_no_more_than_the_cut_one(
    nonlinear, bounded, order, key, hz, mid, swings, high, slew
):
    target = Target(TIME, swing(mid, swings * mid, hz))
    keeps_the_bars(bounded(nonlinear(order, key=key)), target, max_voltage=high, max_slew=slew)


@pytest.mark.slow
def test_a_push_is_approached(actuator):
    """A quarter of this sine asks for a negative force: half of what the cut plan leaves at most."""
    target = Target(TIME, swing(1e-3, 9e-4, 8.0))
    cut, found = keeps_the_bars(actuator, target, max_voltage=2000.0, max_slew=5e4)
    assert cut.infeasible[cut.target].mean() > 0.2
    assert found.self_check_e_rms_percent < 0.5 * cut.self_check_e_rms_percent


@pytest.mark.slow
def test_a_single_time_constant_under_a_limit_is_the_least_squares_of_scipy(linear, bounded):
    """x = H u, H by impulses: bounded least squares of the target over u within its range."""
    model = bounded(linear(1, input_map=LinearInput()), -1e6, 1e6, slew=1e12)
    time = 4e-3 * np.arange(150)
    wanted = 1.5e-3 * np.sin(2 * np.pi * 3 * time) * (1 - np.exp(-((10 * time) ** 3)))
    found = feedforward(model, Target(time, wanted))
    assert found.saturated.mean() > 0.1 and found.target[0]
    impulse = np.zeros(150)
    impulse[1] = 1e6
    x = np.asarray(rollout(model, jnp.asarray(impulse, jnp.float32), 4e-3, rest_state(model))[:, 0], np.float64) * 1e-3
    response = np.array([[x[i - j + 1] if j and i >= j - 1 else 0.0 for j in range(150)] for i in range(150)])
    best = lsq_linear(response, wanted, bounds=(-1, 1), tol=1e-12)
    least = 100 * np.sqrt(2 * best.cost / 150) / np.ptp(wanted)
    assert least < 0.98 * found.equation_e_rms_percent
    assert 0.999 * least < found.self_check_e_rms_percent < 1.02 * least


@pytest.mark.parametrize("kind", ["hump", "swing"])
def test_where_no_limit_bites_it_is_eq_13_and_shooting(linear, bounded, monkeypatch, kind):
    """The nearest motion is not asked; of a model that rests at 0 V, as the first sample asks."""
    monkeypatch.setattr("pitp_jax.method.invert.voltage.nearest_motion", None)
    model = bounded(linear(2), 0.0, 4000.0, 1e9)
    target = hump() if kind == "hump" else Target(TIME, swing(1e-3, 3e-4, 2.0))
    found = feedforward(model, target)
    assert not (found.infeasible | found.saturated).any()
    assert found.self_check_e_rms_percent < 0.5 * found.equation_e_rms_percent


def test_shooting_does_not_make_the_voltage_chatter(linear, bounded):
    """Third derivatives of what float32 rounds made four times the fourth differences of eq. 13."""
    target = Target(TIME, swing(1e-3, 3e-4, 2.0))
    cut, found = (feedforward(bounded(linear(3), 0.0, 4000.0), target, shots=shots) for shots in (0, 6))
    bends = [np.abs(np.diff(f.voltage, 4)).max() for f in (cut, found)]
    assert bends[1] < 1.5 * bends[0]
    assert found.self_check_e_rms_percent < 0.05 * cut.self_check_e_rms_percent


@pytest.mark.slow
def test_the_membrane_is_not_driven_farther_than_allowed(actuator):
    target = Target(TIME, swing(1e-3, 5e-4, 2.0))
    found = feedforward(actuator, target, max_displacement=1.2e-3)
    x = np.asarray(rollout(actuator, jnp.asarray(found.voltage, jnp.float32), DT, rest_state(actuator))[:, 0])
    assert 1.15e-3 < np.abs(x).max() * 1e-3 <= 1.2e-3
    (line,) = [w for w in found.warnings if "max-displacement" in w]
    assert f"{100 * np.mean(target.displacement > 1.2e-3):.2g} %" in line and "1.2 mm" in line
    free = feedforward(actuator, target, max_displacement=1.6e-3)
    np.testing.assert_array_equal(free.voltage, feedforward(actuator, target).voltage)


def test_an_acceleration_at_the_first_sample_is_led_in_above_order_two(linear, bounded):
    """From rest an actuator of order 3 cannot take it up at once, and at order 2 the first sample stays at 0 V."""
    target = Target(TIME, 5e-4 * (1 - np.cos(np.pi * TIME)))
    found = feedforward(bounded(linear(3), 0.0, 4000.0, 1e6), target)
    assert found.time[0] < TIME[0] - 0.1
    assert not found.saturated[found.target][:50].any()
    assert found.self_check_e_rms_percent < 0.1
    at_two = feedforward(bounded(linear(2), 0.0, 4000.0, 1e6), target, shots=0)
    assert not at_two.target[0] and at_two.voltage[0] == 0


def test_rounding_a_corner_is_offered_with_its_cost(actuator):
    triangle = 1e-3 + 5e-4 * (2 * np.abs(2 * ((2 * TIME) % 1) - 1) - 1)
    (line,) = [w for w in feedforward(actuator, Target(TIME, triangle), shots=0).warnings if "not smooth" in w]
    width, cost = float(line.split("Gaussian of ")[1].split()[0]), float(line.split("changes it by ")[1].split()[0])
    assert 1 <= width < 50 and 0.01 < cost < 5

"""The feedforward of a model with effects that leave no way, or need time: flags, the beginning, the session's age."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from motions import DT

from pitp_jax.common.metrics import e_rms_percent
from pitp_jax.method.effects import effect, lookup
from pitp_jax.method.invert.feedforward_plan import feedforward
from pitp_jax.method.signal.record import Record
from pitp_jax.method.signal.target import Target
from pitp_jax.method.simulate.decoder import rest_state, rollout
from pitp_jax.method.simulate.prediction import predict

TIME = DT * np.arange(2000)


def number(value):
    return jnp.asarray(value, jnp.float32)


def plan(model, wanted, begins=0.0, **limits):
    return feedforward(model, Target(begins + TIME, wanted), **limits)


def hump(size=1e-3):
    """From rest to rest."""
    return size * np.sin(np.pi * TIME / TIME[-1]) ** 4


def test_a_pull_beyond_saturation_is_no_push(actuator):
    """Where the target asks for less than -F_s, no voltage is played, and all such samples are flagged."""
    model = replace(actuator, effects=(lookup("dielectric_saturation")(number(1.3)),))
    wanted = hump(0.45e-3) * (1 + 0.9 * np.sin(2 * np.pi * 12 * TIME))
    found = plan(model, wanted, shots=0, max_slew=1e9)
    a0, a1, a2 = actuator.physical_coefficients
    rate = np.gradient(wanted, DT)
    force = a0 * wanted + a1 * rate + a2 * np.gradient(rate, DT)  # V^2; the saturation is at 1e6 / 1.3
    back, fore = force < -1.05e6 / 1.3, force > 1.05e6 / 1.3
    assert back.sum() > 50 and fore.sum() > 50
    voltage, flagged = found.voltage[found.target], found.infeasible[found.target]
    assert (voltage[back] == 0).all() and (voltage[fore] == 2000).all()
    assert flagged[back | fore | (force < -1e4)].all() and not flagged[(force > 1e4) & (force < 0.95e6 / 1.3)].any()


@pytest.mark.parametrize("begins", [0.0, 3600.0, 1.7e9])
def test_a_drift_is_inverted_at_the_age_its_clock_shows(actuator, begins):
    """And one of another kind (epoch seconds) shows none."""
    model = replace(actuator, effects=(effect("stiffness_drift", d=-0.3, time=60.0),))
    found = plan(model, hump(), begins)
    age = begins if begins < 1e6 else 0.0
    states = rollout(model, jnp.asarray(found.voltage, jnp.float32), DT, rest_state(model, age))
    x = np.asarray(states, np.float64)[found.target, 0] * model.scales.state[0]
    assert e_rms_percent(x, hump()) < 1e-3
    assert f"{age:.4g} s after the start of the session" in found.warnings[0]


@pytest.mark.parametrize("late", [0.03, 0.1])
def test_what_is_late_is_played_before_the_target_begins(actuator, late):
    wanted = 5e-4 * (1 - np.cos(4 * np.pi * TIME)) * (1 - np.exp(-((20 * TIME) ** 3)))
    found = plan(replace(actuator, effects=(effect("delay", time=late),)), wanted)
    assert found.time[0] <= -late and found.self_check_e_rms_percent < 0.01


@pytest.mark.parametrize("behind", [effect("voltage_offset", offset=60.0), effect("charge_leak", kappa=0.3, tau=1.0),
                                    effect("electrode_rc", tau=0.03)])  # fmt: skip
def test_a_clip_is_asked_about_what_leaves_it(actuator, behind):
    """Not about the film behind the effects that follow."""
    clip = 700.0
    model = replace(actuator, effects=(effect("voltage_clip", inverse=1 / clip), behind))
    found = plan(model, 6e-4 * np.sin(2 * np.pi * TIME) ** 4, shots=0, max_slew=1e9)
    asked = plan(replace(actuator, effects=(behind,)), 6e-4 * np.sin(2 * np.pi * TIME) ** 4, shots=0, max_slew=1e9)
    beyond = asked.voltage > clip
    np.testing.assert_array_equal(found.infeasible[found.target], beyond[found.target])


@pytest.mark.slow
def test_an_offset_behind_a_clip_is_within_its_reach(actuator):
    model = replace(actuator, effects=(effect("voltage_clip", inverse=1 / 700), effect("voltage_offset", offset=60.0)))
    wanted = 6.3e-4 * np.sin(2 * np.pi * TIME) ** 4
    found = plan(model, wanted)
    assert found.voltage.max() < 700 < found.voltage.max() + 60
    assert not found.infeasible[found.target][wanted > 1e-4].any()


@pytest.mark.slow
def test_overlapping_clocks_tell_no_age(actuator):
    """Two files that both begin at an hour are no session: nothing is known of their age."""
    model = replace(actuator, effects=(effect("stiffness_drift", d=-0.3, time=60.0),))
    voltage = 500 * (1 - np.cos(2 * np.pi * TIME))
    x = np.asarray(rollout(model, jnp.asarray(voltage, jnp.float32), DT, rest_state(model)), np.float64)[:, 0]
    fresh = [Record(name, 3600 + TIME, voltage, x * model.scales.state[0]) for name in ("a", "b")]
    for found, r in zip(predict(model, fresh), fresh, strict=True):
        assert e_rms_percent(found.displacement, r.displacement) < 1e-3
    (aged,) = predict(model, fresh[:1])
    assert e_rms_percent(aged.displacement, fresh[0].displacement) > 5
    (epoch,) = predict(model, [replace(fresh[0], time=1.7e9 + TIME)])
    assert e_rms_percent(epoch.displacement, fresh[0].displacement) < 1e-3

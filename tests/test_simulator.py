"""The diagnosis' simulator beside SciPy, and every form of its library beside the package's own rollout."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lsim, lti

from pitp_jax._diagnose.library import ROWS, model_of, row
from pitp_jax._diagnose.simulator import INDEX, LOGARITHM, OFF, Drive, Simulator, step_response
from pitp_jax._simulate import ports
from pitp_jax._simulate.decoder import rest_state, rollout

DT, SAMPLES = 2e-3, 2000
TIME = np.arange(SAMPLES) * DT
VOLTS = 600 * (1.3 - np.cos(2 * np.pi * (0.5 + 1.2 * TIME) * TIME))


@pytest.fixture(scope="module")
def nominal(linear):
    return replace(linear(hz=5.0, dt=DT), substeps=8)


def slots_of(model):
    slots = OFF.copy()
    scaled = model.physical_coefficients * model.scales.state[0] / model.scales.force
    for k, value in zip(("a0", "a1", "a2"), scaled, strict=True):
        slots[INDEX[k]] = value
    return slots


def free_run(slots, volts=VOLTS, dt=DT, square=True, scale=1.0, substeps=4, start=(0.0, 0.0), before=None):
    simulator = Simulator((Drive(volts, dt, start, 0.0, before),), square, scale, substeps)
    return simulator.run(slots[None], [0], np.array([start]))[0]


@pytest.mark.parametrize(
    "a", [(2.0, 0.3, 0.05), (2.0, 0.3, 0.0), (0.0, 0.3, 0.05), (2.0, 5.0, 0.05), (1e-6, 1e-3, 0.05)], ids=str
)
@pytest.mark.parametrize("samples", [7, 40])
def test_the_linear_part_is_exact_at_any_step(a, samples):
    """Also at seven samples a period, without damping, without a spring and of order one."""
    w = np.sqrt(max(a[0], 0.5) / a[2]) if a[2] else a[0] / a[1]
    dt = 2 * np.pi / w / samples
    time = np.arange(300) * dt
    u = np.sin(0.3 * w * time) + np.sign(np.sin(0.11 * w * time))
    slots = OFF.copy()
    for k, v in zip(("a0", "a1", "a2"), a, strict=True):
        slots[INDEX[k]] = v
    plant = lti([1.0], [v for v in a[::-1] if v or v == a[0]])
    truth = lsim(plant, u, time)[1]
    np.testing.assert_allclose(free_run(slots, u, dt, square=False, substeps=1), truth, atol=1e-8 * np.abs(truth).max())


def test_a_drive_that_jumps_at_its_first_sample_is_there_at_once():
    """From rest at 0 V: as a ramp over the first step it once left 1.5 times the noise in every healthy record."""
    slots = OFF.copy()
    for k, v in (("a0", 1.0), ("a1", 0.006), ("a2", 0.001)):
        slots[INDEX[k]] = v
    u = 600 + 350 * np.sin(7 * TIME)
    truth = lsim(([1.0], [0.001, 0.006, 1.0]), u, TIME)[1]
    run = free_run(slots, u, square=False, substeps=1, before=0.0)
    np.testing.assert_allclose(run, truth, atol=1e-8 * np.abs(truth).max())


def test_a_step_response_does_not_damp():
    """An undamped mode at ten steps a period keeps its energy."""
    e, _, _ = step_response(np.ones(1), np.zeros(1), np.ones(1), np.array([2 * np.pi / 10]))
    assert abs(np.linalg.det(e[0]) - 1) < 1e-12


STARTS = {
    "rc": 0.02, "slew": 20000.0, "clip": 900.0, "offset": 60.0, "dead": 80.0, "delay": 0.0073, "charge": 0.2,
    "charge_tau": 0.5, "saturation": 0.5, "stretch": 0.2, "stretch_exp": -0.3, "gent": 0.4, "tanh": 0.6, "expo":
    0.4, "sine": 0.9, "stop": 4.0, "stop_at": 0.5, "low_stop": 4.0, "low_stop_at": -0.05, "mullins": 0.2,
    "mullins_length": 0.4, "bouc": 0.4, "yield": 0.2, "play1": 0.1, "play2": 0.2, "play3": -0.05, "play4": 0.1,
    "play_range": 500.0,
    "drive_bouc": 80.0, "drive_yield": 30.0, "plays": 0.5, "plays_width": 0.1, "drag": 0.002, "dry":
    0.05, "rise": 0.5, "dry_speed": 0.5, "dry_load": 0.1, "rise_speed": 5.0, "slack": 0.0011, "mode_force": 0.2,
    "mode_gain": 0.3, "mode_w": 55.0, "mode_zeta": 0.05, "backlash": 0.1, "coast": 5.0, "lag": 0.01, "filter": 0.008,
    "filter_zeta": 0.7, "gain": 0.1, "s2": 0.1, "s3": 0.03, "bend": 0.5,
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("key", [k for k in ROWS if k[0] != "stiffness_drift"], ids=": ".join)
def test_a_form_of_the_library_is_the_catalogues(nominal, key):
    """What a fit has found is what the model that is handed back does: within 3 % of the effect, at the same steps."""
    if row(*key) is None:
        pytest.skip("the catalogue has no such row yet")
    slots = slots_of(nominal)
    for code in ROWS[key]:
        name = code.removeprefix("-").removeprefix("1/")
        slots[INDEX[name]] = STARTS[name] * (-1 if key[0] == "charge_leak" and name == "charge" else 1)
    model, added, missing = model_of(slots_of(nominal), slots, nominal, 31.4)
    assert not missing and [(e.name, e.form) for e, _ in added] == [key]
    states = rollout(model, jnp.asarray(VOLTS, jnp.float32), DT, rest_state(model))
    truth = np.asarray(ports.readings(model, states), float)
    mine = free_run(slots, scale=float(nominal.scales.force), substeps=8, before=0.0)
    plain = free_run(slots_of(nominal), scale=float(nominal.scales.force), substeps=8, before=0.0)
    effect = np.std(truth - plain)
    assert effect > 5e-3 * np.std(plain)
    assert np.std(mine - truth) < 0.03 * effect + 2e-4 * np.std(plain)


def test_every_slot_is_off_at_its_off_value(nominal):
    """Numbers of an effect that is off change nothing."""
    plain, slots = slots_of(nominal), slots_of(nominal)
    for name in ("charge_tau", "branch_tau", "yield", "plays_width", "rise_speed", "mode_w", "stop_at", "filter_zeta"):
        slots[INDEX[name]] *= 1.7
    np.testing.assert_array_equal(free_run(slots), free_run(plain))
    assert LOGARITHM[INDEX["a1"]]

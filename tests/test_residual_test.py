"""What a model leaves, tested: white noise alone passes, a mode left out shows."""

import numpy as np
import pytest
from scipy.signal import StateSpace, lfilter, lsim
from typed import of_kind, some

from pitp_jax import Record
from pitp_jax.method.identify.identification import identify

DT, SAMPLES = 2e-3, 3000
TIME = np.arange(SAMPLES) * DT
DRIVE = np.sin(2 * np.pi * (0.2 * TIME + 14 * TIME**2 / 6 / 2))
MODE = (2 * np.pi * 4.0, 0.1)


def response(w, zeta, drive=DRIVE):
    return of_kind(tuple, lsim(([w**2], [1.0, 2 * zeta * w, w**2]), drive, TIME))[1]


def noise(seed, size):
    return size * np.random.default_rng(seed).standard_normal(SAMPLES)


def left_of(x):
    return identify(
        [Record("r", TIME, DRIVE, x)], order=2, input_map="linear", hold="foh", leave_out=("delay",)
    ).residuals


def test_white_noise_passes():
    passed = [left_of(response(*MODE) + noise(seed, 0.02)) for seed in range(8)]
    assert sum(t.white for t in passed) >= 6 and sum(t.independent for t in passed) >= 6


def test_coloured_noise_is_not_white_and_still_independent():
    coloured = np.asarray(lfilter([0.3], [1.0, -0.95], noise(3, 0.02)))
    found = left_of(response(*MODE) + coloured)
    assert not found.white and found.independent


def test_a_mode_left_out_shows_the_drive():
    x = response(*MODE) + 0.3 * response(2 * np.pi * 9.0, 0.05) + noise(4, 0.01)
    assert not left_of(x).independent


def test_the_state_space_has_the_poles_and_the_motion():
    """The state space has the identified poles and, driven by the force, the model's own motion."""
    found = identify([Record("r", TIME, DRIVE, -response(*MODE) + noise(5, 1e-3))], order=2, input_map="linear")
    system = found.to_scipy()
    assert isinstance(system, StateSpace)
    assert np.abs(np.linalg.eigvals(some(system.A))) == pytest.approx([MODE[0]] * 2, rel=1e-3)
    run = of_kind(tuple, lsim(system, DRIVE, TIME))[1]
    np.testing.assert_allclose(run, -response(*MODE), atol=2e-3)


@pytest.mark.parametrize("samples", [64, 65, 70])
def test_the_shortest_recordings_are_tested_as_well(samples):
    x = response(*MODE, drive=10 * DRIVE)[::20][:samples]
    found = identify([Record("r", TIME[::20][:samples], 10 * DRIVE[::20][:samples], x)], order=2, input_map="linear")
    assert np.isfinite(found.residuals.own).all() and found.residuals.own[found.residuals.lag == 0] == pytest.approx(
        1.0
    )

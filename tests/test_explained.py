"""A model that explains nothing, little or everything of the output."""

import numpy as np
import pytest
from scipy.signal import lsim

import pitp_jax as pitp
from pitp_jax.method.identify.explained import is_noise
from pitp_jax.method.identify.heldout import Candidate, HeldOut
from pitp_jax.method.identify.output_error import Problem, Structure

TIME = np.arange(1200) / 100


def _levels(seed):
    return np.repeat(np.random.default_rng(seed).uniform(-1, 1, 60), 20)


def _moved(voltage):
    return lsim(([1.0], [0.005, 0.05, 1.0]), voltage, TIME)[1]


def _identified(output, voltage, order=1):
    record = pitp.Record("log", TIME, voltage, output, displacement_unit="m")
    return pitp.identify([record], input_map="linear", order=order, hold="zoh", leave_out=("delay",))


def test_a_sound_record_has_no_warning():
    found = _identified(_moved(_levels(0)), _levels(0), order=2)
    assert found.explains and found.warning is None


def test_an_output_of_another_input_is_not_explained():
    found = _identified(_moved(_levels(0)), _levels(1))
    assert not found.explains and "explains nothing" in str(found.warning)


def test_an_output_of_two_inputs_is_explained_in_part():
    found = _identified(_moved(_levels(0)) + 1.2 * _moved(_levels(1)), _levels(0), order=2)
    assert found.explains and "explains only a part" in str(found.warning)


def test_a_plant_at_rest_in_its_loop_determines_no_model():
    """The controller reacts to the noise of the sensor, which is all that moves."""
    noise = 1e-6 * np.random.default_rng(2).standard_normal(len(TIME) + 1)
    found = _identified(noise[1:], 1e6 * np.diff(noise))
    assert not found.explains and "which a controller feeds back into the input" in str(found.warning)


def test_noise_that_the_input_does_not_follow_is_a_warning():
    noise = 0.5 * np.random.default_rng(2).standard_normal(len(TIME))
    found = _identified(0.3 * _moved(_levels(0)) + noise, _levels(0))
    assert "larger excitation" in str(found.warning) and "controller" not in str(found.warning)


@pytest.mark.parametrize("other", [0.0, 6.0])
def test_a_coefficient_below_its_error_is_not_identifiable(other):
    fit = _identified(_moved(_levels(0)) + other * _moved(_levels(1)), _levels(0)).chosen
    assert fit.poles_known
    assert fit.identifiable == bool((fit.stderr < np.abs(fit.coefficients)).all()) == (other == 0)


@pytest.mark.parametrize(("fraction", "noisy"), [(0.45, False), (0.55, True)])
def test_an_output_is_noise_beyond_half_of_its_deviation(fraction, noisy):
    """Two records of a slow sine in white noise; one in three samples of the second was not measured."""
    rng, phase = np.random.default_rng(2), np.linspace(0, 6 * np.pi, 6000)
    motion = np.sqrt(2 * (1 - fraction**2)) * np.sin(phase)
    outputs = tuple(size * (motion + fraction * rng.standard_normal(6000)) for size in (1.0, 3.0))
    weights = np.ones(6000), (np.arange(6000) < 4000).astype(float)
    problem = Problem(outputs, outputs, weights, (), (), square=False, dt=1e-3, scale=1.0, omega=10.0, fine=1e-3)
    assert is_noise(problem) == noisy


@pytest.mark.parametrize(("error", "score"), [(0.0, 1e-3), (1e-3, np.sqrt(2e-6)), (0.3, 0.3)])
def test_a_held_out_error_counts_a_thousandth_at_least(error, score):
    found = Candidate(Structure(1), np.zeros(1), 0.0, True, HeldOut(error, (), ()), True)
    assert found.score == pytest.approx(score, rel=1e-5)

"""What training reads: scales of either kind, the nominal unchanged in them, weights, and settings that are refused."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lsim

from pitp_jax import Record
from pitp_jax.method.model.memory import FadingMemory, NoMemory
from pitp_jax.method.signal.preprocess import force_band
from pitp_jax.method.train.dataset import build_dataset, spread_weights

DT, SAMPLES = 2e-3, 1500
TIME = np.arange(SAMPLES) * DT


@pytest.fixture(scope="module")
def plant(linear, coefficients):
    """A linear actuator and two noise-free chirps of it."""

    def record(low, high):
        voltage = 900 * (1 - np.cos(2 * np.pi * (low * TIME + (high - low) * TIME**2 / (2 * TIME[-1]))))
        return Record(f"{low}", TIME, voltage, lsim(([1.0], coefficients(2)[::-1]), voltage**2, TIME)[1])

    return linear(2, dt=DT), [record(0.5, 6.0), record(7.0, 1.0)]


def built(plant, scaling="rms", difference="stencil", memory=lambda states: NoMemory()):
    return build_dataset(*plant, scaling=scaling, difference=difference, memory=memory)


@pytest.mark.parametrize("scaling", ["rms", "paper"])
def test_the_nominal_is_the_same_in_other_scales_and_solves_the_equation(plant, scaling):
    data = built(plant, scaling)
    np.testing.assert_allclose(data.model.physical_coefficients, plant[0].physical_coefficients, rtol=1e-6)
    force = data.equation.equation @ data.model.coefficients
    assert float(jnp.abs(data.equation.force).max()) == pytest.approx(1, abs=0.05)
    np.testing.assert_allclose(force, data.equation.force, atol=1e-2)


def test_rms_scales_every_derivative_to_one(plant):
    equation = np.asarray(built(plant).equation.equation, np.float64)
    np.testing.assert_allclose(np.sqrt(np.mean(equation**2, 0)), 1, rtol=1e-5)


def test_paper_scales_are_eq_3(plant):
    """One rms, of the derivative n // 2, times sqrt(2 pi f_max) per derivative."""
    scale = np.asarray(built(plant, "paper").model.scales.state)
    band = force_band([r.voltage**2 for r in plant[1]], DT)
    np.testing.assert_allclose(scale[1:] / scale[:-1], np.sqrt(2 * np.pi * band), rtol=1e-6)
    assert scale[1] == pytest.approx(built(plant).model.scales.state[1])


def test_features_are_the_state_and_the_memory_of_every_sample(plant):
    data = built(plant, memory=lambda states: FadingMemory(jnp.log(jnp.asarray([0.05, 1.0]))))
    assert [f.shape for f in data.features] == [(SAMPLES, 4)] * 2
    together = np.concatenate([f[v] for f, v in zip(data.features, data.valid, strict=True)])
    np.testing.assert_array_equal(data.equation.features, together)
    np.testing.assert_allclose(data.region, np.stack([together.min(0), together.max(0)], -1), rtol=1e-6)
    np.testing.assert_array_equal(data.features[0][0, 2:], 0)  # from rest


def test_rare_states_weigh_more():
    """A thousand samples at rest, ten in motion: mean 1, the rare ones heavier, at most twentyfold."""
    weight = spread_weights(np.concatenate([np.zeros((1000, 2)), np.ones((10, 2)) * np.arange(1, 11)[:, None]]))
    assert weight.mean() == pytest.approx(1)
    assert weight[1000:].min() > 5 * weight[0]
    assert weight.max() <= 20 * weight.min() * (1 + 1e-12)

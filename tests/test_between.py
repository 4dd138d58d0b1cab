"""The voltage between samples: each hold's weights, and a fast tone through the decoder."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lsim

from pitp_jax import discrete_inverse, rest_state
from pitp_jax.method.model.input_map import LinearInput
from pitp_jax.method.numerics.intersample import between, weights
from pitp_jax.method.simulate.decoder import rollout

HOLDS = ("zoh", "foh", "bandlimited")
FRACTIONS = np.array([0.0, 0.2, 0.5, 0.9])


@pytest.mark.parametrize("hold", HOLDS)
def test_weights_add_up_and_samples_stay(hold):
    taps = weights(hold, FRACTIONS)
    np.testing.assert_allclose(taps.sum(0), 1, rtol=0, atol=1e-14)
    here = np.zeros(len(taps))
    here[len(taps) // 2 - 1] = 1
    np.testing.assert_allclose(taps[:, 0], here, rtol=0, atol=1e-14)


def test_a_held_and_a_linear_voltage():
    v = np.array([1.0, 3.0, -2.0])
    np.testing.assert_allclose(between(v, "zoh", np.array([0.3]), np)[:, 0], v)
    np.testing.assert_allclose(between(v, "foh", np.array([0.25]), np)[:, 0], [1.5, 1.75, -2.0])


@pytest.mark.parametrize(("hz", "share"), [(0.05, 1e-4), (0.25, 2e-4), (0.35, 2e-3)])
def test_tones_below_nyquist_are_read_between_their_samples(hz, share):
    """`hz` of the sampling rate; the ends, where samples are missing, set aside.

    Kaiser's window for beta = 8 and 16 taps ripples by 80 dB, up to a third of the sampling rate.
    """
    t = np.arange(200)
    truth = np.sin(2 * np.pi * hz * (t[:, None] + FRACTIONS) + 0.3)
    error = {hold: np.abs(between(truth[:, 0], hold, FRACTIONS, np) - truth)[8:-8].max() for hold in HOLDS}
    assert error["bandlimited"] < share
    assert error["foh"] > 100 * share
    assert error["zoh"] > error["foh"]


@pytest.mark.parametrize("hold", HOLDS)
def test_on_the_host_as_on_the_device(hold):
    v = np.random.default_rng(2).standard_normal(30)
    with jax.enable_x64(True):
        found = between(jnp.asarray(v), hold, FRACTIONS, jnp)
    np.testing.assert_allclose(found, between(v, hold, FRACTIONS, np), rtol=0, atol=1e-13)


@pytest.mark.parametrize("substeps", [2, 4])
def test_a_fast_tone_through_the_decoder(linear, double, coefficients, substeps):
    """0.2 of the sampling rate into a resonance there: foh loses 10 % of it, a band-limited hold 0.1 % or less."""
    dt, hz = 1e-3, 200.0
    window = np.sin(np.pi * np.arange(200) / 199) ** 2
    fine = np.arange(199 * 64 + 1) / 64
    smooth = np.sin(np.pi * fine / 199) ** 2 * np.sin(2 * np.pi * hz * dt * fine)
    a = coefficients(2, hz=200.0)
    truth = lsim(([1.0], a[::-1]), smooth, fine * dt)[1][::64]
    voltage = window * np.sin(2 * np.pi * hz * dt * np.arange(200))
    errors = {}
    with jax.enable_x64(True):
        for hold in ("foh", "bandlimited"):
            model = double(linear(2, hz=200.0, dt=dt, hold=hold, substeps=substeps, input_map=LinearInput()))
            found = np.asarray(rollout(model, jnp.asarray(voltage), dt, rest_state(model)))[:, 0] * 1e-3
            errors[hold] = np.abs(found - truth).max() / np.abs(truth).max()
    assert errors["bandlimited"] < 0.2 * errors["foh"]
    assert 0.05 < errors["foh"] < 0.3


def test_one_sample_of_sixteen_steps_has_no_discrete_inverse(linear):
    with pytest.raises(ValueError, match="foh or zoh"):
        discrete_inverse(linear(2, hold="bandlimited"), jnp.zeros((10, 2)), 1e-3)

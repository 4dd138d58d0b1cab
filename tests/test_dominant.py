"""Which frequency stands for a model: the mode that moves most, not the mean of all poles."""

import numpy as np
import pytest

from pitp_jax.method.invert.motion import settling
from pitp_jax.method.model.dominant import dominant_frequency
from pitp_jax.method.model.model import linear_model

HZ = 2 * np.pi


def pair(hz, damping):
    return np.array([(HZ * hz) ** 2, 2 * damping * HZ * hz, 1.0])


def real(hz):
    return np.array([HZ * hz, 1.0])


@pytest.mark.parametrize(
    ("factors", "hz"),
    [
        ([pair(8.0, 0.1), real(347.0)], 8.0),
        ([pair(8.0, 0.1), pair(398.0, 0.5)], 8.0),
        ([pair(8.0, 0.1), real(0.01)], 8.0),
        ([pair(8.0, 0.3), pair(20.0, 0.05)], 8.0),
        ([pair(10.0, 0.05), pair(200.0, 0.02)], 10.0),
        ([pair(8.0, 0.1), pair(60.0, 0.05), real(30.0)], 8.0),
        ([real(2.4), real(4.7)], np.sqrt(2.4 * 4.7)),  # sqrt(a_0 / a_2), where the lags add up to 90 degrees
        ([real(3.0)], 3.0),
        ([np.array([0.0, 1.0]), real(3.0)], 3.0),
        ([np.array([0.0, 1.0]), real(3.0), real(30.0)], 3.0),
        ([np.array([0.0, 1.0])], 0.0),
        ([real(1e-9), real(3.0)], 3.0),  # the pole that stands for one at 0 after an identification
    ],
)
def test_the_mode_that_is_meant(factors, hz):
    a = np.ones(1)
    for factor in factors:
        a = np.convolve(a, factor)
    assert dominant_frequency(5.0 * a) == pytest.approx(HZ * hz, rel=1e-9)


def test_without_a_resonance_the_model_lags_90_degrees_there():
    """Three real poles, by the phase itself."""
    a = np.convolve(np.convolve(real(1.0), real(4.0)), real(9.0))
    w = dominant_frequency(a)
    assert np.angle(np.polyval(a[::-1], 1j * w)) == pytest.approx(np.pi / 2, abs=1e-9)


def test_a_lead_in_does_not_wait_for_an_integrator():
    assert settling(linear_model([1e-7, 5.8, 2.7], dt=0.01))[0] < 10.0

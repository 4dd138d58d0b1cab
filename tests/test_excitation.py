"""Excitations against eq. 14 and their own promises."""

import numpy as np
import pytest

from pitp_jax.application.plan.excitation import complex_trajectory, multisine, protocol, sine, steps, sweep, triangle
from pitp_jax.application.plan.waveforms import smooth_step


def test_sine_is_eq_14():
    time, values = sine(3.0, 2.0, 1000.0, 2000.0, 3000.0)
    np.testing.assert_array_equal(time, np.arange(2000) / 1000)
    np.testing.assert_allclose(values, 3000 - 2000 * np.cos(2 * np.pi * 3 * time), atol=1e-9)
    assert values[0] == pytest.approx(1000.0)  # A4 - A3


def test_sweep_starts_at_rest_and_has_the_linear_frequency():
    time, values = sweep(1.0, 20.0, 10.0, 1000.0, 3.0, 3.0)
    assert values[0] == pytest.approx(0.0, abs=1e-12)
    # zero crossings of the phase: upward crossings of the mean happen where phase = 2 pi k
    above = values > 3.0
    at = np.flatnonzero(~above[:-1] & above[1:])
    crossing = time[at] + (3.0 - values[at]) / (values[at + 1] - values[at]) / 1000
    frequency = 1.0 + 19.0 * (crossing[:-1] + crossing[1:]) / 2 / 10.0  # exact for a linear sweep
    np.testing.assert_allclose(1 / np.diff(crossing), frequency, rtol=2e-3)
    # eq. 14 itself
    np.testing.assert_allclose(values, 3 * np.sin(np.pi * (1.9 * time + 2.0) * time - np.pi / 2) + 3, atol=1e-9)


def test_rise_and_rest():
    time, values = sine(2.0, 1.0, 1000.0, 1.0, 3.0, rise=0.2, rest_s=0.5)
    plain = sine(2.0, 1.0, 1000.0, 1.0, 3.0)[1]
    assert len(time) == 1500
    np.testing.assert_allclose(np.diff(time), 1e-3, rtol=1e-9)
    assert values[0] == 0.0
    np.testing.assert_array_equal(values[1000:], 0.0)
    np.testing.assert_array_equal(values[200:1000], plain[200:])
    assert abs(values[1]) < 1e-5  # starts with zero slope
    assert smooth_step(np.array([-1.0, 0.0, 0.5, 1.0, 2.0])).tolist() == [0.0, 0.0, 0.5, 1.0, 1.0]


def test_triangle():
    time, values = triangle(1.0, 2.0, 1000.0, 2.0, 5.0)
    np.testing.assert_allclose(values[[0, 250, 500, 750, 1000]], [3.0, 5.0, 7.0, 5.0, 3.0], atol=1e-9)
    np.testing.assert_allclose(np.abs(np.diff(values)), 8.0 / 1000, atol=1e-9)


def test_steps():
    time, values = steps([2000.0, 500.0, 4000.0], 1.0, 1000.0, rise=0.1)
    assert len(time) == 3000
    assert values[0] == 0.0
    for k, level in enumerate((2000.0, 500.0, 4000.0)):
        np.testing.assert_allclose(values[1000 * k + 100 : 1000 * (k + 1)], level)
    assert np.abs(np.diff(values)).max() < 3500 * 1.9 / 100  # steepest slope of the smooth step is 1.875 / rise
    np.testing.assert_array_equal(steps([1.0], 0.1, 1000.0, rise=0.0)[1], 1.0)
    with pytest.raises(ValueError, match="rise"):
        steps([1.0], 0.1, 1000.0, rise=0.2)


def test_multisine_fills_its_band_and_nothing_else():
    time, values = multisine((2.0, 30.0), 4.0, 1000.0, 1500.0, 2000.0, seed=3)
    assert np.abs(values - 2000).max() == pytest.approx(1500.0)
    spectrum = np.abs(np.fft.rfft(values - 2000.0)) / len(values)
    frequency = np.fft.rfftfreq(len(values), 1e-3)
    inside = (frequency >= 2.0 - 1e-9) & (frequency <= 30.0 + 1e-9)
    assert inside.sum() == 113
    np.testing.assert_allclose(spectrum[inside], spectrum[inside][0], rtol=1e-9)
    assert spectrum[~inside].max() < 1e-9
    np.testing.assert_array_equal(values, multisine((2.0, 30.0), 4.0, 1000.0, 1500.0, 2000.0, seed=3)[1])
    assert not np.array_equal(values, multisine((2.0, 30.0), 4.0, 1000.0, 1500.0, 2000.0, seed=4)[1])


def test_multisine_crest_is_lowered():
    def crest(values):
        return np.abs(values).max() / values.std()

    free = multisine((2.0, 30.0), 4.0, 1000.0, 1.0, 0.0, seed=np.random.default_rng(0))[1]
    low = multisine((2.0, 30.0), 4.0, 1000.0, 1.0, 0.0, seed=np.random.default_rng(0), crest=1.9)[1]
    assert crest(free) > 2.3
    assert crest(low) <= 1.9
    with pytest.raises(ValueError, match="band"):
        multisine((0.01, 0.02), 4.0, 1000.0, 1.0, 0.0, seed=0)


def test_complex_trajectory_is_smooth_and_spans_its_range():
    time, values = complex_trajectory(1.0, 10.0, 1000.0, 2.0, 3.0, seed=1, rise=0.5)
    assert values[0] == 0.0
    assert values.max() <= 5.0
    assert values.min() >= 0.0
    assert np.ptp(values[1000:]) > 2.0
    third = np.diff(values[1000:], 3) * 1e9
    assert np.abs(third).max() < (2 * np.pi * 4.0) ** 3 * 4  # no kinks


def test_presets_are_the_papers():
    cone, roll = protocol("cone"), protocol("roll")
    assert (len(cone), len(roll)) == (30, 78)
    assert sum(len(e.time) for e in protocol("cone", rest_s=20.0)) == 900_000
    assert sum(len(e.time) for e in roll) == 1_170_000
    assert (cone[0].dt, roll[0].dt) == (pytest.approx(1e-3), pytest.approx(2e-4))
    assert cone[0].name == "sine_001Hz_1000V"
    assert roll[-1].name == "sine_130Hz_500V"
    assert len({e.name for e in cone + protocol("cone", "test")}) == 30 + 9
    (both,) = protocol("cone", "sweep")
    assert len(both.time) == 200_000
    assert both.voltage.min() == pytest.approx(0.0, abs=1e-3)
    assert both.voltage.max() == pytest.approx(6000.0, abs=1e-3)
    assert len(protocol("roll", "sweep")[0].time) == 450_000
    third = next(e for e in cone if e.name == "sine_003Hz_2000V")
    np.testing.assert_allclose(third.voltage, 3000 - 2000 * np.cos(2 * np.pi * 3 * third.time), atol=1e-8)


@pytest.mark.parametrize("actuator", ["cone", "roll"])
@pytest.mark.parametrize("part", ["sweep", "train", "test"])
def test_presets_never_ask_for_negative_voltage(actuator, part):
    for excitation in protocol(actuator, part):
        assert excitation.voltage.min() >= -1e-9
        assert len(excitation.time) == len(excitation.voltage)


def test_bad_requests():
    with pytest.raises(ValueError, match="no protocol"):
        protocol("ring")
    with pytest.raises(ValueError, match="no protocol"):
        protocol("cone", "dance")
    for seconds in (0.0, np.nan):
        with pytest.raises(ValueError, match="fewer than two"):
            sine(1.0, seconds, 1000.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="negative"):
        sine(1.0, 1.0, 1000.0, 1.0, 1.0, rise=-1.0)

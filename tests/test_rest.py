"""How records begin: noise, rest, and the sensor's zero."""

import numpy as np
import pytest
from scipy.signal import lsim

from pitp_jax._record.record import Record
from pitp_jax._rest import first_states, initial_rest, noise_std, starts_at_rest

DT, OMEGA = 1e-3, 2 * np.pi * 6
TIME = np.arange(3000) * DT
NOISE = 2e-6


def motion(voltage):
    """Displacement in m of a 6 Hz oscillator, 1 mm at 1 kV."""
    return lsim(([1e-9], [1 / OMEGA**2, 0.2 / OMEGA, 1]), voltage**2, TIME)[1]


def record(voltage, displacement, seed=0, start=0, noise=NOISE):
    y = displacement + noise * np.random.default_rng(seed).standard_normal(len(displacement))
    return Record(f"r{seed}", TIME[: len(TIME) - start], voltage[start:], y[start:])


SINE = 1000 * (1 - np.cos(2 * np.pi * 3 * TIME))
HIGH = 1200 + 700 * np.cos(2 * np.pi * 4 * TIME)  # 1.9 kV at the first sample


@pytest.mark.parametrize("sigma", [1e-9, 3e-6, 0.4])
def test_noise_of_white_noise(sigma):
    noise = sigma * np.random.default_rng(1).standard_normal(20_000)
    assert noise_std(noise) == pytest.approx(sigma, rel=0.06)


def test_noise_under_motion_and_gaps():
    y = record(SINE, motion(SINE)).displacement.copy()
    y[500:700] = np.nan
    assert noise_std(y) == pytest.approx(NOISE, rel=0.1)


@pytest.mark.parametrize("voltage", [SINE, HIGH], ids=["smooth", "full voltage at once"])
@pytest.mark.parametrize("zero", [0.0, -7.3e-3])
def test_rest_is_found(voltage, zero):
    found = [record(voltage, motion(voltage) + zero, seed) for seed in range(10)]
    assert all(starts_at_rest(r, zero) for r in found)
    assert not any(starts_at_rest(r, zero + 1e-4) for r in found)  # 3 % of the range away from the sensor's zero


@pytest.mark.parametrize("start", [700, 830, 910])
def test_a_moving_start_is_found(start):
    assert not starts_at_rest(record(SINE, motion(SINE), start=start), 0.0)


def test_first_state_of_a_moving_start():
    x = motion(SINE)
    velocity = np.gradient(x, DT)[830]
    values, errors = first_states(record(SINE, x, start=830))
    assert abs(values[-1, 0] - x[830]) < 4 * errors[-1, 0]
    assert abs(values[-1, 1] - velocity) < 4 * errors[-1, 1] + 0.01 * abs(velocity)


def test_offset_is_what_most_still_starts_share():
    zero, x = 12.345e-3, motion(SINE)
    records = [record(SINE, x + zero, 1), record(SINE, x + zero, 2, start=830), record(HIGH, motion(HIGH) + zero, 3)]
    rest, offset = initial_rest(records)
    assert rest.tolist() == [True, False, True]
    assert offset == pytest.approx(zero, abs=3 * NOISE)
    assert abs(offset - zero) < 0.002 * np.ptp(x)


def test_no_still_start():
    x = motion(SINE)
    rest, offset = initial_rest([record(SINE, x, 5, start=830)])
    assert not rest.any()
    assert offset == pytest.approx(x[830], abs=5 * NOISE)


def test_missing_first_samples():
    zero = 1e-3
    for start, still in ((0, True), (830, False)):
        r = record(SINE, motion(SINE) + zero, 7, start=start)
        r.displacement[:4] = np.nan
        assert starts_at_rest(r, zero) is still

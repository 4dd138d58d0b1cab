"""How records begin: noise, rest, and the sensor's zero."""

import numpy as np
import pytest
from scipy.signal import lsim

from pitp_jax._record.initial_state import first_known, first_states, initial_rest, noise_std, starts_at_rest
from pitp_jax._record.record import Record

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


SLOW = 1000 * (1 - np.cos(2 * np.pi * 0.3 * TIME))


@pytest.mark.parametrize("start", [1000, 2200])
@pytest.mark.parametrize("others", [0, 1, 2])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_slow_start_in_mid_motion_is_moving(start, others, sign):
    """Below 0.64 Hz at 1 kHz no motion is faster than 0.2 % of range a sample: as still as rest, but under force."""
    zero, x = 1e-3, sign * motion(SLOW)
    slow = record(SLOW, x + zero, 20, start=start)
    assert starts_at_rest(slow, slow.displacement[0])
    rest, offset = initial_rest([slow, *[record(SINE, sign * motion(SINE) + zero, k) for k in range(others)]])
    assert rest.tolist() == [False] + [True] * others
    assert not others or offset == pytest.approx(zero, abs=3 * NOISE)


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("turning", [1, 2])
def test_a_turning_point_is_moving(first, turning):
    """The top of the motion, alike in two records: more votes than the one at rest, but under force."""
    zero, x = 1e-3, motion(SINE)
    top = 1000 + int(np.argmax(x[1000:1300]))
    still = [record(SINE, x + zero, k, start=top) for k in range(turning)]
    resting = record(SINE, x + zero, 9)
    rest, offset = initial_rest([*still, resting] if first else [resting, *still])
    assert rest.tolist() == ([False] * turning + [True] if first else [True] + [False] * turning)
    assert offset == pytest.approx(zero, abs=3 * NOISE)
    assert not initial_rest(still)[0].any()


def test_a_linear_input_pushes_both_ways():
    """An offset of zero force in mid-range, where u^2 would have none."""
    drive = 1000 * np.sin(2 * np.pi * 2 * TIME)
    x = lsim(([1e-6], [1 / OMEGA**2, 0.2 / OMEGA, 1]), drive, TIME)[1]
    top = 1000 + int(np.argmax(x[1000:1500]))
    for start in (0, top):
        rest, _ = initial_rest([record(drive, x, start=start)], "linear")
        assert rest.tolist() == [start == 0]


@pytest.mark.parametrize(("gap", "first"), [(0, 0), (4, 0), (40, 0), (48, 48), (200, 200)])
def test_a_gap_at_the_start_leaves_it_unknown(gap, first):
    r = record(SINE, motion(SINE))
    r.displacement[:gap] = np.nan
    assert first_known(r) == first
    rest, offset = initial_rest([r])
    assert np.isfinite(offset)
    assert not rest.any() or not first


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

"""How records begin: noise, rest, held, moving, and the sensor's zero and direction, planted in a linear ODE."""

from typing import Any

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter, lsim

from pitp_jax import Record
from pitp_jax._identify.beginnings import find_beginnings
from pitp_jax._identify.identification import identify
from pitp_jax._record.initial_state import first_known, first_states, level_groups, noise_std, starts_at_rest

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


def begins(records, input_map="square"):
    return [b.begins for b in find_beginnings(records, input_map)[0]]


def test_a_set_of_rest_and_motion_has_one_zero():
    zero, x = 12.345e-3, motion(SINE)
    records = [record(SINE, x + zero, 1), record(SINE, x + zero, 2, start=830), record(HIGH, motion(HIGH) + zero, 3)]
    found, *_ = find_beginnings(records, "square")
    assert [b.begins for b in found] == ["rest", "moving", "rest"]
    assert {(b.zero, b.group) for b in found} == {(found[0].zero, 0)}
    assert found[0].zero == pytest.approx(zero, abs=3 * NOISE)


def test_levels_of_different_zeros_are_kept_apart():
    x, zeros = motion(SINE), (0.0, 0.0, 2e-4)
    groups = level_groups([record(SINE, x + z, k) for k, z in enumerate(zeros)])
    assert [members for members, *_ in groups] == [[0, 1], [2]]
    for (_, zero, stderr), truth in zip(groups, (0.0, 2e-4), strict=True):
        assert abs(zero - truth) < 3 * stderr < 3 * NOISE


SLOW = 1000 * (1 - np.cos(2 * np.pi * 0.3 * TIME))


@pytest.mark.parametrize("start", [1000, 2200])
@pytest.mark.parametrize("others", [1, 2])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_slow_start_in_mid_motion_is_not_at_rest(start, others, sign):
    """Below 0.64 Hz at 1 kHz no motion is faster than 0.2 % of range a sample: as still as rest, but under force.

    It follows its force so closely that settled at u(0) explains as much as a motion.
    """
    zero, x = 1e-3, sign * motion(SLOW)
    slow = record(SLOW, x + zero, 20, start=start)
    assert starts_at_rest(slow, slow.displacement[0])
    found, *_ = find_beginnings([slow, *[record(SINE, sign * motion(SINE) + zero, k) for k in range(others)]], "square")
    assert [b.begins != "rest" for b in found] == [True] + [False] * others
    assert all(b.zero == pytest.approx(zero, abs=3 * NOISE) for b in found)


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("turning", [1, 2])
def test_a_turning_point_is_moving(first, turning):
    """The top of the motion, alike in two records: more of them than at rest, but under force."""
    zero, x = 1e-3, motion(SINE)
    top = 1000 + int(np.argmax(x[1000:1300]))
    still = [record(SINE, x + zero, k, start=top) for k in range(turning)]
    resting = record(SINE, x + zero, 9)
    found, *_ = find_beginnings([*still, resting] if first else [resting, *still], "square")
    order = ["moving"] * turning + ["rest"]
    assert [b.begins for b in found] == (order if first else order[::-1])
    assert all(b.zero == pytest.approx(zero, abs=3 * NOISE) for b in found)
    assert begins(still) == ["moving"] * turning


def test_a_linear_input_pushes_both_ways():
    """An offset of zero force in mid-range, where u^2 would have none."""
    drive = 1000 * np.sin(2 * np.pi * 2 * TIME)
    x = lsim(([1e-6], [1 / OMEGA**2, 0.2 / OMEGA, 1]), drive, TIME)[1]
    top = 1000 + int(np.argmax(x[1000:1500]))
    for start in (0, top):
        assert begins([record(drive, x, start=start)], "linear") == ["rest" if start == 0 else "moving"]


def planted(kind, seed, *, voltage, zero, direction):
    """A record of 3 s that begins at rest, after 5 s at u(0), or cut from a motion that began 0.7 s earlier."""
    lead = {"rest": 0, "held": 5000, "moving": 700}[kind]
    before = np.full(lead, voltage[0]) if kind == "held" else voltage[:lead][::-1]
    u = np.concatenate([before, voltage])
    fine = np.interp(np.arange((len(u) - 1) * 16 + 1) / 16, np.arange(len(u)), u)
    system: Any = cont2discrete(([1.0], [1 / OMEGA**2, 0.2 / OMEGA, 1]), DT / 16, method="foh")
    top, bottom = system[:2]
    ringing, decay = OMEGA * np.sqrt(0.99), 0.1 * OMEGA
    t = np.arange(len(u)) * DT
    step = 1 - np.exp(-decay * t) * (np.cos(ringing * t) + decay / ringing * np.sin(ringing * t))
    x = lfilter(np.ravel(top), bottom, fine**2 - u[0] ** 2)[::16] + u[0] ** 2 * step  # foh would ramp up to u(0)
    x = 1e-9 * x[lead:]
    y = direction * x + zero + NOISE * np.random.default_rng(seed).standard_normal(len(x))
    return Record(f"{kind}{seed}", TIME, voltage, y)


@pytest.mark.slow
@pytest.mark.parametrize("one_zero", [True, False])
def test_planted_beginnings_zeros_and_directions_come_back(one_zero):
    """Kinds and directions exactly, zeros within their errors: 95 % within 2, all within 5 (60 records in 10 sets)."""
    far, kinds = [], ["rest", "held", "moving", "held", "moving", "rest"]
    for trial in range(5):
        rng = np.random.default_rng(100 + trial)
        directions = [1, 1, -1, 1, 1, 1]
        zeros = np.full(6, 1e-3) if one_zero else 1e-3 * rng.uniform(-1, 1, 6)
        drives = [1000 + 800 * np.sin(2 * np.pi * rng.uniform(1, 8) * TIME + rng.uniform(0, 6)) for _ in kinds]
        records = [
            planted(kind, 10 * trial + k, voltage=u, zero=z, direction=d)
            for k, (kind, u, z, d) in enumerate(zip(kinds, drives, zeros, directions, strict=True))
        ]
        found = identify(records, order=2, hold="foh")
        begun = list(found.beginnings.values())
        assert [b.begins for b in begun] == kinds
        assert [b.direction for b in begun] == directions
        if one_zero:
            assert len({b.group for b in begun}) == 1
        own = {b.group: abs(b.zero - z) / b.stderr for b, z in zip(begun, zeros, strict=True)}
        far += own.values()
        assert all(b.stderr < 2 * NOISE for b in begun)
        assert found.chosen.rms == pytest.approx(NOISE, rel=0.02)
    assert np.mean(np.array(far) < 2) >= 0.9
    assert max(far) < 4


@pytest.mark.parametrize(("gap", "first"), [(0, 0), (4, 0), (40, 0), (48, 48), (200, 200)])
def test_a_gap_at_the_start_leaves_it_unknown(gap, first):
    r = record(SINE, motion(SINE))
    r.displacement[:gap] = np.nan
    assert first_known(r) == first
    (found,), *_ = find_beginnings([r], "square")
    assert np.isfinite(found.zero)
    assert (found.begins == "rest") == (first == 0)


def test_missing_first_samples():
    zero = 1e-3
    for start, still in ((0, True), (830, False)):
        r = record(SINE, motion(SINE) + zero, 7, start=start)
        r.displacement[:4] = np.nan
        assert starts_at_rest(r, zero) is still

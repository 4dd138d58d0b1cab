"""How records begin: noise, rest, held, moving, and the sensor's zero and direction, planted in a linear ODE."""

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter, lsim
from typed import of_kind

import pitp_jax
from pitp_jax import Record
from pitp_jax.method.effects import CATALOGUE
from pitp_jax.method.identify.beginnings import find_beginnings
from pitp_jax.method.identify.identification import identify
from pitp_jax.method.model.input_map import LinearInput
from pitp_jax.method.model.model import linear_model
from pitp_jax.method.signal.initial_state import first_known, level_groups, noise_std, rest_level, standing_drive
from pitp_jax.method.signal.start import Response, estimate_start, first_part
from pitp_jax.method.simulate.beginnings import beginnings
from pitp_jax.method.simulate.decoder import rest_state, rollout
from pitp_jax.method.simulate.moving_start import initial_samples, moving_states
from pitp_jax.method.simulate.prediction import predict

DT, OMEGA = 1e-3, 2 * np.pi * 6
TIME = np.arange(3000) * DT
NOISE = 2e-6


def motion(voltage):
    """Displacement in m of a 6 Hz oscillator, 1 mm at 1 kV."""
    return lsim(([1e-9], [1 / OMEGA**2, 0.2 / OMEGA, 1]), voltage**2, np.arange(len(voltage)) * DT)[1]


def record(voltage, displacement, seed=0, start=0, noise=NOISE):
    y = displacement + noise * np.random.default_rng(seed).standard_normal(len(displacement))
    return Record(f"r{seed}", TIME[: len(TIME) - start], voltage[start:], y[start:])


POLES = OMEGA * (-0.1 + 1j * np.sqrt(0.99) * np.array([1, -1]))


def start_of(r, zeros=()):
    """Return the estimated start of a record, with the equation itself as the model."""
    part = first_part(r, OMEGA)
    level = part.voltage[0] ** 2
    system, t = ([1e-9], [1 / OMEGA**2, 0.2 / OMEGA, 1]), np.arange(part.samples) * part.dt
    rest, held = (of_kind(tuple, lsim(system, part.voltage**2 - u, t))[1] + 1e-9 * u for u in (0.0, level))
    return estimate_start(part, Response(rest, held, POLES, OMEGA, zeros))


SINE = 1000 * (1 - np.cos(2 * np.pi * 3 * TIME))
HIGH = 1200 + 700 * np.cos(2 * np.pi * 4 * TIME)  # 1.9 kV at the first sample


@pytest.mark.parametrize("omega", [1e-3, 0.1, 1.0])
def test_a_record_may_be_short_beside_the_period_of_the_model(omega):
    """Less than one sixteenth of a period: 0 V for half a second, then a ramp that an integrator follows."""
    ramp = np.clip(TIME[:1000] - 0.5, 0, None)
    run = 1e-3 * np.cumsum(ramp) * DT
    found = estimate_start(
        first_part(Record("r", TIME[:1000], ramp, 2e-3 + run), omega),
        Response(run, run, np.array([-omega]), omega),
    )
    assert (found.begins, found.direction) == ("rest", 1.0) and found.zero == pytest.approx(2e-3, abs=1e-9)


@pytest.mark.parametrize("sigma", [1e-9, 3e-6, 0.4])
def test_noise_of_white_noise(sigma):
    noise = sigma * np.random.default_rng(1).standard_normal(20_000)
    assert noise_std(noise) == pytest.approx(sigma, rel=0.06)


def test_a_zero_is_not_known_better_than_the_encoder_counts():
    """Readings that stand still at one count lie anywhere within it: uniform, so 1 / sqrt(12) of a count."""
    voltage, count = np.where(TIME < 1, 0.0, SINE), 1e-4
    off = []
    for zero in np.linspace(0.0, 1.0, 21) * count:
        level, error = rest_level(Record("r", TIME, voltage, count * np.round((motion(voltage) + zero) / count)))
        assert error == pytest.approx(count / np.sqrt(12))
        off.append((level - zero) / error)
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1.0, abs=0.1)


def test_noise_under_motion_and_gaps():
    y = record(SINE, motion(SINE)).displacement.copy()
    y[500:700] = np.nan
    assert noise_std(y) == pytest.approx(NOISE, rel=0.1)


@pytest.mark.parametrize("voltage", [SINE, HIGH], ids=["smooth", "full voltage at once"])
@pytest.mark.parametrize("zero", [0.0, -7.3e-3])
def test_rest_is_found(voltage, zero):
    for seed in range(10):
        start = start_of(record(voltage, motion(voltage) + zero, seed))
        assert start.begins == "rest" and start.certainty > 0.99
        assert abs(start.zero - zero) < 5 * start.stderr < 10 * NOISE


@pytest.mark.parametrize("cut", [700, 830, 910])
@pytest.mark.parametrize("direction", [1, -1])
def test_a_moving_start_is_found_with_its_first_reading(cut, direction):
    x = direction * motion(SINE)
    start = start_of(record(SINE, x + 1e-3, start=cut))
    assert (start.begins, start.direction) == ("moving", direction) and start.certainty > 0.99
    assert start.level == pytest.approx(x[cut] + 1e-3, abs=2 * NOISE)


@pytest.mark.parametrize("lag", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("zeros", [(), (1e-3,)], ids=["own offset", "known offset"])
def test_rest_beside_a_model_without_the_lag_of_the_plant_is_no_motion(lag, zeros):
    """Later, a free motion of the model fits a plant behind a lag; the first samples stand still."""
    plant = np.polymul([1 / OMEGA**2, 0.2 / OMEGA, 1], [2 * np.pi * lag / OMEGA, 1])
    for hz in (0.8, 1.7, 3.1):
        voltage = 800 + 400 * np.sin(2 * np.pi * hz * TIME)
        x = of_kind(tuple, lsim(([1e-9], plant), voltage**2, TIME))[1]
        assert start_of(record(voltage, x + 1e-3), zeros).begins == "rest"


@pytest.mark.parametrize("delay", [5, 20])
def test_rest_beside_a_model_without_the_delay_of_the_plant_is_no_motion(delay):
    """A pure delay, which no lag of order 1 describes."""
    for hz in (0.8, 1.7, 3.1):
        voltage = 800 + 400 * np.sin(2 * np.pi * hz * TIME)
        x = np.concatenate([np.zeros(delay), motion(voltage)[:-delay]])
        assert start_of(record(voltage, x), (0.0,)).begins == "rest"


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
    """It follows its force so closely that settled at u(0) explains as much as a motion."""
    zero, x = 1e-3, sign * motion(SLOW)
    slow = record(SLOW, x + zero, 20, start=start)
    found, *_ = find_beginnings([slow, *[record(SINE, sign * motion(SINE) + zero, k) for k in range(others)]], "square")
    assert [b.begins != "rest" for b in found] == [True] + [False] * others
    assert all(b.zero == pytest.approx(zero, abs=3 * NOISE) for b in found)


@pytest.mark.parametrize("rate", [500.0, 10_000.0])
def test_a_running_motion_that_is_cut_moves_even_at_its_turning_points(rate):
    """At any sampling rate and phase: a free motion under a steady drive."""
    t, rng = np.arange(int(2 * rate)) / rate, np.random.default_rng(0)
    for phase in np.linspace(0, 2 * np.pi, 16, endpoint=False):
        y = 1e-3 * np.exp(-0.01 * OMEGA * t) * np.sin(OMEGA * t + phase) + 1e-6 * rng.standard_normal(len(t))
        part = first_part(Record("a", t, 1 + t, y), OMEGA)
        held, poles = 1e-5 * part.voltage, OMEGA * np.array([-0.01 + 1j, -0.01 - 1j])
        assert estimate_start(part, Response(held - held[0], held, poles, OMEGA)).begins == "moving"


@pytest.fixture(scope="module")
def nominal():
    return identify([record(SINE, motion(SINE), 1)], order=2).model.model


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3])
@pytest.mark.parametrize("hz", [0.5, 2.3, 6.0])
def test_a_jump_at_the_first_sample_begins_at_rest(nominal, hz, noise):
    """The drive is high at once, the output still at its zero: neither held nor moving, whatever the noise."""
    drive = 1000 + 800 * np.sin(2 * np.pi * hz * TIME)
    x = motion(drive)
    y = x + 1e-3 + noise * np.ptp(x) * np.random.default_rng(3).standard_normal(len(x))
    jump = Record("jump", TIME, drive, y)
    (begun,), _ = beginnings(nominal, [jump], [0.0])
    assert begun.begins == "rest"
    assert begun.zero == pytest.approx(1e-3, abs=max(5 * noise, 1e-3) * np.ptp(x))


def test_a_misfit_of_the_model_sets_no_record_in_motion():
    """One record of a stiffer actuator than the others, at the same zero: it stood still there as they did."""
    drive = 1200 + 700 * np.sin(2 * np.pi * 6 * TIME)
    stiff = lsim(([1e-9], [1 / (1.3 * OMEGA) ** 2, 0.2 / OMEGA, 1]), drive**2, TIME)[1]
    records = [record(drive, stiff + 1e-3, 9), *[record(u, motion(u) + 1e-3, k) for k, u in enumerate((SINE, HIGH))]]
    found, *_ = find_beginnings(records, "square")
    assert [b.begins for b in found] == ["rest"] * 3
    assert all(b.zero == pytest.approx(1e-3, abs=5 * NOISE) for b in found)


def test_a_small_jump_that_rings_is_no_held_drive():
    """The first step of a staircase rings by 2 % of the range: the reading is not flat although the drive is."""
    steps = 900 * np.repeat([0.3, 1.0, 0.5, 0.9, 0.1], len(TIME) // 5)
    r = record(steps, motion(steps), 2)
    assert start_of(r).begins == "rest"
    assert [b.begins for b in find_beginnings([r, record(SINE, motion(SINE), 1)], "square")[0]] == ["rest", "rest"]


@pytest.mark.parametrize("held", [0.0, 800.0])
def test_a_noisy_monitor_of_the_drive_hides_no_rest(held):
    """A monitor of 3 V noise on a drive that stands: its level is known before the noise."""
    rng = np.random.default_rng(4)
    drive = np.concatenate([np.full(500, held), held + SINE])
    x = motion(np.concatenate([np.full(3000, held), drive]))[3000:]
    r = Record("noisy", np.arange(len(x)) * DT, drive + 3 * rng.standard_normal(len(x)), x + 1e-3)
    count, level = standing_drive(r)
    assert count == pytest.approx(500, abs=60) and level == pytest.approx(held, abs=1) and (level == 0) == (held == 0)
    assert find_beginnings([r], "square")[0][0].begins == ("held" if held else "rest")


def test_a_small_constant_input_before_large_steps_is_not_zero():
    """The smallest step of an input without noise is not its noise."""
    drive = np.repeat([68.0, 500.0, 200.0, 900.0], 100)
    assert standing_drive(Record("steps", DT * np.arange(400), drive, drive)) == (100, 68.0)


@pytest.mark.parametrize("held", [0.0, 800.0])
def test_a_flat_reading_under_a_flat_drive_is_rest_or_held_whatever_a_model_leaves(nominal, held):
    """Half a second of it before the motion of another actuator than the model's, and another zero."""
    drive = np.where(TIME < 0.5, held, held + 600 * np.sin(2 * np.pi * 3 * (TIME - 0.5)))
    ahead = np.concatenate([np.full(len(TIME), held), drive])
    other = lsim(([4e-9], [1 / (3 * OMEGA) ** 2, 0.2 / OMEGA, 1]), ahead**2, np.arange(len(ahead)) * DT)[1]
    r = record(drive, other[len(TIME) :] + 1e-3)
    (begun,), _ = beginnings(nominal, [r], [0.0])
    assert begun.begins == ("held" if held else "rest")


def test_two_starts_with_one_response_are_one():
    """A hold whose equilibrium is rest leaves no doubt; neither does a sine from rest."""
    part = first_part(record(HIGH, motion(HIGH)), OMEGA)
    run = motion(HIGH)[: part.samples]
    found = estimate_start(part, Response(run, run, POLES, OMEGA))
    assert found.begins == "rest" and found.certainty > 0.99
    assert start_of(record(SINE, motion(SINE))).certainty > 0.99


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("lead", [0.5, 2.0])
def test_a_weak_model_without_mass_reverses_no_sensor(lead, direction):
    """Half of the motion, without its inertia: a response that begins too soon is smoother when it is subtracted."""
    drive = np.concatenate([np.zeros(round(lead / DT)), 1000 + 500 * np.cos(2 * np.pi * TIME)])
    times, omega = np.arange(len(drive)) * DT, OMEGA
    x = lsim(([1e-9], [1 / OMEGA**2, 1.2 / OMEGA, 1]), drive**2, times)[1]
    y = direction * x + NOISE * np.random.default_rng(3).standard_normal(len(x))
    part = first_part(Record("r", times, drive, y), omega)
    run = lsim(([0.5e-9], [1 / omega, 1]), part.voltage**2, np.arange(part.samples) * DT)[1]
    found = estimate_start(part, Response(run, run, np.array([-omega]), omega, (0.0,), direction=1.0))
    assert (found.begins, found.direction) == ("rest", direction)


@pytest.mark.parametrize("gain", [0.3, 1.0])
def test_a_model_without_the_resonance_that_is_driven_reverses_no_sensor(gain):
    """The motion is nearly a quarter of a period behind the response, but does not oppose it."""
    drive, omega = np.concatenate([np.zeros(300), 700 * (1 - np.cos(OMEGA * TIME))]), 0.5 * OMEGA
    times = np.arange(len(drive)) * DT
    x = lsim(([1e-9], [1 / OMEGA**2, 0.4 / OMEGA, 1]), drive**2, times)[1]
    part = first_part(Record("r", times, drive, x + NOISE * np.random.default_rng(3).standard_normal(len(x))), omega)
    run = lsim(([gain * 1e-9], [1 / omega, 1]), part.voltage**2, np.arange(part.samples) * DT)[1]
    found = estimate_start(part, Response(run, run, np.array([-omega]), omega, (0.0,), direction=1.0))
    assert (found.begins, found.direction) == ("rest", 1.0)


@pytest.mark.parametrize("ahead", [0, 3000, 9000])
@pytest.mark.parametrize("direction", [1, -1])
def test_the_direction_is_that_of_the_first_motion_wherever_it_begins(nominal, ahead, direction):
    """Three seconds of a trigger's lead hide it as little as none."""
    drive, x = np.concatenate([np.zeros(ahead), SINE]), np.concatenate([np.zeros(ahead), motion(SINE)])
    y = direction * x + 1e-3 + NOISE * np.random.default_rng(5).standard_normal(len(x))
    (begun,), _ = beginnings(nominal, [Record("late", np.arange(len(x)) * DT, drive, y)], [0.0])
    assert (begun.begins, begun.direction) == ("rest", direction)
    assert begun.zero == pytest.approx(1e-3, abs=3 * NOISE)


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
    r = record(SINE, np.where(np.arange(len(SINE)) < gap, np.nan, motion(SINE)))
    assert first_known(r) == first
    (found,), *_ = find_beginnings([r], "square")
    assert np.isfinite(found.zero)
    assert (found.begins == "rest") == (first == 0)


def test_missing_first_samples():
    zero = 1e-3
    for start, still in ((0, True), (830, False)):
        lost = np.isin(np.arange(len(SINE)), start + np.arange(4))
        r = record(SINE, np.where(lost, np.nan, motion(SINE) + zero), 7, start=start)
        assert (start_of(r, (zero,)).begins == "rest") is still


@pytest.mark.parametrize(("kind", "fraction"), [("rest", 0.0), ("held", 0.04), ("moving", 0.04)])
def test_what_follows_later_does_not_decide_how_a_record_begins(nominal, kind, fraction):
    """Small motions beside a stroke ten times as large, as in an arrow: the first 3 s alone give the same answer."""
    time = np.arange(9000) * DT
    small = 100 * (1 - np.cos(2 * np.pi * 3 * time))
    drive = np.sqrt(fraction) * 1000 + small + np.where(time > 4, 900 * (1 - np.cos(2 * np.pi * 4 * time)) / 2, 0.0)
    x = lsim(([1e-9], [1 / OMEGA**2, 0.2 / OMEGA, 1]), drive**2 - (kind == "held") * drive[0] ** 2, time)[1]
    y = x + (kind == "held") * 1e-9 * drive[0] ** 2 + NOISE * np.random.default_rng(5).standard_normal(len(x))
    cut = 730 if kind == "moving" else 0
    whole = Record("whole", time[: len(time) - cut], drive[cut:], y[cut:])
    first = Record("first", whole.time[:3000], whole.voltage[:3000], whole.displacement[:3000])
    (some,), _ = beginnings(nominal, [first], [0.0])
    (every,), _ = beginnings(nominal, [whole], [0.0])
    assert some == every and some.begins == kind


def test_a_gap_longer_than_the_first_samples_leaves_a_moving_start(nominal):
    """The first 2,500 readings are lost: the start is estimated from those that follow."""
    y = np.concatenate([np.full(2500, np.nan), motion(np.tile(SINE, 2))[2500:]])
    late = Record("late", np.arange(6000) * DT, np.tile(SINE, 2), y)
    (begun,), _ = beginnings(nominal, [late], [0.0])
    assert begun.begins == "moving" and initial_samples(nominal, late) == 2500 + 250  # one and a half periods


def test_the_states_of_records_are_those_of_each_alone_beside_one_that_diverges(nominal):
    """A cubic spring under a hundred times the motion that it was made for."""
    (row,) = [r for r in CATALOGUE if r.key == "stiffening: cubic"]
    model, u = replace(nominal, effects=(row(jnp.asarray(0.5)),)), 800 + 300 * np.sin(4 * np.pi * TIME)
    gentle, far = (Record("r", TIME, size * u, size * motion(u)) for size in (1.0, 100.0))
    both, alone = (moving_states(model, some, np.zeros(len(some))) for some in ([gentle, far], [gentle]))
    np.testing.assert_allclose(both[0], alone[0], atol=1e-6)
    assert np.isfinite(both).all()


def test_a_reversed_sensor_is_no_part_of_a_moving_start(nominal):
    """The readings of a motion, mirrored: the same state starts it, so nothing rings behind the first samples."""
    x, cut = motion(np.tile(HIGH, 2)), slice(3100, 6000)
    mirrored = Record("mirrored", TIME[:2900], np.tile(HIGH, 2)[cut], -x[cut])
    (run,) = predict(nominal, [mirrored])
    assert (run.begins, run.direction) == ("moving", -1.0)
    assert np.abs(run.displacement - mirrored.displacement)[run.scored].max() < 5e-3 * np.ptp(x)


@pytest.mark.parametrize(
    ("form", "numbers", "cut"),
    [
        ("coulomb_friction: Coulomb", (0.1,), 3000),
        ("coulomb_friction: Coulomb", (0.1,), 5000),
        ("stiffening: cubic", (0.5,), 5000),
        ("hysteresis: Bouc-Wen, either sign", (1.0, 0.6, -1.4), 5000),
    ],
)
def test_a_record_cut_in_motion_is_moving_whatever_the_law(nominal, form, numbers, cut):
    """The model that made the run starts it; its linear free responses explain the first period badly."""
    (row,) = [r for r in CATALOGUE if r.key == form]
    zero = jnp.asarray(1e-3)
    model = replace(nominal, effects=(row(*map(jnp.asarray, numbers)),), output=replace(nominal.output, offset=zero))
    time, phases = np.arange(11_000) * DT, np.random.default_rng(1).uniform(0, 2 * np.pi, 12)
    waves = np.sin(2 * np.pi * 0.7 * np.outer(time, np.arange(1, 13)) + phases).sum(1)
    u = 900 + 250 * waves / np.std(waves)
    x = np.asarray(rollout(model, jnp.asarray(u), DT, rest_state(model)))[:, 0] * float(model.scales.state[0])
    part = Record("cut", TIME, u[cut : cut + 3000], (x + 1e-3)[cut : cut + 3000])
    (run,) = predict(model, [part])
    assert run.begins == "moving" and run.zero == pytest.approx(1e-3)


def test_a_slow_store_of_an_axis_cut_in_motion_is_not_settled_at_its_first_voltage():
    """Without a spring the motion never forgets a wrong charge of the store."""
    (row,) = [r for r in CATALOGUE if r.key == "charge_leak: one trap"]
    axis = linear_model([1e-9, 5.8, 2.7], dt=5e-3, input_map=LinearInput())
    axis = replace(axis, effects=(row(jnp.asarray(0.5), jnp.asarray(200.0)),))
    time = np.arange(4000) * 5e-3
    u = 4 * np.sin(2 * np.pi * 0.5 * time) + 3 * np.sin(2 * np.pi * 1.3 * time)
    x = np.asarray(rollout(axis, jnp.asarray(u), 5e-3, rest_state(axis)))[:, 0] * float(axis.scales.state[0])
    first = int(np.argmax(np.where(time > 5, u, 0.0)))
    (run,) = predict(axis, [Record("cut", time[first:] - time[first], u[first:], x[first:])])
    assert run.begins == "moving"
    assert np.abs(run.displacement - x[first:])[run.scored].max() < 0.05 * np.ptp(x)


def test_one_function_decides_how_a_record_starts():
    """Only the two rooms with a model build a response; nothing else weighs rest, held and moving."""
    users, package = {}, Path(pitp_jax.__file__).parent
    for path in package.rglob("*.py"):
        for name in re.findall(r"(?<!def )\b(estimate_start|standing_drive)\(", path.read_text(encoding="utf-8")):
            users.setdefault(name, set()).add(path.relative_to(package).as_posix())
    assert users["estimate_start"] == {"method/identify/beginnings.py", "method/simulate/beginnings.py"}
    assert users["standing_drive"] == {"method/signal/start.py"}


def test_a_joint_that_sticks_before_a_small_motion_reverses_no_sensor():
    """Its first motions are small and late beside the model's; both directions err alike, so the usual one stays."""
    times = np.arange(400) * DT
    drive = np.where(times < 0.2, 0.5, 0.5 + 0.02 * np.sin(2 * np.pi * 2 * (times - 0.2)))
    y = 0.58 - 0.002 * np.clip(np.sin(2 * np.pi * 2 * (times - 0.2)), 0, 1) * (times > 0.2)
    part, omega = first_part(Record("stuck", times, drive, y), OMEGA), OMEGA
    rest, held = (
        0.14 + 0.8 * lsim(([omega], [1, omega]), part.voltage - u, np.arange(part.samples) * DT)[1] + 0.8 * u - 0.14
        for u in (0.0, part.voltage[0])
    )
    found = estimate_start(part, Response(rest, held, np.array([-omega]), omega, (0.14,), direction=1.0))
    assert (found.begins, found.direction) == ("held", 1.0)


@pytest.mark.parametrize("seed", range(8))
def test_a_slow_plant_in_motion_keeps_the_known_offset_beside_a_wrong_model(seed):
    """The drive changes from the first sample, far from the plant's equilibrium; the model is 15 % wrong."""
    rng, omega, step = np.random.default_rng(900 + seed), 0.01, 4.0
    times = np.arange(1200) * step
    drive = 1.5 + sum(rng.uniform(0.3, 0.6) * np.sin(w * omega * times + rng.uniform(0, 6)) for w in (0.3, 0.8, 1.7))
    plant = ([2.0], [1 / omega**2, 2.2 / omega, 1])
    x = of_kind(tuple, lsim(plant, drive, times))[1] - 6.0
    r = Record("tank", times[:1024], drive[176:], x[176:] + 0.01 * rng.standard_normal(1024))  # pyright: ignore[reportIndexIssue]
    wrong = ([2.0 * 1.15], [1 / (1.15 * omega) ** 2, 2.2 / omega, 1])
    part = first_part(r, omega)
    t = np.arange(part.samples) * step
    rest, held = (of_kind(tuple, lsim(wrong, part.voltage - u, t))[1] + 2.3 * u for u in (0.0, part.voltage[0]))
    found = estimate_start(part, Response(rest, held, np.roots(wrong[1]), omega, (-6.0,), direction=1.0))
    assert (found.direction, found.zero) == (1.0, -6.0)


def test_each_unknown_of_a_moving_start_makes_it_ten_times_less_probable():
    """A run in motion that explains the readings a little better than the run from rest, beside a wrong model."""
    x = motion(SINE)
    part = first_part(record(SINE, x), OMEGA)
    runs = (x * (1 + error * np.cos(9 * TIME)) for error in (0.004, 0.0))
    rest, moving = (run[: part.samples] for run in runs)
    odds = []
    for fitted in (1, 2):
        response = Response(rest, np.full(len(rest), np.nan), POLES, OMEGA, (0.0,), 1.0, moving, fitted)
        begun = estimate_start(part, response)
        moves = begun.certainty if begun.begins == "moving" else 1 - begun.certainty
        odds.append(moves / (1 - moves))
    assert odds[0] == pytest.approx(10 * odds[1], rel=1e-6)


def test_a_loop_cut_in_motion_keeps_the_force_that_it_was_left_with():
    """Bouc and Wen's equations, by small steps of midpoints; taken as unloaded, up to 54 % of range."""
    k, damping, mass, kappa, width, gamma = 1e6, 8e3, 1e6 / OMEGA**2, 1.0, 5e-4, -1.4
    time, fine = np.arange(5000) * DT, 16
    phases = np.random.default_rng(5).uniform(0, 2 * np.pi, 10)
    u = 400 * np.sin(2 * np.pi * 0.9 * np.outer(time, np.arange(1, 11)) + phases).sum(1)

    def rates(state, force):
        x, v, z = state
        way = v * (1 - (np.sign(v * z) + gamma) * abs(z) / width)
        return np.array([v, (force - damping * v - k * x - k * kappa * z) / mass, way])

    state, path, h = np.zeros(3), [], DT / fine
    for before, after in pairwise([*u, u[-1]]):
        path.append(state[0])
        for part in range(fine):
            ends = (before + (after - before) * (part + share) / fine for share in (0.0, 0.5))
            middle = state + h / 2 * rates(state, next(ends))
            state = state + h * rates(middle, next(ends))
    (row,) = [r for r in CATALOGUE if r.key == "hysteresis: Bouc-Wen, either sign"]
    linear = linear_model([k, damping, mass], dt=DT, input_map=LinearInput(), force_scale=1e3)
    numbers = kappa, width / float(linear.scales.state[0]), gamma
    model = replace(linear, effects=(row(*map(jnp.asarray, numbers)),))
    x = np.array(path)
    for first in (1000, 1500, 2000, 2500):
        (run,) = predict(model, [Record("cut", time[: 5000 - first], u[first:], x[first:])])
        assert run.begins == "moving"
        assert np.abs(run.displacement - x[first:])[run.scored].max() < 2e-3 * np.ptp(x)


@pytest.mark.parametrize(
    ("key", "numbers"),
    [
        ("charge_leak: one trap", (0.4, 30.0)),
        ("creep: one branch", (0.5, 20.0)),
        ("stiffness_drift: settling", (0.3, 20.0)),
    ],
)
def test_what_was_stored_before_a_cut_is_estimated_and_the_clock_is_not(key, numbers):
    """A store hardly moves over the first samples, but may be far from its equilibrium (kept near: 0.3 to 0.7 %)."""
    (row,) = [r for r in CATALOGUE if r.key == key]
    model = linear_model([1e6, 8e3, 1e6 / OMEGA**2], dt=5e-3)
    model = replace(model, effects=(row(*map(jnp.asarray, numbers)),))
    time = np.arange(8000) * 5e-3
    slow, fast, third = (np.sin(2 * np.pi * hz * time) for hz in (0.031, 0.9, 2.3))
    u = 500 + 400 * fast * slow + 80 * third
    x = np.asarray(rollout(model, jnp.asarray(u), 5e-3, rest_state(model)))[:, 0] * float(model.scales.state[0])
    cut = Record("cut", time[5000:], u[5000:], x[5000:])
    (run,) = predict(model, [cut])
    assert run.begins == "moving"
    assert np.abs(run.displacement - cut.displacement)[run.scored].max() < 1e-3 * np.ptp(x)
    if row.port == "T":
        assert moving_states(model, [cut], np.array([25.0]))[0, -1] == 25.0

"""Records of a high rate become means over blocks: the same plant, enough samples a period, one room that does it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim

import pitp_jax
from pitp_jax import Record
from pitp_jax.common.metrics import e_rms_percent
from pitp_jax.method.model.domain import Domain
from pitp_jax.method.model.input_map import LinearInput, SquareInput
from pitp_jax.method.model.model import Output, linear_model
from pitp_jax.method.model.substeps import substeps
from pitp_jax.method.signal.reduced import averaged, reduce_rate

HZ, RATE = 18.0, 10_000.0
OMEGA = 2 * np.pi * HZ
TIME = np.arange(30_000) / RATE
COEFFICIENTS = 1e9 * np.array([1.0, 0.2 / OMEGA, 1 / OMEGA**2])
SWEEP = 1000 * (1 - np.cos(2 * np.pi * (0.5 + 4 * TIME) * TIME))


def model_at(rate, coefficients=COEFFICIENTS, input_map=None):
    scale = 1e-3 * OMEGA ** np.arange(len(coefficients))
    domain = Domain(1 / rate, (0.0, 2000.0), 1e6)
    count = substeps(coefficients, 1 / rate)
    return linear_model(coefficients, input_map=input_map or SquareInput(), state_scale=scale, force_scale=4e6,
                        output=Output(), hold="foh", substeps=count, domain=domain)  # fmt: skip


def record_of(voltage, force):
    x = lsim(([1.0], COEFFICIENTS[::-1]), force, TIME)[1]
    return Record("r", TIME, voltage, x, "V", "m")


@pytest.mark.parametrize(("input_map", "force"), [(SquareInput(), SWEEP**2), (LinearInput(), 1e3 * (SWEEP - 400))])
def test_a_reduced_record_is_of_the_same_plant(input_map, force):
    """SciPy's run at 10 kHz, averaged, against SciPy's run of the converted coefficients on the averaged input."""
    voltage = SWEEP if input_map.one_sided else force
    fine, model = [record_of(voltage, force)], model_at(RATE, input_map=input_map)
    (small,), converted = reduce_rate(fine, model, 40.0, 10**6)
    size = round(small.dt * RATE)
    assert small.dt * HZ * 40 <= 1 < (small.dt + 1 / RATE) * 3 * HZ * 40
    np.testing.assert_allclose(
        small.displacement, fine[0].displacement[: size * small.samples].reshape(-1, size).mean(1)
    )
    assert (converted.dt, converted.substeps) == (pytest.approx(small.dt), substeps(COEFFICIENTS, small.dt))
    np.testing.assert_array_equal(converted.physical_coefficients, model.physical_coefficients)
    system = [1.0], converted.physical_coefficients[::-1]
    run = lsim(system, np.asarray(input_map.force(small.voltage)), small.time - small.time[0])[1]
    # a straight line between means of 40 a period, at its fastest
    assert e_rms_percent(run, small.displacement) < 0.1
    assert (small.voltage_unit, small.displacement_unit) == ("V", "m")


def test_a_mode_far_above_the_motion_keeps_no_samples():
    """A pair at 400 Hz, as noise makes one at order 4; one at 40 Hz counts."""
    fine = [record_of(SWEEP, SWEEP**2)]

    def rate_with(hz):
        w = 2 * np.pi * hz
        more = np.convolve(COEFFICIENTS, [1.0, 0.1 / w, 1 / w**2])
        return 1 / reduce_rate(fine, model_at(RATE, more), 40.0, 10**6)[0][0].dt

    assert rate_with(400.0) == rate_with(4000.0) < 40 * 3 * HZ
    assert 40 * 40 <= rate_with(40.0) < 1.2 * 40 * 40


def test_an_axis_without_a_spring_keeps_the_samples_of_its_velocity():
    """Pushes of 0.1 s, two forward and two back: the position of such an axis hides that its velocity is fast."""
    pushes = np.zeros(len(TIME))
    for start, sign in ((0.1, 1), (0.8, 1), (1.5, -1), (2.2, -1)):
        pushes += 10 * sign * np.sin(2 * np.pi * 5 * (TIME - start)) * ((start < TIME) & (TIME < start + 0.1))
    coefficients = np.array([0.0, 1.0, 0.1])
    speed = lsim(([1.0], coefficients[:0:-1]), pushes, TIME)[1]
    axis = [Record("axis", TIME, pushes, np.cumsum(speed) / RATE, "V", "m")]
    (small,), _ = reduce_rate(axis, model_at(RATE, coefficients, LinearInput()), 40.0, 10**6)
    assert 1 / small.dt > 40 * 10.0  # Hz: 99.9 % of the energy of the velocity lies below, of the position below 4


def test_what_gains_nothing_stays_as_it_is():
    fine, model = [record_of(SWEEP, SWEEP**2)], model_at(RATE)
    assert reduce_rate(fine, model, 200.0, 10**6) == (fine, model)
    short = [replace(fine[0], **{k: getattr(fine[0], k)[:100] for k in ("time", "voltage", "displacement")})]
    assert reduce_rate(short, model, 40.0, 10**6)[0] is short


@pytest.mark.parametrize(("usable", "kept"), [(10**6, 2500.0), (2000, 2000 / 3), (10, 80.0)])
def test_a_fast_motion_of_little_energy_is_averaged_only_if_the_samples_are_too_many(usable, kept):
    """A motion of 2 Hz with 60 Hz (1 % of the energy) and noise keeps forty samples a period of 60 Hz, if usable."""
    wave = np.sin(4 * np.pi * TIME) + 0.1 * np.sin(120 * np.pi * TIME)
    noise = 0.05 * np.random.default_rng(0).standard_normal((2, len(TIME)))  # 0.5 % of the energy, up to 5 kHz
    fine = [Record("r", TIME, 1000 * (wave + noise[0]), 1e-3 * (wave + noise[1]), "V", "m")]
    (small,), _ = reduce_rate(fine, model_at(RATE, input_map=LinearInput()), 40.0, usable)
    assert 1 / small.dt == pytest.approx(kept)


def test_a_block_of_which_half_is_missing_is_missing():
    y = np.where((np.arange(len(TIME)) >= 105) & (np.arange(len(TIME)) < 116), np.nan, TIME)
    mean = averaged(Record("r", TIME, SWEEP, y), SWEEP, 10)
    assert np.flatnonzero(np.isnan(mean.displacement)).tolist() == [11]
    assert mean.displacement[10] == pytest.approx(TIME[100:105].mean())


def test_no_other_room_averages_samples():
    """Nor resamples them: the room of the signals does."""
    root, ways = Path(pitp_jax.__file__).parent, r"resample_poly|decimate\(|\.reshape\([^()]*\)\.(nan)?mean\(1\)"
    found = {p.parent.relative_to(root).as_posix() for p in root.rglob("*.py") if re.search(ways, p.read_text("utf-8"))}
    assert found == {"method/signal"}


def test_a_mean_stands_in_the_middle_of_its_block():
    """Of a line the mean of a block is its value there."""
    time = np.arange(1000) * 1e-3
    mean = averaged(Record("r", time, time, 2.0 * time), 3.0 * time, 10)
    np.testing.assert_allclose(mean.displacement, 2.0 * mean.time, rtol=1e-12)
    np.testing.assert_allclose(mean.voltage, 3.0 * mean.time, rtol=1e-12)

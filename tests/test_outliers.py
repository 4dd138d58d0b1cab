"""A sensor's spikes, off-scale values and clipping are masked; motion and runs of one value are not."""

import numpy as np
import pytest
from scipy.signal import lfilter

from pitp_jax import read
from pitp_jax.files.recordings.outliers import mask_faults

DT, COUNT = 1e-3, 8000
TIME = np.arange(COUNT) * DT
NOISE = 5e-6 * np.random.default_rng(1).normal(size=COUNT)
DRIVE = 1000 + 900 * np.sin(2 * np.pi * 3 * TIME)
MOTION = 1e-3 * np.sin(2 * np.pi * 3 * TIME - 0.4) + NOISE


@pytest.mark.parametrize("value", [0.9999, -0.5, 0.02, 3e-3])
@pytest.mark.parametrize("length", [1, 2, 3])
def test_spikes_are_masked_and_nothing_else(value, length):
    x = MOTION.copy()
    places = np.concatenate([np.arange(k, k + length) for k in (1000, 3333, 7000)])
    x[places] = value
    found = mask_faults(x, DRIVE)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(found.displacement)), places)
    assert found.outliers == 3 * length and found.largest == value


@pytest.mark.parametrize("edge", [0, COUNT - 1])
def test_a_lost_laser_at_an_end_of_the_record(edge):
    x = MOTION.copy()
    x[edge] = 0.9999
    assert np.flatnonzero(np.isnan(mask_faults(x, DRIVE).displacement)).tolist() == [edge]


def test_an_off_scale_stretch_is_masked_whole():
    """The laser sees nothing for 40 samples, and shows its maximum."""
    x = MOTION.copy()
    x[2000:2040] = 0.9999
    found = mask_faults(x, DRIVE)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(found.displacement)), np.arange(2000, 2040))
    assert found.held == 0


def test_a_stretch_of_one_value_within_the_motion_is_reported_and_kept():
    x = MOTION.copy()
    x[2000:2040] = 2e-4
    found = mask_faults(x, DRIVE)
    assert found.held == 40 and found.outliers == 0
    np.testing.assert_array_equal(found.displacement, x)


def test_clipping_is_masked_where_the_drive_moves():
    x = np.minimum(MOTION, 7e-4)
    found = mask_faults(x, DRIVE)
    np.testing.assert_array_equal(np.isnan(found.displacement), x == 7e-4)
    assert found.limit == 7e-4 and found.outliers == 0


def resonance(force, hz=20.0, damping=0.02):
    """What a mass on a spring makes of a force, by an exact pole pair."""
    pole = np.exp((-damping + 1j * np.sqrt(1 - damping**2)) * 2 * np.pi * hz * DT)
    a = [1, -2 * pole.real, abs(pole) ** 2]
    return lfilter([sum(a)], a, force)


@pytest.mark.parametrize(
    "motion",
    {
        "steps": np.repeat([0, 1e-3, 2e-4, 1.5e-3], COUNT // 4),  # within one sample
        "pulses": resonance(np.where(np.arange(COUNT) % 500 == 0, 1e-1, 0.0)),
        "end stop": np.minimum(1e-3 * np.sin(2 * np.pi * 3 * TIME), 7e-4),
        "bouncing": np.abs(1e-3 * np.sin(2 * np.pi * 11 * TIME)),
        "square": 1e-3 * np.sign(np.sin(2 * np.pi * 3 * TIME)),
        "fast": 1e-3 * np.sin(2 * np.pi * 320 * TIME),
        "broadband": 1e-3 * np.random.default_rng(0).normal(size=COUNT),
        "coarse": np.round(1e-3 * np.sin(2 * np.pi * 0.2 * TIME), 4),
        "heavy tails": 1e-4 * np.random.default_rng(0).laplace(size=COUNT),
    }.items(),
    ids=lambda item: item[0],
)
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_real_motion_is_not_masked(motion, noise):
    found = mask_faults(motion[1] + noise * NOISE, DRIVE)
    assert found.outliers + found.clipped == 0


def test_a_hundred_thousand_samples_of_noise_have_no_outlier():
    rng = np.random.default_rng(5)
    assert mask_faults(rng.normal(size=100_000), rng.normal(size=100_000)).outliers == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "folder", ["data/hasel_peano", "data/silverbox", "data/so101/elbow", "data/so101/pitch", "bench/roll/test"]
)
def test_nothing_is_masked_in_measured_records(shared, folder):
    for record in read(shared / folder):
        if record.recognised["clipped"] > record.samples / 2:
            continue  # stands at one value for most of its time, and that is told
        assert record.recognised["outliers"] + record.recognised["clipped"] == 0


@pytest.mark.slow
def test_three_samples_of_a_lost_laser(shared):
    for spoilt, whole in zip(read(shared / "starts" / "spikes"), read(shared / "starts" / "at_rest"), strict=True):
        assert np.flatnonzero(~spoilt.observed).tolist() == [3000, 3001, 7000]
        assert spoilt.recognised["outliers"] == 3 and "999.9 mm" in spoilt.recognised["remarks"][0]
        seen = spoilt.observed
        np.testing.assert_array_equal(spoilt.displacement[seen], whole.displacement[seen])


def held(x, length=60, every=800):
    """The last value again and again, and where."""
    x, at = x.copy(), np.zeros(len(x), bool)
    for k in range(500, len(x) - length, every):
        x[k : k + length] = x[k]
        at[k + 1 : k + length] = True
    return x, at


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_a_laser_that_holds_its_last_value_is_reported_and_kept(noise):
    """A dropout or stiction: the samples alone cannot show which."""
    x, at = held(MOTION if noise else np.round(MOTION - NOISE, 6))
    masked = mask_faults(x, DRIVE)
    assert not np.isnan(masked.displacement).any() and at.sum() / 2 < masked.held <= at.sum() * 62 / 59
    flat = np.where(np.append(at[1:], False) | at, 1000.0, DRIVE)  # the output may stand still while the input does
    assert mask_faults(x, flat).held == 0


def test_a_sensor_that_sees_nothing_for_most_of_the_record_is_told():
    blind = np.random.default_rng(0).random(COUNT) < 0.6
    masked = mask_faults(np.where(blind, 0.0999, MOTION), DRIVE)
    assert masked.unseen == blind.sum() and masked.limit == 0.0999


@pytest.mark.parametrize("fraction", [0.58, 0.67])
@pytest.mark.parametrize("hz", [1, 5, 20])
@pytest.mark.parametrize("quantum", [0.0, 1e-6])
def test_a_sensor_at_its_limit_for_most_of_a_record_is_clipped(fraction, hz, quantum):
    drive = 1 - np.cos(2 * np.pi * hz * TIME)
    x = 5e-4 * drive + NOISE / 5
    x = np.round(x / quantum) * quantum if quantum else x
    limit = np.quantile(x, 1 - fraction)
    masked = mask_faults(np.minimum(x, limit), drive)
    assert masked.clipped == pytest.approx(fraction * COUNT, rel=0.05) and masked.outliers == 0
    assert not mask_faults(np.round(x - NOISE / 5, 6), drive).clipped


def test_a_gear_that_stands_still_at_every_reversal_has_a_good_sensor():
    """Stiction holds one value at each turning point, the extremes among them; in motion no two readings are equal."""
    time = np.arange(4000) * 0.02
    drive = np.sin(2 * np.pi * 0.05 * time) + 0.5 * np.sin(2 * np.pi * 0.13 * time)
    motion, stands = np.empty_like(drive), 0.0
    for k, u in enumerate(drive):
        stands = motion[k] = min(max(stands, u - 0.2), u + 0.2)
    moves = np.append(True, np.diff(motion) != 0)
    motion += 1e-3 * moves * np.random.default_rng(0).standard_normal(len(motion))
    assert np.mean(~moves) > 0.1
    found = mask_faults(motion, drive)
    assert (found.outliers, found.clipped) == (0, 0)
    assert found.held > 0


@pytest.mark.parametrize("end", [3000, 5000])
def test_a_sensor_that_freezes_for_long_or_to_the_end_is_reported(end):
    time = np.arange(5000) / 1000
    drive, moved = np.sin(10 * np.pi * time), 1e-3 * np.sin(10 * np.pi * time - 0.8)
    for noise in (0.0, 1e-6):
        frozen = moved + noise * np.random.default_rng(4).standard_normal(len(time))
        whole = mask_faults(frozen.copy(), drive)
        frozen[end - 1000 : end] = frozen[end - 1000]
        found = mask_faults(frozen, drive)
        assert whole.held == 0 and found.held >= 1000
        assert not np.isnan(found.displacement).any()


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_simulator_that_has_settled_before_the_next_step_is_not_stuck(noise):
    """It is exact, and answers three samples late: at each step its last value stands while the input has moved."""
    levels = np.repeat([0.5, 0.2, 0.9, 0.1, 0.6], 400)
    settled = np.append(np.zeros(3), lfilter([0.1], [1, -0.9], levels)[:-3]).astype(np.float32).astype(float)
    assert np.mean(np.diff(settled) == 0) > 0.3
    found = mask_faults(settled, levels + noise * np.random.default_rng(0).standard_normal(len(levels)))
    assert (found.outliers, found.clipped, found.held) == (0, 0, 0)

"""Parts of the noise floor, each alone: a hum's line, a drive's period, slow residuals, the rounding's spectrum."""

from dataclasses import replace

import numpy as np
import pytest
from played import DT, HZ, SAMPLES, TIME, nominal_of, play
from scipy.signal import lfilter

from pitp_jax._diagnose.case import build_case
from pitp_jax._diagnose.noise import estimate
from pitp_jax._diagnose.steady_tone import steady_tone
from pitp_jax._numerics.noise_spectrum import band_edges
from pitp_jax._record.repeatability import _period

HUM = 17.3


@pytest.fixture(scope="module")
def case(linear):
    nominal = nominal_of(linear)
    return build_case(nominal, play(nominal, noise=0.0))


def sines(hz):
    return [np.sin(2 * np.pi * f * TIME + 1.0) for f in hz]


def told(tones, drives, noise=0.1):
    """Of errors with these tones and a little noise under square roots of sines as drives."""
    rng = np.random.default_rng(0)
    errors = [e + noise * rng.standard_normal(SAMPLES) for e in sines(tones)]
    return steady_tone(errors, [np.sqrt(1 + u) for u in sines(drives)], [DT] * len(errors))


def test_a_hum_is_the_same_in_all_records_under_drives_of_their_own():
    found = told([HUM] * 3, [2.0, 3.0, 4.0])
    assert found is not None
    hz, share = found
    assert hz == pytest.approx(HUM, abs=0.1) and share == pytest.approx(1 / (1 + 2 * 0.1**2), abs=0.01)
    assert told([HUM] * 3, [2.0, 3.0, HUM]) is not None


@pytest.mark.parametrize(
    ("tones", "drives", "noise"),
    [
        ([HUM] * 2, [2.0, 3.0], 0.1), ([HUM] * 3, [2.0, HUM, HUM], 0.1), ([HUM, HUM, HUM + 1], [2.0, 3.0, 4.0], 0.1),
        ([HUM] * 3, [2.0, 3.0, 4.0], 0.8),
    ],
    ids=["two records", "drives of that line", "lines apart", "no line"],
)  # fmt: skip
def test_no_hum(tones, drives, noise):
    assert told(tones, drives, noise) is None


@pytest.mark.parametrize("samples", [37.0, 83.3, 150.4])
def test_the_period_of_a_drive_is_read_between_the_lines_of_its_spectrum(case, samples):
    s = case.series[0]
    drive = 500 + 300 * np.sin(2 * np.pi * np.arange(SAMPLES) / samples)
    assert _period(replace(s.record, voltage=drive)) == pytest.approx(samples, rel=3e-3)


def test_slow_residuals_are_held_to_twice_what_lies_above(case):
    """Creep is no noise: below a quarter of the resonance."""
    rng = np.random.default_rng(1)
    slow = np.cumsum(rng.standard_normal((len(case.series), SAMPLES)), 1)
    frequency, level = estimate(case, [1e-3 * rng.standard_normal(SAMPLES) + 1e-4 * e for e in slow]).spectrum.T
    below = frequency < HZ / 4
    assert below.any() and level[below].max() == pytest.approx(2 * level[~below][0], rel=1e-9)


@pytest.mark.parametrize("colour", [([20**-0.5] * 20, [1.0]), ([0.4], [1.0, -0.9])], ids=("average", "memory"))
def test_the_floor_knows_the_colour_of_its_noise(case, colour):
    """A moving average over 20 samples, which has zeros but no peak, and AR(0.9): read as large as they are."""
    rng, found = np.random.default_rng(2), []
    for _ in range(5):
        errors = (
            1e-3
            * np.asarray(lfilter(colour[0], colour[1], rng.standard_normal((len(case.series), 2 * SAMPLES))))[
                :, SAMPLES:
            ]
        )
        noise = estimate(case, list(errors))
        found.append((noise.sigma / errors.std(), noise.sigma / noise.sensor))
    told, struck = np.mean(found, axis=0)
    assert told == pytest.approx(1.0, abs=0.12) and struck == pytest.approx(1.0)


def test_a_sensor_that_reads_in_steps_is_no_better_than_they_are(case):
    """A residual of lines alone, as a slow drive between coarse steps leaves it."""
    step, unit = 0.03, case.model.scales.state[0]
    parts = [(s, np.round(s.record.displacement / (step * unit)) * step) for s in case.series]
    coarse = replace(case, series=tuple(replace(s, record=replace(s.record, displacement=y * unit)) for s, y in parts))
    found = estimate(coarse, [0.0 * s.run for s in case.series])
    assert found.sigma == pytest.approx(step / 12**0.5, rel=1e-3) and found.source.startswith("steps")
    assert estimate(case, [0.0 * s.run for s in case.series]).source.startswith("rounding")


def test_the_spectrum_of_rounding_sums_to_the_floor(case):
    found = estimate(case, [0.0 * s.run for s in case.series])
    edges = band_edges(int(0.6 * SAMPLES), DT)
    assert np.sum(found.spectrum[:, 1] * np.diff(edges)) == pytest.approx(found.sigma**2, rel=1e-9)

"""A hum's line in the residuals of all records, and the period of a drive."""

import numpy as np
import pytest
from played import DT, SAMPLES, TIME

from pitp_jax.application.check.repeatability import _period
from pitp_jax.method.diagnose.steady_tone import steady_tone
from pitp_jax.method.signal.record import Record

HUM = 17.3


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
def test_the_period_of_a_drive_is_read_between_the_lines_of_its_spectrum(samples):
    drive = 500 + 300 * np.sin(2 * np.pi * np.arange(SAMPLES) / samples)
    assert _period(Record("r", TIME, drive, drive)) == pytest.approx(samples, rel=3e-3)

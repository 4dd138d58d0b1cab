"""Where a gap lies: errors and missing forces that were put in one place are told there."""

from dataclasses import replace

import numpy as np
import pytest
from played import SAMPLES, TIME, nominal_of, play

from pitp_jax.method.diagnose.data import build_case
from pitp_jax.method.diagnose.search import Search
from pitp_jax.method.diagnose.where import locate, motions, windows


@pytest.fixture(scope="module")
def case(linear):
    nominal = nominal_of(linear)
    built = build_case(nominal, play(nominal, noise=0.0))
    assert built.thinned == 1
    seen = motions(built, Search(built, False).scale)
    return seen._replace(motions=tuple(replace(m, noise=0.0) for m in seen.motions))


def index(case, name):
    return next(k for k, s in enumerate(case.motions) if s.record.name == name)


def nowhere(case):
    return [np.zeros(SAMPLES) for _ in case.motions]


def share(rows, key, at):
    """Of the row whose interval holds `at`."""
    return next(r["share"] for r in rows if r[key][0] <= at < r[key][1])


def test_bands_are_parts_of_the_natural_frequency(case):
    found = [row["band_hz"] for row in locate(case, nowhere(case))["frequency"]]
    edges = [0.0, 0.75, 1.75, 3.5, 7.0, 14.0, 30.0, 125.0]  # of 5 Hz, and half the sampling rate
    np.testing.assert_allclose(found, np.column_stack([edges[:-1], edges[1:]]), rtol=1e-6)


def test_an_error_is_told_in_its_record_band_and_tenth(case):
    errors, k = nowhere(case), index(case, "multisine")
    errors[k] = np.sin(2 * np.pi * 10.0 * TIME) * (np.arange(SAMPLES) // (SAMPLES // 10) == 3)
    where = locate(case, errors)
    assert where["records"]["multisine"] == pytest.approx(1.0)
    assert share(where["frequency"], "band_hz", 10.0) > 0.9
    assert share(where["time"], "part", 0.35) == pytest.approx(1.0)


def test_a_gap_in_no_cell_is_told_by_record_and_band(case):
    """Where nothing was observed no cell of band and amplitude was visited; the sentence goes without it."""
    where = locate(case._replace(motions=tuple(replace(m, weight=0 * m.weight) for m in case.motions)), nowhere(case))
    assert where["cells"] == [] and "14 % of the error is in sweep." in where["summary"]
    assert "largest for" not in where["summary"]


def test_the_sentence_describes_one_cell_with_its_fraction(case):
    """It spanned all cells with most of the force, such as inputs of 0 to 98.3 Hz, and named the only recording."""
    errors, k = nowhere(case), index(case, "multisine")
    errors[k] = np.sin(2 * np.pi * 5.0 * TIME)
    where = locate(case._replace(unit="um"), errors)
    cell = max(where["cells"], key=lambda c: c["share"])
    (low, high), (least, most) = cell["band_hz"], (1e6 * edge for edge in cell["amplitude"])
    assert where["summary"] == (
        f"The missing force is largest for inputs of {low:.3g} to {high:.3g} Hz and motions of {least:.3g} to "
        f"{most:.3g} µm ({100 * cell['share']:.0f} % of it). 100 % of the error is in multisine. "
        f"{100 * share(where['frequency'], 'band_hz', 5.0):.0f} % of the error is at 3.5 to 7 Hz."
    )
    alone = locate(case._replace(motions=case.motions[k : k + 1]), errors[k : k + 1])
    assert "of the error is in" not in alone["summary"] and "of the error is at" in alone["summary"]


@pytest.mark.parametrize(("order", "name"), [(1, "1f"), (2, "2f"), (3, "3f"), (2.5, "other"), (7, "other")])
def test_an_error_is_told_at_the_harmonic_it_has(case, order, name):
    errors, k = nowhere(case), index(case, "sine3")
    errors[k] = np.sin(2 * np.pi * 3.6 * order * TIME)
    assert locate(case, errors)["harmonics"][name] > 0.95


@pytest.mark.parametrize("periods", [1, 2, 8])
def test_a_drift_is_not_a_tone(case, periods):
    """Of a sensor that wanders, one period in a recording held 85 % of the error: "one oscillation at 0.100 Hz"."""
    slow = np.sin(2 * np.pi * periods * TIME / (TIME[-1] - TIME[0]))
    tone = locate(case, [slow for _ in case.motions])["tone"]
    assert (tone is not None) == (periods >= 4)


def test_noise_has_no_fraction_of_the_harmonics(case):
    """White noise of the stated deviation, and a line at twice the frequency with the same energy."""
    errors, k, size = nowhere(case), index(case, "sine3"), 0.1
    noise = size * np.random.default_rng(5).standard_normal(SAMPLES)
    errors[k] = size * np.sqrt(2) * np.sin(2 * np.pi * 7.2 * TIME) + noise
    noisy = [replace(m, noise=size * (place == k)) for place, m in enumerate(case.motions)]
    assert locate(case._replace(motions=tuple(noisy)), errors)["harmonics"]["2f"] > 0.9


@pytest.mark.parametrize(("hz", "passed"), [(15.0, 1.0), (30.0, 0.5), (60.0, 0.0)])
def test_motions_are_filtered_at_six_times_the_resonance(linear, hz, passed):
    """A zero-phase filter halves a sine at its cut-off, 30 Hz for a resonance of 5 Hz."""
    nominal = nominal_of(linear)
    built = build_case(nominal, play(nominal, noise=0.0))
    sine = np.sin(2 * np.pi * hz * TIME)
    series = tuple(replace(s, output=sine) for s in built.series)
    (state, *_) = motions(replace(built, series=series), Search(built, False).scale).motions
    inner = slice(300, -300)
    assert np.ptp(state.states[inner, 0]) / np.ptp(sine[inner]) == pytest.approx(passed, abs=0.05)


def test_a_missing_force_is_told_where_the_actuator_was(case):
    """Put in beyond eight tenths of the range of x: in the two last bins of ten, and in cells of large motions."""
    low, high = (np.quantile(np.concatenate([s.states[:, 0] for s in case.motions]), q) for q in (0.001, 0.999))
    series = tuple(replace(s, force=0.1 * (s.states[:, 0] > low + 0.8 * (high - low))) for s in case.motions)
    where = locate(case._replace(motions=series), nowhere(case))
    assert sum(row["share"] for row in where["displacement"][7:]) == pytest.approx(1.0, abs=1e-6)
    assert sum(row["share"] for row in where["displacement"][:7]) == pytest.approx(0.0, abs=1e-6)
    least = case.length * (low + 0.8 * (high - low))
    loud = [c for c in where["cells"] if c["share"] > 1e-6]
    assert loud and all(c["amplitude"][1] > least for c in loud)


def test_windows_follow_the_drive(case):
    s = case.motions[index(case, "sine2")]
    found = list(windows(s, case))
    firsts, lasts, hz, sizes = map(np.array, zip(*found, strict=True))
    np.testing.assert_array_equal(firsts[1:], lasts[:-1])
    assert (
        firsts[0] == 0 and (lasts - firsts >= 25).all() and (lasts - firsts <= 500).all()
    )  # 1/2 to 10 periods of 5 Hz
    assert np.median(hz) == pytest.approx(2.2, rel=0.02)
    np.testing.assert_allclose(sizes, [np.abs(s.states[a:b, 0]).max() for a, b in zip(firsts, lasts, strict=True)])

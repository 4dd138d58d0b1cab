"""Cells of frequency and amplitude: closed forms of sines and noise, files of before, and the sentence."""

import numpy as np
import pytest

import pitp_jax as pitp
from pitp_jax.files.model_file.parts import describe, origin_of
from pitp_jax.files.model_file.plausible import header_problems
from pitp_jax.method.model.coverage import trained_words, untrained, untrained_words, with_excited
from pitp_jax.method.model.domain import Domain
from pitp_jax.method.model.fitted import Fitted
from pitp_jax.method.model.input_map import LinearInput
from pitp_jax.method.model.model import Output, linear_model
from pitp_jax.method.model.origin import Origin
from pitp_jax.method.signal.excited import beyond, distinct, tabulate, unexcited

DT, RESONANCE = 1e-3, 5.0
TIME = np.arange(10_000) * DT


def sine(hz: float, amplitude: float = 1.0) -> np.ndarray:
    """A steady sine of 10 s."""
    return amplitude * np.sin(2 * np.pi * hz * TIME)


TABLE = tabulate([sine(hz) for hz in range(1, 8)], DT)


@pytest.mark.parametrize("hz", [0.3, 0.7, 1.5, 3.3, 5.5, 7.0])
def test_sines_between_trained_ones_are_covered(hz):
    assert beyond(TABLE, sine(hz), DT, RESONANCE).fraction < 1e-6


def test_faster_sine_is_not_covered():
    part = beyond(TABLE, sine(11.0), DT, RESONANCE)
    assert part.fraction == pytest.approx(1.0, abs=1e-6)
    assert part.low_hz < 11.0 <= part.high_hz and part.high_hz < 2 * part.low_hz
    assert part.below_hz == pytest.approx(7.0, rel=0.01) and part.above_hz is None


@pytest.mark.parametrize(("factor", "fraction"), [(1.2, 0.0), (2.0, 1.0)])
def test_amplitude_twice_as_large(factor, fraction):
    part = beyond(TABLE, sine(3.3, factor), DT, RESONANCE)
    assert part.fraction == pytest.approx(fraction, abs=1e-4)
    if fraction:
        assert (part.amplitude, part.reached) == (pytest.approx(2.0, rel=1e-3), pytest.approx(1.0, rel=1e-3))
        assert part.below_hz is None and part.above_hz is None


def test_white_noise_has_its_energy_above_the_trained_band():
    noise = np.sqrt(0.5) * np.random.default_rng(0).standard_normal(len(TIME))
    # of the band up to the Nyquist frequency, all but that up to the end of the quarter octave of 7 Hz
    assert beyond(TABLE, noise, DT, RESONANCE).fraction == pytest.approx(1 - 8 / 500, abs=0.01)


def test_two_tones_are_told_apart():
    part = beyond(TABLE, sine(2.0) + sine(11.0, np.sqrt(0.5)), DT, RESONANCE)
    assert part.fraction == pytest.approx(1 / 3, abs=1e-3) and part.low_hz > 7


def test_gap_around_the_resonance_is_not_covered():
    part = beyond(tabulate([sine(1.0), sine(20.0)], DT), sine(5.0), DT, RESONANCE)
    assert part.fraction == pytest.approx(1.0, abs=1e-3)
    assert (part.below_hz, part.above_hz) == (pytest.approx(1.0, rel=0.2), pytest.approx(20.0, rel=0.05))


def test_step_excites_fast_frequencies_only_a_little():
    table = tabulate([np.sign(sine(0.5)), sine(3.0), sine(7.0)], DT)
    assert beyond(table, sine(11.0), DT, RESONANCE).fraction > 0.99
    assert beyond(table, sine(11.0, 0.1), DT, RESONANCE).fraction < 0.01


def test_sweep_covers_its_band_and_noise_its_own_kind():
    swept = np.sin(np.pi * 2.0 * TIME**2)  # 0 to 20 Hz
    for hz in (0.5, 3.0, 18.0):
        assert beyond(tabulate([swept], DT), sine(hz), DT, RESONANCE).fraction < 0.01
    first, second = np.random.default_rng(1).standard_normal((2, len(TIME)))
    table = tabulate([first], DT)
    assert beyond(table, second, DT, RESONANCE).fraction < 0.05
    assert beyond(table, 3 * second, DT, RESONANCE).fraction > 0.9


def test_what_a_plan_lacks():
    assert unexcited(TABLE, (0.5, 6.5), lambda hz: 1.0, RESONANCE) is None
    low, high = unexcited(TABLE, (3.0, 12.0), lambda hz: 1.0, RESONANCE) or (0.0, 0.0)
    assert 7 < low < 8.1 and high == 12.0
    # an amplifier that plays less there needs no recording of it
    assert unexcited(TABLE, (3.0, 12.0), lambda hz: 1e-9, RESONANCE) is None


def _record(hz: float, amplitude: float = 300.0, name: str = "r") -> pitp.Record:
    x = 1e-4 * sine(hz)
    x[500:600] = np.nan
    return pitp.Record(name, TIME, sine(hz, amplitude), x)


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    records = [_record(hz) for hz in (1.0, 2.0, 4.0, 7.0)]
    a = 1e7 * np.array([1.0, 0.02, 1e-3])
    scale = 1e-4 * np.array([1.0, 30.0, 1000.0])
    model = linear_model(a, input_map=LinearInput(), state_scale=scale, force_scale=300.0, output=Output(0.0, 1.0),
                         hold="foh", domain=Domain(DT, (np.inf, -np.inf), 0.0).driven_by(records))  # fmt: skip
    return Fitted(model, with_excited(Origin(), records))


def test_sentence_and_remedy(fitted):
    words = untrained_words(fitted, "input", untrained(fitted, "input", sine(11.0, 300.0), DT))
    assert words.startswith("The input has 100 % of its energy between 10 and 12 Hz; ")
    assert "trained up to 7 Hz." in words and "--band 10 12" in words
    assert untrained_words(fitted, "input", untrained(fitted, "input", sine(3.0, 300.0), DT)) == ""


@pytest.mark.parametrize(("size", "told"), [(0.2, False), (0.7, True)])
def test_a_part_below_a_tenth_of_the_energy_is_not_worth_a_line(fitted, size, told):
    """Beside a trained sine one of 11 Hz with 4 % or 33 % of the energy."""
    mixed = sine(3.0, 300.0) + sine(11.0, 300.0 * size)
    part = untrained(fitted, "input", mixed, DT)
    assert part.fraction == pytest.approx(size**2 / (1 + size**2), rel=0.1)
    assert bool(untrained_words(fitted, "input", part)) is told


def test_amplitude_is_told_in_the_users_unit(fitted):
    words = untrained_words(fitted, "input", untrained(fitted, "input", sine(3.0, 900.0), DT))
    assert "up to 900 V" in words and "up to 300 V there" in words


def test_targets_are_compared_with_the_measured_output(fitted):
    assert untrained(fitted, "output", 1e-4 * sine(3.0), DT).fraction < 0.01
    assert untrained(fitted, "output", 1e-4 * sine(11.0), DT).fraction > 0.99
    assert "0.0001 m" in trained_words(fitted) and "300 V" in trained_words(fitted)


def test_model_without_a_table_says_nothing(fitted):
    assert untrained(fitted.model, "input", sine(40.0), DT).fraction == 0.0
    assert trained_words(fitted.model) == ""


def test_table_is_kept_in_files_and_older_files_load(fitted, tmp_path):
    pitp.save(tmp_path / "m.pitp", fitted)
    again = pitp.load(tmp_path / "m.pitp").origin
    assert again.excited_input == fitted.origin.excited_input
    assert again.excited_output == fitted.origin.excited_output
    header = describe(fitted)
    for name in ("excited_input", "excited_output"):
        del header["origin"][name]
    assert header_problems({**header, "leaves": []}) == []
    assert origin_of(header).excited_input == ()


def test_repetitions_are_one_excitation_and_other_frequencies_or_amplitudes_are_not():
    rng = np.random.default_rng(1)
    noisy = [sine(3.0) + 0.02 * rng.standard_normal(len(TIME)) for _ in range(2)]
    white = [rng.standard_normal(len(TIME)) for _ in range(2)]
    signals = [noisy[0], sine(3.0, 2.0), white[0], noisy[1], sine(4.5), white[1], np.zeros(len(TIME))]
    assert distinct(signals, DT) == ((0, 3), (1,), (2, 5), (4,), (6,))

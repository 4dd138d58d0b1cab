"""The error to expect: closed forms for sines, and no figure where nothing was left out."""

from dataclasses import replace

import numpy as np
import pytest

from pitp_jax.files.model_file.parts import describe
from pitp_jax.files.model_file.plausible import header_problems
from pitp_jax.method.model.expected_error import error_table, expected_error, merged
from pitp_jax.method.model.fitted import Fitted
from pitp_jax.method.model.model import linear_model
from pitp_jax.method.model.origin import Origin
from pitp_jax.method.train.cross_validation import HeldOut, with_held_out

DT = 1e-3
MODEL = linear_model([1e7, 2e5, 1e4], dt=DT)


def sine(hz: float, amplitude: float) -> np.ndarray:
    """A sine of 2 s, of which each of eight windows holds whole periods of a multiple of 4 Hz."""
    return amplitude * np.sin(2 * np.pi * hz * DT * np.arange(2000))


def known(*rows: tuple[float, float, float], step: str = "identify") -> Fitted:
    return Fitted(MODEL, Origin(lineage=({"step": "identify"}, {"step": step}), errors=rows))


def percent(model: Fitted, motion: np.ndarray) -> float:
    found = expected_error(model, motion, DT)
    assert found is not None
    return found.percent


ROOT2 = float(np.sqrt(2))


def test_a_constant_error_is_tabulated_whole():
    """The mean error counts; 8 Hz and 16 Hz lie in cells of their own, windows without a measurement in none."""
    lost = np.where(np.arange(2000) < 1000, np.nan, 3e-6)
    table = error_table([sine(8.0, 1e-3), sine(16.0, 2e-3)], [np.full(2000, 2e-6), lost], DT)
    expected = [(8.0, 1e-3 / ROOT2, 2e-6), (16.0, 2e-3 / ROOT2, 3e-6)]
    np.testing.assert_allclose(table, expected, rtol=2e-3)
    assert error_table([np.zeros(2000)], [np.ones(2000)], DT) == ()


def test_a_motion_that_stands_still_for_a_while_has_a_finite_error():
    motion = np.where(np.arange(2000) < 1000, 0.0, sine(8.0, 1e-3))
    assert np.isfinite(error_table([motion], [np.full(2000, 2e-6)], DT)).all()
    assert percent(known((8.0, 1e-3 / ROOT2, 2e-6)), motion) == pytest.approx(0.1, rel=1e-2)


def test_rows_of_one_cell_are_merged():
    table = merged([(1.0, 1.0, 3.0), (1.0, 1.0, 4.0), (4.0, 1.0, 5.0)])
    np.testing.assert_allclose(table, [(1.0, 1.0, np.sqrt(12.5)), (4.0, 1.0, 5.0)])


@pytest.mark.parametrize("size", [1 / 4, 1.0, 4.0])
def test_the_only_known_error_holds_at_every_amplitude(size):
    motion = np.append(sine(8.0, 1e-3 * size), np.nan)
    assert percent(known((8.0, 1e-3 / ROOT2, 2e-6)), motion) == pytest.approx(100 * 2e-6 / (2e-3 * size), rel=1e-4)


def test_the_error_of_the_nearest_amplitude_counts_most():
    model = known((8.0, 1e-4, 1e-6), (8.0, 1.6e-3, 8e-6))  # four octaves apart: exp(-8)
    for amplitude, error in ((1e-4, 1e-6), (1.6e-3, 8e-6)):
        found = percent(model, sine(8.0, amplitude * ROOT2))
        assert found == pytest.approx(100 * error / (2 * ROOT2 * amplitude), rel=0.02)


def test_halfway_between_two_frequencies_both_count():
    model = known((4.0, 1e-3 / ROOT2, 2e-6), (16.0, 1e-3 / ROOT2, 4e-6))
    assert percent(model, sine(8.0, 1e-3)) == pytest.approx(100 * np.sqrt(10) * 1e-6 / 2e-3, rel=1e-2)
    # two octaves away a row weighs exp(-2)
    far = (4 + 16 * np.exp(-2)) / (1 + np.exp(-2))
    assert percent(model, sine(4.0, 1e-3)) == pytest.approx(100 * np.sqrt(far) * 1e-6 / 2e-3, rel=1e-2)


def test_a_motion_far_below_all_others_has_an_error():
    assert np.isfinite(percent(known((8.0, 1e-3, 2e-6)), sine(8.0, 1e-9)))


def test_trained_model_has_the_errors_of_recordings_left_out():
    trained = known(step="fit")
    trained = Fitted(MODEL, replace(trained.origin, training={}))
    assert expected_error(trained, sine(8.0, 1e-3), DT) is None
    errors = [HeldOut(f"r{k}", 0.1, e, cells=((8.0, 1e-3 / ROOT2, e * 1e-6),)) for k, e in enumerate((1.0, 7.0))]
    kept = with_held_out(trained, [*errors, HeldOut("lost", 0.1, np.inf, "diverged")])
    found = expected_error(kept, sine(8.0, 1e-3), DT)
    assert found is not None and "2 recordings" in found.source and "1 to 7 %" in found.source
    assert found.percent == pytest.approx(100 * 5e-6 / 2e-3, rel=1e-2)
    assert header_problems({**describe(kept), "leaves": []}) == []


@pytest.mark.parametrize("model", [known(), Fitted(MODEL, Origin())])
def test_no_figure_where_none_was_measured(model):
    assert expected_error(model, sine(8.0, 1e-3), DT) is None

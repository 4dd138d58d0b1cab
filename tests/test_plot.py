"""The figures show the data they are given, in mm, V, kV and s, on the axes they are given."""

import runpy
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib import rcParams
from matplotlib.figure import Figure
from test_compare import machine
from typed import some

import pitp_jax as pitp
from pitp_jax.application.pages.bode_page import bode
from pitp_jax.application.pages.drawing import beside, some_periods
from pitp_jax.common.picture import BINS, finish, new_axes, shrink, thin

EXPERIMENTS = Path(__file__).resolve().parents[1] / "experiments"
plot: Any = SimpleNamespace(**runpy.run_path(str(EXPERIMENTS / "_paper_figures.py")))
envelope, error_shown, extremes, over = plot.envelope, plot.error_shown, plot.extremes, plot.over

T = np.arange(500) / 1e3
X = 1e-3 * np.sin(2 * np.pi * 5 * T)
Y = 0.9 * X
U = 3e3 + 2e3 * np.sin(2 * np.pi * 5 * T)


def drawn(ax, i):
    return np.asarray(ax.lines[i].get_xdata()), np.asarray(ax.lines[i].get_ydata())


def test_prediction_shows_both_and_their_difference():
    axes = plot.prediction(T, X, Y)
    np.testing.assert_allclose(drawn(axes[0], 0), (T, 1e3 * X))
    np.testing.assert_allclose(drawn(axes[0], 1), (T, 1e3 * Y))
    np.testing.assert_allclose(drawn(axes[1], 0), (T, 1e3 * (Y - X)))
    assert [ax.get_ylabel() for ax in axes] == ["displacement (mm)", "error (mm)"]
    assert axes[1].get_xlabel() == "time (s)"
    assert [t.get_text() for t in axes[0].get_legend().get_texts()] == ["measured", "predicted"]


def test_an_electronic_output_stays_in_volts():
    axes = plot.prediction(T, X, Y, unit="V")
    np.testing.assert_array_equal(drawn(axes[0], 0)[1], X)
    assert axes[0].get_ylabel() == "output (V)"
    with pytest.raises(ValueError, match="unknown output unit"):
        plot.prediction(T, X, Y, unit="mm")


def test_tracking_shows_motion_error_and_voltage():
    axes = plot.tracking(T, X, Y, U)
    np.testing.assert_allclose(drawn(axes[0], 0)[1], 1e3 * X)
    np.testing.assert_allclose(drawn(axes[0], 1)[1], 1e3 * Y)
    np.testing.assert_allclose(drawn(axes[1], 0)[1], 1e3 * (Y - X))
    np.testing.assert_allclose(drawn(axes[2], 0)[1], U / 1e3)
    assert axes[2].get_ylabel() == "voltage (kV)"
    roll = plot.tracking(T, X, Y, U / 4)
    np.testing.assert_allclose(drawn(roll[2], 0)[1], U / 4)
    assert roll[2].get_ylabel() == "voltage (V)"


def test_hysteresis_loops_add_a_pair_each_time():
    ax = plot.hysteresis_loops(U, X, Y, label="5 Hz")
    assert plot.hysteresis_loops(U, Y, X, ax, label="7 Hz") is ax
    np.testing.assert_allclose(drawn(ax, 0), (U / 1e3, 1e3 * X))
    np.testing.assert_allclose(drawn(ax, 3), (U / 1e3, 1e3 * X))
    assert ax.lines[0].get_color() == ax.lines[1].get_color() != ax.lines[2].get_color()
    assert [t.get_text() for t in some(ax.get_legend()).get_texts()] == ["5 Hz", "predicted", "7 Hz"]


def test_tokens_have_an_axes_each():
    theta = np.stack([X, Y, X + Y], axis=1)
    axes = plot.tokens(T, theta, ["a (1)", "b (s)", "c (s$^2$)"])
    for i, ax in enumerate(axes):
        np.testing.assert_array_equal(drawn(ax, 0)[1], theta[:, i])
    assert [ax.get_ylabel() for ax in axes] == ["a (1)", "b (s)", "c (s$^2$)"]
    with pytest.raises(ValueError, match=r"\(T, k\)"):
        plot.tokens(T, theta, ["a"])


def test_sweep_shows_frequency_and_the_models_envelope():
    time = np.arange(50_000) / 1e3
    x = 1e-3 * np.sin(np.pi * time**2 / 5)
    ax = plot.sweep_response(time, x, 2 * x, sweep_hz=(0.0, 10.0))
    across, y = drawn(ax, 0)
    assert (y.min(), y.max()) == (1e3 * x.min(), 1e3 * x.max())
    assert (across[0], across[-1]) == (0.0, 10.0)
    assert drawn(ax, 1)[1][240:].min() > 1.9
    assert drawn(ax, 2)[1][240:].max() < -1.9
    assert ax.get_xlabel() == "drive frequency (Hz)"
    assert plot.sweep_response(time, x, x).get_xlabel() == "time (s)"


def test_the_envelope_has_nothing_of_the_motion_left():
    """Slower than its bins, which alone would see one flank each; a signal without troughs is one stretch."""
    time = np.arange(20_000) / 1e3
    x = (1 + 0.02 * time) * np.cos(2 * np.pi * 0.5 * time)
    low, high = envelope(x, 300)
    inside = (time[high] > 2) & (time[high] < 18)
    np.testing.assert_allclose(x[high][inside], 1 + 0.02 * time[high][inside], atol=1e-3)
    np.testing.assert_allclose(x[low][inside], -1 - 0.02 * time[low][inside], atol=1e-3)
    assert x[extremes(x, 300)[1]].min() < -0.9  # what bins alone would draw
    assert set(envelope(time, 10)[1]) == {19_999}


def test_small_errors_are_shown_in_smaller_units():
    error, name = error_shown("m", np.array([0.02, np.nan, -0.04]))
    np.testing.assert_allclose(error, [20, np.nan, -40])
    assert name == "error (µm)"
    assert error_shown("m", np.array([0.06]))[1] == "error (mm)"
    assert error_shown("V", np.array([1e-3]))[1] == "error (mV)"
    axes = plot.tracking(T, X, X + 2e-6, U)
    np.testing.assert_allclose(drawn(axes[1], 0)[1], 2.0)
    assert axes[1].get_ylabel() == "error (µm)"


def test_a_line_over_another_can_be_told_from_it():
    few, many, filled = (np.sin(np.linspace(0, turns * np.pi, 10_000)) for turns in (8, 80, 800))
    assert [over(v) for v in (few, many, filled)] == [{"ls": "--"}, {}, {"alpha": 0.6}]


def test_given_axes_are_used_and_counted():
    figure = Figure()
    axes = figure.subplots(2, 1)
    back = plot.prediction(T, X, Y, axes)
    assert all(a is b for a, b in zip(back, axes, strict=True))
    ax = figure.add_subplot()
    assert plot.sweep_response(T, X, Y, ax) is ax
    with pytest.raises(ValueError, match="needs 3 axes, not 2"):
        plot.tracking(T, X, Y, U, axes)


def test_unequal_lengths_are_refused():
    with pytest.raises(ValueError, match="one length"):
        plot.prediction(T[:-1], X, Y)
    with pytest.raises(ValueError, match="one length"):
        plot.tracking(T, X, Y, U[:-1])


def test_thinning_keeps_ends_extremes_and_order():
    rng = np.random.default_rng(0)
    values = rng.standard_normal(200_000)
    values[[12_345, 67_890]] = 50.0, -60.0
    kept = thin(values)
    assert len(kept) <= 2 * BINS + 2
    assert (np.diff(kept) > 0).all()
    assert {0, 12_345, 67_890, 199_999} <= set(kept.tolist())
    low, high = extremes(values, 100)
    np.testing.assert_array_equal(values[low], values.reshape(100, -1).min(axis=1))
    np.testing.assert_array_equal(values[high], values.reshape(100, -1).max(axis=1))
    np.testing.assert_array_equal(thin(values[:500]), np.arange(500))


def test_missing_samples_neither_warn_nor_hide_peaks():
    values = np.zeros(20_000)
    values[7_000] = 1.0
    values[5_000:6_990] = np.nan
    kept = thin(values)
    assert np.nanmax(values[kept]) == 1.0
    assert np.isnan(values[kept]).any()  # the gap stays a gap
    assert np.isfinite(values[kept]).sum() > 1000


def test_long_figures_are_written_and_leave_no_trace(tmp_path):
    before = dict(rcParams)
    had_pyplot = "matplotlib.pyplot" in sys.modules
    time = np.arange(200_000) / 1e3
    x = 1e-3 * np.sin(time)
    plot.prediction(time, x, x)[0].figure.savefig(tmp_path / "long.png")
    assert (tmp_path / "long.png").stat().st_size > 1000
    assert dict(rcParams) == before
    assert ("matplotlib.pyplot" in sys.modules) == had_pyplot


def test_a_dense_sine_is_drawn_by_twelve_periods_and_a_chirp_whole():
    time = np.arange(20_000) * 1e-3
    part = some_periods(3.0 + np.sin(2 * np.pi * 4.0 * time))
    assert time[part][-1] - time[part][0] == pytest.approx(3.0, abs=0.01)  # twelve periods of 0.25 s
    assert time[part].mean() == pytest.approx(10.0, abs=0.3)  # of the middle
    for whole in (np.sin(2 * np.pi * time), np.sin(2 * np.pi * 0.2 * time**2), np.zeros(20_000), np.full(9, np.nan)):
        assert some_periods(whole) == slice(None)


def test_no_legend_is_wider_than_its_figure():
    """The legend "best candidate" of a narrow figure was cut off."""
    for labels in (
        ("measured", "model as given", "best candidate"),
        ("robot", "MuJoCo, before", "MuJoCo, after"),
        ("l" * 90,),
    ):
        axes = new_axes(1, 2.0)
        for label in labels:
            axes[0].plot([0, 1], [0, 1], label=label)
        finish(axes, "x", ["y"])
        shrink(axes[0].figure)
        axes[0].figure.draw_without_rendering()
        assert axes[0].get_legend().get_window_extent().x1 <= axes[0].figure.bbox.x1


def test_time_counts_from_the_start_and_the_error_of_every_run_is_drawn():
    drawn = beside(700 + T, ("robot", X), [("before", 2 * X, "#000000"), ("after", Y, "#111111")], "m", ("x", "error"))
    upper, lower = drawn.axes
    assert np.asarray(upper.lines[0].get_xdata())[0] == 0 and lower.get_xlabel() == "time from the start (s)"
    assert len(upper.lines) == 3 and len(lower.lines) == 2
    np.testing.assert_allclose(np.asarray(lower.lines[0].get_ydata()), X)


@pytest.mark.slow
def test_a_response_without_information_does_not_stretch_the_axis():
    """One frequency with an error of its own size made the axis of a response eight decades high."""
    fits = pitp.identify(machine(), order=2, input_map="linear")
    value, stderr = fits.response.value.copy(), fits.response.stderr.copy()
    at = np.flatnonzero(fits.response.coherent)[3]
    value[at] *= 1e8
    stderr[at] = abs(value[at])
    upper = bode(replace(fits, response=replace(fits.response, value=value, stderr=stderr))).drawn.axes[0]
    assert max(np.max(line.get_ydata()) for line in upper.lines) < 1e3

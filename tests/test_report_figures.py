"""The figures of a report, on axes of the caller and in the user's units; its numbers and words."""

import io
from dataclasses import replace

import pytest
from diagnosis_cases import T, where
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from typed import of_kind

from pitp_jax.application.pages.diagnosis import figures, formatting, gap_figure
from pitp_jax.application.pages.diagnosis.answers import next_step, verdict_text
from pitp_jax.application.pages.diagnosis.page import report
from pitp_jax.common import numbers
from pitp_jax.method.effects import CATALOGUE
from pitp_jax.method.model.origin import Origin


def test_a_line_in_every_recording_is_a_disturbance(unknown):
    """The page reports the tone that `where` found, also where the page's own traces are shorter or not thinned."""
    assert "oscillation" not in verdict_text(unknown) + next_step(unknown)
    hummed = replace(unknown, where=where() | {"tone": {"hz": 7.5, "records": 3, "share": 0.93}})
    assert "at least 93 % of the error is one oscillation at 7.50 Hz" in verdict_text(hummed)
    assert "find the source of this oscillation" in next_step(replace(hummed, next_experiment=None))


def test_figures_take_and_return_axes(tied, no_gap, unknown):
    for diagnosis in (tied, no_gap, unknown):
        for draw, count in ((gap_figure.gap, 2), (figures.shares, 3)):
            axes = Figure().subplots(count, 1)
            assert all(a is b for a, b in zip(draw(diagnosis, axes), axes, strict=True))
        for draw in (figures.where_map, figures.ranking):
            ax = Figure().subplots()
            assert draw(diagnosis, ax) is ax
    ax = Figure().subplots()
    assert figures.excitation(tied, ax) is ax
    with pytest.raises(ValueError, match="no further experiment"):
        figures.excitation(no_gap)
    with pytest.raises(ValueError, match="needs 2 axes"):
        gap_figure.gap(tied, Figure().subplots(3, 1))


def test_the_gap_is_drawn_where_it_is_largest_in_the_users_unit(explained):
    part = gap_figure.telling(gap_figure.worst(explained))
    assert T[part.start] >= 1.9 and 1.5 < (part.stop - part.start) / 500 <= 2.1  # six of 3 Hz, after 2 s
    axes = gap_figure.gap(explained)
    labels = [text.get_text() for text in axes[0].get_legend().get_texts()]
    assert labels == ["measured", "model as given", "with electrode_rc"]
    assert axes[0].get_ylabel() == "displacement (mm)"
    assert max(axes[0].lines[0].get_ydata()) == pytest.approx(1.0, rel=0.01)
    assert max(axes[1].lines[0].get_ydata()) == pytest.approx(0.2, rel=0.01)
    before, after = gap_figure.errors(explained.traces[2])
    assert before == pytest.approx(100 * 2e-4 / 2 / 2e-3, rel=0.02) and after == pytest.approx(before / 50)


def test_an_electronic_output_is_told_in_volts(explained):
    electronic = replace(explained, model=replace(explained.model, origin=Origin(displacement_unit="mV")))
    assert gap_figure.gap(electronic)[0].get_ylabel() == "output (mV)"
    text = report(electronic)
    assert "outputs of 1.1 to 1.2 mV" in text and "range (mV)" in text and "In mV, rms" in text


def test_many_long_names_are_cut_under_their_bars(explained):
    names = [f"monday/sine_{k:05.1f}Hz_2600V" for k in range(20)]
    many = replace(explained, where=where() | {"records": dict.fromkeys(names, 0.05)})
    ax = figures.shares(many)[0]
    labels = [t.get_text() for t in ax.get_xticklabels()]
    assert max(map(len, labels)) <= 18 and len({*labels}) == 20


def test_maps_and_bars_show_the_shares(tied):
    ax = figures.where_map(tied)
    assert [t.get_text() for t in ax.texts] == ["20 %", "50 %", "30 %"]
    assert sum(not p.get_fill() for p in ax.patches) == 2
    assert [t.get_text() for t in ax.get_xticklabels()] == ["1.0", "4.0", "9.0"]
    bars = figures.ranking(tied)
    assert [t.get_text() for t in bars.texts] == ["99.5 %", "62 % (tied)", "30 %", "none"]
    assert [of_kind(Rectangle, p).get_width() for p in bars.patches] == pytest.approx([0.995, 0.62, 0.3, 0.0])
    axes = figures.shares(tied)
    assert [of_kind(Rectangle, p).get_height() for p in axes[0].patches] == pytest.approx([10, 20, 70])


def test_numbers_have_sensible_digits():
    assert numbers.with_error(0.00047808, 2.1e-7, "s") == "(4.781 ± 0.002)·10⁻⁴ s"
    assert numbers.with_error(7.76e-8, 5e-7, "m") == "(1 ± 5)·10⁻⁷ m"
    assert numbers.with_error(7623.0, 10804.0, "V²") == "8000 ± 11000 V²"
    assert numbers.with_error(-1.5, None, "V") == "−1.50 V"
    assert (
        formatting.parameter("tau", {"value": 0.00047808, "unit": "s", "stderr": 2.1e-7}, "mm")[1]
        == "0.4781 ± 0.0002 ms"
    )
    assert formatting.parameter("place", {"value": 0.0022, "unit": "m", "stderr": None}, "um")[1] == "2200 µm"
    level = {"value": 0.02, "unit": "rad/s", "stderr": None}  # a joint's, in files of degrees
    assert formatting.parameter("speed", level, "deg")[1] == "1.15 deg/s"
    assert formatting.parameter("inverse", {"value": 2e-5, "unit": "s/V", "stderr": 1.2e-6}, "m") == (
        "limit", "50000 ± 3000 V/s",
    )  # fmt: skip
    assert [numbers.percent(v) for v in (-1e-9, 0.999, 0.9999, 1.0, None, float("nan"))] == [
        "0 %", "99.9 %", "100 %", "100 %", "–", "–",
    ]  # fmt: skip
    assert numbers.interval(0.9767, 0.9816) == "97.7 % to 98.2 %"
    assert numbers.interval(0.5, 0.8) == "50 % to 80 %"
    assert [numbers.figure(v) for v in (0.0, 41686, 1e-9, None)] == ["0", "41700", "1.00·10⁻⁹", "–"]


def test_every_effect_has_plain_words():
    assert {c.name for c in CATALOGUE} | {"parameter_change"} == set(formatting.PLAIN)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cost_$5_and_$6", "$\\frac{", "back\\slash$", "<b>&amp;--></b>", "µ\u202ename"])
def test_any_name_of_a_record_can_be_drawn(explained, name):
    odd = replace(explained, where={**explained.where, "records": {name: 0.7, "other": 0.3}})
    for drawn in figures.figures(odd).values():
        assert not any("not drawn" in text.get_text() for text in drawn.texts)
        drawn.savefig(io.BytesIO(), format="svg")
    assert "<b>" not in report(odd)


def test_a_figure_that_fails_costs_itself_alone(explained, monkeypatch):
    def fails(*_):
        raise RuntimeError("no such $\\frac{")

    monkeypatch.setattr(figures, "where_map", fails)
    drawn = figures.figures(explained)
    assert "no such" in drawn["where"].texts[0].get_text()
    assert len(drawn["shares"].axes) == 3
    assert "<svg" in report(explained)


def test_records_that_begin_alike_are_told_apart(explained):
    """Names with a date before them were cut to the same letters."""
    names = [f"2026-11-25_recording_of_the_robot_{k}" for k in ("chirp", "steps", "sine")]
    values = explained.where["records"].values()
    found = replace(explained, where=explained.where | {"records": dict(zip(names, values, strict=True))})
    (ax,) = figures.shares(found, names=("records",))
    assert [text.get_text() for text in ax.get_xticklabels()] == ["…chirp", "…steps", "…sine"]

"""The figures of a report, on axes of the caller and in the user's units; its numbers and words."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_cases import T, where
from matplotlib.patches import Rectangle
from typed import of_kind

from pitp_jax.application.pages.diagnosis import figures
from pitp_jax.application.pages.diagnosis.page import report
from pitp_jax.common import numbers
from pitp_jax.method.diagnose.words import errors, next_step, verdict_lines, worst
from pitp_jax.method.effects import CATALOGUE
from pitp_jax.method.effects.words import PLAIN, parameter
from pitp_jax.method.model.origin import Origin


def test_a_line_in_every_recording_is_a_disturbance(unknown):
    """The page reports the tone that `where` found, also where the page's own traces are shorter or not thinned."""
    assert "oscillation" not in " ".join(verdict_lines(unknown))
    hummed = replace(unknown, where=where() | {"tone": {"hz": 7.48, "records": 3, "share": 0.93}})
    assert "at least 93 % of the error is one oscillation at about 7.5 Hz" in " ".join(verdict_lines(hummed))
    assert "find the source of this oscillation" in next_step(replace(hummed, next_experiment=None))
    stopped = replace(unknown, notes=("The search stopped after 5 s (--seconds) and did not try: sets of 2 effects",))
    assert next_step(stopped) == "Next: diagnose again without a limit of time (--seconds)."
    # the part has the frequency to its error, 2.846407 Hz, beside which the line of the spectrum was 2.80 Hz
    named = replace(hummed, verdict="explained", effects=("steady_tone",))
    assert "7.5 Hz" not in " ".join(verdict_lines(named))


def test_the_gap_is_drawn_where_it_is_largest_in_the_users_unit(explained):
    part = figures.telling(worst(explained))
    assert T[part.start] >= 1.9 and 1.5 < (part.stop - part.start) / 500 <= 2.1  # six of 3 Hz, after 2 s
    axes = figures.gap(explained)[0].axes
    legend = axes[0].get_legend()
    assert legend is not None
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == ["measured", "model as given", "model handed back"]
    assert axes[0].get_ylabel() == "displacement (mm)"
    assert np.max(axes[0].lines[0].get_ydata()) == pytest.approx(1.0, rel=0.01)
    assert np.max(axes[1].lines[0].get_ydata()) == pytest.approx(0.2, rel=0.01)
    before, after = errors(explained.traces[2])
    assert before == pytest.approx(100 * 2e-4 / 2 / 2e-3, rel=0.02) and after == pytest.approx(before / 50)


def test_an_electronic_output_is_told_in_volts(explained):
    electronic = replace(explained, model=replace(explained.model, origin=Origin(displacement_unit="mV")))
    assert figures.gap(electronic)[0].axes[0].get_ylabel() == "output (mV)"
    text = report(electronic).html()
    assert "range (mV)" in text


def test_maps_and_bars_show_the_shares(tied):
    (ax,) = figures.where_map(tied)[0].axes
    assert [t.get_text() for t in ax.texts] == ["20 %", "50 %", "30 %"]
    assert sum(not p.get_fill() for p in ax.patches) == 2
    assert [t.get_text() for t in ax.get_xticklabels()] == ["1.0", "4.0", "9.0"]
    (bars,) = figures.ranking(tied)[0].axes
    assert [t.get_text() for t in bars.texts] == ["99.5 %", "62 % (tied)", "30 %", "nothing"]
    assert [of_kind(Rectangle, p).get_width() for p in bars.patches] == pytest.approx([0.995, 0.62, 0.3, 0.0])
    axes = figures.shares(tied)[0].axes
    assert [of_kind(Rectangle, p).get_height() for p in axes[0].patches] == pytest.approx([10, 85, 5])


def test_numbers_have_sensible_digits():
    assert numbers.with_error(0.00047808, 2.1e-7, "s") == "(4.781 ± 0.002)·10⁻⁴ s"
    assert numbers.with_error(7.76e-8, 5e-7, "m") == "(1 ± 5)·10⁻⁷ m"
    assert numbers.with_error(7623.0, 10804.0, "V²") == "8000 ± 11000 V²"
    assert numbers.with_error(-1.5, None, "V") == "−1.50 V"
    assert parameter("tau", {"value": 0.00047808, "unit": "s", "stderr": 2.1e-7}, "mm")[1] == "0.4781 ± 0.0002 ms"
    assert parameter("place", {"value": 0.0022, "unit": "m", "stderr": None}, "um")[1] == "2200 µm"
    level = {"value": 0.02, "unit": "rad/s", "stderr": None}  # a joint's, in files of degrees
    assert parameter("speed", level, "deg")[1] == "1.15 deg/s"
    assert parameter("inverse", {"value": 2e-5, "unit": "s/V", "stderr": 1.2e-6}, "m") == (
        "limit", "50000 ± 3000 V/s",
    )  # fmt: skip
    assert [numbers.percent(v) for v in (-1e-9, 0.999, 0.9999, 1.0, None, float("nan"))] == [
        "0 %", "99.9 %", "100 %", "100 %", "–", "–",
    ]  # fmt: skip
    assert numbers.interval(0.9767, 0.9816) == "97.7 % to 98.2 %"
    assert numbers.interval(0.5, 0.8) == "50 % to 80 %"
    assert [numbers.figure(v) for v in (0.0, 41686, 1e-9, None)] == ["0", "41700", "1.00·10⁻⁹", "–"]


def test_every_effect_has_plain_words():
    assert {c.name for c in CATALOGUE} | {"parameter_change", "steady_tone"} == set(PLAIN)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cost_$5_and_$6", "$\\frac{", "back\\slash$", "<b>&amp;--></b>", "µ\u202ename"])
def test_any_name_of_a_record_can_be_drawn(explained, name):
    odd = replace(explained, where={**explained.where, "records": {name: 0.7, "other": 0.3}})
    for picture in figures.figures(odd).values():
        assert not any("not drawn" in text.get_text() for text in picture.drawn.texts)
        assert "<svg" in picture.html()
    assert "<b>" not in report(odd).html()


def test_a_figure_that_fails_costs_itself_alone(explained, monkeypatch):
    def fails(*_):
        raise RuntimeError("no such $\\frac{")

    monkeypatch.setattr(figures, "where_map", fails)
    drawn = figures.figures(explained)
    assert "no such" in drawn["where"].drawn.texts[0].get_text()
    assert len(drawn["force"].drawn.axes) == 3
    assert "<svg" in report(explained).html()


def test_chart_table_and_card_have_one_order(unknown):
    """The card named candidates that closed less than others of the chart."""
    fractions = (0.33, 0.45, None, 0.42)
    ranking = tuple(replace(r, closed_fraction=f) for r, f in zip(unknown.ranking, fractions, strict=True))
    text = report(replace(unknown, ranking=ranking)).html()
    order = ["delay", "drag", "electrode_rc"]
    for part in (text[text.index("Which") :], text[text.index("All candidates") :]):
        assert sorted(order, key=part.index) == order
    (bars,) = figures.ranking(replace(unknown, ranking=ranking))[0].axes
    assert [label.get_text() for label in bars.get_yticklabels()] == order

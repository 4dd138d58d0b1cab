"""The report: everything is said, in the user's units, on one self-contained page."""

import re
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from diagnosis_cases import budget, candidate, explained, no_gap, part, tied, unknown
from matplotlib import rcParams

from pitp_jax.application.pages.diagnosis import figures
from pitp_jax.application.pages.diagnosis.page import budget_table, ranking, report
from pitp_jax.common.quantity import Units
from pitp_jax.method.diagnose import rules
from pitp_jax.method.diagnose.parts import Parts
from pitp_jax.method.diagnose.words import next_step, result_line
from pitp_jax.method.effects.words import plain_words


class Page(HTMLParser):
    """Text and tags of a page; every tag closed, nothing loaded from elsewhere."""

    def __init__(self, text):
        super().__init__()
        self.text, self.tags, self.open, self.ids = "", [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        told = dict(attrs)
        assert "src" not in told and tag not in ("link", "script", "iframe", "object", "img")
        assert (told.get("href") or "#").startswith("#")
        self.ids += [told["id"]] if "id" in told else []
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.text += data


def read(diagnosis):
    text = report(diagnosis).html()
    assert "http" not in text and "@import" not in text and "url(h" not in text
    page = Page(text)
    assert len(set(page.ids)) == len(page.ids)
    return page, re.sub(r"\s+", " ", page.text)


@pytest.fixture(scope="module")
def read_tied(actuator):
    """The tied diagnosis, its page and the page's text."""
    diagnosis = tied(explained(actuator))
    return diagnosis, *read(diagnosis)


def test_the_first_screen_answers_which_where_and_how_far(explained):
    page, text = read(explained)
    screen = text[: text.index("The gap at a glance")]
    assert "explained by electrode_rc" in screen
    assert plain_words("electrode_rc", Units()) in screen.lower()
    assert "reduces the error on held-out recordings from 8.0 % to 0.41 % of range" in screen
    assert "tau = 12.3 ms (11.9 to 12.8)" in screen and "certain" in screen
    assert "8.0 % to 0.41 % of range" in screen
    assert "99.5 % of the gap is closed, 95 % interval 98 % to 100 %" in screen
    assert "The model's own error: 0.40 % of range (a <band>)" in screen
    assert "electrode_rc90 %85 % to 95 %0.970" in text[text.index("Parts of the gap") :]
    assert "It stands out <here> & there." in screen
    assert "delay alone: closes 62 %, error 1.5 % of range" in screen
    assert "85 % of the error" in screen and "Worst recording: sine&4, 70 % of the error." in screen
    assert page.tags.count("svg") == len(figures.figures(explained)) == 5


def test_a_cause_without_an_interval_has_an_empty_cell(explained):
    """Beside a simulator no fraction has one, and the page of `--against` ended in a KeyError."""
    (row,) = [r for r in budget_table(explained.budget | {"nuisance": {"share": 0.2}}).rows if r[1] == "20 %"]
    assert row[2] == ""


def test_of_too_many_names_none_is_reported_and_all_are_in_the_json(explained):
    found = replace(unknown(explained), equivalent=("delay", "electrode_rc", "sensor_lag", "force_lag"))
    assert "No single cause is certain" in read(found)[1] and found.as_json()["equivalent"][0] == "delay"


def test_tables_hold_every_candidate_and_every_recording(read_tied):
    diagnosis, page, text = read_tied
    for row in diagnosis.ranking:
        assert row.effect in text
    assert "delay (tied)" in text
    assert "limit = 5000 V" in text  # stored as its inverse
    assert "4.20·10⁷ V² s²/m²" in text
    for trace in diagnosis.traces:
        assert f"{trace.name}2000" in text
    assert "as given, error %handed back, error %" in text  # in sample; it was beside the words "held out"
    assert "The model handed back was fitted to all of these recordings" in text
    assert page.tags.count("table") == 4


def test_ties_are_said_first_and_come_with_an_experiment(read_tied):
    _, page, text = read_tied
    assert "verdict: explained by electrode_rc, or by delay" in text
    assert "do not separate electrode_rc from delay" in text
    assert "Next: play and record next_experiment.csv: a sine of 5 Hz for 4.0 s, to separate electrode_rc from" in text
    assert "Play a sine of 5 Hz for 4.0 s, to separate electrode_rc from delay, within the voltages" in text
    assert "differ by 12 times the noise" in text
    assert page.tags.count("svg") == 6


def test_two_effects_are_both_told_with_their_own_numbers(explained):
    limit = part("stiffening", "limited chain", {"curvature": (250.0, "1/m", [248.0, 252.0])})
    both = replace(
        explained, effects=("electrode_rc", "stiffening"), parts=Parts((*explained.parts, limit)),
        budget=budget(("electrode_rc", 0.5), ("stiffening", 0.4)), verdict="partly",
        handed_back=("electrode_rc", "stiffening", "parameters"),
    )  # fmt: skip
    _, text = read(both)
    assert "verdict: partly by electrode_rc and stiffening" in text
    assert (
        "energy of the error: 50 % electrode_rc; 40 % stiffening; 8 % remaining error; 1 % sensor offsets and initial "
        "states; 1 % can be predicted from the input, but no single cause is certain" in text
    )
    assert "limit = 4.000 mm (3.968 to 4.032)" in text
    assert "electrode_rc + stiffening + parameterstogether" in text and "stiffening40 %" in text


def test_a_row_of_the_ranking_with_all_parts_is_the_model_handed_back(explained):
    """Its error was beside the names of the reported effects alone, though it also held an uncertain part."""
    more = replace(explained, verdict="partly", handed_back=("electrode_rc", "drag", "parameters"))
    first, *rows = ranking(more).rows
    assert first[:2] == ("electrode_rc + drag + parameters", "together") and first[4] == explained.gap.after
    assert figures.ranking(more)[0].axes[0].get_yticklabels()[0].get_text() == "model handed back"
    assert len(ranking(explained).rows) == len(rows) == 4
    assert len(ranking(replace(explained, handed_back=("electrode_rc", "parameters"))).rows) == 4


def test_one_form_of_a_reported_effect_is_marked(explained):
    """Two forms of a friction were in bold, of which the model held one; it is not always the one that closes most."""
    other = replace(explained.ranking[0], form="one lag each way", closed_fraction=0.999)
    assert ranking(replace(explained, ranking=(*explained.ranking, other))).bold == [False, True, False, False, False]


@pytest.mark.parametrize(("folds", "where"), [(4, "held-out recordings"), (3, "left-out parts of the recordings")])
def test_parts_of_recordings_are_not_called_held_out_recordings(explained, folds, where):
    assert f"on {where} from 8.0 % to 0.41 %" in result_line(replace(explained, folds=explained.folds[:folds]))


def test_explained_leaves_nothing_to_be_found(explained):
    """`explained` was followed by "diagnose again, because up to 47 % of the remaining error can be predicted"."""
    more = replace(explained, gap=replace(explained.gap, explainable=0.2))
    assert next_step(more).startswith("Next: predict and invert with model_augmented")
    assert "up to 51 % of the remaining error" in next_step(replace(more, verdict="partly"))


def test_a_refit_is_beside_the_given_models_curve(explained):
    """The curve was called "model, refitted", and the model's own error "not known (not known in a refit)"."""
    gap = replace(explained.gap, unrefitted=12.0, noise_floor=None, floor_from="not known in a refit")
    legend = figures.gap(replace(explained, gap=gap))[0].axes[0].get_legend()
    assert legend is not None and legend.get_texts()[1].get_text() == "model as given"
    _, text = read(replace(explained, gap=gap))
    assert "The model's own error: not known in a refit." in text
    assert "Model as given: 12.0 %; refitted without any effect: 8.0 %." in text


def test_no_gap_reads_as_good_news(no_gap):
    page, text = read(no_gap)
    assert "The nominal model is handed back: its error is 0.41 % of range (a band: 0.40 %)." in text
    assert "There is no gap to close" in text and "stands out" not in text
    assert "noise in every recording" not in text and "Parts of the gap" not in text and page.tags.count("svg") == 1
    # all records have one fraction of no error: "14 % of the gap is in multisine" was beside the verdict
    assert no_gap.as_json()["where"]["summary"] == result_line(no_gap)


def test_a_changed_coefficient_is_an_explanation_of_its_own(explained):
    row = candidate("parameter_change", "refitted coefficients", {"a_1 over given": (1.28, "1", 0.004)}, 0.99)
    model = replace(explained.model, effects=())
    moved = part("parameter_change", "refitted coefficients", {"a_1 over given": (1.28, "1", [1.272, 1.288])})
    change = replace(
        explained, effects=("parameter_change",), ranking=(row,), shift=np.array([1.0, 1.28, 1.0]), model=model,
        parts=Parts((moved,)),
    )  # fmt: skip
    _, text = read(change)
    assert "own coefficients have changed" in text
    assert "damping (a1) × 1.280 (1.272 to 1.288)" in text


def test_unknown_names_nothing_but_says_what_was_near_and_why(unknown):
    _, text = read(unknown)
    assert "No single cause is certain" in text and "electrode_rc alone: closes 1 %" in text
    assert "No effect in the catalogue improves the fit significantly" in text and "explained by" not in text


@pytest.mark.slow
def test_the_page_says_what_to_do_next_and_decides_by_the_verdicts_thresholds(explained, unknown):
    text = read(explained)[1]
    assert "Next: predict and invert with model_augmented" in text
    assert "Next: play and record next_experiment.csv" in read(tied(explained))[1]
    linear = read(no_gap(explained))[1]
    assert "Next: predict and invert with this model" in linear and "train with `pitp fit`" in linear
    assert "Next: check " in read(unknown)[1]
    assert f"at most {rules.OWN:g} times" in text and f"P of at least {rules.SURE:g}" in text


@pytest.mark.slow
def test_a_report_is_reproducible_and_leaves_no_trace(explained):
    before, had = dict(rcParams), "matplotlib.pyplot" in sys.modules
    assert report(explained).html() == report(explained).html()
    assert dict(rcParams) == before
    assert ("matplotlib.pyplot" in sys.modules) == had

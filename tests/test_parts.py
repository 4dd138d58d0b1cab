"""The parts of the model handed back: certainty by hand-made hypotheses, intervals against closed forms, and words."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnosis_cases import part
from played import nominal_of
from test_names import SCALE, hypothesis, searched

from pitp_jax.method.diagnose import parts, result, verdict
from pitp_jax.method.diagnose.budget import Budget
from pitp_jax.method.diagnose.gap import Gap, as_far_as_closed
from pitp_jax.method.diagnose.library import INDEX, OFF, Form, slots_of_row
from pitp_jax.method.diagnose.next_experiment import Experiment
from pitp_jax.method.diagnose.parts import Parts, parts_of
from pitp_jax.method.diagnose.search import PARAMETERS
from pitp_jax.method.diagnose.verdict import decide
from pitp_jax.method.diagnose.words import certainty, lines, part_lines
from pitp_jax.method.effects import CATALOGUE, lookup
from pitp_jax.method.effects.words import parameter

CREEP, CLIP = lookup("creep", "one branch"), lookup("voltage_clip", "hard")
KAPPA, TAU = slots_of_row(CREEP)
(LIMIT,) = slots_of_row(CLIP)


def fitted(names, error, slots, without=(), labels=None):
    """A hand-made set with these numbers, and those without each fold."""
    made = hypothesis(names, error, labels=labels)
    values = OFF.copy()
    for k, v in slots.items():
        values[INDEX[k]] = v
    folds = np.tile(values, (len(without), 1))
    for row, change in zip(folds, without, strict=True):
        for k, v in change.items():
            row[INDEX[k]] = v
    return replace(
        made, fit=replace(made.fit, free=tuple(slots), slots=values, unit=np.ones(len(slots))), without=folds
    )


@pytest.fixture
def judged(monkeypatch, linear):
    """fn(search, handed, effects, errors): parts; recordings of 9 s, numbers of these standard errors."""

    def make(search, handed, effects, errors, library=()) -> Parts:
        monkeypatch.setattr(parts, "errors_of", lambda search, fit: {k: errors.get(k, 1e-6) for k in fit.free})
        search.case = SimpleNamespace(
            blocks=1,
            series=[SimpleNamespace(record=SimpleNamespace(time=np.array([0.0, 9.0])))],
            nominal=OFF,
            recordings={"all": [*range(6)]},
        )
        search.scale, search.movable, search.library = SCALE, (), library
        decision = decide(search, 0.0, 0.0, 6)
        added = [(spec(*(handed.fit.value(k) for k in slots_of_row(spec))), slots_of_row(spec)) for spec in effects]
        return parts_of(search, decision, handed, (nominal_of(linear), added))

    return make


@pytest.mark.parametrize(
    ("flexible", "rival", "certainty"),
    [(1.0, 0.5, "certain"), (1.0, 0.301, "tied"), (0.2, 0.5, "likely"), (0.2, 0.299, "none")],
)
def test_numbers_are_reported_under_every_verdict(judged, monkeypatch, flexible, rival, certainty):
    """A clip; a black-box model leaves `flexible` of the error, another effect `rival`."""
    monkeypatch.setattr(verdict, "reference", lambda case, h, floors: hypothesis((), flexible).evidence)
    clip = fitted(("voltage_clip",), 0.3, {LIMIT: 1 / 850.0})
    search = searched(clip, hypothesis(("drag",), rival))
    search.best = lambda: clip
    (found,) = judged(search, clip, [CLIP], {})
    assert (found.effect, found.form, found.certainty) == ("voltage_clip", "hard", certainty)
    assert found.parameters["inverse"]["value"] == pytest.approx(1 / 850.0)
    assert found.fraction == pytest.approx(1.0)
    assert found.tied == (("drag",) if certainty == "tied" else ())
    assert (found.recording is not None) == (certainty == "likely")


@pytest.mark.parametrize(
    ("key", "value", "error", "certainty"),
    [
        # the interval of a signed number reaches zero from 0.51 of its size on; so for a positive one
        ("stretch_coupling: linear", -0.3, 0.1, "likely"),
        ("stretch_coupling: linear", -0.3, 0.16, "none"),
        ("voltage_clip: hard", 1 / 850.0, 0.45, "likely"),
        ("voltage_clip: hard", 1 / 850.0, 0.55, "none"),
    ],
)
def test_a_likely_part_differs_from_its_absence(judged, monkeypatch, key, value, error, certainty):
    monkeypatch.setattr(verdict, "reference", lambda case, h, floors: hypothesis((), 0.2).evidence)
    row = next(r for r in CATALOGUE if r.key == key)
    (slot,) = slots_of_row(row)
    found = fitted((row.name,), 0.3, {slot: value})
    search = searched(found, hypothesis(("drag",), 0.5))
    search.best = lambda: found
    (told,) = judged(search, found, [row], {slot: error}, [Form(row.name, row, {slot: value})])
    assert told.certainty == certainty


@pytest.mark.parametrize(("flexible", "certainty"), [(0.2, "none"), (0.28, "likely")])
def test_changed_coefficients_are_not_likely_if_a_black_box_model_fits_better(judged, monkeypatch, flexible, certainty):
    """They absorb a part of any effect that is missing; a clip beside the same model is likely."""
    monkeypatch.setattr(verdict, "reference", lambda case, h, floors: hypothesis((), flexible).evidence)
    moved = fitted((PARAMETERS,), 0.3, {"a0": 0.7}, labels=("parameter_change",))
    search = searched(moved, hypothesis(("drag",), 0.301), hypothesis(("a", "b", "c"), 0.1))
    search.best = lambda: moved
    monkeypatch.setattr(parts, "needed", lambda h, rival: 0.6)
    told = judged(search, moved, [], {})
    assert [(p.effect, p.certainty) for p in told] == [("parameter_change", certainty)]


def test_a_likely_part_comes_with_what_to_record(judged, monkeypatch):
    """The excitation under which it differs most from the best hypothesis without it, where that exceeds the noise."""
    monkeypatch.setattr(verdict, "reference", lambda case, h, floors: hypothesis((), 0.2).evidence)
    clip = fitted(("voltage_clip",), 0.3, {LIMIT: 1 / 850.0})
    for difference, expected in (
        (12.0, "sine of 3 Hz, 7 s (to separate it from drag)"),
        (0.5, "an excitation of another"),
    ):
        sine = Experiment(("voltage_clip", "drag"), "sine of 3 Hz", np.arange(8.0), np.zeros(8), difference)
        monkeypatch.setattr(parts, "separate", lambda case, scale, a, b, names, sine=sine: sine)
        search = searched(clip, hypothesis(("drag",), 0.5))
        search.best = lambda: clip
        search.budget = Budget()
        (found,) = judged(search, clip, [CLIP], {})
        assert str(found.recording).startswith(expected) and (found.experiment is sine) == (difference > 1)


@pytest.mark.usefixtures("no_flexible")
def test_an_interval_holds_the_spread_of_refits_and_of_hypotheses_as_good(judged):
    """Jackknife over three folds of log 1 / 850: sqrt(2 / 3 sum d^2) = sqrt(4 / 3) 0.1; a set as good has 1 / 600."""
    logs = [{LIMIT: np.exp(d) / 850.0} for d in (-0.1, 0.0, 0.1)]
    clip = fitted(("voltage_clip",), 0.3, {LIMIT: 1 / 850.0}, logs)
    (found,) = judged(searched(clip), clip, [CLIP], {})
    wide = np.exp(1.96 * np.sqrt(4 / 3) * 0.1)
    np.testing.assert_allclose(found.parameters["inverse"]["ci95"], [1 / 850 / wide, wide / 850], rtol=1e-5)
    other = fitted(("voltage_clip", "drag"), 0.301, {LIMIT: 1 / 600.0})
    search = searched(clip, other, hypothesis(("drag",), 0.9))
    search.best = lambda: clip
    (found,) = judged(search, clip, [CLIP], {})
    assert found.parameters["inverse"]["ci95"][1] == pytest.approx(1 / 600.0)


@pytest.mark.usefixtures("no_flexible")
def test_a_memory_longer_than_a_third_of_the_recording_has_a_lower_bound(judged):
    for tau, error, expected in ((2.9, 0.01, None), (3.1, 0.01, 3.0), (60.0, np.inf, 3.0)):
        creep = fitted(("viscoelastic",), 0.3, {KAPPA: 0.2, TAU: tau}, labels=("creep",))
        (found,) = judged(searched(creep), creep, [CREEP], {TAU: error})
        low, high = found.parameters["tau"]["ci95"]
        assert (high is None) == (expected is not None)
        assert low == pytest.approx(expected or tau * np.exp(-1.96e-2))


@pytest.mark.parametrize(("tau", "known"), [(2.9, True), (3.1, False)])
def test_a_time_whose_end_was_not_recorded_has_no_error(linear, tau, known):
    """Recordings of 9 s: 35.4 +- 0.4 s was printed for a memory of recordings of 21 s."""
    series = [SimpleNamespace(record=SimpleNamespace(time=np.array([0.0, 9.0])))]
    search: Any = searched()
    search.case, search.scale = SimpleNamespace(series=series), SCALE
    fit = fitted(("viscoelastic",), 0.3, {KAPPA: 0.2, TAU: tau}).fit
    effects = [(CREEP(0.2, tau), (KAPPA, TAU))]
    (found,) = result.added_of(search, nominal_of(linear), effects, fit, {KAPPA: 0.01, TAU: 0.01})
    assert found.parameters["kappa"]["stderr"] == pytest.approx(0.2 * 0.01)
    assert found.parameters["tau"]["stderr"] == (pytest.approx(tau * 0.01) if known else None)


@pytest.mark.usefixtures("no_flexible")
def test_a_number_without_information_has_no_interval(judged):
    clip = fitted(("voltage_clip",), 0.3, {LIMIT: 1 / 850.0})
    (found,) = judged(searched(clip), clip, [CLIP], {LIMIT: np.inf})
    assert found.parameters["inverse"]["ci95"] is None


def test_numbers_without_information_are_told_from_those_in_other_units():
    """Two units far apart are inverted; a number that changes nothing, and two that act as one, are not determined."""
    apart, known = result._inverse(np.diag([1e12, 1e-12]))
    np.testing.assert_allclose(apart, np.diag([1e-12, 1e12]))
    assert known.all()
    inverse, known = result._inverse(np.diag([4.0, 0.0]))
    assert inverse[0, 0] == pytest.approx(0.25) and list(known) == [True, False]
    both = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert list(result._inverse(both)[1]) == [False, False, True]


@pytest.fixture
def no_flexible(monkeypatch):
    monkeypatch.setattr(verdict, "reference", lambda case, h, floors: hypothesis((), 1.0).evidence)


@pytest.mark.parametrize(
    ("name", "number", "text"),
    [
        ("tau", (0.012345, "s", [0.01193, 0.01276]), ("tau", "12.3 ms (11.9 to 12.8)")),
        ("tau", (35.4, "s", [3.0, None]), ("tau", "at least 3.0 s")),
        ("inverse", (2e-4, "1/V", [1.9e-4, 2.1e-4]), ("limit", "5000 V (4760 to 5260)")),
        ("level", (0.3, "V^2", None), ("level", "0.30 V² (these recordings do not determine it)")),
        ("a_1 over given", (1.28, "1", [1.27, 1.29]), ("damping (a1)", "× 1.280 (1.270 to 1.290)")),
    ],
)
def test_numbers_are_printed_with_their_interval(name, number, text):
    value, unit, ci95 = number
    assert parameter(name, {"value": value, "unit": unit, "ci95": ci95}, "mm") == text


def test_the_result_comes_before_the_verdict_under_every_verdict(explained, unknown, no_gap):
    likely = part("drag", "quadratic", {"c": (4.2e7, "V^2 s^2/m^2", None)}, "likely", recording="a sine of 3 Hz")
    found: Any = replace(unknown, parts=Parts((likely,)), handed_back=("drag",))
    told = lines(found)
    assert told[0].startswith("The model handed back reduces the error on held-out recordings from 8.0 % to 7.9 %")
    assert "drag (quadratic)" in told[1] and "likely; to make it certain, record a sine of 3 Hz" in told[1]
    assert told[2] == "verdict: unknown. No effect in the catalogue improves the fit significantly."
    assert lines(unknown)[0].startswith("The nominal model is handed back: no model significantly reduces its error")
    assert lines(no_gap)[:2] == ["The nominal model is handed back: its error is 0.41 % of range (a band: 0.40 %).",
                                 "verdict: no_gap."]  # fmt: skip
    refitted: Any = replace(no_gap, gap=replace(no_gap.gap, noise_floor=None), handed_back=("parameters",))
    assert lines(refitted)[0] == (
        "The refitted nominal model is handed back: its error is 0.41 % of range (no model of the input predicts it)."
    )
    assert "electrode_rc (one lag): tau 12.3 ms (11.9 to 12.8); 90 % of the reduction, P 0.97; certain" in part_lines(
        explained
    )
    assert lines(explained)[-1].startswith("Next: predict and invert with model_augmented")
    shares = {0.0: "not certain", 0.06: "too small to be named as a cause", 0.5: "not certain"}
    unsure = replace(explained.parts[0], certainty="none")
    assert {share: certainty(replace(unsure, fraction=share)) for share in shares} == shares
    assert certainty(replace(unsure, effect="term")) == "describes the error, names no cause"  # at P 1.00
    assert len(repr(explained).splitlines()) <= 10 and "12.3 ms" in explained._repr_html_()


def test_a_gap_that_may_not_be_closed_at_all_is_explained_in_part():
    doubtful, certain = (Gap(8.0, 1.2, 8.0, 0.4, "", 0.86, (low, 0.9)) for low in (-0.003, 0.1))
    assert as_far_as_closed("explained", doubtful) == "partly" == as_far_as_closed("partly", certain)
    assert as_far_as_closed("explained", certain) == "explained"
    assert as_far_as_closed("unknown", doubtful) == "unknown"


def test_many_times_the_nominals_own_error_is_explained_in_part():
    """A leak in parallel to the film left 2.6 % at a floor of 0.2 %, under "explained"."""
    assert as_far_as_closed("explained", Gap(12.0, 2.6, 12.0, 0.2, "", 0.78, (0.7, 0.8))) == "partly"
    assert as_far_as_closed("explained", Gap(12.0, 2.6, 12.0, None, "", 0.78, (0.7, 0.8))) == "explained"


def test_parts_are_a_table(explained):
    pytest.importorskip("pandas")
    table = explained.parts.frame()
    assert list(table["effect"]) == ["electrode_rc"] and table["high"][0] == 0.01276
    (told,) = explained.as_json()["parts"]
    assert told["parameters"]["tau"] == {"value": 0.012345, "unit": "s", "ci95": [0.01193, 0.01276]}
    assert (told["certainty"], told["tied"]) == ("certain", [])

"""The package reproduces what commit 01c30c9 computed (`guard` says from what, and how an intended change edits it)."""

import guard
import numpy as np
import pytest

import pitp_jax as pitp
from pitp_jax.common.errors import BadInput

RUNS = guard.stored("runs")
QUICK = ("fading_memory", "spring_and_electrode")
NAMES = [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in RUNS]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return guard.unpack(tmp_path_factory.mktemp("guard"))


def test_every_stored_model_has_a_run():
    assert {*guard.names(), "ensemble_band"} - guard.refused() == set(RUNS)


def test_a_form_that_the_catalogue_no_longer_has_is_refused_by_name(folder):
    gone = guard.refused()
    assert {"creep_three_branches", "drag_power", "found_term", "all_forms"} <= gone
    for name in gone:
        with pytest.raises(BadInput, match=r"holds '.*', which this pitp_jax does not know"):
            pitp.load(folder / f"{name}.pitp")


@pytest.mark.parametrize("name", ["spring_and_electrode", "cone100_adapted", "paper_encoder"])
def test_a_stored_model_survives_being_saved_again(folder, name, tmp_path):
    model = pitp.load(folder / f"{name}.pitp")
    pitp.save(tmp_path / "again", model)
    assert repr(pitp.load(tmp_path / "again")) == repr(model)


@pytest.mark.parametrize("name", NAMES)
def test_stored_models_run_as_they_did(folder, name):
    x = guard.runs(folder)[name]()
    np.testing.assert_allclose(x, RUNS[name], rtol=0, atol=1e-6 * np.ptp(RUNS[name]))


# Training and inversion of the roll and coefficients of the other cones are compared already.
AGAIN = ("cone100",)
ACTUATORS = [pytest.param(n, marks=pytest.mark.exhaustive if n in AGAIN else pytest.mark.slow) for n in guard.SWEEPS]


@pytest.mark.parametrize("name", ACTUATORS)
def test_actuators_are_identified_trained_and_inverted_as_they_were(name):
    """Training ends where its last bits send it: a thousandth of range is far below what a changed method moves."""
    was, now = guard.stored("figures")[name], guard.figures_of(name)
    np.testing.assert_allclose(now["coefficients"], was["coefficients"], rtol=1e-4)
    for series in was.keys() - {"coefficients"}:
        np.testing.assert_allclose(now[series], was[series], rtol=0, atol=1e-3 * np.ptp(was[series]), err_msg=series)


NOISY = ("gap after", "gap noise_floor")
# `test_diagnose` plants the same, against the whole catalogue.
PLANTED = ("nothing", "hum", "spring", "electrode", "clip", "friction", "spring and electrode")
CASES = [pytest.param(c, marks=pytest.mark.exhaustive if c in PLANTED else pytest.mark.slow) for c in guard.DIAGNOSED]


@pytest.mark.parametrize("case", CASES)
def test_diagnoses_say_what_they_said(folder, case):
    was, now = guard.stored("verdicts")[case], guard.verdict(folder, case)
    for key in ("verdict", "effects", "equivalent"):
        assert now[key] == was[key], key
    assert now["numbers"].keys() == was["numbers"].keys()
    for key, number in was["numbers"].items():
        expected = None if number is None else pytest.approx(number, rel=0.05 if key in NOISY else 0.01, abs=1e-6)
        assert now["numbers"][key] == expected, key

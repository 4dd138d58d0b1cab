"""`pitp diagnose ROBOT --against SIM` around the diagnosis itself: what is read, written, printed and refused."""

import json

import diagnosis_cases
import numpy as np
import pytest
from cli_cases import columns_of, refused, tree

import pitp_jax as pitp
from pitp_jax.application.against import entry
from pitp_jax.application.demo import joint


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("joint")
    joint.write(folder, quick=True)
    return folder


@pytest.mark.slow
def test_pages_figures_and_numbers_are_written(demo, call, tmp_path, monkeypatch):
    """The robot's file unit in the corrections, the clock's offset on standard output, one entry a parameter."""
    monkeypatch.setattr(entry, "identify", lambda r, **_: pitp.identify(r, order=2, input_map="linear"))
    monkeypatch.setattr(entry, "diagnose_model", lambda model, records, **_: diagnosis_cases.explained(model))
    argv = ["diagnose", demo / "robot", "--against", demo / "sim", "--position-gain", "20"]
    code, text, err = call(*argv, "--out", tmp_path / "d", "--json", tmp_path / "j")
    assert code == 0, err
    assert "identifying the simulator; the searches that follow have no limit of time" in err
    told = json.loads((tmp_path / "j").read_text())
    assert {p["name"] for p in told["parameters"]} >= {"gain", "damping", "inertia"}
    assert all(p["clock_offset_s"] == pytest.approx(0.7, abs=3e-3) for p in told["pairs"])
    assert set(told["budget"]["simulator"]) == {"share", "ci95"}
    assert "The clock of the robot is 0.7 s ahead" in text and "joint damping" in text
    written = set(tree(tmp_path / "d"))
    assert {"report.html", "robot.html", "diagnosis.json", "model_augmented"} <= written
    assert {f"figures/correction_{name}.csv" for name in joint.commands(1.0)} <= written
    header, values = columns_of(tmp_path / "d" / "figures" / "correction_sine_1Hz.csv")
    assert header == ["time_s", "added_input_deg"] and np.isfinite(values).all()


def test_options_of_the_other_kind_are_refused(demo, call):
    argv = ["diagnose", demo / "robot"]
    assert "--refit-nominal only works with --nominal" in refused(
        call(*argv, "--against", demo / "sim", "--refit-nominal")
    )
    assert "--position-gain only works with --against" in refused(
        call(*argv, "--nominal", demo / "x", "--position-gain", "2")
    )
    assert "--nominal" in refused(call(*argv))

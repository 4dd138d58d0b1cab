"""`pitp identify` and `pitp info`: results, units, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cli_cases import COEFFICIENTS, TIME, motion, refused, tree, truth, write_record

from pitp_jax.files.model_file import model_file
from pitp_jax.method.model.domain import Domain


def test_identify_writes_and_reports(call, bench, tmp_path, quick_identify):
    out = tmp_path / "nominal"
    code, text, _ = call("identify", bench / "records", "--out", out, "--order", "2", "--json", tmp_path / "j")
    assert code == 0
    assert quick_identify[0][0] == ["sine2", "sine4", "sweep"]
    assert quick_identify[0][1]["order"] == 2
    assert "2 *" in text
    assert "V^2 s^2/m" in text
    assert "mode at 5 Hz, damping 0.15" in text
    np.testing.assert_allclose(model_file.load(out).physical_coefficients, COEFFICIENTS, rtol=1e-2)
    assert json.loads((tmp_path / "j").read_text())["order"] == 2


def test_identify_validates_and_draws(call, bench, tmp_path):
    """Other records are only run; the page and the scores are there, and a delay left out stays out."""
    records = bench / "records"
    options = ["--order", "2", "--no-delay", "--validate", records / "sine2.csv", "--report", tmp_path / "page"]
    code, text, _ = call("identify", records / "sweep.csv", "--out", tmp_path / "m", *options, "--json", tmp_path / "j")
    told = json.loads((tmp_path / "j").read_text())
    assert code == 0 and "validated on" in text
    assert told["validation"]["sine2"]["nrmse_percent"] < 1
    assert all(order["delay"] == 0 for order in told["orders"])
    page = next((tmp_path / "page").glob("*.html")).read_text()
    assert (
        "Order 2 was asked for." in page and "on 1 recording<" in page and page.count("<svg") == 2
    )  # response with its coherence; residual
    assert "The residual is" in page
    refused(call("identify", records, "--out", tmp_path / "n", "--no-delay", "--learn", "delay"))


def test_info(call, tmp_path, identified):
    model_file.save(tmp_path / "m", identified.model)
    code, text, err = call("info", tmp_path / "m", "--json", tmp_path / "j")
    told = json.loads((tmp_path / "j").read_text())
    assert (code, err) == (0, "")
    assert told["coefficients_unit"] == ["V^2/m", "V^2 s/m", "V^2 s^2/m"]
    assert all(e > 0 for e in told["coefficients_stderr"])
    assert told["modes"][0]["natural_hz"] == pytest.approx(5, rel=1e-2)
    assert "identified on 1 recording (sweep)" in text
    assert "input linear between samples (hold foh)" in text


def test_info_of_a_trained_model(call, tmp_path):
    training = {
        "records": ["a", "b"], "samples": 9, "seconds": 1.5, "interrupted": True,
        "history": [{"stage": 1, "box": [0.6, 1.5], "physics": 0.1}, {"stage": "free runs", "step": 1, "error": 2.0}],
    }  # fmt: skip
    model_file.save(tmp_path / "m", truth(training=training))
    code, text, _ = call("info", tmp_path / "m")
    assert code == 0
    assert "trained on 2 recordings (a, b) (9 samples) in 1.5 s, interrupted" in text
    assert "stage 1: box 0.6 to 1.5, physics 0.1" in text


@pytest.mark.parametrize("what", ["the nominal itself", "a model between it and the nominal"])
def test_info_says_first_that_training_failed(call, tmp_path, what):
    model_file.save(tmp_path / "m", truth(training={"fallback": what}))
    code, text, _ = call("info", tmp_path / "m", "--json", tmp_path / "j")
    line = text.splitlines()[1]
    assert (
        code == 0
        and line.startswith("Training failed")
        and line == json.loads((tmp_path / "j").read_text())["fallback"]
    )
    assert ("between" in line) == ("between" in what)


def test_info_of_an_unbounded_model_has_no_infinity(call, tmp_path):
    model_file.save(tmp_path / "m", replace(truth(), domain=Domain(1.0)))
    assert call("info", tmp_path / "m", "--json", tmp_path / "j")[0] == 0
    assert json.loads((tmp_path / "j").read_text(), parse_constant=pytest.fail)["max_slew"] is None


@pytest.mark.parametrize("command", ["info", "predict", "invert"])
def test_a_model_that_is_none(call, bench, tmp_path, command):
    rest = {
        "info": [],
        "predict": [bench / "records"],
        "invert": [bench / "target.csv", "--out", tmp_path / "v"],
    }
    for path in (tmp_path / "absent", bench, bench / "target.csv"):
        assert str(path) in refused(call(command, path, *rest[command]))
    assert tree(tmp_path) == []


def test_bad_records_are_refused(call, bench, tmp_path):
    (tmp_path / "empty").mkdir()
    voltage, x = motion("sine2")
    write_record(tmp_path / "short.csv", voltage[:10], x[:10], time=TIME[:10])
    write_record(tmp_path / "other.csv", voltage, x, time=TIME * 2)
    before = tree(tmp_path)
    for records in (
        ["absent"],
        [tmp_path / "empty"],
        [tmp_path / "short.csv"],
        [tmp_path, bench / "records"],
    ):
        refused(call("identify", *records, "--out", tmp_path / "m"))
        refused(call("fit", *records, "--out", tmp_path / "m"))
        refused(call("predict", bench / "nominal", *records, "--json", tmp_path / "j", "--out", tmp_path / "d"))
    assert tree(tmp_path) == before


def test_columns_can_be_chosen(call, bench, tmp_path, quick_identify):
    voltage, x = motion("sine2")
    path = write_record(tmp_path / "r.csv", voltage, x, units=("V", "m"))
    path.write_text(path.read_text().replace("voltage_V", "command_V").replace("displacement_m", "laser_um"))
    choice = ["--input-column", "command_V", "--output-column", "laser_um"]
    assert "missing" in refused(call("identify", path, "--out", tmp_path / "m", "--input-column", "other_V"))
    assert call("identify", path, "--out", tmp_path / "m", *choice)[0] == 0
    assert call("predict", tmp_path / "m", path, "--out", tmp_path / "d", *choice)[0] == 0
    header = (tmp_path / "d" / "r.csv").read_text().splitlines()[0]
    assert header == "time_s,voltage_V,displacement_um,predicted_um"


def test_interrupted_identify_writes_nothing(call, bench, tmp_path, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("pitp_jax.application.commands.identify.run_identify", stop)
    assert call("identify", bench / "records", "--out", tmp_path / "m")[0] == 130
    assert tree(tmp_path) == []


def test_validation_with_another_kind_of_input_is_refused(call, bench, tmp_path):
    percent = write_record(tmp_path / "percent.csv", *motion("sine2"))
    percent.write_text(percent.read_text().replace("voltage_V", "input_percent"))
    out = tmp_path / "n.pitp"
    assert "input in percent" in refused(call("identify", bench / "records", "--validate", percent, "--out", out))
    assert not out.exists()

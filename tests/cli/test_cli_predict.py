"""`pitp predict`: scores and records in their own units, and records that diverge."""

import json
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from cli_cases import DRIVES, SCORE_KEYS, TIME, columns_of, motion, refused, tree, write_record

from pitp_jax.application.commands.predict import median_e_rms

command = import_module("pitp_jax.application.commands.predict")


def test_predict_writes_scores_and_records_in_their_own_units(call, bench, tmp_path):
    out, file = tmp_path / "new" / "folder", tmp_path / "scores.json"
    code, text, err = call("predict", bench / "nominal", bench / "records", "--out", out, "--json", file)
    assert code == 0 and err.startswith("pitp: read 3 recordings") and err.count("\n") == 1
    result = json.loads(file.read_text())
    assert list(result) == ["written_by", "records", "median_e_rms_percent"]
    assert set(result["records"]) == set(DRIVES)
    for name, row in result["records"].items():
        assert set(row) == SCORE_KEYS
        assert row["rmse_unit"] == "mm"
        assert row["rmse"] == pytest.approx(1e-3, rel=0.2)  # the noise: 1 um
        assert (row["samples"], row["missing"], row["diverged"]) == (2000, 0, False)
        header, values = columns_of(out / f"{name}.csv")
        assert header == ["time_s", "voltage_kV", "displacement_mm", "predicted_mm"]
        voltage, x = motion(name)
        np.testing.assert_allclose(values[:, 0], TIME, atol=1e-9)
        np.testing.assert_allclose(values[:, 1], voltage / 1e3, atol=1e-8)
        np.testing.assert_allclose(values[:, 2], x * 1e3, atol=1e-7)
        assert np.sqrt(np.mean((values[:, 3] - values[:, 2]) ** 2)) == pytest.approx(row["rmse"], rel=1e-4)
    assert result["median_e_rms_percent"] == np.median([row["e_rms_percent"] for row in result["records"].values()])
    assert "median e_rms" in text
    assert tree(tmp_path) == sorted(
        ["new", "new/folder", "new/folder/index.html", "new/folder/report.html", "scores.json",
         *(f"new/folder/{name}.csv" for name in DRIVES)]
    )  # fmt: skip


def test_predict_counts_missing_samples_and_names_moving_records(call, bench, tmp_path):
    voltage, x = motion("sine4")
    gaps = x.copy()
    gaps[700:720] = np.nan
    moving = write_record(tmp_path / "moving.csv", voltage[315:], gaps[315:], time=TIME[315:])
    assert call("predict", bench / "nominal", moving, "--json", tmp_path / "j", "--out", tmp_path / "d")[0] == 0
    code, text, _ = call("predict", bench / "nominal", moving, "--json", tmp_path / "j")
    assert code == 0
    assert (
        "moving: starts moving; its initial state was estimated from the first 150 samples" in text
    )  # 1.5 periods of 5 Hz
    row = json.loads((tmp_path / "j").read_text())["records"]["moving"]
    assert (row["samples"], row["missing"], row["initial_samples"]) == (1685, 20, 150)
    assert row["e_rms_percent"] < 2
    _, values = columns_of(tmp_path / "d" / "moving.csv")
    assert np.isnan(values[:, 2]).sum() == 20
    assert np.isfinite(values[:, 3]).all()


@pytest.mark.slow
def test_predict_gives_names_that_collide_their_folders(call, bench, tmp_path):
    for folder in ("clean", "worn"):
        (tmp_path / folder).mkdir()
        write_record(tmp_path / folder / "sine2.csv", *motion("sine2"))
    out = tmp_path / "out"
    assert call("predict", bench / "nominal", tmp_path / "clean", tmp_path / "worn", "--out", out)[0] == 0
    assert tree(out) == ["clean", "clean/sine2.csv", "index.html", "report.html", "worn", "worn/sine2.csv"]


@pytest.fixture
def diverging(monkeypatch):
    """`predict` in which the named records leave every range half way."""
    real, names = command.run_predict, set()

    def fake(model, records):
        lost = []
        for p in real(model, records):
            x = np.where(np.arange(len(p.displacement)) < 1000, p.displacement, np.nan)
            lost.append(replace(p, displacement=x, diverged=True) if p.name in names else p)
        return tuple(lost)

    monkeypatch.setattr(command, "run_predict", fake)
    return names


@pytest.mark.slow
@pytest.mark.parametrize(("lost", "median"), [(["sine2"], True), (["sine2", "sine4"], False)])
def test_predict_with_diverged_records(call, bench, tmp_path, diverging, lost, median):
    diverging.update(lost)
    argv = [
        "predict",
        bench / "nominal",
        bench / "records",
        "--json",
        tmp_path / "j",
        "--out",
        tmp_path / "d",
    ]
    code, text, _ = call(*argv)
    assert code == 0
    assert text.count("diverged") == len(lost)
    result = json.loads((tmp_path / "j").read_text(), parse_constant=pytest.fail)
    row = result["records"]["sine2"]
    assert [row[k] for k in ("e_rms_percent", "nrmse_percent", "rmse", "diverged")] == [
        None,
        None,
        None,
        True,
    ]
    assert (result["median_e_rms_percent"] is not None) == median
    assert np.isnan(columns_of(tmp_path / "d" / "sine2.csv")[1][:, 3]).sum() == 1000


def test_a_record_without_a_figure_says_why(call, bench, monkeypatch):
    """Dashes alone, and a reader looks for the mistake in the model."""
    real = command.run_predict

    def fake(model, records):
        return tuple(replace(p, scored=p.scored & (p.name != "sine2")) for p in real(model, records))

    monkeypatch.setattr(command, "run_predict", fake)
    code, text, _ = call("predict", bench / "nominal", bench / "records")
    assert code == 0
    (line,) = [line for line in text.splitlines() if "no motion to score" in line]
    assert line.startswith("sine2 ")


def test_an_uncertain_start_is_printed(call, bench, monkeypatch):
    real = command.run_predict

    def fake(model, records):
        return tuple(replace(p, start_certainty=0.6 if p.name == "sine2" else 1.0) for p in real(model, records))

    monkeypatch.setattr(command, "run_predict", fake)
    assert "in motion): 1 recording (sine2)." in call("predict", bench / "nominal", bench / "records")[1]
    monkeypatch.setattr(command, "run_predict", real)
    assert "uncertain" not in call("predict", bench / "nominal", bench / "records")[1]


def test_predict_fails_only_where_all_diverge(call, bench, tmp_path, diverging):
    diverging.update(DRIVES)
    code, _, err = call("predict", bench / "nominal", bench / "records", "--json", tmp_path / "j")
    assert code == 3
    assert [line.split()[1] for line in err.splitlines()] == ["read", "error:"]
    assert json.loads((tmp_path / "j").read_text())["median_e_rms_percent"] is None


def test_median_counts_diverged_as_infinite():
    def row(value, diverged=False):
        return {"e_rms_percent": value, "diverged": diverged}

    assert median_e_rms([row(1.0), row(3.0)]) == 2.0
    assert median_e_rms([row(1.0), row(None, diverged=True)]) is None
    assert median_e_rms([row(1.0), row(2.0), row(None, diverged=True)]) == 2.0
    assert median_e_rms([row(None), row(4.0)]) == 4.0  # a record that never moves has no range to divide by
    assert median_e_rms([row(None)]) is None


@pytest.mark.parametrize("command", ["predict", "simulate", "adapt"])
def test_another_kind_of_input_is_refused(call, bench, tmp_path, command):
    """Percent of a valve were taken for volts, and the model explained nothing."""
    percent = write_record(tmp_path / "percent.csv", *motion("sine2"))
    percent.write_text(percent.read_text().replace("voltage_V", "input_percent"))
    out = ("--out", tmp_path / "today.pitp") if command == "adapt" else ()
    assert "input in percent, but" in refused(call(command, bench / "nominal", percent, *out))


def test_predict_refuses_another_kind_of_output_and_warns_of_another_rate(call, bench, tmp_path):
    voltage, x = motion("sine2")
    volts = write_record(tmp_path / "volts.csv", voltage, x)
    volts.write_text(volts.read_text().replace("displacement_m", "displacement_V"))
    assert "predicts m" in refused(call("predict", bench / "nominal", volts))
    slow = write_record(tmp_path / "slow.csv", voltage[::2], x[::2], time=TIME[::2])
    code, _, err = call("predict", bench / "nominal", slow)
    assert code == 0
    assert [line for line in err.splitlines() if line.startswith("pitp: warning: ")]

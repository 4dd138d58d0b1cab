"""`pitp invert`: the voltage and its counts, and targets that are refused."""

import json

import pytest
from cli_cases import columns_of, refused, tree


def test_invert_writes_the_voltage_and_counts(call, bench, tmp_path, quick_inverse):
    out, file = tmp_path / "v.csv", tmp_path / "j"
    limits = ["--max-voltage", "1500", "--max-slew", "2e4"]
    code, text, err = call("invert", bench / "nominal", bench / "target.csv", "--out", out, "--json", file, *limits)
    assert code == 0
    assert err == "pitp: warning: 25 % of the target lies outside the trained region\n"
    assert quick_inverse[0][1:] == (1500.0, 2e4)
    assert quick_inverse[0][0].displacement.max() == pytest.approx(1.5e-3, rel=1e-2)
    header, values = columns_of(out)
    assert header == ["time_s", "voltage_V", "infeasible", "saturated"]
    assert values.shape == (2200, 4)
    assert json.loads(file.read_text(), parse_constant=pytest.fail) == {
        "samples": 2200, "infeasible": 7, "saturated": 3, "outside_training_share": 0.25,
        "self_check_e_rms_percent": None,
    }  # fmt: skip
    assert "infeasible 7, saturated 3" in text


def test_invert_refuses_bad_targets_and_names(call, bench, tmp_path, quick_inverse):
    target = bench / "target.csv"
    start = ["invert", bench / "nominal"]
    refused(call(*start, bench / "records", "--out", tmp_path / "v.csv"))
    refused(call(*start, tmp_path / "absent.csv", "--out", tmp_path / "v.csv"))
    refused(call(*start, target, "--out", target))
    refused(call(*start, target, "--out", tmp_path / "v.csv", "--output-column", "laser_mm"))
    volts = tmp_path / "volts.csv"
    volts.write_text(target.read_text().replace("displacement_mm", "displacement_V"))
    assert "predicts m" in refused(call(*start, volts, "--out", tmp_path / "v.csv"))
    assert tree(tmp_path) == ["volts.csv"]
    assert quick_inverse == []


def test_invert_takes_another_column(call, bench, tmp_path, quick_inverse):
    path = tmp_path / "t.csv"
    path.write_text((bench / "target.csv").read_text().replace("displacement_mm", "wanted_um"))
    argv = ["invert", bench / "nominal", path, "--out", tmp_path / "v.csv", "--output-column", "wanted_um"]
    assert call(*argv)[0] == 0
    assert quick_inverse[0][0].displacement.max() == pytest.approx(1.5e-6, rel=1e-2)

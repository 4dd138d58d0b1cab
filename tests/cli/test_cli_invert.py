"""`pitp invert`: the voltage and its counts, and targets that are refused."""

import json

import numpy as np
import pytest
from cli_cases import columns_of, refused, tree

import pitp_jax


def test_invert_writes_the_voltage_and_counts(call, bench, tmp_path, quick_inverse):
    out, file = tmp_path / "v.csv", tmp_path / "j"
    limits = ["--max-voltage", "1500", "--max-slew", "2e4"]
    code, text, err = call("invert", bench / "nominal", bench / "target.csv", "--out", out, "--json", file, *limits)
    assert code == 0
    assert err == "pitp: warning: 25 % of the target lies outside the trained region\n"
    assert quick_inverse[0][1:] == (
        1500.0,
        2e4,
        {"max_displacement": None, "zero": "rest", "start_input": 0.0, "resample": True},
    )
    assert quick_inverse[0][0].displacement.max() == pytest.approx(1.5e-3, rel=1e-2)
    header, values = columns_of(out)
    assert header == ["time_s", "voltage_V", "target_mm", "infeasible", "saturated"]
    assert values.shape == (2200, 5)
    np.testing.assert_array_equal(np.isfinite(values[:, 2]), (np.arange(2200) >= 100) & (np.arange(2200) < 2100))
    assert values[100, 2] == 1.0
    assert json.loads(file.read_text(), parse_constant=pytest.fail) == {
        "written_by": f"pitp_jax {pitp_jax.__version__}",
        "samples": 2200, "infeasible": 7, "saturated": 3, "outside_training_share": 0.25,
        "self_check_e_rms_percent": None, "target_start_s": pytest.approx(0.2), "target_end_s": pytest.approx(4.198),
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


def test_invert_writes_what_a_daq_plays(call, bench, tmp_path, quick_inverse):
    """Its clock starts at 0; kilovolts over the amplifier's gain, at its rate."""
    plain, played = tmp_path / "v.csv", tmp_path / "daq.csv"
    start = ["invert", bench / "nominal", bench / "target.csv", "--out"]
    assert call(*start, plain)[0] == 0
    code, text, _ = call(*start, played, "--unit", "kV", "--input-scale", "0.5", "--rate", "1000")
    assert code == 0
    assert "in this file the target starts at 0.2 s, which is 0 s in the target's file" in text
    (_, volts), (header, values) = columns_of(plain), columns_of(played)
    assert header == ["time_s", "voltage_kV", "target_mm", "infeasible", "saturated"]
    assert volts[0, 0] == values[0, 0] == 0
    assert values[:, 0] == pytest.approx(1e-3 * np.arange(len(values)), abs=1e-6)
    assert values[::2, 1] == pytest.approx(volts[:, 1] / 500, rel=1e-6)
    assert len(values) == 2 * len(volts) - 1


def test_invert_takes_another_zero_and_another_start(call, bench, tmp_path, quick_inverse):
    """A zero in the target's own unit."""
    start = ["invert", bench / "nominal", bench / "target.csv", "--out", tmp_path / "v.csv"]
    assert call(*start, "--zero", "2.5", "--start-input", "30")[0] == 0
    assert quick_inverse[0][3] == {
        "max_displacement": None,
        "zero": pytest.approx(2.5e-3),
        "start_input": 30.0,
        "resample": True,
    }
    assert "is not rest, sensor or a number" in refused(call(*start, "--zero", "here"))


@pytest.mark.parametrize("option", ["--rate", "--input-scale", "--max-displacement", "--unit"])
def test_invert_refuses_options_without_sense(call, bench, tmp_path, quick_inverse, option):
    refused(call("invert", bench / "nominal", bench / "target.csv", "--out", tmp_path / "v.csv", option, "-1"))
    assert tree(tmp_path) == []

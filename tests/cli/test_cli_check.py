"""`pitp check` and `pitp simulate`: what they write, in which units, and what they refuse."""

import json
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from cli_cases import COEFFICIENTS, DRIVES, TIME, columns_of, motion, refused, tree, truth, write_record
from scipy.signal import lsim

from pitp_jax.files.model_file import model_file
from pitp_jax.method.model.fitted import Fitted
from pitp_jax.method.model.model import Output

command = import_module("pitp_jax.application.commands.simulate")


KEYS = {
    "samples", "rate_hz", "recognised", "begins", "zero", "direction", "noise", "missing", "outliers", "jitter",
    "excitation", "band_hz", "problems",
}  # fmt: skip


def strict(path):
    def never(token):
        raise AssertionError(token)

    return json.loads(path.read_text(), parse_constant=never)


def test_check_writes_records_as_understood_a_page_and_json(call, bench, tmp_path):
    out, file = tmp_path / "out", tmp_path / "check.json"
    broken = tmp_path / "broken.csv"
    broken.write_text("time_s,voltage_V\n0,1\n")
    code, text, err = call("check", bench / "records", broken, "--out", out, "--json", file)
    assert code == 0, err
    told = strict(file)
    assert list(told) == ["written_by", "records", "advice"] and set(told["records"]) == {*DRIVES, "broken"}
    for name in DRIVES:
        row = told["records"][name]
        assert set(row) >= KEYS
        assert (row["samples"], row["begins"], row["direction"], row["problems"]) == (2000, "rest", 1, [])
        assert row["zero"]["unit"] == "mm" and abs(row["zero"]["value"]) < 0.01
        assert row["noise"] == pytest.approx(1e-3, rel=0.2)  # 1 um in mm
        header, values = columns_of(out / f"{name}.csv")
        assert header == ["time_s", "voltage_V", "displacement_m"]
        np.testing.assert_allclose(values[:, 1], motion(name)[0], atol=1e-5)
    assert "displacement" in told["records"]["broken"]["problems"][0] and "broken" in err
    assert tree(out) == sorted(["check.html", "index.html", "source.toml", *(f"{name}.csv" for name in DRIVES)])
    page = (out / "check.html").read_text()
    assert page.count("<svg") == 1 + len(DRIVES) and "http" not in page and "sweep" in text


def test_check_refuses_where_nothing_can_be_read(call, tmp_path):
    (tmp_path / "bad.csv").write_text("a,b\n1,2\n")
    assert "bad.csv" in refused(call("check", tmp_path / "bad.csv", "--out", tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def drive_file(path, voltage, unit="V", extra=""):
    scale = {"V": 1.0, "kV": 1e-3}[unit]
    rows = [f"{t:.6f},{scale * v:.9g}" + (",0" if extra else "") for t, v in zip(TIME, voltage, strict=True)]
    path.write_text("\n".join([f"time_s,voltage_{unit}{extra}", *rows]) + "\n")
    return path


def test_simulate_writes_the_rollout_in_the_rigs_units(call, bench, tmp_path):
    voltage, _ = motion("sweep")
    plain = drive_file(tmp_path / "plain.csv", voltage, "kV")
    measured = drive_file(tmp_path / "measured.csv", voltage, "V", ",displacement_mm")
    held = drive_file(tmp_path / "held.csv", 0 * voltage + 1000)
    out, file = tmp_path / "out", tmp_path / "j"
    code, text, err = call("simulate", bench / "nominal", plain, measured, held, "--out", out, "--json", file)
    assert code == 0, err
    assert "'displacement_mm' is a measurement and was ignored" in err and "held: starts at 1000 V" in err
    right = 1e3 * lsim(([1.0], COEFFICIENTS[::-1]), voltage**2, TIME)[1]
    for name, unit in (("plain", "kV"), ("measured", "V")):
        header, values = columns_of(out / f"{name}.csv")
        assert header == ["time_s", f"voltage_{unit}", "displacement_mm"]
        np.testing.assert_allclose(values[:, 2], right, atol=2e-2)
    np.testing.assert_allclose(columns_of(out / "held.csv")[1][:, 2], 1.0, rtol=1e-3)
    rows = strict(file)["records"]
    assert rows["held"]["begins"] == "held" and rows["plain"]["highest"] == pytest.approx(right.max(), rel=0.01)
    assert "highest (mm)" in text


@pytest.mark.parametrize(
    ("zero", "at_rest", "sign"), [((), 0.0, 1), (("--zero", "sensor"), 18.4, -1), (("--zero", "2.5"), 2.5, 1)]
)
def test_simulate_gives_the_displacement_from_the_position_at_zero_volts(call, bench, tmp_path, zero, at_rest, sign):
    """A reversed sensor that reads 18.4 mm at 0 V: its readings are printed with `--zero sensor` alone."""
    known = truth()
    reversed_ = replace(known.model, output=Output(offset=18.4e-3, polarity=-1.0))
    model_file.save(tmp_path / "model", Fitted(reversed_, known.origin))
    held = drive_file(tmp_path / "held.csv", np.full(len(TIME), 1000.0))
    assert call("simulate", tmp_path / "model", held, "--out", tmp_path / "out", *zero)[0] == 0
    np.testing.assert_allclose(columns_of(tmp_path / "out" / "held.csv")[1][:, 2], at_rest + sign * 1.0, rtol=1e-3)


def test_simulate_at_another_rate(call, bench, tmp_path):
    time = TIME[::4]
    voltage = 500 * (1 - np.cos(2 * np.pi * 2 * time))
    path = tmp_path / "slow.csv"
    path.write_text("time_s,voltage_V\n" + "".join(f"{t:.6f},{v:.9g}\n" for t, v in zip(time, voltage, strict=True)))
    code, _, err = call("simulate", bench / "nominal", path, "--out", tmp_path / "out")
    assert code == 0 and "sampled every 0.008 s" in err
    fine = 500 * (1 - np.cos(2 * np.pi * 2 * TIME))
    right = 1e3 * lsim(([1.0], COEFFICIENTS[::-1]), fine**2, TIME)[1][::4]
    np.testing.assert_allclose(columns_of(tmp_path / "out" / "slow.csv")[1][:, 2], right, atol=2e-2)


def test_simulate_says_how_far_it_leaves_the_range(call, bench, tmp_path):
    low, high = model_file.load(bench / "nominal").domain.voltage_range
    drive_file(tmp_path / "wide.csv", np.linspace(low, high + 0.5 * (high - low), len(TIME)))
    code, _, err = call("simulate", bench / "nominal", tmp_path / "wide.csv", "--out", tmp_path / "out")
    assert code == 0 and "extrapolates by 50 % of that range's width" in err


def test_simulate_fails_only_where_all_diverge(call, bench, tmp_path, monkeypatch):
    voltage, _ = motion("sine2")
    one, two = (drive_file(tmp_path / f"{name}.csv", voltage) for name in ("one", "two"))
    real, lost = command.rollout, {"count": 0}

    def fake(*args, **options):
        lost["count"] += 1
        x = real(*args, **options)
        x[1000:] = np.nan
        return x if lost["count"] <= lost["most"] else real(*args, **options)

    monkeypatch.setattr(command, "rollout", fake)
    lost["most"] = 1
    code, text, _ = call("simulate", bench / "nominal", one, two, "--out", tmp_path / "out")
    assert code == 0 and text.count("diverged") == 1
    assert np.isnan(columns_of(tmp_path / "out" / "one.csv")[1][:, 2]).sum() == 1000
    lost.update(count=0, most=2)
    code, _, err = call("simulate", bench / "nominal", one, two, "--json", tmp_path / "j")
    assert code == 3 and "diverged under every input" in err
    assert all(row["diverged"] for row in strict(tmp_path / "j")["records"].values())


def test_simulate_needs_a_voltage(call, bench, tmp_path):
    path = tmp_path / "none.csv"
    path.write_text("time_s,weg_mm\n" + "".join(f"{t},1\n" for t in TIME))
    assert "voltage" in refused(call("simulate", bench / "nominal", path))


def test_predict_prints_zeros_and_directions_that_differ(call, bench, tmp_path):
    for name, change in (("sine2", lambda x: x + 3e-4), ("sine4", lambda x: -x), ("sweep", lambda x: x)):
        voltage, x = motion(name)
        write_record(tmp_path / f"{name}.csv", voltage, change(x), units=("V", "mm"))
    code, text, _ = call("predict", bench / "nominal", tmp_path)
    assert code == 0
    assert "reversed sensor (its reading decreases as the actuator extends): 1 recording (sine4)" in text
    rows = text.split("sensor offset of each recording:")[1]
    zero = next(line.split()[1] for line in rows.splitlines() if line.startswith("sine2"))
    assert float(zero) == pytest.approx(0.3, abs=2e-3)
    assert "sensor offset" not in call("predict", bench / "nominal", bench / "records")[1]

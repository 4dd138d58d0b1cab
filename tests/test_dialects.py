"""Text as laboratories and their programs write it: any dialect written is read back."""

import csv
import gzip
import io
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from effort import calls
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from record_files import OUTPUT, SAVERS, TIME, VOLTAGE, T, columns, refused

from pitp_jax import read

HEADERS = [
    ("time_s", "voltage_V", "displacement_mm"),
    ("Time (s)", "Voltage (V)", "Displacement (mm)"),
    ("Zeit [s]", "Spannung [V]", "Weg [mm]"),
    ("t / s", "U / V", "x / mm"),
]


@st.composite
def dialects(draw):
    """Bytes of the record of `record_files` in some dialect, and the suffix they belong to."""
    separator = draw(st.sampled_from([",", ";", "\t", "|", " "]))
    decimal = draw(st.sampled_from([".", ","] if separator != "," else ["."]))
    units = draw(st.sampled_from(["header", "row", "comment"]))
    names = draw(st.sampled_from(HEADERS if separator != " " else HEADERS[:1]))
    order = draw(st.permutations(range(3)))
    missing = draw(st.booleans()) and separator != " "
    quoting = csv.QUOTE_ALL if draw(st.booleans()) and separator != " " else csv.QUOTE_MINIMAL
    cells = [[f"{v:.6g}".replace(".", decimal) for v in values] for values in (TIME, VOLTAGE, OUTPUT)]
    if missing:
        cells[2][40:50] = [draw(st.sampled_from(["", "nan", "NaN"]))] * 10
    if units != "header":
        names = ("t", "u", "x")
    out = io.StringIO()
    writer = csv.writer(out, delimiter=separator, quoting=quoting, lineterminator="\n")
    mark = draw(st.sampled_from(["#", "%"]))
    for k in range(draw(st.integers(0, 3))):
        out.write(f"{mark} rig {k}, membrane 12\n")
    if units == "comment":
        out.write(f"{mark} t in s, u in V, x in mm\n")
    if draw(st.booleans()):
        out.write(mark + " ") if units == "header" else None
    writer.writerow([names[k] for k in order])
    if units == "row":
        writer.writerow([("s", "V", "mm")[k] for k in order])
    for row in zip(*[cells[k] for k in order], strict=True):
        writer.writerow(row)
    body = out.getvalue()
    if draw(st.booleans()) and separator != " ":
        body = (
            "\n".join(line + separator if not line.startswith(mark) else line for line in body.split("\n")[:-1]) + "\n"
        )
    if draw(st.booleans()):
        body += draw(st.sampled_from(["\n\n", "\n" + separator * 2 + "\n", f"{mark} end\n"]))
    body = body.replace("\n", draw(st.sampled_from(["\n", "\r\n", "\r"])))
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "latin-1"]))
    data = body.encode(encoding)
    zipped = draw(st.booleans())
    suffix = draw(st.sampled_from([".csv", ".txt", ".dat", ".tsv"])) + (".gz" if zipped else "")
    return (gzip.compress(data) if zipped else data), suffix, missing


@pytest.mark.slow
@given(dialect=dialects())
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_dialect_is_read_back(tmp_path, dialect):
    data, suffix, missing = dialect
    path = tmp_path / f"a{suffix}"
    path.write_bytes(data)
    (record,) = read(path)
    assert record.name == "a"
    np.testing.assert_allclose(record.time, TIME, atol=1e-12)
    np.testing.assert_allclose(record.voltage, VOLTAGE, rtol=1e-6)
    seen = record.observed
    np.testing.assert_array_equal(np.flatnonzero(~seen), np.arange(40, 50) if missing else [])
    np.testing.assert_allclose(record.displacement[seen], OUTPUT[seen] * 1e-3, atol=1e-8)


LVM = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t,
Date\t2026/11/23
***End_of_Header***\t

Channels\t2
Samples\t100\t100
Y_Unit_Label\tVolts\tMillimeters
X_Dimension\tTime\tTime
Delta_X\t0,001000\t0,001000
***End_of_Header***\t\t
X_Value\tVoltage\tDisplacement\tComment
"""


def test_labview_text(tmp_path):
    rows = zip(TIME, VOLTAGE, OUTPUT, strict=True)
    body = "\n".join("\t".join(f"{v:.6f}".replace(".", ",") for v in row) for row in rows)
    (tmp_path / "a.lvm").write_text(LVM + body + "\n")
    (record,) = read(tmp_path / "a.lvm")
    np.testing.assert_allclose(record.displacement, OUTPUT * 1e-3, atol=1e-9)
    assert record.displacement_unit == "mm" and record.dt == pytest.approx(1e-3)


def test_a_file_without_header_is_read_by_counting(tmp_path):
    body = "\n".join(f"{a},{b},{c}" for a, b, c in zip(TIME, VOLTAGE, OUTPUT, strict=True))
    (tmp_path / "a.csv").write_text(body)
    assert "columns here: '1', '2', '3'" in refused(tmp_path / "a.csv")
    (record,) = read(
        tmp_path / "a.csv", time_column="1", input_column="2", output_column="3", input_unit="V", output_unit="mm"
    )
    assert record.samples == T and "no header" in record.recognised["file"]


def test_comments_among_the_rows_are_left_out(tmp_path):
    lines = ["time_s,voltage_V,displacement_mm"] + [
        f"{a},{b},{c}" for a, b, c in zip(TIME, VOLTAGE, OUTPUT, strict=True)
    ]
    lines[30:30] = ["# pause", "", "# on again"]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert read(tmp_path / "a.csv")[0].samples == T
    lines[60] = "0.056,oops,1"
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert "line 61" in refused(tmp_path / "a.csv")


@pytest.mark.parametrize("others", [[""], ["  "], ["# on again"], ["# 1,2,3,4"], ["", "// 1,2,3,4", ""]])
def test_rows_without_numbers_are_left_out_beside_words(tmp_path, others):
    rows = [f"go,{a},{b},{c}" for a, b, c in zip(TIME, VOLTAGE, OUTPUT, strict=True)]
    lines = ["state,time_s,voltage_V,displacement_mm", *rows[:30], *others, *rows[30:], ",,,", ",,,", *others]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    (record,) = read(tmp_path / "a.csv")
    np.testing.assert_array_equal(record.voltage, VOLTAGE)
    lines[50] += ",9"
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert "line 51): 5 cells, but 4" in refused(tmp_path / "a.csv")


def test_a_sheet_is_found_among_others(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["rig 3"])
    sheet = book.create_sheet("data")
    sheet.append(["membrane 12"])
    sheet.append(["Time", "Voltage", "Displacement"])
    sheet.append(["ms", "kV", "mm"])
    for row in zip(TIME * 1000, VOLTAGE / 1000, OUTPUT, strict=True):
        sheet.append([float(v) for v in row])
    sheet["C20"] = None
    book.save(tmp_path / "a.xlsx")
    (record,) = read(tmp_path / "a.xlsx")
    np.testing.assert_allclose(record.voltage, VOLTAGE, rtol=1e-12)
    assert record.missing == 1 and "sheet 'data'" in record.recognised["file"]
    sheet["B30"] = "oops"
    book.save(tmp_path / "a.xlsx")
    assert "(line 30): text 'oops'" in refused(tmp_path / "a.xlsx")


def test_tdms_channels_with_units_and_a_waveform_clock(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    clock = {"wf_increment": 1e-3, "wf_start_offset": 0.0}
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment([
            nptdms.ChannelObject("run", "Voltage", VOLTAGE, properties={"unit_string": "V", **clock}),
            nptdms.ChannelObject("run", "Laser", OUTPUT, properties={"unit_string": "mm", **clock}),
        ])  # fmt: skip
    (record,) = read(tmp_path / "a.tdms")
    np.testing.assert_allclose(record.displacement, OUTPUT * 1e-3, rtol=1e-12)
    np.testing.assert_allclose(record.time, TIME, atol=1e-12)


def test_structs_and_groups(tmp_path):
    inside = {"t": TIME, "u": VOLTAGE, "y": OUTPUT, "units": "s, V, mm"}
    scipy.io.savemat(tmp_path / "a.mat", {"data": inside, "note": "rig 3"}, do_compression=True)
    (record,) = read(tmp_path / "a.mat")
    np.testing.assert_array_equal(record.voltage, VOLTAGE)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        for name, values in columns().items():
            file[f"run1/{name}"] = values
    np.testing.assert_array_equal(read(tmp_path / "b.h5")[0].voltage, VOLTAGE)
    with h5py.File(tmp_path / "b.h5", "r+") as file:
        for name, values in columns().items():
            file[f"run2/{name}"] = values
    assert "'run1/voltage_V', 'run2/voltage_V'" in refused(tmp_path / "b.h5")
    picked: dict[str, Any] = {
        f"{k}_column": f"run2/{n}" for k, n in zip(("time", "input", "output"), columns(), strict=True)
    }
    assert len(read(tmp_path / "b.h5", **picked)) == 1


def sines(count):
    """The columns of a record of that many samples at 10 kHz."""
    t = np.arange(count) / 1e4
    return {"time_s": t, "voltage_V": 1000 + 500 * np.sin(30 * t), "displacement_mm": np.sin(30 * t)}


@pytest.mark.parametrize("name", ["a.csv", "b.csv.gz", "c.mat", "f.npz", "g.h5"])
def test_no_format_is_read_by_a_loop_over_its_rows(tmp_path, name):
    for count in (2_000, 100_000):
        (tmp_path / str(count)).mkdir()
        SAVERS[name](tmp_path / str(count) / name, sines(count))
    short, long = tmp_path / "2000" / name, tmp_path / "100000" / name
    assert read(long)[0].samples == 100_000
    assert calls(lambda: read(long)) < calls(lambda: read(short)) + 10_000


def test_eight_ways_of_writing_one_sweep(shared):
    truth = np.load(shared / "lab" / "files_truth.npz")
    files = sorted((shared / "lab" / "files").iterdir())
    assert len(files) == 8
    for file in files:
        if file.suffix == ".xlsx":
            pytest.importorskip("openpyxl")
        (record,) = read(file)
        for found, true in zip((record.time, record.voltage, record.displacement), truth.values(), strict=True):
            assert np.abs(found - true).max() < 1e-3 * np.ptp(true), file.name

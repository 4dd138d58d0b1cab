"""Every format gives the same record; a file that is not what it says is refused."""

import gzip
import os

import h5py
import numpy as np
import pytest
from record_files import (
    OUTPUT,
    SAVERS,
    TIME,
    VOLTAGE,
    T,
    columns,
    refused,
    save_h5,
    save_mat73,
    save_npz,
    text,
)

from pitp_jax import BadInput, read
from pitp_jax.files.containers.formats import READERS, SUFFIXES


@pytest.mark.parametrize("name", SAVERS)
def test_every_format_gives_the_same_record(tmp_path, name):
    SAVERS[name](tmp_path / name, columns(note=np.zeros(T)))
    (record,) = read(tmp_path / name)
    assert record.name == name.split(".")[0]
    assert record.time.shape == record.voltage.shape == record.displacement.shape == (T,)
    np.testing.assert_allclose(record.time, TIME, atol=1e-15)
    np.testing.assert_array_equal(record.voltage, VOLTAGE)
    np.testing.assert_allclose(record.displacement, OUTPUT * 1e-3, rtol=1e-14)
    assert (record.voltage_unit, record.displacement_unit) == ("V", "mm")
    assert record.dt == pytest.approx(1e-3, rel=1e-12)


@pytest.mark.parametrize("name", SAVERS)
def test_missing_output_is_nan_and_counted_in_every_format(tmp_path, name):
    gap = OUTPUT.copy()
    gap[40:60] = np.nan
    SAVERS[name](tmp_path / name, columns(displacement_mm=gap))
    (record,) = read(tmp_path / name)
    assert record.missing == 20
    np.testing.assert_array_equal(record.observed, np.isfinite(gap))


@pytest.mark.parametrize("name", SAVERS)
def test_missing_columns_are_refused_in_every_format(tmp_path, name):
    for gone in ("time_s", "voltage_V", "displacement_mm"):
        SAVERS[name](tmp_path / name, columns(**{gone: None}))
        message = refused(tmp_path / name)
        assert name in message
        assert gone.split("_")[0] in message


@pytest.mark.parametrize("name", [n for n in SAVERS if "csv" not in n.lower()])
def test_text_complex_and_matrices_are_refused_in_stored_formats(tmp_path, name):
    if name == "e.mat":
        save_mat73(tmp_path / name, columns(displacement_mm=np.full(T, 65, np.uint16)))
        with h5py.File(tmp_path / name, "r+") as file:
            file["displacement_mm"].attrs["MATLAB_class"] = np.bytes_("char")
    else:
        kind = "S1" if name in ("g.h5", "h.hdf5") else "U1"
        SAVERS[name](tmp_path / name, columns(displacement_mm=np.full(T, "A", kind)))
    message = refused(tmp_path / name)
    assert "displacement_mm" in message
    assert "text" in message
    SAVERS[name](tmp_path / name, columns(voltage_V=VOLTAGE + 1j))
    assert "complex" in refused(tmp_path / name)


def test_matrix_and_unequal_lengths_are_refused(tmp_path):
    save_h5(tmp_path / "a.h5", columns(voltage_V=np.ones((T, 2))))
    assert "'voltage_V[1]', 'voltage_V[2]': two columns" in refused(tmp_path / "a.h5")
    save_npz(tmp_path / "a.npz", columns(displacement_mm=OUTPUT[:90]))
    message = refused(tmp_path / "a.npz")
    assert "sample 90" in message
    assert "displacement_mm" in message


def test_npz_with_objects_is_refused_and_not_unpickled(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "ran"),))

    np.savez(tmp_path / "a.npz", time_s=TIME, voltage_V=VOLTAGE, displacement_mm=np.array([Bomb()], dtype=object))
    assert "displacement_mm" in refused(tmp_path / "a.npz")
    assert not (tmp_path / "ran").exists()


def test_each_control_character_is_refused_with_its_line(tmp_path):
    lines = [f"{line},ok" for line in text(columns()).splitlines()]
    for code in set(range(32)) - set(b"\t\n\f\r"):
        noted = [*lines[:40], lines[40] + chr(code), *lines[41:]]
        (tmp_path / "a.csv").write_text("\n".join(noted))
        assert "line 41: control characters" in refused(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text(
        "\n".join([*lines[:40], lines[40] + "\t\f\x7f\u00fc", *lines[41:]]), encoding="utf-8"
    )
    assert read(tmp_path / "a.csv")[0].samples == len(lines) - 1


def test_empty_matlab73_variable_is_refused(tmp_path):
    save_mat73(tmp_path / "a.mat", columns(displacement_mm=np.array([0, 0], np.uint64)))
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        file["displacement_mm"].attrs["MATLAB_empty"] = 1
    assert "displacement_mm" in refused(tmp_path / "a.mat")


@pytest.mark.parametrize(
    ("name", "data", "word"),
    [
        ("a.csv", b"", "empty"),
        ("a.csv", bytes(range(256)) * 20, "control characters in a text file"),
        ("a.csv", text(columns()).encode("utf-16")[:-1], "UTF-16"),
        ("a.csv", b"1,2,3\n" * 100, "missing"),
        ("a.csv", b"time_s;voltage_V;displacement_mm\n0;1;2\n", "64"),
        ("a.csv.gz", gzip.compress(text(columns()).encode(), mtime=0)[:-300], "truncated"),
        ("a.csv.gz", gzip.compress(b"\x00\x01" * 900, mtime=0), "control characters in a text file"),
        ("a.mat", text(columns()).encode(), "not a MATLAB"),
        ("a.mat", b"MATLAB 5.0 MAT-file" + bytes(range(256)), "too early"),
        ("a.npz", b"\x93NUMPY", "not a NumPy"),
        ("a.npz", b"PK\x03\x04" + b"junk" * 50, "cannot be read as"),
        ("a.h5", b"not hdf5 at all", "cannot be read as"),
        ("a.h5", b"", "empty"),
        ("a.txt", b"x", "no table of numbers"),
        ("a.doc", b"x", "suffix"),
        ("a.xlsx", b"x", "not an Excel"),
        ("a.xlsx", b"PK\x03\x04" + b"junk" * 50, "cannot be read as"),
        ("a.tdms", b"x", "not a TDMS"),
    ],
)
def test_files_that_are_not_what_they_say(tmp_path, name, data, word):
    (tmp_path / name).write_bytes(data)
    message = refused(tmp_path / name)
    assert name in message
    assert word in message


def test_text_is_unzipped_by_its_bytes_whatever_its_suffix_says(tmp_path):
    (tmp_path / "a.csv").write_bytes(gzip.compress(text(columns()).encode(), mtime=0))
    (tmp_path / "b.csv.gz").write_bytes(text(columns()).encode())
    for record in read(tmp_path / "a.csv", tmp_path / "b.csv.gz"):
        np.testing.assert_allclose(record.displacement, OUTPUT * 1e-3, rtol=1e-6)


def test_every_damaged_bit_of_gzip_is_refused_or_harmless(tmp_path):
    whole = gzip.compress(text(columns()).encode(), mtime=0)
    path = tmp_path / "a.csv.gz"
    path.write_bytes(whole)
    good = read(path)[0]
    for at in range(0, len(whole), 37):
        damaged = bytearray(whole)
        damaged[at] ^= 0x10
        path.write_bytes(damaged)
        try:
            same = np.array_equal(read(path)[0].displacement, good.displacement)
        except BadInput:  # anything else fails the test
            same = True
        assert same


@pytest.mark.parametrize("name", ["c.mat", "e.mat", "f.npz", "g.h5"])
def test_truncated_binary_files_are_refused(tmp_path, name):
    SAVERS[name](tmp_path / name, columns())
    data = (tmp_path / name).read_bytes()
    for share in (0.1, 0.5, 0.9):
        (tmp_path / name).write_bytes(data[: int(share * len(data))])
        assert name in refused(tmp_path / name)


def test_a_trace_of_a_plc_is_read_by_its_variables(tmp_path):
    head = "[key]; [value]\nName; Trace\n0.Variable; PLC_PRG.rGoal\n1.Variable; PLC_PRG.rSpeed\n"
    blocks = (
        f"{k}.Data" + "".join(f"; {20 * i}; {v:.6f}\n" for i, v in enumerate(values))
        for k, values in enumerate((VOLTAGE, OUTPUT))
    )
    (tmp_path / "a.csv").write_text(head + "".join(blocks))
    columns = {"input_column": "PLC_PRG.rGoal", "output_column": "PLC_PRG.rSpeed", "output_unit": "rpm"}
    (record,) = read(tmp_path / "a.csv", **columns, input_unit="percent", time_unit="ms")
    assert record.dt == pytest.approx(0.02)
    np.testing.assert_allclose(record.voltage, VOLTAGE / 100, rtol=1e-12)
    assert "--time-unit" in refused(tmp_path / "a.csv", **columns, input_unit="percent")


@pytest.mark.parametrize("name", ["policy.pt", "policy.pth", "run.pkl", "old.xls", "log.jsonl", "run.zip"])
def test_files_that_are_not_read_are_named_with_what_to_save(tmp_path, name):
    (tmp_path / name).write_bytes(b"PK\x03\x04")
    for path in (tmp_path, tmp_path / name):
        assert "CSV" in refused(path)


def test_a_data_set_of_simulink_is_named(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file["tout"] = TIME
        file["logsout"] = np.zeros((1, 6), np.uint32)
        file["logsout"].attrs["MATLAB_class"] = np.bytes_("Simulink.SimulationData.Dataset")
    message = refused(tmp_path / "a.mat")
    assert "Simulink data set (logsout)" in message and "d{1}.Values.Data" in message


def test_every_reader_states_what_it_reads():
    names = {suffix for reader in READERS for suffix in reader.suffixes}
    assert names == set(SUFFIXES) and {".csv", ".csv.gz", ".mat", ".mcap", ".xlsx"} <= names
    for reader in READERS:
        assert reader.kind.startswith(("a ", "an ")) and reader.remedy and callable(reader.tables)
        assert all(isinstance(begin, bytes) for begin in reader.begins)

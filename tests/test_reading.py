"""Reading: every format, every refusal of the contract's section on records, names, and round trips."""

import gzip
import io
import os
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pitp_jax._errors import BadInput
from pitp_jax._record.reading import read, read_target, session_clock
from pitp_jax._record.record import Record
from pitp_jax._record.units import from_base, to_base, unit_of
from pitp_jax._record.writing import write_bytes_atomic, write_csv, write_text_atomic

T = 100
TIME = np.arange(T) / 1000
VOLTAGE = 1000.0 + np.arange(T)
OUTPUT = np.sin(TIME * 50)
SHARED = Path(__file__).resolve().parents[2] / "shared"
needs_shared = pytest.mark.skipif(not SHARED.exists(), reason="shared recordings are absent")


def columns(**changes):
    wide = {"time_s": TIME, "voltage_V": VOLTAGE, "displacement_mm": OUTPUT}
    wide.update(changes)
    return {name: values for name, values in wide.items() if values is not None}


def text(table):
    rows = [",".join(table)]
    rows += [",".join(str(v) for v in row) for row in zip(*table.values(), strict=True)]
    return "\n".join(rows) + "\n"


def save_csv(path, table):
    path.write_text(text(table))


def save_csv_gz(path, table):
    path.write_bytes(gzip.compress(text(table).encode()))


def save_mat(path, table):
    scipy.io.savemat(path, {name: np.asarray(v).reshape(-1, 1) for name, v in table.items()})


def save_mat_rows(path, table):
    scipy.io.savemat(path, {name: np.asarray(v).reshape(1, -1) for name, v in table.items()})


def save_mat73(path, table):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in table.items():
            file[name] = np.asarray(values).reshape(1, -1)
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def save_npz(path, table):
    np.savez(path, **table)


def save_h5(path, table):
    with h5py.File(path, "w") as file:
        for name, values in table.items():
            file[name] = values


SAVERS = {
    "a.csv": save_csv,
    "b.csv.gz": save_csv_gz,
    "c.mat": save_mat,
    "d.mat": save_mat_rows,
    "e.mat": save_mat73,
    "f.npz": save_npz,
    "g.h5": save_h5,
    "h.hdf5": save_h5,
    "I.CSV": save_csv,
}


def refused(*paths, **options) -> str:
    with pytest.raises(BadInput) as caught:
        read(*paths, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def refused_csv(tmp_path, body: str | bytes, **options) -> str:
    path = tmp_path / "bad.csv"
    path.write_bytes(body if isinstance(body, bytes) else body.encode())
    message = refused(path, **options)
    assert "bad.csv" in message
    return message


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
    assert "matrix" in refused(tmp_path / "a.h5")
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


def test_empty_matlab73_variable_is_refused(tmp_path):
    save_mat73(tmp_path / "a.mat", columns(displacement_mm=np.array([0, 0], np.uint64)))
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        file["displacement_mm"].attrs["MATLAB_empty"] = 1
    assert "displacement_mm" in refused(tmp_path / "a.mat")


@pytest.mark.parametrize("unit", ["V", "kV", "mV"])
@pytest.mark.parametrize("out", ["m", "mm", "um", "V", "mV"])
@pytest.mark.parametrize("clock", ["s", "ms"])
def test_units(tmp_path, unit, out, clock):
    factors = {"V": 1, "kV": 1e3, "mV": 1e-3, "m": 1, "mm": 1e-3, "um": 1e-6, "s": 1, "ms": 1e-3}
    table = {f"time_{clock}": TIME, f"voltage_{unit}": VOLTAGE, f"displacement_{out}": OUTPUT}
    save_csv(tmp_path / "a.csv", table)
    (record,) = read(tmp_path / "a.csv")
    np.testing.assert_allclose(record.time, TIME * factors[clock], rtol=1e-14)
    np.testing.assert_allclose(record.voltage, VOLTAGE * factors[unit], rtol=1e-14)
    np.testing.assert_allclose(record.displacement, OUTPUT * factors[out], rtol=1e-14)
    assert (record.voltage_unit, record.displacement_unit) == (unit, out)
    back = from_base(record.displacement, out, "displacement")
    np.testing.assert_allclose(back, OUTPUT, rtol=1e-14)
    assert to_base(2.0, "kV", "voltage") == 2000.0


@pytest.mark.parametrize("column", ["voltage", "voltage_", "_V", "voltage_MV", "voltage_m", "voltage_v"])
def test_unknown_units_are_refused(column):
    with pytest.raises(BadInput, match=r"f\.csv: column .* unknown unit"):
        unit_of(column, "voltage", "f.csv")


@pytest.mark.parametrize(
    "damage",
    [
        lambda s: "\ufeff" + s,
        lambda s: s.replace("\n", "\r\n"),
        lambda s: s.replace("\n", "\r\r\n"),
        lambda s: s.replace("time_s,voltage_V,", ' time_s ,"voltage_V" , '),
        lambda s: s + "\n\n  \n",
        lambda s: s.replace("\n", ",\n"),
        lambda s: s.rstrip("\n"),
        lambda s: s.replace(",", ", "),
        lambda s: s.replace("1003.0", '"1003.0"'),
        lambda s: "\n" + s,
    ],
    ids=["bom", "crlf", "crcrlf", "header", "blank", "trailing comma", "no end", "spaces", "quotes", "top"],
)
def test_csv_dialects(tmp_path, damage):
    (tmp_path / "a.csv").write_bytes(damage(text(columns())).encode())
    (record,) = read(tmp_path / "a.csv")
    np.testing.assert_array_equal(record.voltage, VOLTAGE)
    np.testing.assert_allclose(record.displacement, OUTPUT * 1e-3, rtol=1e-14)


@pytest.mark.parametrize("empty", ["", " ", "nan", "NaN"])
@pytest.mark.parametrize(
    "order", [("time_s", "voltage_V", "displacement_mm"), ("displacement_mm", "voltage_V", "time_s")]
)
def test_gap_of_200_samples_in_csv(tmp_path, empty, order):
    count = 500
    table = {
        "time_s": [f"{i / 1000:.3f}" for i in range(count)],
        "voltage_V": ["5"] * count,
        "displacement_mm": [empty if 100 <= i < 300 or i in (0, count - 1) else "1.5" for i in range(count)],
    }
    save_csv(tmp_path / "a.csv", {name: table[name] for name in order})
    (record,) = read(tmp_path / "a.csv")
    assert record.missing == 202
    assert not record.observed[[0, 100, 299, 499]].any()
    assert record.observed[[1, 99, 300, 498]].all()


def with_line(number, line):
    lines = text(columns()).split("\n")
    lines[number - 1] = line
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("0.048,oops,0.1", ("voltage_V", "line 50", "sample 48", "'oops'", "text")),
        ("0.048,1_000,0.1", ("voltage_V", "line 50", "text")),
        ("0.048,1048.0", ("line 50", "sample 48", "displacement_mm", "2 cells", "3")),
        ("0.048,1048.0,0.1,7", ("line 50", "sample 48", "4 cells")),
        ("0.048,,0.1", ("voltage_V", "line 50", "sample 48", "input is missing", "split")),
        ("0.048,nan,0.1", ("voltage_V", "line 50", "sample 48", "input is missing", "split")),
        ("0.048,inf,0.1", ("voltage_V", "line 50", "infinite")),
        ("0.048,1048.0,-inf", ("displacement_mm", "line 50", "infinite")),
        ("0.048,1048.0,1e400", ("displacement_mm", "line 50", "infinite")),
        (",1048.0,0.1", ("time_s", "line 50", "time is missing")),
        ("0.0483,1048.0,0.1", ("time_s", "line 50", "not uniform")),
        ("0.047,1048.0,0.1", ("time_s", "line 50", "repeats")),
        ("0.040,1048.0,0.1", ("time_s", "line 50", "decreases")),
    ],
)
def test_bad_line_is_named(tmp_path, line, words):
    message = refused_csv(tmp_path, with_line(50, line))
    for word in words:
        assert word in message, message


def test_line_numbers_skip_blank_lines(tmp_path):
    message = refused_csv(tmp_path, with_line(50, "\n\n0.048,inf,0.1"))
    assert "sample 48 (line 52)" in message


def test_dropped_sample_and_jitter(tmp_path):
    keep = np.arange(T) != 70
    save_csv(tmp_path / "bad.csv", {name: v[keep] for name, v in columns().items()})
    assert "sample 70 (line 72)" in refused(tmp_path / "bad.csv")
    jitter = np.random.default_rng(0).uniform(-1, 1, T)
    save_npz(tmp_path / "a.npz", columns(time_s=TIME + 0.9e-5 * jitter))
    assert read(tmp_path / "a.npz")[0].samples == T
    save_npz(tmp_path / "a.npz", columns(time_s=TIME + 3e-5 * jitter))
    assert "not uniform" in refused(tmp_path / "a.npz")


@pytest.mark.parametrize("count", [0, 1, 5, 63])
def test_short_records_are_refused(tmp_path, count):
    save_csv(tmp_path / "0_short.csv", {name: v[:count] for name, v in columns().items()})
    save_csv(tmp_path / "1_long.csv", columns())
    message = refused(tmp_path)
    assert "0_short.csv" in message
    assert "64" in message
    save_csv(tmp_path / "0_short.csv", {name: v[:64] for name, v in columns().items()})
    assert [r.samples for r in read(tmp_path)] == [64, T]


def test_all_missing_output_is_refused(tmp_path):
    message = refused_csv(tmp_path, text(columns(displacement_mm=[""] * T)))
    assert "displacement_mm" in message
    assert "every output sample is missing" in message


def test_two_matches_need_a_choice(tmp_path):
    path = tmp_path / "a.csv"
    save_csv(path, columns(voltage_kV=VOLTAGE))
    assert "--input-column" in refused(path)
    assert read(path, input_column="voltage_kV")[0].voltage[0] == 1e6
    save_csv(path, columns(displacement_V=OUTPUT))
    assert "--output-column" in refused(path)
    assert read(path, output_column="displacement_V")[0].displacement_unit == "V"
    save_csv(path, columns(time_ms=TIME * 1000))
    assert "two matches" in refused(path)
    path.write_text(text(columns()).replace("displacement_mm", "voltage_V", 1))
    assert refused(path)


def test_duplicate_column_is_refused(tmp_path):
    body = text(columns(x=VOLTAGE)).replace(",x\n", ",voltage_V\n", 1)
    assert "two matches" in refused_csv(tmp_path, body)


def test_other_columns_are_ignored_and_can_be_picked(tmp_path):
    path = tmp_path / "a.csv"
    save_csv(path, columns(voltage_command_V=2 * VOLTAGE, note=["abc"] * T, laser_um=OUTPUT))
    assert read(path)[0].voltage[0] == VOLTAGE[0]
    assert read(path, input_column="voltage_command_V")[0].voltage[0] == 2 * VOLTAGE[0]
    assert read(path, output_column="laser_um")[0].displacement_unit == "um"
    assert "unknown unit" in refused(path, input_column="note")
    assert "missing" in refused(path, input_column="nothing_V")
    assert "chosen twice" in refused(path, output_column="voltage_V")


def test_nearly_right_columns_are_not_matches(tmp_path):
    for near in ("Voltage_V", "voltage_v", "voltage_command_V", "voltage", "voltage_MV"):
        message = refused_csv(tmp_path, text({"time_s": TIME, near: VOLTAGE, "displacement_mm": OUTPUT}))
        assert near in message


@pytest.mark.parametrize(
    ("name", "data", "word"),
    [
        ("a.csv", b"", "empty"),
        ("a.csv", bytes(range(256)) * 20, "not UTF-8"),
        ("a.csv", text(columns()).encode("utf-16"), "not UTF-8"),
        ("a.csv", gzip.compress(b"x"), "gzip"),
        ("a.csv", b"1,2,3\n" * 100, "missing"),
        ("a.csv", b"time_s;voltage_V;displacement_mm\n0;1;2\n", "commas"),
        ("a.csv.gz", text(columns()).encode(), "not gzip"),
        ("a.csv.gz", gzip.compress(text(columns()).encode())[:-300], "truncated"),
        ("a.csv.gz", gzip.compress(b"\x00\x01" * 900), "not UTF-8"),
        ("a.mat", text(columns()).encode(), "not a MATLAB"),
        ("a.mat", b"MATLAB 5.0 MAT-file" + bytes(range(256)), "not readable"),
        ("a.npz", b"\x93NUMPY", "not a NumPy"),
        ("a.npz", b"PK\x03\x04" + b"junk" * 50, "not readable"),
        ("a.h5", b"not hdf5 at all", "not readable"),
        ("a.h5", b"", "empty"),
        ("a.txt", b"x", "suffix"),
    ],
)
def test_files_that_are_not_what_they_say(tmp_path, name, data, word):
    (tmp_path / name).write_bytes(data)
    message = refused(tmp_path / name)
    assert name in message
    assert word in message


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


def test_names_and_collisions(tmp_path):
    for folder in ("clean", "real"):
        (tmp_path / folder).mkdir()
        save_csv_gz(tmp_path / folder / "sine_000.7Hz_2600V.csv.gz", columns())
    save_csv(tmp_path / "clean" / "z.csv", columns())
    (record,) = read(tmp_path / "real")
    assert record.name == "sine_000.7Hz_2600V"
    names = [r.name for r in read(tmp_path / "clean", tmp_path / "real")]
    assert names == ["clean/sine_000.7Hz_2600V", "z", "real/sine_000.7Hz_2600V"]
    assert "given twice" in refused(tmp_path / "clean", tmp_path / "clean" / "z.csv")
    save_npz(tmp_path / "clean" / "z.npz", columns())
    assert "rename one" in refused(tmp_path / "clean")


def test_folders(tmp_path):
    assert "no record files" in refused(tmp_path)
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / ".hidden.csv").write_text("x")
    (tmp_path / "inner").mkdir()
    save_csv(tmp_path / "inner" / "a.csv", columns())
    assert "do not recurse" in refused(tmp_path)
    save_csv(tmp_path / "b.csv", columns())
    save_h5(tmp_path / "a.h5", columns())
    assert [r.name for r in read(tmp_path)] == ["a", "b"]
    assert "no such file" in refused(tmp_path / "nothing")
    assert "no records given" in refused()
    assert refused("a\0b")


def test_mixed_sets_are_refused(tmp_path):
    save_csv(tmp_path / "a.csv", columns())
    save_csv(tmp_path / "b.csv", columns(time_s=TIME * 2))
    message = refused(tmp_path)
    assert "a.csv" in message
    assert "b.csv" in message
    save_csv(tmp_path / "b.csv", {"time_s": TIME, "voltage_V": VOLTAGE, "displacement_mV": OUTPUT})
    assert "mV" in refused(tmp_path)
    save_csv(tmp_path / "b.csv", {"time_s": TIME, "voltage_kV": VOLTAGE, "displacement_um": OUTPUT})
    assert len(read(tmp_path)) == 2


def test_record_built_by_hand_is_checked():
    with pytest.raises(BadInput, match="record 'x'.*64"):
        Record("x", TIME[:5], VOLTAGE[:5], OUTPUT[:5])
    with pytest.raises(BadInput, match="infinite"):
        Record("x", TIME, VOLTAGE, np.where(TIME > 0.05, np.inf, 0.0))
    with pytest.raises(BadInput, match="shape"):
        Record("x", TIME[:, None], VOLTAGE, OUTPUT)


def test_session_clock():
    def at(start):
        return Record("x", TIME + start, VOLTAGE, OUTPUT)

    assert session_clock([at(0)])
    assert session_clock([at(50), at(0), at(10)])
    assert session_clock([at(0), at(0.1)])
    assert session_clock([at(0), at(0.099)])  # the shared end point of two records is no overlap
    assert not session_clock([at(0), at(0)])
    assert not session_clock([at(0), at(0.05)])


def test_target(tmp_path):
    path = tmp_path / "target.csv"
    save_csv(path, {"time_s": TIME, "displacement_um": OUTPUT})
    target = read_target(path)
    np.testing.assert_allclose(target.displacement, OUTPUT * 1e-6)
    assert target.displacement_unit == "um"
    assert target.dt == pytest.approx(1e-3)
    save_csv(path, {"time_s": TIME, "displacement_um": [""] + [1] * (T - 1)})
    with pytest.raises(BadInput, match=r"target is missing"):
        read_target(path)
    save_csv(path, {"time_s": TIME[:10], "displacement_um": OUTPUT[:10]})
    with pytest.raises(BadInput, match="64"):
        read_target(path)
    with pytest.raises(BadInput, match="folder"):
        read_target(tmp_path)


VALUES = st.floats(-1e6, 1e6, allow_subnormal=False)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    dt=st.sampled_from([1e-3, 2e-4, 0.0016384, 1 / 3000, 5e-5]),
    start=st.floats(0, 1e4),
    data=st.lists(VALUES | st.just(float("nan")), min_size=64, max_size=80),
    suffix=st.sampled_from([".csv", ".csv.gz"]),
)
def test_write_then_read(tmp_path, dt, start, data, suffix):
    output = np.array(data)
    output[0] = 1.0
    time = start + dt * np.arange(len(output))
    voltage = np.linspace(0, 6000, len(output))
    path = tmp_path / f"a{suffix}"
    flags = np.arange(len(output)) % 2 == 0
    write_csv(path, {"time_s": time, "voltage_V": voltage, "displacement_mm": output, "infeasible": flags})
    (record,) = read(path)
    np.testing.assert_allclose(record.time, time, atol=1e-9)
    np.testing.assert_allclose(record.voltage, voltage, rtol=1e-8)
    np.testing.assert_allclose(record.displacement * 1e3, output, rtol=1e-8, atol=1e-300)
    assert list(tmp_path.glob(".pitp*")) == []


def test_flags_are_written_as_digits(tmp_path):
    write_csv(tmp_path / "a.csv", {"time_s": np.array([0.0, 0.5]), "saturated": np.array([True, False])})
    assert (tmp_path / "a.csv").read_text() == "time_s,saturated\n0.000000000,1\n0.500000000,0\n"


def test_writing_is_whole_or_nothing(tmp_path, monkeypatch):
    path = tmp_path / "a.csv"
    write_text_atomic(path, "old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(BadInput, match=r"cannot write .*a\.csv: No space left on device"):
        write_csv(path, {"x": np.zeros(3)})
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]


def test_writing_to_odd_places(tmp_path):
    with pytest.raises(BadInput, match="create the folder"):
        write_bytes_atomic(tmp_path / "no" / "a", b"")
    with pytest.raises(BadInput, match="Is a directory"):
        write_bytes_atomic(tmp_path, b"")
    write_bytes_atomic("/dev/null", b"x")
    assert not Path("/dev/null").is_file()
    with pytest.raises(BadInput, match="No space left on device"):
        write_bytes_atomic("/dev/full", b"x")
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write_text_atomic(tmp_path / "link", "new")
    assert (tmp_path / "real").read_text() == "new"
    assert (tmp_path / "link").is_symlink()


def test_a_long_csv_is_read_quickly(tmp_path):
    count = 200_000
    buffer = io.StringIO("time_s,voltage_V,displacement_mm\n")
    buffer.seek(0, 2)
    buffer.write("\n".join(f"{i / 1000:.3f},{i % 700},{i % 13}.5" for i in range(count)))
    (tmp_path / "a.csv").write_text(buffer.getvalue())
    begun = time.perf_counter()
    (record,) = read(tmp_path / "a.csv")
    assert record.samples == count
    assert time.perf_counter() - begun < 4.0  # about 0.2 s; row by row about 0.6 s


@needs_shared
def test_measured_records():
    records = read(SHARED / "data" / "hasel_peano")
    assert [r.name for r in records] == ["sine_03Hz", "sine_07Hz", "steps"]
    assert all(r.voltage[0] > 1 for r in records)  # voltage_V, not the command
    silver = read(SHARED / "data" / "silverbox" / "multisine_test.csv.gz")[0]
    assert silver.displacement_unit == "V"
    real = SHARED / "gap" / "creep-cone-23" / "real"
    assert session_clock(read(real))

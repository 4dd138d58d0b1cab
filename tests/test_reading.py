"""Sets of records: names, folders, sampling, what is refused; targets."""

import numpy as np
import pytest
from record_files import (
    OUTPUT,
    TIME,
    VOLTAGE,
    T,
    columns,
    refused,
    refused_csv,
    save_csv,
    save_csv_gz,
    save_h5,
    save_npz,
    text,
)

from pitp_jax import BadInput, Record, Target, read, read_target, read_voltage
from pitp_jax.method.signal.sets import session_clock


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
    assert "no recording files" in refused(tmp_path)
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / ".hidden.csv").write_text("x")
    (tmp_path / "inner").mkdir()
    save_csv(tmp_path / "inner" / "a.csv", columns())
    assert "subfolders are not searched" in refused(tmp_path)
    save_csv(tmp_path / "b.csv", columns())
    save_h5(tmp_path / "a.h5", columns())
    assert [r.name for r in read(tmp_path)] == ["a", "b"]
    assert "no such file" in refused(tmp_path / "nothing")
    assert "no recordings given" in refused()
    assert refused("a\0b")


def test_mixed_sets_are_refused(tmp_path):
    save_csv(tmp_path / "a.csv", columns())
    save_csv(tmp_path / "b.csv", columns(time_s=TIME * 2))
    message = refused(tmp_path)
    assert "a.csv" in message
    assert "b.csv" in message
    save_csv(tmp_path / "b.csv", {"time_s": TIME, "voltage_V": VOLTAGE, "displacement_mV": OUTPUT})
    assert "mV" in refused(tmp_path)
    save_csv(tmp_path / "b.csv", {"time_s": TIME, "input_percent": VOLTAGE, "displacement_mm": OUTPUT})
    assert "input in percent, but" in refused(tmp_path)
    save_csv(tmp_path / "b.csv", {"time_s": TIME, "voltage_kV": VOLTAGE / 1000, "displacement_um": OUTPUT})
    assert len(read(tmp_path)) == 2


def test_record_built_by_hand_is_checked():
    with pytest.raises(BadInput, match="record 'x'.*64"):
        Record("x", TIME[:5], VOLTAGE[:5], OUTPUT[:5])
    with pytest.raises(BadInput, match="infinite"):
        Record("x", TIME, VOLTAGE, np.where(TIME > 0.05, np.inf, 0.0))
    with pytest.raises(BadInput, match="shape"):
        Record("x", TIME[:, None], VOLTAGE, OUTPUT)


def test_records_are_real_and_cannot_be_written_to():
    given = VOLTAGE.copy()
    record = Record("x", TIME, given, OUTPUT)
    given[5] = 0.0
    assert record.voltage[5] == VOLTAGE[5]
    target = Target(TIME, OUTPUT)
    for column in (record.time, record.voltage, record.displacement, target.displacement):
        with pytest.raises(ValueError, match="read-only"):
            column[5] = np.nan
    for wrong, said in ((OUTPUT + 0j, "complex"), (np.array(["x"] * T), "does not hold numbers")):
        with pytest.raises(BadInput, match=f"record .x.: displacement .*{said}|displacement {said}"):
            Record("x", TIME, VOLTAGE, wrong)
        with pytest.raises(BadInput, match=said):
            Target(TIME, wrong)


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
    with pytest.raises(BadInput, match="folder"):
        read_target(tmp_path)


def test_measured_records(shared):
    records = read(shared / "data" / "hasel_peano")
    assert [r.name for r in records] == ["sine_01Hz", "sine_03Hz", "sine_07Hz", "sine_11Hz", "steps"]
    assert all(r.voltage[0] > 1 for r in records)  # voltage_V, not the command
    silver = read(shared / "data" / "silverbox" / "multisine_test.csv.gz")[0]
    assert silver.displacement_unit == "V"
    real = shared / "gap" / "creep-cone-23" / "real"
    assert session_clock(read(real))


def test_a_target_of_two_rows_is_read(tmp_path):
    save_csv(tmp_path / "a.csv", {"time_s": [0.0, 0.5], "displacement_mm": [0.0, 2.0]})
    np.testing.assert_array_equal(read_target(tmp_path / "a.csv").displacement, [0.0, 2e-3])
    save_csv(tmp_path / "a.csv", {"time_s": [0.0], "displacement_mm": [0.0]})
    with pytest.raises(BadInput, match="at least 2"):
        read_target(tmp_path / "a.csv")


def rows_of(first, last, start=0.0, turn=None):
    """The table with its rows from one time to another, on a clock that starts there or overflows, in ms."""
    time = start + TIME
    clock = 1e3 * (time if turn is None else time % turn)
    kept = (TIME >= first - 1e-9) & (TIME <= last + 1e-9)
    return {"t [ms]": clock[kept], "voltage_V": VOLTAGE[kept], "displacement_mm": OUTPUT[kept]}


@pytest.mark.parametrize(("start", "turn"), [(0.0, None), (1.7e9, None), (65.4, 65.536)])
def test_a_range_of_time_is_a_file_cut_by_hand(tmp_path, start, turn):
    """Whatever the clock starts at: an own one, epoch seconds, a counter that overflows within the range."""
    first, last = TIME[20], TIME[T - 10]
    whole, cut = tmp_path / "a.csv", tmp_path / "b.csv"
    save_csv(whole, rows_of(-1, 1e9, start, turn))
    save_csv(cut, rows_of(first, last, start, turn))
    (got,), (wanted,) = read(whole, from_s=first, to_s=last), read(cut)
    for name in ("time", "voltage", "displacement"):
        assert np.array_equal(getattr(got, name), getattr(wanted, name), equal_nan=True)
    assert "after its first row" in got.recognised["time"]
    (drive,), (cut_drive,) = read_voltage(whole, from_s=first, to_s=last), read_voltage(cut)
    assert np.array_equal(drive.voltage, cut_drive.voltage)
    (tmp_path / "pitp.toml").write_text(f'["a.csv"]\nfrom = {first}\nto = {last}\n')
    assert np.array_equal(read(whole)[0].displacement, wanted.displacement, equal_nan=True)
    # the caller wins
    assert read(whole, from_s=0.0)[0].samples == T - 9


def test_ranges_that_hold_nothing_are_refused(tmp_path):
    save_csv(tmp_path / "a.csv", columns())
    assert "--from and --to in seconds after its first row" in refused(tmp_path, from_s=1e6)
    for said in ({"from_s": 2.0, "to_s": 1.0}, {"from_s": -1.0}, {"to_s": float("nan")}):
        assert "is not a time range" in refused(tmp_path, **said)


@pytest.mark.parametrize("line", ["Date: 24.11.2026 14:00:49", "# recorded 2026-11-24T14:00:49", "Datum;24/11/26"])
def test_a_date_above_the_table_is_reported_as_ignored(tmp_path, line):
    """The session's clock is the time column alone; a number such as a version is no date."""
    (tmp_path / "a.csv").write_text(f"{line}\n{text(columns())}")
    (tmp_path / "b.csv").write_text(f"# program 1.2.3, 24.5 kV\n{text(columns())}")
    dated, plain = read(tmp_path)
    assert "a date above the table ignored" in dated.recognised["file"] and "date" not in plain.recognised["file"]
    assert dated.time[0] == TIME[0]

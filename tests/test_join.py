"""Time, input and output in separate files: joined as asked."""

import numpy as np
import pytest
from record_files import OUTPUT, TIME, VOLTAGE, T, refused, save_csv, save_npz

from pitp_jax import BadInput, read, read_target


def assert_whole(record):
    np.testing.assert_allclose(record.time, TIME, atol=1e-9)
    np.testing.assert_array_equal(record.voltage, VOLTAGE)
    np.testing.assert_allclose(record.displacement, OUTPUT * 1e-3, rtol=1e-12)


def single_columns(folder):
    for name, values in (("time_s", TIME), ("voltage_V", VOLTAGE), ("displacement_mm", OUTPUT)):
        (folder / f"{name[:4]}.csv").write_text(f"{name}\n" + "\n".join(map(repr, values.tolist())) + "\n")


def each_with_its_clock(folder):
    save_csv(folder / "u.csv", {"time_s": TIME, "voltage_V": VOLTAGE})
    save_npz(folder / "y.npz", {"t_ms": TIME * 1e3, "displacement_mm": OUTPUT})


def one_without_clock(folder):
    save_csv(folder / "u.csv", {"time_s": TIME, "voltage_V": VOLTAGE})
    save_csv(folder / "y.csv", {"displacement_mm": OUTPUT, "temperature_degC": OUTPUT})


@pytest.mark.parametrize("write", [single_columns, each_with_its_clock, one_without_clock])
def test_files_are_joined_as_asked(tmp_path, write):
    write(tmp_path)
    file, *others = sorted(tmp_path.iterdir())
    assert "--join" in refused(file) or "is missing" in refused(file)
    assert_whole(read(file, join=others)[0])
    # files that are joined to others are no recordings of their own
    assert_whole(read(tmp_path, join=others)[0])


def test_names_that_occur_twice_carry_their_file(tmp_path):
    np.savetxt(tmp_path / "time.csv", TIME)
    np.savetxt(tmp_path / "inputs.csv", np.stack([OUTPUT, VOLTAGE], 1), delimiter=",")
    np.savetxt(tmp_path / "outputs.csv", np.stack([OUTPUT, VOLTAGE], 1), delimiter=",")
    names = [tmp_path / f"{stem}puts.csv" for stem in ("in", "out")]
    assert "--input-column inputs/1" in refused(tmp_path / "time.csv", join=names)
    (tmp_path / "pitp.toml").write_text(
        '["*"]\njoin = ["inputs.csv", "outputs.csv"]\ninput-column = "inputs/2"\ninput-unit = "V"\n'
        'output-column = "outputs/1"\noutput-unit = "mm"\n'
    )
    (record,) = read(tmp_path)
    assert record.name == "time"
    assert_whole(record)
    # as `pitp check --out` writes it into source.toml
    assert record.recognised["options"]["join"] == ("inputs.csv", "outputs.csv")


def test_rows_of_two_clocks_are_taken_in_turn(tmp_path):
    """The input at 125 Hz, the output at 1 kHz: the input holds until it is written again."""
    late = np.arange(0, T, 8)
    save_csv(tmp_path / "u.csv", {"time_s": TIME[late], "voltage_V": VOLTAGE[late]})
    save_csv(tmp_path / "y.csv", {"time_s": TIME + 2e-4, "displacement_mm": OUTPUT})
    (record,) = read(tmp_path / "y.csv", join=tmp_path / "u.csv")
    np.testing.assert_allclose(record.displacement, OUTPUT * 1e-3, rtol=1e-9)
    held = VOLTAGE[8 * (np.arange(T) // 8)]
    middle = np.arange(T) % 8 < 7  # the step before the next value holds a part of it
    np.testing.assert_allclose(record.voltage[middle], held[middle])


def test_rows_that_do_not_belong_together_are_refused(tmp_path):
    save_csv(tmp_path / "u.csv", {"time_s": TIME, "voltage_V": VOLTAGE})
    save_csv(tmp_path / "y.csv", {"displacement_mm": OUTPUT[:90], "temperature_degC": OUTPUT[:90]})
    message = refused(tmp_path / "u.csv", join=[tmp_path / "y.csv"])
    assert "u.csv (100 rows), y.csv (90 rows)" in message and "same length" in message
    with pytest.raises(BadInput, match=r"none\.csv"):
        read(tmp_path / "u.csv", join=[tmp_path / "none.csv"])


def test_a_column_alone_leaves_cells_out_as_in_a_table(tmp_path):
    """A word for a missing sample, and an exponent of Fortran, are what they are in a file of two columns."""
    time, motion = np.arange(100) / 100, [f"{np.sin(k / 9):.6f}" for k in range(100)]
    motion[7], motion[8] = "NA", "1.5D-1"
    (tmp_path / "x.csv").write_text("\n".join(["laser_mm", *motion]), encoding="utf-8")
    (tmp_path / "u.csv").write_text("\n".join(["time_s,voltage_V", *(f"{t},{t**2}" for t in time)]), encoding="utf-8")
    (record,) = read(tmp_path / "u.csv", join=tmp_path / "x.csv")
    truth = [np.nan if k == 7 else 0.15 if k == 8 else np.sin(k / 9) for k in range(100)]
    np.testing.assert_allclose(record.displacement, np.array(truth) / 1e3, rtol=0, atol=1e-9)


@pytest.mark.parametrize("text", ["# only\n# comments\n", "some words\nand more\n"])
def test_a_file_without_numbers_is_not_joined(tmp_path, text):
    """One of comments alone ended in a StopIteration, one of words was `(0 rows)`."""
    save_csv(tmp_path / "u.csv", {"time_s": TIME, "voltage_V": VOLTAGE})
    (tmp_path / "y.txt").write_text(text)
    assert "y.txt: holds no table of numbers" in refused(tmp_path / "u.csv", join=[tmp_path / "y.txt"])


def test_a_target_of_two_files(tmp_path):
    single_columns(tmp_path)
    target = read_target(tmp_path / "time.csv", join=[tmp_path / "disp.csv"])
    np.testing.assert_allclose(target.displacement, OUTPUT * 1e-3, rtol=1e-12)


def test_rows_above_the_header_do_not_prevent_joining(tmp_path):
    """Rows above the names of a motion capture could be names too, but then the file has no time."""
    time, fast = np.arange(200) / 100, np.arange(1000) / 500
    rows = [f"{k},{t:.2f},{np.sin(t):.6f}" for k, t in enumerate(time)]
    (tmp_path / "a.csv").write_text("\n".join([",,tip", ",,Position", "Frame,Time (s),z (mm)", *rows]))
    (tmp_path / "u.csv").write_text("\n".join(["t,U (V)", *(f"{t:.3f},{100 * t:.2f}" for t in fast)]))
    (record,) = read(tmp_path / "a.csv", join=[tmp_path / "u.csv"])
    assert record.samples >= 199 and record.voltage_unit == "V"


def test_a_clock_without_a_unit_is_asked_about_before_joining(tmp_path):
    save_csv(tmp_path / "u.csv", {"t": np.arange(400), "voltage_V": np.arange(400.0)})
    save_csv(tmp_path / "y.csv", {"t": np.arange(0, 400, 2), "displacement_mm": np.sin(np.arange(200) / 9)})
    with pytest.raises(BadInput, match="counts in whole numbers and has no unit.*--time-unit UNIT"):
        read(tmp_path / "u.csv", join=[tmp_path / "y.csv"])
    (record,) = read(tmp_path / "u.csv", join=[tmp_path / "y.csv"], time_unit="ms")
    assert record.dt == pytest.approx(2e-3)

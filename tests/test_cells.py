"""Cells with more or less than a number, and durations beside the clock."""

import numpy as np
import pytest
from record_files import refused, save_csv, save_npz

from pitp_jax import read, read_voltage

T = 1600
TIME = np.arange(T) / 100


def held(written, values, time):
    """The value written last at or before each time."""
    return values[np.maximum(np.searchsorted(written, time, side="right") - 1, 0)]


def test_lists_in_parquet_are_columns(tmp_path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    rows = np.stack([TIME * k for k in range(6)], 1)
    lists = [None if k == 700 else row.tolist() for k, row in enumerate(rows)]
    sized = pa.FixedSizeListArray.from_arrays(pa.array(np.sin(rows).ravel()), 6)
    table = {"action": sized, "observation.state": pa.array(lists), "timestamp": TIME, "episode": np.arange(T) // 800}
    pq.write_table(pa.table(table), tmp_path / "a.parquet")
    said = {"input_column": "action[3]", "output_column": "observation.state[2]", "input_unit": "rad"}
    first, second = read(tmp_path / "a.parquet", **said, output_unit="rad", split_by="episode")
    np.testing.assert_allclose(np.append(first.voltage, second.voltage), np.sin(2 * TIME))
    np.testing.assert_allclose(second.displacement, TIME[800:])
    assert np.flatnonzero(~first.observed).tolist() == [700]
    assert "'observation.state[1]'" in refused(tmp_path / "a.parquet", input_column="action[3]", output_column="x")


def messages(path, command_rate=50, other=False):
    """A row per message of a command and of an angle at 80 Hz; what was sent and what was measured."""
    sent = np.arange(0, 16, 1 / command_rate) + 0.0031
    measured = np.arange(0, 16, 1 / 80)
    command, angle = np.sin(2 * sent), np.cos(measured)
    time = np.concatenate([sent, measured])
    rows = {"command_rad": np.append(command, np.full(len(measured), np.nan))}
    rows["angle_rad"] = np.append(np.full(len(sent), np.nan), angle)
    order = np.argsort(time)
    columns = {"time_s": time[order], **{name: values[order] for name, values in rows.items()}}
    if other:  # rows of a third topic
        columns = {name: np.repeat(values, 2) for name, values in columns.items()}
        columns["command_rad"][1::2] = columns["angle_rad"][1::2] = np.nan
    save_npz(path, columns)
    return sent, command, measured, angle


@pytest.mark.parametrize("command_rate", [10, 50, 200])
@pytest.mark.parametrize("other", [False, True])
def test_a_row_per_message_is_held_on_the_rows_of_the_output(tmp_path, command_rate, other):
    sent, command, measured, angle = messages(tmp_path / "a.npz", command_rate, other)
    (record,) = read(tmp_path / "a.npz")
    assert record.dt == pytest.approx(1 / 80, rel=1e-6)
    np.testing.assert_allclose(record.displacement, angle[-record.samples :])
    assert record.samples == (measured >= sent[0]).sum()
    # the mean of what was held from row to row, on a clock a thousand times finer
    fine = record.time[0] + (np.arange(1000 * record.samples) + 0.5) / 80_000
    means = held(sent, command, fine).reshape(-1, 1000).mean(1)
    np.testing.assert_allclose(record.voltage, means, atol=2e-3)
    assert "% of the rows, held constant between them" in record.recognised["input"]


def test_values_logged_on_change_are_held(tmp_path):
    steps = np.repeat(np.random.default_rng(0).uniform(-1, 1, 40), T // 40)
    seldom = np.where(np.append(True, np.diff(steps) != 0), steps, np.nan)
    save_csv(tmp_path / "a.csv", {"time_s": TIME, "command_rad": seldom, "angle_rad": np.cos(TIME)})
    (record,) = read(tmp_path / "a.csv")
    np.testing.assert_allclose(record.voltage, steps)
    assert "in 2.5 % of the rows" in record.recognised["input"]
    save_csv(tmp_path / "u.csv", {"time_s": TIME, "command_rad": seldom})
    (drive,) = read_voltage(tmp_path / "u.csv", input_column="command_rad")
    np.testing.assert_allclose(drive.voltage[:-1], steps[:-1], atol=1e-9)


def test_an_input_that_is_missing_for_a_while_is_still_refused(tmp_path):
    command = np.sin(TIME)
    command[300:900] = np.nan
    save_csv(tmp_path / "a.csv", {"time_s": TIME, "command_rad": command, "angle_rad": np.cos(TIME)})
    assert "the input is missing (600 of 1600 samples)" in refused(tmp_path / "a.csv")


@pytest.mark.parametrize("clock", ["time", "time_s", "t", "elapsed", "reltime", "stamp", "Timestamp (s)"])
@pytest.mark.parametrize("duration", ["latency_ms", "loop_time [ms]", "cycle_time_ms", "period (us)", "exec time [ms]"])
def test_durations_beside_the_clock(tmp_path, clock, duration):
    waits = np.random.default_rng(0).uniform(3, 9, T)
    rows = {duration: waits, clock: TIME, "command_rad": np.sin(TIME), "angle_rad": np.cos(TIME)}
    save_csv(tmp_path / "a.csv", rows)
    (record,) = read(tmp_path / "a.csv")
    assert record.dt == pytest.approx(0.01) and clock in record.recognised["time"]


def test_degrees_celsius_beside_a_heater(tmp_path):
    rows = {"abstime": 1.6e9 + TIME, "reltime": TIME, "Heater [%]": np.sin(TIME), "Line 2 [C]": 20 + np.cos(TIME)}
    save_csv(tmp_path / "a.csv", rows)
    (record,) = read(tmp_path / "a.csv")
    assert (record.voltage_unit, record.displacement_unit) == ("percent", "degC")
    np.testing.assert_allclose(record.displacement, 20 + np.cos(TIME))
    np.testing.assert_allclose(record.time, TIME)


def test_cells_that_carry_their_unit_are_numbers_in_it(tmp_path):
    time, volts, millimetres = np.arange(200) / 100, np.sin(np.arange(200) / 9), 0.3 * np.sin(np.arange(200) / 9 - 0.2)
    rows = (f"{1e3 * t:.0f} ms,{v:.6f} kV,{y:.6f} mm" for t, v, y in zip(time, volts, millimetres, strict=True))
    (tmp_path / "a.csv").write_text("\n".join(["time,voltage,displacement", *rows]))
    (record,) = read(tmp_path / "a.csv")
    for mine, true in ((record.time, time), (record.voltage, 1e3 * volts), (record.displacement, 1e-3 * millimetres)):
        np.testing.assert_allclose(mine, true, rtol=0, atol=1e-6 * np.ptp(true))

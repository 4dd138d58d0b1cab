"""Logs of robots and data frames: topics as columns on the output's clock, commands held; Parquet by its columns."""

from datetime import UTC, datetime

import numpy as np
import pandas as pd
import pytest

import pitp_jax as pitp

RATE, COUNT = 200, 600
COLUMNS = {"input_column": "/arm/command.data[1]", "output_column": "/joint_states.position[2]"}


def written(folder, *, stamped, late=0.0, plugin="MCAP", begin=1_700_000_000.0):
    """A log of joint states at 200 Hz and of commands at 50 Hz that begin earlier; what was commanded and measured."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = {
        k.rpartition("/")[2]: v for k, v in store.types.items() if k.startswith(("std_msgs", "sensor_msgs", "builtin"))
    }
    motion, command = np.sin(np.arange(COUNT) / 40), np.cos(np.arange(COUNT // 4 + 5) / 10)
    empty, joint = np.zeros(0), "sensor_msgs/msg/JointState"
    kind = joint if stamped else "std_msgs/msg/Float64MultiArray"

    def header(t):
        return types["Header"](stamp=types["Time"](sec=int(t), nanosec=round(1e9 * (t % 1))), frame_id="")

    with rosbag2.Writer(folder, version=9, storage_plugin=rosbag2.StoragePlugin[plugin]) as bag:
        states = bag.add_connection("/joint_states", joint, typestore=store)
        commands = bag.add_connection("/arm/command", kind, typestore=store)
        log = bag.add_connection("/rosout", "std_msgs/msg/Int32", typestore=store)
        bag.write(log, round(1e9 * begin), store.serialize_cdr(types["Int32"](data=3), "std_msgs/msg/Int32"))
        events = [(begin + k / RATE, "state", k) for k in range(COUNT)]
        events += [(begin + k / 50 - 0.0801, "command", k) for k in range(len(command))]
        for t, what, k in sorted(events):
            if what == "state":
                position = np.array([0.1, 0.2, motion[k]])
                message = types["JointState"](
                    header=header(t), name=["a", "b", "c"], position=position, velocity=empty, effort=empty
                )
                bag.write(states, round(1e9 * (t + late)), store.serialize_cdr(message, joint))
            elif stamped:
                message = types["JointState"](
                    header=header(t), name=[], position=empty, velocity=empty, effort=np.array([0.0, command[k]])
                )
                bag.write(commands, round(1e9 * (t + late)), store.serialize_cdr(message, kind))
            else:
                layout = types["MultiArrayLayout"](dim=[], data_offset=0)
                message = types["Float64MultiArray"](layout=layout, data=np.array([0.0, command[k]]))
                bag.write(commands, round(1e9 * (t + late)), store.serialize_cdr(message, kind))
    return command, motion


def test_commands_are_held_on_the_clock_of_the_measured_joint(tmp_path):
    command, motion = written(tmp_path / "run", stamped=False)
    (record,) = pitp.read(tmp_path / "run", **COLUMNS, input_unit="rad")
    assert (record.name, record.samples, record.displacement_unit) == ("run", COUNT, "rad")
    np.testing.assert_allclose(record.displacement, motion)
    sent = np.arange(len(command)) / 50 - 0.0801
    held = np.searchsorted(sent, np.arange(COUNT) / RATE, side="right") - 1
    np.testing.assert_allclose(record.voltage, command[held])
    assert record.dt == pytest.approx(1 / RATE, rel=1e-6)
    assert "clock log time" in record.recognised["file"] and "commands held" in record.recognised["file"]


@pytest.mark.parametrize("plugin", ["MCAP", "SQLITE3"])
def test_the_header_is_the_clock_where_all_topics_have_one(tmp_path, plugin):
    columns = {"input_column": "/arm/command.effort[1]", "output_column": "/joint_states.position[2]"}
    written(tmp_path / "run", stamped=True, late=0.3, plugin=plugin)
    (record,) = pitp.read(tmp_path / "run", **columns)
    assert record.time[0] == pytest.approx(1_700_000_000.0, abs=1e-5)
    assert record.voltage_unit == "N m" and "clock header.stamp" in record.recognised["file"]


def test_rows_before_the_first_command_are_left_out(tmp_path):
    written(tmp_path / "run", stamped=False)
    columns = {"input_column": "/joint_states.position[2]", "output_column": "/arm/command.data[1]"}
    (record,) = pitp.read(tmp_path / "run", **columns, output_unit="rad")
    assert record.time[0] - 1_700_000_000.0 == pytest.approx(0.0199, abs=1e-4)  # the first command after a state


def test_a_folder_of_logs_and_one_file_of_them(tmp_path):
    for name in ("day1", "day2"):
        written(tmp_path / name, stamped=False)
    records = pitp.read(tmp_path, **COLUMNS, input_unit="rad")
    assert [r.name for r in records] == ["day1", "day2"]
    (single,) = pitp.read(next((tmp_path / "day1").glob("*.mcap")), **COLUMNS, input_unit="rad")
    np.testing.assert_array_equal(single.voltage, records[0].voltage)


def test_topics_are_listed_where_nothing_says_which(tmp_path):
    written(tmp_path / "run", stamped=False)
    with pytest.raises(pitp.BadInput, match=r"/joint_states\.position\[0\]") as caught:
        pitp.read(tmp_path / "run")
    assert "rosout" not in str(caught.value)


def test_a_damaged_log_is_one_line(tmp_path):
    pytest.importorskip("rosbags")
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(300))
    with pytest.raises(pitp.BadInput, match="cannot be read as a robot log"):
        pitp.read(tmp_path / "a.mcap")


def frame(**columns):
    time = np.arange(300) / 100
    return pd.DataFrame({"time_s": time, "voltage_V": 1000 * np.sin(time), "displacement_mm": np.cos(time), **columns})


def test_parquet_reads_as_the_same_csv(tmp_path):
    pytest.importorskip("pyarrow")
    data = frame(note="x")
    data.loc[7, "displacement_mm"] = None
    data.to_parquet(tmp_path / "a.parquet")
    data.drop(columns="note").to_csv(tmp_path / "b.csv", index=False)
    one, two = pitp.read(tmp_path)
    for field in ("time", "voltage", "displacement"):
        np.testing.assert_allclose(getattr(one, field), getattr(two, field), rtol=1e-12)
    assert one.missing == 1


def test_parquet_with_dates_units_beside_and_runs(tmp_path):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet

    run = np.repeat(["first", "second"], 150)
    stamp = pd.date_range("2026-11-25", periods=300, freq="10ms", tz="Europe/Berlin")
    table = pa.table({"timestamp": stamp, "u": frame()["voltage_V"] / 1000,
                      "x": frame()["displacement_mm"], "run": run})  # fmt: skip
    units = {"u": "kV", "x": "mm"}
    schema = pa.schema([f.with_metadata({"unit": units[f.name]}) if f.name in units else f for f in table.schema])
    pyarrow.parquet.write_table(table.cast(schema), tmp_path / "a.parquet")
    first, second = pitp.read(tmp_path / "a.parquet", split_by="run")
    assert (first.name, second.name, first.samples) == ("a.first", "a.second", 150)
    assert second.time[0] - first.time[0] == pytest.approx(1.5, abs=1e-6)
    np.testing.assert_allclose(first.voltage, frame()["voltage_V"][:150])
    assert first.time[0] == pytest.approx(datetime(2026, 11, 24, 23, tzinfo=UTC).timestamp())


def test_what_is_no_parquet_is_refused(tmp_path):
    (tmp_path / "a.parquet").write_text("time_s,voltage_V\n")
    with pytest.raises(pitp.BadInput, match="not a Parquet file"):
        pitp.read(tmp_path / "a.parquet")

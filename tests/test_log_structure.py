"""The structure of a log before its numbers: rows that take turns, sign bits, values that stand, lists in cells."""

import numpy as np
import pytest
from record_files import refused, save_csv, save_npz

from pitp_jax import read
from pitp_jax.common.units import base_unit, column_name, from_base, to_base
from pitp_jax.files.containers.names import read_header
from pitp_jax.files.containers.structure import refreshed, sign_bit, signed

STEPS = 600
TIME = np.arange(STEPS) / 100
DRIVE = np.sin(2 * np.pi * (0.3 + 0.2 * TIME) * TIME)
MOTION = 0.8 * np.sin(2 * np.pi * (0.3 + 0.2 * TIME) * TIME - 0.4) + 1e-3 * np.random.default_rng(0).normal(size=STEPS)


def in_turns(path, stamps, names=("hip", "knee", "ankle")):
    """Write a row for each joint at each time; the joints move apart."""
    rows = ["time_s,joint,goal_rad,position_rad"]
    for k, t in enumerate(TIME):
        for n, name in enumerate(names):
            rows.append(f"{t + n * stamps:.5f},{name},{(1 - 2 * n) * DRIVE[k]:.6f},{(1 - 2 * n) * MOTION[k]:.6f}")
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("stamps", [0.0, 0.002])
@pytest.mark.parametrize("names", [("hip", "knee", "ankle"), ("11", "12")])
def test_a_row_for_each_joint_is_split_by_the_joint(tmp_path, stamps, names):
    path = in_turns(tmp_path / "log.csv", stamps, names)
    message = refused(path)
    assert f"'joint' has {len(names)} values" in message and message.endswith("try: --split-by joint")
    records = read(path, split_by="joint")
    assert [r.samples for r in records] == [STEPS] * len(names)
    np.testing.assert_allclose(records[1].voltage, -DRIVE, atol=1e-6)


def test_a_bit_that_toggles_is_no_joint(tmp_path):
    """A heartbeat takes turns as joints do, but the signals are smooth from row to row."""
    save_csv(
        tmp_path / "a.csv", {"time_s": TIME, "goal_rad": DRIVE, "position_rad": MOTION, "beat": np.arange(STEPS) % 2}
    )
    assert read(tmp_path / "a.csv")[0].samples == STEPS


@pytest.mark.parametrize("bit", [11, 15])
def test_registers_are_read_as_sign_and_magnitude(tmp_path, bit):
    motion, drive = np.round(400 * MOTION), np.round(400 * np.sign(DRIVE))
    registers = [np.where(v < 0, 2.0**bit - v, v) for v in (drive, motion)]
    assert sign_bit(registers[1]) == bit
    np.testing.assert_array_equal(signed(registers[1], bit), motion)
    table = {"time_s": TIME, "goal_counts": registers[0], "position_counts": registers[1]}
    save_csv(tmp_path / "a.csv", table)
    (record,) = read(tmp_path / "a.csv")
    np.testing.assert_array_equal(record.displacement, motion)
    np.testing.assert_array_equal(record.voltage, drive)  # jumps across zero: the output shows what the bit means
    assert f"bit {bit} is the sign" in record.recognised["output"]


@pytest.mark.parametrize("bits", [16, 32])
def test_registers_are_read_as_a_twos_complement(tmp_path, bits):
    """A current and a speed below zero are close to 65535 in a register that is read as unsigned."""
    motion, drive = np.round(400 * MOTION), np.round(400 * np.sign(DRIVE))
    table = {"time_s": TIME, "goal_current [mA]": drive % 2.0**bits, "speed [rpm]": motion % 2.0**bits}
    save_csv(tmp_path / "a.csv", table)
    (record,) = read(tmp_path / "a.csv")
    np.testing.assert_allclose(record.displacement, motion * 2 * np.pi / 60, rtol=0, atol=1e-9)
    np.testing.assert_allclose(record.voltage, drive / 1e3, rtol=0, atol=1e-9)
    assert f"bit {bits - 1} is the sign" in record.recognised["output"]


@pytest.mark.parametrize("high", [4e4, 65535.0])
def test_a_command_between_two_ends_is_no_complement(tmp_path, high):
    drive = np.where(DRIVE > 0, high, 0.0)
    save_csv(tmp_path / "a.csv", {"time_s": TIME, "dac_counts": drive, "position_mm": MOTION})
    options = {"input_column": "dac_counts"}
    np.testing.assert_array_equal(read(tmp_path / "a.csv", **options)[0].voltage, drive)


@pytest.mark.parametrize("values", [np.arange(40000.0), np.where(TIME > 3, 40000.0, 5.0), np.round(4e4 + 100 * MOTION)])
def test_plain_numbers_have_no_sign_bit(values):
    assert sign_bit(values) is None


@pytest.mark.parametrize("rows", [2, 6.4, 10])
def test_values_that_stand_are_read_at_their_own_rate(tmp_path, rows):
    fast = np.arange(6000) / 1000
    kept = np.floor(np.arange(6000) / rows + 1e-9) * rows / 1000  # when the value was taken
    drive = np.sin(2 * np.pi * 1.5 * fast)
    motion = (
        np.sin(2 * np.pi * 1.5 * kept)
        + 1e-3 * np.random.default_rng(1).normal(size=6001)[np.round(1e3 * kept).astype(int)]
    )
    save_csv(tmp_path / "a.csv", {"time_s": fast, "command_rad": drive, "position_rad": motion})
    (record,) = read(tmp_path / "a.csv")
    assert record.dt == pytest.approx(rows / 1000, rel=1e-3) and "own rate" in record.recognised["output"]
    np.testing.assert_allclose(record.displacement, np.sin(2 * np.pi * 1.5 * record.time), atol=0.02)
    np.testing.assert_allclose(record.voltage, np.sin(2 * np.pi * 1.5 * (record.time + record.dt / 2)), atol=0.02)


def test_a_slow_motion_of_the_same_log_is_read_at_the_same_rate(tmp_path):
    fast = np.arange(6000) / 1000
    for name, size in (("a", 1.0), ("b", 0.002)):  # b moves by a few steps of the sensor
        motion = np.round(size * np.sin(2 * np.pi * fast) / 5e-4)[10 * (np.arange(6000) // 10)] * 5e-4
        save_csv(
            tmp_path / f"{name}.csv", {"time_s": fast, "command_rad": size * np.sin(9 * fast), "position_rad": motion}
        )
    assert read(tmp_path / "b.csv")[0].dt == pytest.approx(1e-3)
    assert [record.dt for record in read(tmp_path)] == pytest.approx([1e-2, 1e-2])


@pytest.mark.parametrize(
    "values",
    [np.round(TIME * 25) / 10, np.round(20 * MOTION), MOTION, np.zeros(STEPS)],
    ids=["ramp of a coarse sensor", "coarse motion", "fine motion", "nothing"],
)
def test_a_sensor_of_its_own_rate_keeps_its_rows(values):
    assert refreshed(values) is None


@pytest.mark.parametrize("period", [60.0, 3600.0, 86400.0])
def test_seconds_of_the_hour_or_day_run_on(tmp_path, period):
    save_csv(
        tmp_path / "a.csv", {"time_s": (period - 2.995 + TIME) % period, "goal_rad": DRIVE, "position_rad": MOTION}
    )
    if period < 3600:
        assert "decreases" in refused(tmp_path / "a.csv")
        return
    (record,) = read(tmp_path / "a.csv")
    assert record.samples == STEPS and record.dt == pytest.approx(0.01)


def test_a_column_given_twice_and_a_dead_sensor_are_reported(tmp_path):
    for name, output in (("twice", DRIVE), ("dead", 1873.0 + (np.arange(STEPS) % 7 == 0)), ("sound", MOTION)):
        save_csv(tmp_path / f"{name}.csv", {"time_s": TIME, "goal_rad": DRIVE, "position_rad": output})
    said = {r.name: " ".join(r.recognised["remarks"]) for r in read(tmp_path)}
    assert "the same numbers" in said["twice"] and "does not move" in said["dead"] and not said["sound"]


@pytest.mark.parametrize("between", [", ", " "])
def test_lists_in_cells_become_columns(tmp_path, between):
    cells = [f"[{between.join(f'{v:.5f}' for v in (a, 0.5, -a))}]" for a in DRIVE]
    rows = [f'{t:.3f},"{cell}",{x:.6f}' for t, cell, x in zip(TIME, cells, MOTION, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["time_s,action,position_rad", *rows]) + "\n")
    (record,) = read(tmp_path / "a.csv", input_column="action[3]", input_unit="rad")
    np.testing.assert_allclose(record.voltage, -DRIVE, atol=1e-5)


def test_environments_and_joints_of_an_array_become_columns(tmp_path):
    drive, motion = (np.stack([np.stack([v, -v], 1)] * 3, 1) for v in (DRIVE, MOTION))
    save_npz(tmp_path / "a.npz", {"time_s": TIME, "action": drive, "qpos": motion})
    columns = {"input_column": "action[2,2]", "output_column": "qpos[2,2]"}
    (record,) = read(tmp_path / "a.npz", **columns, input_unit="rad", output_unit="rad")
    np.testing.assert_array_equal(record.voltage, -DRIVE)
    (tmp_path / "pitp.toml").write_text(
        '["*"]\neach = ["q=action[2,2],qpos[2,2]"]\ninput-unit = "rad"\noutput-unit = "rad"\n'
    )
    np.testing.assert_array_equal(read(tmp_path / "a.npz", joint="q")[0].voltage, -DRIVE)


def test_a_clock_of_another_length_gives_way_to_the_rate(tmp_path):
    save_npz(tmp_path / "a.npz", {"time_s": TIME[::8], "goal_rad": DRIVE, "position_rad": MOTION})
    assert refused(tmp_path / "a.npz").endswith("try: --rate RATE")
    assert read(tmp_path / "a.npz", rate=100.0)[0].samples == STEPS


def test_two_recordings_in_one_file_are_not_mixed(tmp_path):
    short = {f"{name}_val": v[:400] for name, v in (("u", DRIVE), ("y", MOTION), ("t", TIME))}
    save_npz(tmp_path / "a.npz", short | {"t_id": TIME, "u_id": DRIVE, "y_id": MOTION})
    message = refused(tmp_path / "a.npz", time_column="t_id", time_unit="s")
    assert "--input-column u_id" in message and "--output-column y_id" in message


def test_an_offset_is_subtracted_in_the_numbers_of_the_file(tmp_path):
    table = {"time_s": TIME, "goal_mV": 1e3 * DRIVE + 2048, "position_mm": MOTION + 5}
    save_csv(tmp_path / "a.csv", table)
    said = {"input_offset": 2048.0, "output_offset": 5.0, "input_scale": 10.0}
    (record,) = read(tmp_path / "a.csv", **said)
    np.testing.assert_allclose(record.voltage, 10 * DRIVE, atol=1e-9)
    np.testing.assert_allclose(record.displacement, 1e-3 * MOTION, atol=1e-12)
    assert "less 2048 times 10" in record.recognised["input"]
    (tmp_path / "pitp.toml").write_text('["*"]\ninput-offset = 2048\noutput-offset = 5\ninput-scale = 10\n')
    np.testing.assert_array_equal(read(tmp_path / "a.csv")[0].voltage, record.voltage)
    assert "--input-offset" in refused(tmp_path / "a.csv", input_offset=np.nan)


@pytest.mark.parametrize("unit", ["W", "kW", "L/min", "m3/h", "Hz", "mT"])
def test_a_unit_of_symbols_of_si_is_kept_as_written(tmp_path, unit):
    save_csv(tmp_path / "a.csv", {"Time (s)": TIME, f"Heater ({unit})": DRIVE, "Stroke (mm)": MOTION})
    (record,) = read(tmp_path / "a.csv", input_column=f"Heater ({unit})")
    assert (record.voltage_unit, base_unit(unit)) == (unit, unit)
    assert to_base(2.0, unit) == from_base(2.0, unit) == 2.0
    # the column that pitp writes is read again
    header = read_header(column_name("voltage", unit))
    assert (header.unit, header.role) == (unit, "input")


@pytest.mark.parametrize("text", ["amplifier", "raw", "furlong", "Kanal 2", "monitor", "AI 0"])
def test_words_in_brackets_are_no_units(tmp_path, text):
    save_csv(tmp_path / "a.csv", {"Time (s)": TIME, f"Input ({text})": DRIVE, "Stroke (mm)": MOTION})
    assert "--input-unit" in refused(tmp_path / "a.csv")
    assert "counts for any other" in refused(tmp_path / "a.csv", input_unit=text)

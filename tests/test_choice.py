"""Which column is the input, which the output, and in which unit."""

import numpy as np
import pytest
from record_files import OUTPUT, TIME, VOLTAGE, T, columns, refused, refused_csv, save_csv, text

from pitp_jax._errors import BadInput
from pitp_jax._record.reading import read
from pitp_jax._record.units import from_base, to_base, unit_of


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
    ("before", "after", "remedy"),
    [(",", ";", "by commas"), (",", "\t", "by commas"), ("time_s", "# rig 3\ntime_s", "delete the comment lines"),
     ("time_s", "% time_s", "delete the comment lines")],
)  # fmt: skip
def test_other_habits_of_a_header_get_their_remedy(tmp_path, before, after, remedy):
    message = refused_csv(tmp_path, text(columns()).replace(before, after))
    assert remedy in message
    assert "name it" not in message

"""What stands above the numbers of a text, and what is said twice: read, or asked about."""

import datetime

import numpy as np
import pytest
from record_files import OUTPUT, TIME, VOLTAGE, refused_csv

from pitp_jax import BadInput, read, read_voltage
from pitp_jax.files.containers.stamps import seconds

NAMES = "time_s,voltage_V,displacement_mm\n"
ROWS = [f"{a:.3f},{b:.0f},{c:.6f}" for a, b, c in zip(TIME, VOLTAGE, OUTPUT, strict=True)]
BODY = "\n".join(ROWS) + "\n"


def assert_read(tmp_path, text, **said):
    (tmp_path / "a.csv").write_text(text)
    (record,) = read(tmp_path / "a.csv", **said)
    np.testing.assert_allclose(record.time, TIME, atol=1e-9)
    np.testing.assert_allclose(record.voltage, VOLTAGE, rtol=1e-12)
    np.testing.assert_allclose(record.displacement, OUTPUT * 1e-3, atol=1e-9)


@pytest.mark.parametrize(
    "above",
    [
        "rate,1000,\ncount,800,\n",
        "rate,1000\ncount,800\n",
        "1000,,\n800,,\n",
        "Clock,Amplifier,Laser\n",
        "Channel 0,Channel 1,Channel 2\n",
        "s,V,mm\n",
        "# units: s, V, mm\n",
        "# time in s, voltage in V, displacement in mm\n",
        "# my first recording\n",
    ],
)
def test_rows_above_the_names_are_no_names(tmp_path, above):
    assert_read(tmp_path, above + NAMES + BODY)


@pytest.mark.parametrize("separator", [" ", ",", ";"])
@pytest.mark.parametrize(
    "names",
    [
        "time [s] voltage [V] displacement [mm]",
        "time [s], drive voltage [V], laser displacement [mm]",
        "time_s voltage_V displacement_mm",
        "columns: time (s)  voltage (V)  displacement (mm)",
    ],
)
def test_headers_of_savetxt(tmp_path, separator, names):
    table = np.stack([TIME, VOLTAGE, OUTPUT], 1)
    np.savetxt(tmp_path / "b.txt", table, delimiter=separator, header=f"rig 3, today\n{names}")
    assert_read(tmp_path, (tmp_path / "b.txt").read_text())


@pytest.mark.parametrize(
    "units", ["# units: ms, kV, mm\n", "# Units: ms kV mm\n", "ms,kV,mm\n", "# time in ms, voltage in kV\n"]
)
def test_units_that_contradict_the_names_are_asked_about(tmp_path, units):
    message = refused_csv(tmp_path, units + NAMES + BODY)
    assert "has two units, V in its name and kV in its unit" in message and "--input-unit" in message
    assert_read(tmp_path, units + NAMES + BODY, time_unit="s", input_unit="V")


def test_a_decimal_comma_below_the_first_lines(tmp_path):
    whole = [f"{k};{1000 + k};{k % 7}" for k in range(300)]
    text = "time_ms;voltage_V;displacement_um\n" + "\n".join(whole)
    (tmp_path / "a.csv").write_text(text + "\n300;1300;2,5\n")
    (record,) = read(tmp_path / "a.csv")
    assert record.displacement[-1] == pytest.approx(2.5e-6) and "decimal comma" in record.recognised["file"]
    # 1,250 may be 1250
    assert "'1,250' instead of a number" in refused_csv(tmp_path, text + "\n300;1,250;2\n")
    assert "thousands" in refused_csv(tmp_path, text.replace(";1", ";1,") + "\n300;1,300;2\n")


@pytest.mark.parametrize(
    "form", ["%d-%b-%Y %H:%M:%S.%f", "%y-%m-%d %H:%M:%S.%f", "%b %d, %Y %H:%M:%S.%f", "%d.%m.%y %H:%M:%S.%f"]
)
def test_dates_go_on_over_midnight(form):
    for day in ((2026, 11, 5), (2026, 11, 30), (2027, 2, 28)):
        begin = datetime.datetime(*day, 23, 59, 59)
        stamps = [(begin + datetime.timedelta(milliseconds=100 * k)).strftime(form) for k in range(30)]
        np.testing.assert_allclose(np.diff(seconds(stamps)), 0.1, atol=1e-6)


def test_the_order_of_day_and_month_is_asked_where_both_go_on():
    with pytest.raises(ValueError, match="day and month cannot be told apart"):
        seconds(["05/11/2026 10:00:00", "07/11/2026 10:00:01"])


@pytest.mark.parametrize("drive", ["HV", "voltage", "amplifier output"])
def test_a_drive_without_unit_competes_with_its_monitor(tmp_path, drive):
    rows = [f"{row.split(',')[0]},{b:.0f},{b / 1000},{c:.6f}" for row, b, c in zip(ROWS, VOLTAGE, OUTPUT, strict=True)]
    message = refused_csv(tmp_path, f"time_s,{drive},monitor_V,displacement_mm\n" + "\n".join(rows))
    assert "two columns may be the input" in message and f"'{drive}', 'monitor_V'" in message
    # proposed is the first of them by role; "amplifier output" is named like an output, so its monitor comes first
    proposed = message.partition("; try: ")[2]
    first = (
        "--input-column monitor_V --input-scale SCALE"
        if drive == "amplifier output"
        else f"--input-column {drive} --input-unit UNIT"
    )
    assert first in proposed


def test_a_voltage_needs_two_rows(tmp_path):
    (tmp_path / "a.csv").write_text("time_s,voltage_V\n0,0\n0.1,100\n")
    (drive,) = read_voltage(tmp_path / "a.csv")
    np.testing.assert_array_equal(drive.voltage, [0, 100])
    (tmp_path / "a.csv").write_text("time_s,voltage_V\n0,0\n")
    with pytest.raises(BadInput, match="at least 2"):
        read_voltage(tmp_path / "a.csv")


def test_seconds_since_1970_need_no_unit(tmp_path):
    """Steps of 0.2 may be ms; a second clock that agrees and counts from 1970 shows that they are seconds."""
    steps = 0.2 * np.arange(len(TIME))
    rows = [f"{1.6e9 + t:.3f},{t:.1f},{row.split(',', 1)[1]}" for t, row in zip(steps, ROWS, strict=True)]
    names = "abstime,reltime,voltage_V,displacement_mm\n"
    (tmp_path / "a.csv").write_text(names + "\n".join(rows))
    (record,) = read(tmp_path / "a.csv")
    assert record.dt == pytest.approx(0.2, rel=1e-5)
    (tmp_path / "a.csv").write_text(names[8:] + "\n".join(row.split(",", 1)[1] for row in rows))
    with pytest.raises(BadInput, match="--time-unit"):
        read(tmp_path / "a.csv")


def test_clocks_of_infinite_values_are_refused_without_a_warning_of_numpy(tmp_path):
    rows = [f"{t},{row}" for t, row in zip(TIME, ROWS, strict=True)]
    rows[5] = f"inf,inf,{ROWS[5].split(',', 1)[1]}"
    (tmp_path / "a.csv").write_text("time,elapsed,voltage_V,displacement_mm\n" + "\n".join(rows))
    with pytest.raises(BadInput):
        read(tmp_path / "a.csv", input_unit="V")

"""Which column is the time, which the input, which the output, and in which unit."""

from typing import Any

import numpy as np
import pytest
from record_files import OUTPUT, TIME, VOLTAGE, T, columns, refused, refused_csv, save_csv, save_h5, text

from pitp_jax.common.units import from_base, spelt, to_base
from pitp_jax.files.containers.names import read_header
from pitp_jax.files.recordings.reading import read


@pytest.mark.parametrize("unit", ["V", "kV", "mV"])
@pytest.mark.parametrize("out", ["m", "mm", "um", "cm", "nm", "V", "mV"])
@pytest.mark.parametrize("clock", ["s", "ms", "us"])
def test_units(tmp_path, unit, out, clock):
    factors = {"V": 1, "kV": 1e3, "mV": 1e-3, "m": 1, "mm": 1e-3, "um": 1e-6, "cm": 1e-2, "nm": 1e-9}
    factors |= {"s": 1, "ms": 1e-3, "us": 1e-6}
    table = {f"time_{clock}": TIME, f"voltage_{unit}": VOLTAGE / 50, f"displacement_{out}": OUTPUT / 50}
    save_csv(tmp_path / "a.csv", table)
    (record,) = read(tmp_path / "a.csv")
    np.testing.assert_allclose(record.time, TIME * factors[clock], rtol=1e-14)
    np.testing.assert_allclose(record.voltage, VOLTAGE / 50 * factors[unit], rtol=1e-14)
    np.testing.assert_allclose(record.displacement, OUTPUT / 50 * factors[out], rtol=1e-14)
    assert (record.voltage_unit, record.displacement_unit) == (unit, out)
    back = from_base(record.displacement, out)
    np.testing.assert_allclose(back, OUTPUT / 50, rtol=1e-14)
    assert to_base(2.0, "kV") == 2000.0


@pytest.mark.parametrize(
    ("header", "stem", "unit"),
    [
        ("time_s", "time", "s"),
        ("Time (s)", "Time", "s"),
        ("t [ms]", "t", "ms"),
        ("Voltage (kV)", "Voltage", "kV"),
        ("Voltage, kV", "Voltage", "kV"),
        ("U/V", "U", "V"),
        ("Weg [µm]", "Weg", "um"),
        ("Weg / μm", "Weg", "um"),
        ("Weg in Mikron", "Weg in Mikron", None),
        ("displacement in microns", "displacement", "um"),
        ("Laser {Millimeter}", "Laser", "mm"),
        ("Voltage (amplifier)", "Voltage (amplifier)", None),
        ("voltage_command_V", "voltage_command", "V"),
        ("Zeit", "Zeit", None),
        ("voltage_MV", "voltage_MV", None),  # a megavolt, and no millivolt
        ("V(in)", "V(in)", None),  # of a SPICE program: the node called in, no inches
        ("x (in)", "x", "inch"),
        ("V(mm)", "V", "mm"),
    ],
)
def test_headers_as_people_write_them(header, stem, unit):
    seen = read_header(header)
    assert (seen.stem, seen.unit) == (stem, unit)


def test_an_index_in_brackets_is_no_unknown_unit():
    assert read_header("joint_states.position[2]").unknown is None
    assert read_header("position [furlong]").unknown == "furlong"


def test_spellings():
    assert [spelt(w) for w in ("Volts", "kv", "sec", "Âµm", "micron", "furlong", "")] == [
        "V", "kV", "s", "um", "um", None, None,
    ]  # fmt: skip


@pytest.mark.parametrize(
    "names",
    [
        ("Time (s)", "Voltage (V)", "Displacement (mm)"),
        ("t [s]", "U [V]", "x [mm]"),
        ("Zeit [s]", "Spannung [V]", "Weg [mm]"),
        ("t/s", "U/V", "Weg/mm"),
        ("elapsed seconds (s)", "HV out (V)", "keyence (mm)"),
        ("time", "Dev1/ai0 (V)", "height_mm"),
        ("Temps (s)", "Tension (V)", "Déplacement (mm)"),
    ],
)
def test_columns_are_found_by_name_and_unit(tmp_path, names):
    save_csv(tmp_path / "a.csv", dict(zip(names, (TIME, VOLTAGE, OUTPUT), strict=True)))
    (record,) = read(tmp_path / "a.csv")
    np.testing.assert_array_equal(record.voltage, VOLTAGE)
    np.testing.assert_allclose(record.displacement, OUTPUT * 1e-3, rtol=1e-14)
    assert record.recognised["input"] == f"{names[1]!r} in V"


def test_all_that_is_missing_in_all_files_is_told_at_once(tmp_path):
    for name in ("a", "b"):
        save_csv(tmp_path / f"{name}.csv", {"clock": TIME, "one": VOLTAGE, "two": OUTPUT})
    save_csv(tmp_path / "c.csv", {"t": TIME, "u": VOLTAGE, "x": OUTPUT})
    save_csv(tmp_path / "d.csv", columns())
    message = refused(tmp_path)
    for word in ("3 of 4 files", "a.csv", "b.csv", "c.csv", "--input-column one", "--output-column two"):
        assert word in message, word
    assert message.count("is missing") == 2  # the input and the output, alike refusals once
    assert len(message) <= 600
    read(tmp_path / "c.csv", input_unit="V", output_unit="mm")


def test_units_and_scales_can_be_given(tmp_path):
    """An amplifier's monitor of 1 V per kV and a laser of 2 mm per V, as a DAQ records them."""
    save_csv(tmp_path / "a.csv", {"t": TIME, "ai0 (V)": VOLTAGE / 1000, "ai1 (V)": OUTPUT / 2})
    assert "two columns may be" in refused(tmp_path / "a.csv")
    picked: dict[str, Any] = {"input_column": "ai0 (V)", "output_column": "ai1 (V)"}
    (record,) = read(tmp_path / "a.csv", **picked, input_scale=1000, output_scale=0.002)
    np.testing.assert_allclose(record.voltage, VOLTAGE, rtol=1e-14)
    np.testing.assert_allclose(record.displacement, OUTPUT * 1e-3, rtol=1e-12)
    assert (record.voltage_unit, record.displacement_unit) == ("V", "mm")
    assert "times 1000" in record.recognised["input"]
    (record,) = read(tmp_path / "a.csv", **picked, output_unit="mV")
    assert record.displacement_unit == "mV"
    save_csv(tmp_path / "a.csv", {"u": VOLTAGE, "x": OUTPUT})
    (record,) = read(tmp_path / "a.csv", input_unit="V", output_unit="mm", rate=500)
    assert record.dt == pytest.approx(2e-3)
    assert "--rate" in refused(tmp_path / "a.csv", input_unit="V", output_unit="mm")


@pytest.mark.parametrize(
    ("option", "word"),
    [({"input_unit": "MV"}, "--input-unit"), ({"rate": -1}, "--rate"), ({"output_scale": 0}, "--output-scale")],
)
def test_options_that_mean_nothing_are_refused(tmp_path, option, word):
    save_csv(tmp_path / "a.csv", columns())
    assert word in refused(tmp_path / "a.csv", **option)


def test_a_clock_without_unit_is_seconds_or_asked_about(tmp_path):
    save_csv(tmp_path / "a.csv", columns(time_s=None, time=TIME))
    (record,) = read(tmp_path / "a.csv")
    assert record.dt == pytest.approx(1e-3)
    assert "taken as seconds" in record.recognised["time"]
    save_csv(tmp_path / "a.csv", columns(time_s=None, time=np.arange(T)))
    assert "--time-unit" in refused(tmp_path / "a.csv")
    assert read(tmp_path / "a.csv", time_unit="ms")[0].dt == pytest.approx(1e-3)
    assert read(tmp_path / "a.csv", rate=100)[0].dt == pytest.approx(1e-2)
    save_csv(tmp_path / "a.csv", columns(time_s=None, time=TIME / 60))  # minutes, for all that the file says
    assert read(tmp_path / "a.csv", rate=1000)[0].dt == pytest.approx(1e-3)


def test_two_matches_need_a_choice(tmp_path):
    path = tmp_path / "a.csv"
    save_csv(path, columns(voltage_kV=VOLTAGE / 1000))
    assert "--input-column" in refused(path)
    assert read(path, input_column="voltage_kV")[0].voltage[0] == VOLTAGE[0]
    save_csv(path, columns(displacement_V=OUTPUT))
    assert "--output-column" in refused(path)
    assert read(path, output_column="displacement_V")[0].displacement_unit == "V"
    save_csv(path, columns(time_ms=TIME * 2000))
    assert "two columns may be" in refused(path)
    save_csv(path, columns(time_ms=TIME * 1000 + 5))
    assert read(path)[0].dt == pytest.approx(1e-3)  # they agree
    save_csv(path, columns(voltage_V=None, **{"Voltage (V)": VOLTAGE, "Monitor (V)": VOLTAGE}))
    assert "--input-column" in refused(path)
    path.write_text(text(columns()).replace("displacement_mm", "voltage_V", 1))
    assert "rename or delete" in refused(path)


def test_the_exact_name_wins_and_that_is_told(tmp_path):
    path = tmp_path / "a.csv"
    save_csv(path, columns(voltage_command_V=2 * VOLTAGE, note=["abc"] * T, laser_um=OUTPUT))
    (record,) = read(path)
    assert record.voltage[0] == VOLTAGE[0]
    assert "other candidates: 'voltage_command_V'" in record.recognised["input"]
    assert read(path, input_column="voltage_command_V")[0].voltage[0] == 2 * VOLTAGE[0]
    assert read(path, output_column="laser_um")[0].displacement_unit == "um"
    assert "unit" in refused(path, input_column="note")
    assert "missing" in refused(path, input_column="nothing_V")
    assert read(path, output_column="voltage_V")[0].voltage[0] == 2 * VOLTAGE[0]  # what is said of one leaves the other
    assert "chosen twice" in refused(path, output_column="voltage_V", input_column="voltage_V")


def test_units_beside_the_data_count(tmp_path):
    save_h5(tmp_path / "a.h5", {"t": TIME, "u": VOLTAGE / 1000, "x": OUTPUT})
    assert "--output-unit" in refused(tmp_path / "a.h5")
    import h5py

    with h5py.File(tmp_path / "a.h5", "r+") as file:
        for name, unit in (("t", "s"), ("u", b"kV"), ("x", np.bytes_("mm"))):
            file[name].attrs["unit"] = unit
    (record,) = read(tmp_path / "a.h5")
    np.testing.assert_allclose(record.voltage, VOLTAGE, rtol=1e-14)
    assert record.displacement_unit == "mm"


@pytest.mark.parametrize("name", ["HV 1:1000 (V)", "Monitor 1000:1 [V]", "voltage x1000 (V)", "U (V) x10"])
def test_a_factor_in_a_name_is_asked(tmp_path, name):
    """A monitor's volts were read as the amplifier's, a thousandth of them; a scale or a unit says what they are."""
    body = f"time (s),{name},laser (mm)\n" + "".join(f"{k / 100},{k % 7},{k % 5}\n" for k in range(200))
    why = refused_csv(tmp_path, body)
    assert "the unknown unit 'V, " in why and "--input-unit" in why
    path = next(tmp_path.glob("*.csv"))
    for options in ({"input_unit": "kV"}, {"input_scale": 1000.0}):
        (record,) = read(path, input_column=name, output_column="laser (mm)", **options)
        assert record.voltage.max() == pytest.approx(6000.0)
    path.write_text(body.replace(name, "channel 1:2 (V)"))
    assert read(path)[0].voltage.max() == pytest.approx(6.0)

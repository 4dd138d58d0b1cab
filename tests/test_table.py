"""Files to columns: units against pint, names, dialects with random names and units, what must be asked, pitp.toml."""

import shlex
from datetime import UTC, datetime, timedelta
from typing import Any

import h5py
import numpy as np
import pint
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from record_files import OUTPUT, TIME, VOLTAGE, T, columns, refused, save_csv, save_xlsx, text

import pitp_jax as pitp
from pitp_jax.common.errors import BadInput
from pitp_jax.common.units import INPUT_UNITS, TIME_UNITS, base_unit, column_name, from_base, spelt, to_base
from pitp_jax.files.containers.names import read_header
from pitp_jax.files.containers.options import folder_file
from pitp_jax.files.recordings.reading import read

QUIET = settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
FEW = settings(QUIET, max_examples=8)
_PINT = {"rev": "turn", "deg/s": "degree/second", "N m": "newton*meter", "mN m": "millinewton*meter", "m/s2": "m/s**2"}
_PINT |= {"counts": "count", "h": "hour", "d": "day", "min": "minute"}


@pytest.fixture(scope="module")
def registry():
    return pint.UnitRegistry()


@pytest.mark.parametrize("unit", [*TIME_UNITS, *INPUT_UNITS])
def test_every_factor_is_pints(unit, registry):
    name, base = (_PINT.get(u, u) for u in (unit, base_unit(unit)))
    assert to_base(1.0, unit) == pytest.approx(registry.Quantity(1.0, name).to(base).magnitude, rel=1e-14)
    assert from_base(to_base(2.5, unit), unit) == pytest.approx(2.5, rel=1e-15)
    assert spelt(unit) == unit


@pytest.mark.parametrize(
    ("header", "unit", "unknown"),
    [
        ("Field V/um", None, "V/um"),
        ("stiffness N/m", None, "N/m"),
        ("d33 pm/V", None, "pm/V"),
        ("v_m/s", "m/s", None),
        ("Time (100us)", None, "100us"),
        ("Temp (degC)", "degC", None),
        ("Channel A", None, None),
        ("motor current A", "A", None),
        ("C1 in V", "V", None),
        ("電圧（kV）", "kV", None),
        ("変位（㎜）", "mm", None),
        ("Перемещение, мкм", "um", None),
        ("torque [Nm]", "N m", None),
        ("length [nm]", "nm", None),
        ("acc (m/s²)", "m/s2", None),
        ("angle_deg", "deg", None),
        ("theta_m", None, None),
        ("cmd_m", "m", None),
        ("pos_m", "m", None),
        ("101 <HV> (VDC)", "V", None),
        ("Weg..mm.", "mm", None),
        ("HV, kV (LGR S/N: 10, SEN S/N: 11)", "kV", None),
        ("Displacement (in)", "inch", None),
        ("travel in", None, None),
        ("Position [cnt]", "counts", None),
        ("Time (sec.)", "s", None),
    ],
)
def test_units_in_headers(header, unit, unknown):
    seen = read_header(header)
    assert (seen.unit, seen.unknown) == (unit, unknown)


def csv_of(path, names, values, separator=",", above=(), below=()):
    rows = [*above, separator.join(names), *below]
    rows += [separator.join(f"{v:.9g}" for v in row) for row in zip(*values, strict=True)]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def tried(message: str) -> dict[str, Any]:
    """The options that a refusal ends with."""
    assert len(message) <= 587, len(message)  # `pitp: error: ` stands before it
    words = shlex.split(message.rpartition("; try: ")[2])
    kinds = {"rate": float, "input_scale": float, "output_scale": float, "header_line": int}
    options = dict(zip((w[2:].replace("-", "_") for w in words[::2]), words[1::2], strict=True))
    return {k: v if v.isupper() and len(v) > 2 else kinds.get(k, str)(v) for k, v in options.items()}


WORDS = st.sampled_from(["Rig 3", "drive", "Kanal 1", "HV out", "probe", "AI 0", "Keyence", "elapsed", "a b", "x"])
LENGTHS, VOLTS = st.sampled_from(["m", "mm", "um", "cm", "nm"]), st.sampled_from(["V", "kV", "mV"])
CLOCKS = st.sampled_from(["s", "ms", "us"])


def same(record, drive, motion, rtol=1e-6):
    np.testing.assert_allclose(record.voltage, drive, rtol=rtol, atol=rtol * np.ptp(drive))
    np.testing.assert_allclose(record.displacement, motion, rtol=rtol, atol=rtol * np.ptp(motion))
    np.testing.assert_allclose(record.time - record.time[0], TIME, atol=1e-8)


def test_a_column_called_elapsed_that_is_in_grams_is_no_clock(tmp_path):
    values = [TIME, VOLTAGE, OUTPUT / 50, TIME + 20]
    path = csv_of(tmp_path / "a.csv", ["drive 0", "drive 1", "drive 2", "elapsed"], values, below=["s,V,m,g"])
    same(read(path)[0], VOLTAGE, OUTPUT / 50)


@pytest.mark.slow
@QUIET
@given(data=st.data())
def test_units_rows_below_any_names(tmp_path, data):
    """Names of any words over a row of units: the units choose the columns, others beside are left."""
    clock, volts, length = data.draw(CLOCKS), data.draw(VOLTS), data.draw(LENGTHS)
    other = data.draw(st.sampled_from(["degC", "g", "-", "N"]))
    names = [f"{data.draw(WORDS)} {k}" for k in range(3)]
    names.append("spare 3" if other == "-" else f"{data.draw(WORDS)} 3")  # no unit: its name would be asked about
    values = [from_base(TIME, clock), from_base(VOLTAGE, volts), from_base(OUTPUT / 50, length), TIME + 20]
    order = data.draw(st.permutations(range(4)))
    units = [clock, volts, length, other]
    bracket = data.draw(st.sampled_from(["{}", "({})", "[{}]"]))
    row = ";".join(bracket.format(units[k]) for k in order)
    above = data.draw(st.sampled_from([(), ("Rig 3;;;",), ("Date: 24 Nov", "Operator;lab;;")]))
    path = csv_of(tmp_path / "a.csv", [names[k] for k in order], [values[k] for k in order], ";", above, [row])
    same(read(path)[0], VOLTAGE, OUTPUT / 50)


@pytest.mark.slow
@QUIET
@given(data=st.data())
def test_labview_measurements(tmp_path, data):
    """Signed by LabVIEW: separator, decimal mark, names of several words and units of any channel."""
    decimal, mark = data.draw(st.sampled_from(".,")), data.draw(st.sampled_from(["\t", ""]))
    volts, length = data.draw(st.sampled_from(["Volts", "kV"])), data.draw(st.sampled_from(["Millimeters", "um"]))
    head = ["LabVIEW Measurement", "Writer_Version\t2", "Separator\tTab", f"Decimal_Separator\t{decimal}"]
    head += ["X_Columns\tOne", "***End_of_Header***\t", "", "Channels\t2", f"Y_Unit_Label\t{volts}\t{length}"]
    head += ["X_Dimension\tTime\tTime", "X0\t0.0\t0.0", "Delta_X\t0.001\t0.001", "***End_of_Header***\t\t"]
    head += [f"X_Value\t{data.draw(WORDS)} in\t{data.draw(WORDS)} beside\tComment"]
    drive, motion = VOLTAGE / (1000 if volts == "kV" else 1), OUTPUT * (1000 if length == "um" else 1)
    rows = [
        "\t".join(f"{v:.9f}" for v in row).replace(".", decimal) + mark for row in zip(TIME, drive, motion, strict=True)
    ]
    (tmp_path / "a.lvm").write_text("\n".join(head + rows) + "\n")
    same(read(tmp_path / "a.lvm")[0], VOLTAGE, OUTPUT * 1e-3)


@pytest.mark.slow
@QUIET
@given(data=st.data())
def test_twincat_scopes(tmp_path, data):
    volts, length = data.draw(VOLTS), data.draw(LENGTHS)
    pairs = {"Name": ("a b", "c"), "SymbolName": ("M.a", "M.c"), "SampleTime[ms]": ("1", "1"), "Unit": (volts, length)}
    head = ["Name\tscope", "", *(f"{key}\t{a}\t{key}\t{b}" for key, (a, b) in pairs.items()), ""]
    values = (TIME * 1e3, from_base(VOLTAGE, volts), TIME * 1e3, from_base(OUTPUT / 50, length))
    rows = ["\t".join(f"{v:.9g}" for v in row) for row in zip(*values, strict=True)]
    (tmp_path / "a.txt").write_text("\n".join(head + rows))
    same(read(tmp_path / "a.txt")[0], VOLTAGE, OUTPUT / 50)


@pytest.mark.slow
@QUIET
@given(
    script=st.sampled_from([
        ("cp1252", "Zeit [s]", "Höhe über Spannung [kV]", "Weg [µm]", "um"),
        ("cp932", "時間[s]", "高電圧[kV]", "変位[mm]", "mm"),
        ("gb18030", "时间(s)", "电压(kV)", "位移(mm)", "mm"),
        ("cp1251", "Время, мс", "Напряжение, кВ", "Перемещение, мм", "mm"),
    ]),
    order=st.permutations(range(3)),
)  # fmt: skip
def test_encodings_are_told_apart_by_columns_and_units(tmp_path, script, order):
    encoding, *names, unit = script
    clock = 1e3 if "мс" in names[0] else 1.0
    values = (TIME * clock, VOLTAGE / 1000, from_base(OUTPUT / 50, unit))
    body = csv_of(tmp_path / "a.csv", [names[k] for k in order], [values[k] for k in order], ";").read_text("utf-8")
    (tmp_path / "a.csv").write_bytes(body.encode(encoding))
    record = read(tmp_path / "a.csv")[0]
    same(record, VOLTAGE, OUTPUT / 50)
    assert encoding in record.recognised["file"] or encoding == "cp1252"


@pytest.mark.slow
@QUIET
@given(data=st.data())
def test_channels_of_a_scope_are_asked_about_and_the_command_answers(tmp_path, data):
    """Two channels in volts and no name that tells: refused, with the complete command to try."""
    first, second = data.draw(
        st.sampled_from([("CH1", "CH2"), ("Channel A", "Channel B"), ("1", "2"), ("C1 in V", "C2 in V")])
    )
    head, rows = data.draw(
        st.sampled_from([("X", "Second,Volt,Volt"), ("x-axis", "second,Volt,Volt"), ("Time", "(s),(V),(V)")])
    )
    path = csv_of(tmp_path / "a.csv", [head, first, second], (TIME, VOLTAGE / 1000, OUTPUT / 2), below=[rows])
    options = tried(refused(path))
    assert (options["input_column"], options["output_column"]) == (first, second)
    assert options["input_scale"] == options["output_scale"] == "SCALE"
    same(read(path, **{**options, "input_scale": 1000.0, "output_scale": 0.002})[0], VOLTAGE, OUTPUT * 1e-3)


def test_row_names_of_r_are_no_time(tmp_path):
    for separator in (" ", ","):
        rows = [separator.join(f'"{n}"' for n in columns())]
        rows += [
            separator.join((f'"{k + 1}"', *map(str, row)))
            for k, row in enumerate(zip(*columns().values(), strict=True))
        ]
        (tmp_path / "a.txt").write_text("\n".join(rows))
        same(read(tmp_path / "a.txt")[0], VOLTAGE, OUTPUT * 1e-3)
    (tmp_path / "a.txt").write_text("\n".join(rows).replace('"7"', '"9"'))
    assert "3 column names, but 4 cells in the rows below" in refused(tmp_path / "a.txt")


@pytest.mark.parametrize(
    ("names", "below", "word"),
    [
        (
            ("Time (s)", "Voltage (kV)", "Displacement (mm)"),
            ["s,V,V"],
            "has two units, kV in its name and V in its unit",
        ),
        (("Time (fortnights)", "Voltage (V)", "Displacement (mm)"), [], "unknown unit 'fortnights'"),
        (("t", "U (kV)", "Field V/um"), [], "the output (displacement_mm"),
        (("time_s", "Voltage", "Load cell (mV)"), [], "two columns may be the input"),
        (("time_s", "Input (V)", "Output (V)"), [], "ports of the DAQ"),
        (("time_s", "cmd 1 [rad]", "cmd 2 [rad]"), [], "two columns may be the input"),
    ],
)
def test_what_is_not_certain_is_asked(tmp_path, names, below, word):
    assert word in refused(csv_of(tmp_path / "a.csv", names, (TIME, VOLTAGE, OUTPUT), below=below))


def test_a_clock_that_ticks_in_fractions_of_known_units(tmp_path):
    path = csv_of(tmp_path / "a.csv", ("Time (msecs)", "Voltage (V)", "x (mm)"), (TIME * 1e3, VOLTAGE, OUTPUT))
    same(read(path)[0], VOLTAGE, OUTPUT * 1e-3)
    path = csv_of(tmp_path / "a.csv", ("Time (h)", "Voltage (V)", "x (mm)"), (TIME / 3600, VOLTAGE, OUTPUT))
    same(read(path)[0], VOLTAGE, OUTPUT * 1e-3, 1e-5)


def test_comments_are_units_only_as_whole_lists_of_pairs(tmp_path):
    path = csv_of(tmp_path / "a.csv", columns(), columns().values(), above=["# time_s: min 0 max 0.8", "# voltage: v2"])
    same(read(path)[0], VOLTAGE, OUTPUT * 1e-3)


@pytest.mark.parametrize(
    ("unit", "other", "names"),
    [
        ("rad", "rad", ("cmd", "position")), ("deg", "deg", ("setpoint", "measured")), ("bar", "mm", ("p", "x")),
        ("N m", "deg", ("torque", "joint")), ("A", "rad/s", ("current", "speed")), ("percent", "rpm", ("pwm", "n")),
        ("V", "bar", ("valve", "p")), ("psi", "rev", ("p", "angle")), ("counts", "counts", ("cmd", "encoder")),
    ],
)  # fmt: skip
def test_units_of_any_machine(tmp_path, unit, other, names):
    """Commands drive and measurements answer, efforts drive and motions answer; written and read back in base units."""
    heads = ["time_s", f"{names[0]} [{unit}]", f"{names[1]} [{other}]"]
    (record,) = read(csv_of(tmp_path / "a.csv", heads, (TIME, VOLTAGE, OUTPUT + 2)))
    np.testing.assert_allclose(record.voltage, to_base(VOLTAGE, unit), rtol=1e-8)
    np.testing.assert_allclose(record.displacement, to_base(OUTPUT + 2, other), rtol=1e-8)
    assert (record.voltage_unit, record.displacement_unit) == (unit, other) and f" {other}" in repr(record)
    written = {"time_s": TIME, column_name("voltage", unit): VOLTAGE, column_name("displacement", other): OUTPUT + 2}
    save_csv(tmp_path / "b.csv", written)
    np.testing.assert_allclose(read(tmp_path / "b.csv")[0].voltage, record.voltage, rtol=1e-8)


def test_a_voltage_with_a_length_keeps_precedence(tmp_path):
    heads = ["time_s", "HV [kV]", "force [N]", "current [mA]", "laser [mm]", "humidity [%]"]
    (record,) = read(csv_of(tmp_path / "a.csv", heads, (TIME, VOLTAGE / 1000, TIME, TIME, OUTPUT, TIME)))
    assert (record.voltage_unit, record.displacement_unit) == ("kV", "mm")


def test_a_clock_that_repeats_gives_way_to_the_rate(tmp_path):
    path = csv_of(tmp_path / "a.csv", ("t [ms]", "U [V]", "x [mm]"), (np.floor(TIME * 1e3 / 4), VOLTAGE, OUTPUT))
    assert tried(refused(path))["rate"] == "RATE"
    (record,) = read(path, rate=1000)
    same(record, VOLTAGE, OUTPUT * 1e-3)
    assert "timed by --rate instead of the clock" in record.recognised["remarks"][0]


def test_empty_rows_without_a_clock_are_lost_samples(tmp_path):
    lines = text(columns(time_s=None)).split("\n")
    lines[50:50] = [","] * 5
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert "input is missing" in refused(tmp_path / "a.csv", rate=1000)
    lines[50:55] = [""] * 5
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert "empty lines" in refused(tmp_path / "a.csv", rate=1000)


def test_a_row_with_a_time_alone_is_a_lost_sample(tmp_path):
    time = np.arange(400) / 1000
    rows = [f"{t:.3f},{1000 * np.sin(12 * t):.3f},{np.cos(12 * t):.6f}" for t in time]
    rows[50] = "0.050,,"
    (tmp_path / "a.csv").write_text("\n".join(["time_s,voltage_V,displacement_mm", *rows]))
    (record,) = read(tmp_path / "a.csv")
    assert record.recognised["lost"] == 1 and np.flatnonzero(np.isnan(record.displacement)).tolist() == [50]
    np.testing.assert_allclose(record.voltage, 1000 * np.sin(12 * time), atol=0.1)


def test_channels_of_tdms_have_their_own_clocks(tmp_path):
    nptdms = pytest.importorskip("nptdms")

    def write(*steps):
        names = ("Temp", 20 + TIME, "degC"), ("HV", VOLTAGE, "V"), ("Laser", OUTPUT, "mm")
        with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
            clocks = [{"wf_increment": dt, "wf_start_offset": 0.0} for dt in steps]
            writer.write_segment([
                nptdms.ChannelObject("run", n, v, properties={"unit_string": u, **clock})
                for (n, v, u), clock in zip(names, clocks, strict=True)
            ])  # fmt: skip
        return tmp_path / "a.tdms"

    same(read(write(1e-2, 1e-3, 1e-3))[0], VOLTAGE, OUTPUT * 1e-3)
    (slow,) = read(write(1e-3, 1e-3, 1e-2))  # the input of each step of the output: its mean there
    np.testing.assert_allclose(slow.displacement, OUTPUT * 1e-3, rtol=1e-6)
    np.testing.assert_allclose(slow.voltage[:5], VOLTAGE[:50].reshape(5, 10).mean(1), rtol=1e-6)


@pytest.mark.parametrize(
    "form", ["%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S", "%Y.%m.%d %H:%M:%S", "%d.%m.%Y %H:%M:%S", "%m/%d/%Y %I:%M:%S %p"]
)
def test_dates_over_midnight(tmp_path, form):
    start = datetime(2026, 11, 5, 23, 59, 30)
    stamps = [(start + timedelta(seconds=k)).strftime(form) for k in range(T)]
    save_csv(tmp_path / "a.csv", {"Zeit": stamps, "U [V]": VOLTAGE, "Weg [mm]": OUTPUT})
    (record,) = read(tmp_path / "a.csv")
    np.testing.assert_allclose(record.time - record.time[0], np.arange(T), atol=1e-6)


def test_stamps_of_a_serial_monitor(tmp_path):
    """It writes the hour and an arrow before what the board sent."""
    start, sent = datetime(2026, 11, 24, 23, 59, 59, 950_000), zip(VOLTAGE, OUTPUT, strict=True)
    lines = [f"{start + timedelta(milliseconds=k):%H:%M:%S.%f} -> {u:.17g},{x:.17g}\n" for k, (u, x) in enumerate(sent)]
    (tmp_path / "a.txt").write_text("".join(lines))
    said = {"time_column": "1", "input_column": "2", "output_column": "3", "input_unit": "V", "output_unit": "mm"}
    (record,) = read(tmp_path / "a.txt", **said)
    same(record, VOLTAGE, OUTPUT * 1e-3)


def test_minutes_or_hours_are_asked_about(tmp_path):
    save_csv(tmp_path / "a.csv", {"Zeit": [f"00:{k % 60:02d}" for k in range(T)], "U [V]": VOLTAGE, "Weg [mm]": OUTPUT})
    assert "expected hh:mm:ss" in refused(tmp_path / "a.csv")


def test_lines_of_header_and_units_can_be_said(tmp_path):
    above = ["p,q,r", "alpha,beta,gamma", "s,V,mm"]
    path = csv_of(tmp_path / "a.csv", ("note", "by", "hand"), (TIME, VOLTAGE, OUTPUT), above=above)
    said: dict[str, Any] = {"header_line": 2, "units_line": "3"}
    (record,) = read(path, **said)
    same(record, VOLTAGE, OUTPUT * 1e-3)
    assert "'alpha' in s" in record.recognised["time"]
    for wrong in (
        {"header_line": 0},
        {"units_line": "x"},
        {"separator": "ab"},
        {"decimal": ";"},
        {"encoding": "klingon"},
    ):
        assert f"--{next(iter(wrong)).replace('_', '-')}" in refused(path, **wrong)
    assert "is not an option" in refused(path, colour="red")


def test_a_folder_file_speaks_for_its_files_and_not_for_ours(tmp_path):
    csv_of(tmp_path / "scope.csv", ("X", "CH1", "CH2"), (TIME, VOLTAGE / 1000, OUTPUT / 2), below=["s,V,V"])
    save_csv(tmp_path / "ours.csv", {"time_s": TIME, "voltage_V": VOLTAGE, "displacement_m": OUTPUT * 1e-3})
    (tmp_path / "pitp.toml").write_text(
        '["*.csv"]\ninput-column = "CH1"\noutput-column = "CH2"\ninput-scale = 1000\noutput-scale = 0.002\n'
    )
    for record in read(tmp_path):
        same(record, VOLTAGE, OUTPUT * 1e-3)
    assert read(tmp_path / "scope.csv", output_scale=0.004)[0].displacement[9] == pytest.approx(OUTPUT[9] * 2e-3)
    (tmp_path / "pitp.toml").write_text('["*.csv"]\ncolour = "red"\n')
    assert "colour: unknown key" in refused(tmp_path / "scope.csv")


def test_options_that_all_files_share_are_written_once(tmp_path):
    """The written file reads another file of the same kind, too; different options are kept apart."""
    for name, gain in (("a[1].csv", 1000), ("b.csv", 1000), ("new.csv", 1000), ("apart.csv", 500)):
        csv_of(tmp_path / name, ("X", "CH1", "CH2"), (TIME, VOLTAGE / gain, OUTPUT / 2), below=["s,V,V"])
    shared = {"input_column": "CH1", "output_column": "CH2", "output_scale": 0.002}
    said = {}
    for name, gain in (("a[1].csv", 1000), ("b.csv", 1000)):
        said[name] = read(tmp_path / name, **shared, input_scale=gain)[0].recognised["options"]
    (tmp_path / "pitp.toml").write_text(folder_file(said))
    assert (tmp_path / "pitp.toml").read_text().count("input-scale") == 1
    same(read(tmp_path / "new.csv")[0], VOLTAGE, OUTPUT * 1e-3)
    said["apart.csv"] = read(tmp_path / "apart.csv", input_scale=500)[0].recognised["options"]
    (tmp_path / "pitp.toml").write_text(folder_file(said))
    for name in said:
        same(read(tmp_path / name)[0], VOLTAGE, OUTPUT * 1e-3)


@pytest.mark.parametrize(
    "each",
    [
        'each = ["up=CH1,CH2", "down=CH1,CH3"]',
        '["*.csv".each]\nup = "CH1,CH2"\ndown = "CH1,CH3"',
        '["*.csv".each]\nup = ["CH1", "CH2"]\ndown = ["CH1", "CH3"]',
    ],
)
def test_joints_of_a_folder(tmp_path, each):
    names = ("time_s", "CH1", "CH2", "CH3")
    csv_of(tmp_path / "log.csv", names, (*columns().values(), -columns()["displacement_mm"]))
    (tmp_path / "pitp.toml").write_text(f'["*.csv"]\ninput-unit = "V"\noutput-unit = "mm"\n{each}\n')
    for joint, sign in (("up", 1), ("down", -1)):
        same(read(tmp_path, joint=joint)[0], VOLTAGE, sign * OUTPUT * 1e-3)
    assert "names up, down; give joint=NAME" in refused(tmp_path)
    assert "has no joint 'left'" in refused(tmp_path, joint="left")
    same(read(tmp_path, input_column="CH1", output_column="CH2")[0], VOLTAGE, OUTPUT * 1e-3)


@pytest.mark.parametrize("each", ['["up=CH1"]', '["up=CH1,CH2", "up=CH1,CH3"]', '["up"]', '"up=CH1,CH2"'])
def test_joints_of_another_form_are_refused(tmp_path, each):
    save_csv(tmp_path / "log.csv", columns())
    (tmp_path / "pitp.toml").write_text(f'["*.csv"]\neach = {each}\n')
    assert "joint" in refused(tmp_path)


def test_several_runs_in_one_file(tmp_path):
    path = csv_of(tmp_path / "a.csv", (*columns(), "run"), (*columns().values(), np.arange(T) // 50 + 1))
    assert "64" in refused(path, split_by="run")
    wide = {n: np.concatenate([v, v]) for n, v in columns().items()}
    path = csv_of(tmp_path / "a.csv", (*wide, "run"), (*wide.values(), np.repeat([3, 7], T)))
    records = read(path, split_by="run")
    assert [r.name for r in records] == ["a.3", "a.7"]
    for record in records:
        same(record, VOLTAGE, OUTPUT * 1e-3)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        for run in ("up", "down"):
            for name, values in columns().items():
                file[f"{run}/{name}"] = values
    assert [r.name for r in read(tmp_path / "b.h5", split_by="group")] == ["b.down", "b.up"]


def test_units_in_matlab_only_where_they_suit(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"disp": OUTPUT, "time": TIME, "voltage": VOLTAGE, "units": "s, V, mm"})
    assert "--output-unit" in refused(tmp_path / "a.mat")
    scipy.io.savemat(tmp_path / "a.mat", {"data": columns(), "settings": {"rate": 1000.0, "gain": 3.0}})
    same(read(tmp_path / "a.mat")[0], VOLTAGE, OUTPUT * 1e-3)


def test_alike_files_are_refused_once(tmp_path):
    for k in range(20):
        csv_of(tmp_path / f"{k:02d}.csv", ("X", "CH1", "CH2"), (TIME, VOLTAGE / 1000, OUTPUT / 2), below=["s,V,V"])
    message = refused(tmp_path)
    assert message.startswith("20 of 20 files are refused: 00.csv, 01.csv, 02.csv and 17 more")
    assert len(message) < 587 and message.count("; try: ") == 1
    assert tried(message)["input_column"] == "CH1"


def test_names_stay_unique(tmp_path):
    """A record that is split at its gap beside a file that has that name already; folders of one name."""
    t = np.concatenate([TIME, TIME + 10])
    u = 1000 + 500 * np.sin(2 * np.pi * 5 * t)
    save_csv(tmp_path / "a.csv", {"time_s": t, "voltage_V": u, "displacement_mm": np.sin(9 * t)})
    save_csv(tmp_path / "a.1.csv", columns())
    names = [r.name for r in read(tmp_path)]
    assert len(set(names)) == len(names) == 3
    for day in ("day1", "day2"):
        (tmp_path / day / "records").mkdir(parents=True)
        save_csv(tmp_path / day / "records" / "s.csv", columns())
    both = read(tmp_path / "day1" / "records", tmp_path / "day2" / "records")
    assert [r.name for r in both] == ["day1/records/s", "day2/records/s"]


def test_a_record_owns_its_samples():
    span = np.arange(T) * np.timedelta64(1, "ms")
    masked = np.ma.array(OUTPUT.copy(), mask=TIME > 0.09)
    record = pitp.Record("x", span, VOLTAGE, masked)
    assert record.dt == pytest.approx(1e-3) and record.missing == int((TIME > 0.09).sum())
    masked.data[0] = 3.0
    assert record.displacement[0] == OUTPUT[0]
    assert record in [record]
    with pytest.raises(BadInput, match="furlong"):
        pitp.Record("x", TIME, VOLTAGE, OUTPUT, displacement_unit="furlong")
    epoch = pitp.Record("x", 1.8e9 + np.arange(T) / 1e5, VOLTAGE, OUTPUT)
    assert epoch.dt == pytest.approx(1e-5, rel=1e-3)


@pytest.mark.parametrize("step", [0.2, 1.0, 1e-3 / 86400])
def test_a_clock_without_a_unit_that_need_not_be_in_seconds_is_asked_about(tmp_path, step):
    """Tenths of milliseconds, counts and the days of a spreadsheet; with all else that is wrong in the same line."""
    clock = 46350.4 * (step < 1e-3) + np.arange(T) * step
    heads = ("Time", "U (V)", "x (mm)")
    save_csv(tmp_path / "a.csv", dict(zip(heads, (clock, VOLTAGE, OUTPUT), strict=True)))
    assert tried(refused(tmp_path / "a.csv")) == {"time_unit": "UNIT"}
    save_csv(tmp_path / "a.csv", dict(zip(("Time", "U", "x (mm)"), (clock, VOLTAGE, OUTPUT), strict=True)))
    assert tried(refused(tmp_path / "a.csv")) == {"time_unit": "UNIT", "input_unit": "UNIT"}


@FEW
@given(data=st.data())
def test_rows_that_begin_with_a_key(tmp_path, data):
    """`TraceName,CH1,CH2` and `VUnit,V,V` among settings with numbers; rows of numbers begin with an empty cell."""
    separator = data.draw(st.sampled_from([",", "\t"]))
    volts, length = data.draw(VOLTS), data.draw(LENGTHS)
    named, united = data.draw(
        st.sampled_from([("TraceName", "VUnit"), ("ChannelTitle=", "UnitName="), ("Name", "Unit")])
    )
    settings_ = [["BlockSize", "300", "300"], ["Range", "10", "5"], ["SampleRate", "1000", "1000"]]
    head = [[named, f"{data.draw(WORDS)} 1", f"{data.draw(WORDS)} 2"], [united, volts, length], *settings_]
    head = [head[k] for k in data.draw(st.permutations(range(5)))]
    values = (from_base(VOLTAGE, volts), from_base(OUTPUT / 50, length))
    rows = [["", *(f"{v:.9g}" for v in row)] for row in zip(*values, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(separator.join(row) for row in (*head, *rows)) + "\n")
    same(read(tmp_path / "a.csv", rate=1 / (TIME[1] - TIME[0]))[0], VOLTAGE, OUTPUT / 50)


def test_settings_among_the_names_are_no_columns(tmp_path):
    heads = ("CH1 (V)", "CH2 (V)", "t0 =-0.2s", "tInc = 0.001")
    lines = [f"{u / 1000},{x / 2},," for u, x in zip(VOLTAGE, OUTPUT, strict=True)]
    message = refused(csv_of(tmp_path / "a.csv", heads, (), below=lines))
    assert "the file says t0 =-0.2s, tInc = 0.001" in message and tried(message)["rate"] == "RATE"


def test_stamps_with_their_zone(tmp_path):
    begin = datetime(2026, 11, 24, 10)
    for zone in ("Z", " UTC", "+01:00"):
        lines = [
            f"{begin + timedelta(seconds=float(t) + 1e-6):%Y-%m-%d %H:%M:%S.%f}{zone},{u},{x}"
            for t, u, x in zip(TIME, VOLTAGE, OUTPUT, strict=True)
        ]
        (record,) = read(csv_of(tmp_path / "a.csv", ("created_at", "U (V)", "x (mm)"), (), below=lines))
        np.testing.assert_array_equal(record.voltage, VOLTAGE)
        assert record.dt == pytest.approx(1e-3, rel=1e-4) and record.time[0] == pytest.approx(1795514400, abs=3600)


def test_settings_beside_the_header_and_below_it(tmp_path):
    head = "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-2.000000e-01,1.000000e-03\n"
    rows = "".join(f"{k},{u / 1000:.9g},{x / 2:.9g},\n" for k, (u, x) in enumerate(zip(VOLTAGE, OUTPUT, strict=True)))
    (tmp_path / "a.csv").write_text(head + rows)
    options = tried(refused(tmp_path / "a.csv"))
    assert (options["rate"], options["input_column"], options["output_column"]) == ("RATE", "CH1", "CH2")


@FEW
@given(data=st.data())
def test_names_with_blanks_over_columns_of_blanks(tmp_path, data):
    heads = [f"{data.draw(WORDS)} {k} ({unit})" for k, unit in enumerate(("s", "kV", "mm"))]
    mark = data.draw(st.sampled_from(["% ", "    "]))
    lines = [mark + "   ".join(f"{head:>16s}" for head in heads)]
    lines += ["".join(f"{v:19.9g}" for v in row) for row in zip(TIME, VOLTAGE / 1000, OUTPUT, strict=True)]
    (tmp_path / "a.txt").write_text("\n".join(["% Version:   6.2.0.278", *lines]))
    same(read(tmp_path / "a.txt")[0], VOLTAGE, OUTPUT * 1e-3)


@pytest.mark.parametrize("below", [["Mean,1,2"], ["", "Min,0,0", "Max,3,4"], ["*** END ***"]])
def test_words_below_the_rows_are_refused_with_their_line(tmp_path, below):
    (tmp_path / "a.csv").write_text(text(columns()) + "\n".join(below) + "\n")
    assert f"line {T + 2 + (below[0] == '')}" in refused(tmp_path / "a.csv")


def test_a_note_in_the_first_row_loses_no_sample(tmp_path):
    lines = text(columns()).splitlines()
    for place in (0, 3):  # before and behind the numbers
        rows = [[*line.split(",")] for line in lines]
        for k, row in enumerate(rows):
            row.insert(place, "note" if not k else "filled" if k == 1 else "")
        (tmp_path / "a.csv").write_text("\n".join(map(",".join, rows)) + "\n")
        same(read(tmp_path / "a.csv")[0], VOLTAGE, OUTPUT * 1e-3)


def test_marks_of_programs(tmp_path):
    """`Unit: kV`, a quoted `#` as a name, exponents of Fortran, decimal commas as texts of a sheet."""
    rows = text(columns()).split("\n", 1)[1]
    (tmp_path / "a.csv").write_text(
        'time,HV,laser\n"Unit: s","Unit: V","Unit: mm"\nInterp: linear,Interp: linear,x\n' + rows
    )
    same(read(tmp_path / "a.csv")[0], VOLTAGE, OUTPUT * 1e-3)
    numbered = "\n".join(f"{k},{line}" for k, line in enumerate(rows.splitlines()))
    (tmp_path / "a.csv").write_text('"Plot Title: rig"\n"#","Time, s","HV, V (S/N: 1)","x, mm (S/N: 2)"\n' + numbered)
    same(read(tmp_path / "a.csv")[0], VOLTAGE, OUTPUT * 1e-3)
    body = "\n".join(
        " ".join(f"{v:.10E}".replace("E", "D") for v in row) for row in zip(*columns().values(), strict=True)
    )
    (tmp_path / "a.dat").write_text(f"# {' '.join(columns())}\n{body}\n")
    same(read(tmp_path / "a.dat")[0], VOLTAGE, OUTPUT * 1e-3)
    texts = {name: [f"{v:.9f}".replace(".", ",") for v in values] for name, values in columns().items()}
    save_xlsx(tmp_path / "a.xlsx", texts)
    same(read(tmp_path / "a.xlsx")[0], VOLTAGE, OUTPUT * 1e-3)


def test_text_in_a_named_column_is_named(tmp_path):
    cells = [f'"{1000 + u:,.3f}"' for u in VOLTAGE]
    lines = [f"{t},{u},{x}" for t, u, x in zip(TIME, cells, OUTPUT, strict=True)]
    message = refused(csv_of(tmp_path / "a.csv", ("t (s)", "U (V)", "x (mm)"), (), below=lines))
    assert "'U (V)' holds text" in message and "thousands" in message


def test_columns_of_one_name_are_chosen_by_number(tmp_path):
    heads, values = ("t (s)", "U (V)", "x (mm)"), (TIME, VOLTAGE, OUTPUT)
    path = csv_of(tmp_path / "a.csv", heads * 2, (TIME, VOLTAGE, OUTPUT, *(v * 0.5 for v in values)))
    options = tried(refused(path))
    assert options == {"time_column": "1", "input_column": "2", "output_column": "3"}
    same(read(path, **options)[0], VOLTAGE, OUTPUT * 1e-3)


def test_of_two_ports_the_smoother_one_is_suggested_as_the_drive(tmp_path):
    noisy = OUTPUT / 2 + np.random.default_rng(0).normal(size=T) * 1e-3
    for names in (("Output (V)", "Input (V)"), ("Vin (V)", "Vout (V)")):
        path = csv_of(tmp_path / "a.csv", ("t (s)", *names), (TIME, VOLTAGE / 1000, noisy))
        options = tried(refused(path))
        assert (options["input_column"], options["output_column"]) == names


def test_matrices_and_tables_of_one_dataset_have_columns(tmp_path):
    values = np.stack([TIME, VOLTAGE, OUTPUT], -1)
    np.savez(tmp_path / "a.npz", data=values)
    scipy.io.savemat(tmp_path / "b.mat", {"data": values.T})
    with h5py.File(tmp_path / "c.h5", "w") as file:
        file["entry/rig/data"] = values
    wanted = {"time_unit": "s", "input_unit": "V", "output_unit": "mm"}
    for name in ("a.npz", "b.mat", "c.h5"):
        options = tried(refused(tmp_path / name))
        assert options["time_column"] == "data[1]" and options["output_column"] == "data[3]"
        same(read(tmp_path / name, **(options | wanted))[0], VOLTAGE, OUTPUT * 1e-3)
    with h5py.File(tmp_path / "d.h5", "w") as file:
        file["rows"] = np.array([tuple(row) for row in values], [(name, "f8") for name in columns()])
    same(read(tmp_path / "d.h5")[0], VOLTAGE, OUTPUT * 1e-3)


def test_a_clock_whose_two_units_disagree_is_asked_about(tmp_path):
    heads = ("Time (ms)", "U (V)", "x (mm)")
    options = tried(refused(csv_of(tmp_path / "a.csv", heads, (TIME * 1e3, VOLTAGE, OUTPUT), below=["s,V,mm"])))
    assert options == {"time_unit": "ms"}


def test_an_empty_clock_asks_for_the_rate(tmp_path):
    lines = [f",{u},{x}" for u, x in zip(VOLTAGE, OUTPUT, strict=True)]
    path = csv_of(tmp_path / "a.csv", columns(), (), below=lines)
    assert tried(refused(path)) == {"rate": "RATE"}
    same(read(path, rate=1000)[0], VOLTAGE, OUTPUT * 1e-3)


def test_names_broken_within_their_quotes(tmp_path):
    rows = text(columns()).split("\n", 1)[1]
    (tmp_path / "a.csv").write_text('"Time\n(s)","Voltage\n(V)","Laser\n(mm)"\n' + rows)
    same(read(tmp_path / "a.csv")[0], VOLTAGE, OUTPUT * 1e-3)
    (tmp_path / "a.csv").write_text('"Time\n(s)","Voltage\n(V)","Laser\n(mm)"\n' + rows + "x,1,2\n1,2,3\n")
    assert f"(line {T + 5})" in refused(tmp_path / "a.csv")  # as an editor counts
    (tmp_path / "a.csv").write_text('# a 5" pipe\n' + text(columns()))
    same(read(tmp_path / "a.csv")[0], VOLTAGE, OUTPUT * 1e-3)


def test_structs_of_controldesk_and_simulink(tmp_path):
    signals = [{"Name": "HV (V)", "Data": VOLTAGE}, {"Name": "Laser (mm)", "Data": OUTPUT}]
    scipy.io.savemat(tmp_path / "a.mat", {"rec": {"X": {"Name": "Time (s)", "Data": TIME}, "Y": signals}})
    same(read(tmp_path / "a.mat")[0], VOLTAGE, OUTPUT * 1e-3)
    # as ControlDesk writes it: the service that samples names the clock, and the units have their own fields
    signals = [{"Name": n, "Data": v, "Unit": u} for n, v, u in (("Rig/HV", VOLTAGE, "V"), ("Rig/x", OUTPUT, "mm"))]
    clock = {"Name": "HostService", "Data": 1e3 * TIME, "Unit": "ms"}
    scipy.io.savemat(tmp_path / "c.mat", {"rec": {"X": clock, "Y": signals}})
    same(read(tmp_path / "c.mat")[0], VOLTAGE, OUTPUT * 1e-3)
    signals = np.array([(VOLTAGE, "HV (V)"), (OUTPUT, "Laser (mm)")], [("values", object), ("label", object)])
    scipy.io.savemat(tmp_path / "b.mat", {"Scope": {"time": TIME, "signals": signals, "blockName": "rig/Scope"}})
    same(read(tmp_path / "b.mat")[0], VOLTAGE, OUTPUT * 1e-3)


def test_a_clock_before_every_channel(tmp_path):
    """The input is held, so its mean over a step of the output's later clock mixes two of its values."""
    names = ["Time (s)", "HV (V)", "Time (s)", "Laser (mm)"]
    late = read(csv_of(tmp_path / "a.csv", names, [TIME, VOLTAGE, TIME + 0.3 * TIME[1], OUTPUT]))[0]
    held = 0.7 * VOLTAGE[:-1] + 0.3 * VOLTAGE[1:]
    np.testing.assert_allclose(late.voltage[:-1], held, atol=float(1e-6 * np.ptp(VOLTAGE)))
    np.testing.assert_allclose(late.displacement, OUTPUT * 1e-3, rtol=1e-6)
    same(read(csv_of(tmp_path / "b.csv", names, [TIME, VOLTAGE, TIME, OUTPUT]))[0], VOLTAGE, OUTPUT * 1e-3)
    head = ["LabVIEW Measurement", "Separator\tTab", "X_Columns\tMulti", "***End_of_Header***", "Channels\t2"]
    head += ["Y_Unit_Label\tVolts\t\tMillimeters", "***End_of_Header***", "X_Value\tHV\tX_Value\tLaser\tComment"]
    rows = ["\t".join(f"{v:.9f}" for v in row) for row in zip(TIME, VOLTAGE, TIME, OUTPUT, strict=True)]
    (tmp_path / "c.lvm").write_text("\n".join(head + rows) + "\n")
    same(read(tmp_path / "c.lvm")[0], VOLTAGE, OUTPUT * 1e-3)


def test_hours_of_half_a_day(tmp_path):
    noon = datetime(2026, 3, 1, 11, 59, 59, 900_000)
    clock = [(noon + timedelta(seconds=float(t))).strftime("%I:%M:%S.%f %p") for t in TIME]
    lines = [f"{c},{u},{x}" for c, u, x in zip(clock, VOLTAGE, OUTPUT, strict=True)]
    same(read(csv_of(tmp_path / "a.csv", ("Time", "U (V)", "x (mm)"), (), below=lines))[0], VOLTAGE, OUTPUT * 1e-3)


def test_patterns_that_the_shell_left_alone(tmp_path):
    for name in ("a1.csv", "a2.csv", "b.csv"):
        save_csv(tmp_path / name, columns())
    assert [r.name for r in read(tmp_path / "a*.csv")] == ["a1", "a2"]
    assert "no such file" in refused(tmp_path / "c*.csv")


def test_an_empty_name_at_the_end_shifts_no_name(tmp_path):
    """A row counter and an unnamed last column (motion capture) are not the row names of R."""
    rows = [f"{k},{t:.3f},{v:.1f},{y:.6f},0.1" for k, (t, v, y) in enumerate(zip(TIME, VOLTAGE, OUTPUT, strict=True))]
    (tmp_path / "a.csv").write_text("\n".join(["Frame,Time (s),HV (V),Tip (mm),", *rows]))
    same(read(tmp_path / "a.csv")[0], VOLTAGE, OUTPUT * 1e-3)


@pytest.mark.parametrize(
    ("names", "read_as"),
    [
        (("duty_percent", "pos_mm", "battery_voltage_V"), "percent"),
        (("current [A]", "position [mm]", "Vbus [V]"), "A"),
        (("control mode", "position [mm]", "motor voltage [V]"), "V"),
        (("cmd [%]", "position [mm]", "supply [V]"), None),
        (("pressure_set_kPa", "displacement_mm", "valve_V"), None),
    ],
)
def test_a_voltage_beside_a_command_is_not_taken_for_it(tmp_path, names, read_as):
    path = csv_of(tmp_path / "a.csv", ("time_s", *names), (TIME, VOLTAGE, OUTPUT, 24 - TIME))
    if read_as is None:
        assert tried(refused(path))["input_column"] == names[0]
    else:
        assert read(path)[0].voltage_unit == read_as


def test_a_clock_that_dates_contradict_is_asked_about(tmp_path):
    """The header says ms, the numbers are s; the dates beside them cannot have a wrong unit."""
    dates = [(datetime(2026, 11, 23, 10) + timedelta(seconds=t)).isoformat(timespec="milliseconds") for t in TIME]
    rows = [f"{d},{t:.3f},{v:.1f},{y:.6f}" for d, t, v, y in zip(dates, TIME, VOLTAGE, OUTPUT, strict=True)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["DateTime,time_ms,U (V),x (mm)", *rows]))
    assert tried(refused(path)) == {"time_column": "DateTime"}
    for said in ({"time_column": "DateTime"}, {"time_unit": "s"}):
        (record,) = read(path, **said)
        assert record.dt == pytest.approx(1e-3, rel=1e-6)


def test_fields_of_a_structured_array_are_columns(tmp_path):
    rows = np.zeros(T, dtype=[(name, float) for name in columns()])
    for name, values in columns().items():
        rows[name] = values
    np.savez(tmp_path / "a.npz", log=rows)
    same(read(tmp_path / "a.npz")[0], VOLTAGE, OUTPUT * 1e-3)


@pytest.mark.parametrize("day", [739944.4, 46345.4])  # of MATLAB and of Excel
def test_days_without_a_unit_are_asked_about(tmp_path, day):
    rows = [f"{day + 500 * t / 86400:.9f},{v:.1f},{y:.6f}" for t, v, y in zip(TIME, VOLTAGE, OUTPUT, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["Time,U (V),x (mm)", *rows]))
    assert tried(refused(tmp_path / "a.csv"))["time_unit"] == "UNIT"
    assert read(tmp_path / "a.csv", time_unit="d")[0].dt == pytest.approx(0.5, rel=1e-3)


def test_a_zone_that_changes_moves_no_time(tmp_path):
    """Summer time ends within the record: 01:00 UTC is 03:00+02:00 and 02:00+01:00."""
    start, rows = datetime(2026, 10, 25, 0, 59, 59, 950000), []
    for k in range(T):
        utc = start + timedelta(milliseconds=k)
        zone = 2 if utc.hour < 1 else 1
        local = (utc + timedelta(hours=zone)).isoformat(timespec="milliseconds")
        rows.append(f"{local}+0{zone}:00,{VOLTAGE[k]:.1f},{OUTPUT[k]:.6f}")
    (tmp_path / "a.csv").write_text("\n".join(["Timestamp,U (V),x (mm)", *rows]))
    begin = start.replace(tzinfo=UTC).timestamp()
    # a float resolves 0.24 us of the seconds since 1970
    np.testing.assert_allclose(read(tmp_path / "a.csv")[0].time - begin, TIME, atol=1e-6)


@pytest.mark.parametrize(
    ("command", "measured"), [("Sollwert", "Istwert"), ("pos_cons", "pos_mes"), ("control_position", "position")]
)
def test_commands_in_other_words_are_inputs(tmp_path, command, measured):
    path = csv_of(tmp_path / "a.csv", ("time_s", f"{measured} [deg]", f"{command} [deg]"), (TIME, OUTPUT, VOLTAGE))
    same(read(path)[0], np.radians(VOLTAGE), np.radians(OUTPUT))

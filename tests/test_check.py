"""The check finds what was planted (zeros, directions, faults, strangers, gaps in the band), nothing in a good set."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim
from typed import some

import pitp_jax as pitp
from pitp_jax.application.check.check import checked
from pitp_jax.application.check.one_record import quick_problems
from pitp_jax.application.pages.check import page
from pitp_jax.files.recordings.remarks import Remark, by_kind

DT, SAMPLES = 2e-3, 3000
TIME = np.arange(SAMPLES) * DT
HZ, NOISE = 8.0, 2e-6


def actuator(voltage, hz=HZ, stiffness=1e9, damping=0.1):
    """Displacement from rest in m, stepped finely enough for lsim's linear force between samples."""
    w = 2 * np.pi * hz
    return lsim(([1.0], stiffness * np.array([1 / w**2, 2 * damping / w, 1.0])), voltage**2, TIME)[1]


def sine(f, size=1000.0):
    return size * (1 - np.cos(2 * np.pi * f * TIME)) / 2


def record(name, voltage, *, zero=0.0, direction=1, seed=0, coloured=False, **other):
    noise = NOISE * np.random.default_rng([seed, len(name), ord(name[-1])]).standard_normal(SAMPLES)
    if coloured:
        noise = lsim(([1.0], [0.02, 1.0]), noise, TIME)[1] * 30
    x = direction * actuator(voltage, **other) + zero + noise
    return pitp.Record(name, TIME, voltage, x, displacement_unit="mm")


SIZES = {1.0: 1000, 2.0: 600, 3.0: 1000, 4.0: 400, 5.0: 900, 6.5: 1000, 8.5: 500, 11.0: 1000}


@pytest.fixture(scope="module")
def good():
    sweep = 500 * (1 - np.cos(2 * np.pi * (0.3 * TIME + 1.2 * TIME**2)))
    return [record("sweep", sweep)] + [record(f"sine{f:g}", sine(f, size)) for f, size in SIZES.items()]


def with_(records, name, change):
    return [change(r) if r.name == name else r for r in records]


def moved(record, y):
    return replace(record, displacement=y)


def test_a_good_set_has_no_problems(good):
    found = pitp.check(good)
    assert found.problems == {}
    assert found.resonance_hz == pytest.approx(HZ, rel=0.01)
    for row in found.records.values():
        assert (row.begins, row.direction, row.noise_colour) == ("rest", 1, "white")
        assert row.noise == pytest.approx(1e3 * NOISE, rel=0.15)
        assert abs(some(row.zero)) < 5e-3 and row.unit == "mm"
    kinds = {name: row.excitation for name, row in found.records.items()}
    assert kinds["sweep"] == "sweep" and kinds["sine5"] == "sine"
    assert found.records["sine5"].band_hz == pytest.approx((5.0, 5.0), abs=0.2)
    low, high = some(found.records["sweep"].band_hz)
    assert low < 1 and 10 < high < 16
    assert not any("nothing between" in line or "offset differs" in line for line in found.advice)


def test_zeros_and_directions_that_were_planted(good):
    planted = with_(good[:6], "sine3", lambda r: record(r.name, r.voltage, zero=4e-4))
    planted = with_(planted, "sine5", lambda r: record(r.name, r.voltage, zero=-2e-4, direction=-1))
    found = pitp.check(planted)
    three, five = found.records["sine3"], found.records["sine5"]
    assert three.zero == pytest.approx(0.4, abs=0.005) and three.direction == 1
    assert five.zero == pytest.approx(-0.2, abs=0.005) and five.direction == -1
    assert list(found.problems) == ["sine5"] and "is reversed" in found.problems["sine5"][0]
    assert any("offset differs" in line for line in found.advice)


def test_faults_are_counted_and_do_not_hide_the_others(good, tmp_path):
    spiked, gapped, clipped = (next(r for r in good if r.name == n) for n in ("sine2", "sine4", "sweep"))
    y = spiked.displacement.copy()
    y[[400, 900, 1700]] = 0.9
    holes = gapped.displacement.copy()
    holes[1000:1400] = np.nan
    limit = np.sort(clipped.displacement)[-150]
    records = [moved(spiked, y), moved(gapped, holes), moved(clipped, np.minimum(clipped.displacement, limit))]
    found = pitp.check(records + [r for r in good[:6] if r.name not in ("sine2", "sine4", "sweep")])
    assert found.records["sine2"].outliers == 3
    assert found.records["sine4"].missing == 400
    assert any("limit" in line for line in found.problems["sweep"])
    assert set(found.problems) == {"sine4", "sweep"}  # three spikes are mended, and no problem
    assert found.repaired == ["sine2: 3 output samples masked as spikes or dropouts"]
    assert found.as_json()["records"]["sine2"]["problems"] == ["3 output samples masked as spikes or dropouts"]
    assert found.records["sine5"].begins == "rest"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda r: record(r.name, r.voltage, hz=5.5, stiffness=4e8), "check preload, scale and actuator"),
        (lambda r: moved(r, 1e3 * r.displacement), "unit"),
        (lambda r: moved(r, 0.2 * r.displacement), "check preload, scale"),
    ],
)
def test_one_record_of_ten_that_does_not_belong(good, change, word):
    found = pitp.check(with_(good, "sine5", change))
    assert list(found.problems) == ["sine5"], found.problems
    assert word in found.problems["sine5"][-1]
    assert found.resonance_hz == pytest.approx(HZ, rel=0.02)


def test_a_gap_in_the_band_is_named_in_numbers(good):
    kept = [record(f"sine{f:g}", sine(f, 1000)) for f in (1.0, 2.0, 3.0, 4.0, 5.0, 9.0, 11.0)]
    kept.append(record("small7", sine(7.0, 200)))
    (line,) = [line for line in pitp.check(kept).advice if "nothing between" in line]
    assert "between 5 and 9 Hz" in line and "exceeds half the swing (500 V from peak to peak)" in line


def test_repeats_say_what_the_rig_repeats(good):
    again = record("again", sine(3.0, 1000), seed=5)
    found = pitp.check([*good[:4], moved(again, again.displacement * 1.01)])
    (repeat,) = found.repeats
    assert set(repeat.names) == {"sine3", "again"}
    assert 0.1 < repeat.percent < 0.5
    assert any("played twice" in line and "again" in line for line in found.advice)


def test_coloured_noise_is_told_from_white(good):
    found = pitp.check(with_(good[:4], "sine2", lambda r: record(r.name, r.voltage, coloured=True)))
    assert found.records["sine2"].noise_colour == "coloured"
    assert [n for n, row in found.records.items() if row.noise_colour == "coloured"] == ["sine2"]


def test_an_input_of_another_kind_is_left_out_of_the_set(good):
    """Percent of a valve beside volts would be fitted as volts."""
    percent = replace(good[1], name="percent", voltage=good[1].voltage / 60, voltage_unit="percent")
    found = pitp.check([*good, percent])
    assert list(found.problems) == ["percent"] and "input is in percent" in found.problems["percent"][-1]
    assert found.input_map == pitp.check(good).input_map


@pytest.mark.slow
def test_whatever_is_given_the_json_is_strict_and_every_record_is_there(good):
    flat = pitp.Record("flat", TIME, 0 * TIME, NOISE * np.random.default_rng(1).standard_normal(SAMPLES))
    other = pitp.Record("other", TIME * 2, sine(1.0), actuator(sine(1.0)))
    volts = pitp.Record("volts", TIME, sine(1.0), actuator(sine(1.0)), displacement_unit="V")
    strange = {"other": "sampled at", "volts": "in V", "flat": "never changes"}
    still = replace(good[0], name="still", displacement=NOISE * np.random.default_rng(2).standard_normal(SAMPLES))
    for records in ([*good, flat, other, volts, still], [flat], [still], [other], good[:1]):
        found = checked(records, {"broken": "broken.csv: no such column"})
        told = json.loads(json.dumps(found.as_json(), allow_nan=False))
        assert set(told) == {"records", "advice"}
        assert set(told["records"]) == {r.name for r in records} | {"broken"}
        row = told["records"]["broken"]
        assert row["problems"] == ["broken.csv: no such column"] and row["zero"]["value"] is None
        if len(records) == 1:
            assert page(found).html().count("<tr") == len(told["records"]) + 1
        else:
            for name, words in strange.items():
                assert any(words in line for line in told["records"][name]["problems"]), name


def test_half_of_one_output_missing_and_no_noise_hide_nothing(good):
    few = good[2].displacement.copy()
    few[::2] = np.nan
    exact = [pitp.Record(r.name, TIME, r.voltage, actuator(r.voltage)) for r in good[1:5]]
    found = pitp.check([good[0], moved(good[2], few), *exact[2:]])
    assert [row.begins for row in found.records.values()] == ["rest"] * 4
    assert "50 % of its output is missing" in found.records["sine2"].problems[0]
    assert pitp.check(exact).problems == {}


def test_quick_problems_need_no_fit(good):
    assert quick_problems(good) == []
    flat = replace(good[1], name="flat", voltage=0 * TIME)
    (line,) = quick_problems([*good, flat])[:1]
    assert line.startswith("flat: its input never changes")
    (line,) = quick_problems(with_(good, "sine5", lambda r: moved(r, 1e3 * r.displacement)))
    assert "sine5: moves" in line and "unit" in line


def test_zeros_are_compared_in_base_units(good):
    """0.05 mm and 50 um are one zero; the difference of another is reported in the unit of the first."""
    same = [moved(r, r.displacement + 5e-5) for r in good[:4]]
    mixed = [replace(r, displacement_unit="um") if r.name == "sine3" else r for r in same]
    assert not any("offset differs" in line for line in pitp.check(mixed).advice)
    mixed = [moved(r, r.displacement + 4e-4) if r.name == "sine3" else r for r in mixed]
    (line,) = [line for line in pitp.check(mixed).advice if "offset differs" in line]
    apart, most = map(float, re.findall(r"by up to (\S+) mm .in most it is (\S+) mm", line)[0])
    assert apart == pytest.approx(0.4, rel=0.02) and most == pytest.approx(0.05, abs=0.006)


def test_one_line_for_every_kind_of_what_was_mended():
    rows = [Remark("lost", f"r{k}", 1) for k in range(9)]
    assert by_kind(rows) == ["9 recordings: 1 lost sample each, inserted, with a missing output (r0, r1, r2, ...)"]
    assert by_kind(rows[:1]) == ["r0: 1 lost sample inserted, with a missing output"]
    rows = [Remark("outliers", "a", 1), Remark("lost", "a", 2), Remark("outliers", "b", 3)]
    assert by_kind(rows) == [
        "2 recordings: 1 to 3 output samples each, masked as spikes or dropouts (a, b)",
        "a: 2 lost samples inserted, with a missing output",
    ]


def test_a_motor_without_a_resonance_is_not_to_be_sampled_faster():
    """y' = (u - y) / tau under steps of half a second; a mode of 8 Hz that rings, sampled as coarsely, is."""
    time = np.arange(800) / 100
    drive = np.array([0.0, 1.0, -0.5, 0.8, 0.2, -1.0, 0.6, 0.0])[(time / 0.5).astype(int) % 8]
    told = []
    for denominator in ([0.15, 1.0], [1 / (16 * np.pi) ** 2, 0.2 / (16 * np.pi), 1.0]):
        y = lsim(([1.0], denominator), drive, time, interp=False)[1]
        y += 1e-5 * np.random.default_rng(0).standard_normal(len(y))
        record = pitp.Record("steps", time, drive, y, voltage_unit="V", displacement_unit="rad")
        told.append(any("samples in a period" in line for line in pitp.check([record]).advice))
    assert told == [False, True]


def test_advice_on_a_resonance_needs_a_resonance():
    """A lag behind a dead time, an integrator and a copy of the input have none; the mode of the good set stays."""
    time = np.arange(2000) / 50
    drive = np.sin(2 * np.pi * (0.05 * time + 0.02 * time**2))
    held = np.repeat(np.random.default_rng(1).uniform(-1, 1, 40), 50)
    for denominator, late in (([1.2, 1.0], 20), ([0.3, 1.0, 0.0], 0), ([1e-6, 1.0], 0)):
        records = []
        for name, u in (("sweep", drive), ("steps", held)):
            y = lsim(([1.0], denominator), np.r_[np.zeros(late), u][: len(u)], time)[1]
            y += 1e-3 * y.std() * np.random.default_rng(0).standard_normal(len(y))
            records.append(pitp.Record(name, time, u, y, voltage_unit="V", displacement_unit="rad"))
        found = pitp.check(records)
        assert found.resonance_hz is None and found.coverage is None
        assert not any("resonance" in line for line in found.advice)


def test_an_encoder_that_reads_2048_at_rest_is_checked_as_one_that_reads_0():
    """A servo of 3 Hz in ticks, and in ticks less 2048: the same facts, and the offset is printed."""
    t, ticks, found = np.arange(2000) / 250, 2 * np.pi / 4096, []
    for offset in (0.0, 2048 * ticks):
        records = []
        for k, hz in enumerate((0.3, 1.0, 2.5)):
            u = 0.3 * np.sin(2 * np.pi * hz * np.clip(t - 0.5, 0, None))
            y = lsim(([1.0], [1 / 355.0, 0.05, 1.0]), u, t)[1]
            u, y = (np.round(v / ticks) * ticks + offset for v in (u, y))
            records.append(pitp.Record(f"r{k}", t, u, y, voltage_unit="rad", displacement_unit="rad"))
        found.append(pitp.check(records))
    plain, raw = found
    assert plain.input_map == raw.input_map == "linear"
    for name, row in plain.records.items():
        other = raw.records[name]
        assert (row.begins, row.direction, row.excitation) == (other.begins, other.direction, other.excitation)
        assert other.begins == "rest" and other.noise == pytest.approx(row.noise, rel=1e-3)
        assert other.zero - row.zero == pytest.approx(np.pi, rel=1e-3)
    assert "start at a command of 3.142 rad" in raw.advice[0] and raw.advice[1:] == plain.advice

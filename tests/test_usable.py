"""What a rig puts in the way of a diagnosis: rest, repeats, gaps, short and long records, an amplifier of one sign."""

import json
from dataclasses import replace

import numpy as np
import pytest
from played import SAMPLES, TIME, nominal_of, play

import pitp_jax as pitp
from pitp_jax._diagnose import select_records as rules
from pitp_jax._diagnose.bootstrap import means
from pitp_jax._diagnose.case import build_case, split
from pitp_jax._diagnose.next_experiment import excitations
from pitp_jax._diagnose.noise import estimate
from pitp_jax._diagnose.select_records import usable
from pitp_jax._effects import CATALOGUE
from pitp_jax._errors import BadInput
from pitp_jax._record.excitation_kind import kind

OTHERS = sorted({c.name for c in CATALOGUE} - {"drag"})


@pytest.fixture(scope="module")
def nominal(linear):
    return nominal_of(linear)


def resting(name, noise):
    """The actuator at zero volts."""
    return pitp.Record(name, TIME + 200, np.zeros(SAMPLES), noise * np.random.default_rng(5).standard_normal(SAMPLES))


def test_what_does_not_move_is_left_out(nominal):
    """Errors are counted in ranges: noise alone would have a floor of 14 %, and hide the gap of all others."""
    records = play(nominal)
    kept, notes = usable([*records, resting("rest", 2e-6), resting("dead", 0.0)])
    assert [r.name for r in kept] == [r.name for r in records]
    assert notes == ("left out, since they do not move beyond their noise: rest, dead",)
    small = replace(records[0], name="small", displacement=records[0].displacement / 50)
    assert len(usable([*records, small])[0]) == 8  # a fiftieth of the range moves all the same


@pytest.mark.parametrize(
    ("records", "told"),
    [
        (lambda r: [resting("rest", 0.0)], "no record moves"),
        (lambda r: [*r, replace(r[0], voltage=r[1].voltage)], "2 records are named 'sweep'"),
    ],
    ids=("still", "twice"),
)
def test_what_cannot_be_diagnosed_is_refused(nominal, records, told):
    with pytest.raises(BadInput, match=told):
        pitp.diagnose(nominal, records(play(nominal)))


def test_a_set_too_large_is_cut_and_says_so(nominal, monkeypatch):
    monkeypatch.setattr(rules, "BUDGET", 7 * 1000)
    monkeypatch.setattr(rules, "_FEWEST", 100)
    late = play(nominal)[0]
    late.displacement[:1200] = np.nan
    kept, notes = usable([*play(nominal)[1:], late])
    assert [r.samples for r in kept] == [1000] * 6 + [SAMPLES]  # its output begins behind the cut: kept whole
    assert notes[0].startswith("6 of 7 recordings count with their first 4 s alone")


def test_a_drive_played_twice_stays_on_one_side(nominal):
    once = play(nominal)
    twice = [*once, *(replace(r, name=f"{r.name} again", time=r.time + 100) for r in once)]
    fitted = split(twice)
    assert all((r.name in fitted) == (f"{r.name} again" in fitted) for r in once if r.name.startswith("sine"))
    assert {r.removesuffix(" again") for r in fitted if r.startswith("sine")} == {"sine0", "sine2"}
    sines = [replace(once[2], name=f"same{k}") for k in range(4)]
    assert len(split(sines)) == 2  # nothing but one drive: some of it is held out all the same


@pytest.mark.parametrize("rate", [200, 1000, 10_000])
def test_the_kind_does_not_ask_for_the_sampling_rate(rate):
    t = np.arange(4 * rate) / rate
    drives = {
        "sine": 600 + 300 * np.sin(2 * np.pi * 1.5 * t),
        "steps": 600 + 300 * np.repeat([0.1, 0.9, 0.4, 0.7], rate),
        "broadband": 600 + 40 * sum(np.sin(2 * np.pi * f * t + f**2) for f in (0.5, 1.25, 2.0, 3.25, 4.5)),
    }
    assert [kind(pitp.Record(name, t, u, t)) for name, u in drives.items()] == list(drives)


@pytest.mark.slow
def test_a_short_record_does_not_blur_the_floor(nominal):
    records = play(nominal, noise=0.0)
    brief = replace(records[0], name="brief", **{
        field: getattr(records[0], field)[:70] for field in ("time", "voltage", "displacement")
    })  # fmt: skip
    case = build_case(nominal, [*records, brief])
    rng = np.random.default_rng(0)
    found = estimate(case, [1e-3 * rng.standard_normal(s.record.samples) for s in case.series])
    assert found.sigma == pytest.approx(1e-3, rel=0.1)
    alone = replace(case, series=case.series[-1:])
    assert estimate(alone, [1e-3 * rng.standard_normal(70)]).sigma == pytest.approx(1e-3, rel=0.5)


@pytest.mark.slow
def test_blocks_are_drawn_of_what_counts(nominal):
    case = build_case(nominal, play(nominal, noise=0.0)[:2])
    rng = np.random.default_rng(0)
    holes = rng.random(SAMPLES) < 0.3
    half = tuple(replace(s, weight=np.where(holes, 0.0, s.weight)) for s in case.series)
    draws = means(replace(case, series=half), (0, 1), lambda k: np.where(holes, 7.0, 1.0) * np.ones(SAMPLES))
    np.testing.assert_allclose(draws, 1.0)


def test_the_next_experiment_is_one_that_the_amplifier_can_play(nominal):
    """Nothing below zero where nothing was, from zero volts and back, within the slew that was played."""
    case = build_case(nominal, play(nominal, noise=0.0))
    played = [s.record.voltage for s in case.series]
    step = max(np.abs(np.diff(u)).max() for u in played)
    for voltage in excitations(case).values():
        assert abs(voltage[0]) <= step and abs(voltage[-1]) <= step
        assert voltage.min() >= 0 and voltage.max() <= max(u.max() for u in played)
        assert np.abs(np.diff(voltage)).max() <= step * (1 + 1e-9)
    either = replace(case, series=tuple(
        replace(s, record=replace(s.record, voltage=s.record.voltage - 600)) for s in case.series
    ))  # fmt: skip
    carriers = [u for name, u in excitations(either).items() if "about zero" in name]
    assert carriers and min(u.min() for u in carriers) < 0 <= max(u.max() for u in carriers)


def test_a_rig_of_negative_voltage_is_inverted(nominal):
    """Squared, the sign is the amplifier's affair: limits come from the largest voltage of either sign."""
    mirrored = replace(nominal, domain=replace(nominal.domain, voltage_range=(-1e3, 0.0)))
    target = pitp.Target(TIME, 2e-4 * (1 - np.cos(2 * np.pi * TIME)) ** 2)
    plain, found = (pitp.feedforward(m, target) for m in (nominal, mirrored))
    np.testing.assert_array_equal(found.voltage, plain.voltage)
    assert found.self_check_e_rms_percent < 0.1 and not plain.warnings
    (line,) = found.warnings
    assert "play its negative" in line


def test_notes_are_in_the_words_and_in_the_file(nominal):
    found = pitp.diagnose(nominal, [*play(nominal, seed=7), resting("rest", 2e-6)], exclude=OTHERS)
    assert found.verdict == "no_gap" and "rest" not in (*found.fitted, *found.heldout)
    assert "note: left out" in str(found) and json.loads(json.dumps(found.as_json()))["notes"] == list(found.notes)
    worse = replace(found.gap, closed_fraction=-0.88)
    assert ", 0 % of the gap closed" in str(replace(found, gap=worse))

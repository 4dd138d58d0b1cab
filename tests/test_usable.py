"""What a rig puts in the way of a diagnosis: rest, repeats, gaps, short and long records, an amplifier of one sign."""

import json
from dataclasses import replace

import numpy as np
import pytest
from played import SAMPLES, TIME, nominal_of, play
from scipy.signal import lfilter

import pitp_jax as pitp
from pitp_jax.common.errors import BadInput
from pitp_jax.files.model_file.model_file import load, save
from pitp_jax.method.diagnose.data import build_case
from pitp_jax.method.diagnose.library import DELAY, INDEX
from pitp_jax.method.diagnose.next_experiment import excitations, separate
from pitp_jax.method.diagnose.search import PARAMETERS, Search
from pitp_jax.method.diagnose.select_records import usable
from pitp_jax.method.effects import CATALOGUE
from pitp_jax.method.model.fitted import Fitted
from pitp_jax.method.model.lineage import descended, was_made_from
from pitp_jax.method.model.origin import Origin
from pitp_jax.method.signal.excitation_kind import kind

DRAG = "drag: quadratic, c"
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
    assert notes == ("left out, because they show no motion beyond their noise: rest, dead",)
    rng = np.random.default_rng(6)  # a drive read by a monitor, and a sensor with noise of long memory
    slow = 2e-5 * np.asarray(lfilter([np.sqrt(1 - 0.98**2)], [1, -0.98], rng.standard_normal(SAMPLES)))
    read = replace(resting("read", 0.0), voltage=2 * rng.standard_normal(SAMPLES), displacement=slow)
    assert [r.name for r in usable([*records, read])[0]] == [r.name for r in records]
    small = replace(records[0], name="small", displacement=records[0].displacement / 50)
    assert len(usable([*records, small])[0]) == 8  # a fiftieth of the range moves all the same


@pytest.mark.parametrize(
    ("records", "told"),
    [
        (lambda r: [resting("rest", 0.0)], "no recording shows motion"),
        (lambda r: [*r, replace(r[0], voltage=r[1].voltage)], "2 records are named 'sweep'"),
    ],
    ids=("still", "twice"),
)
def test_what_cannot_be_diagnosed_is_refused(nominal, records, told):
    with pytest.raises(BadInput, match=told):
        pitp.diagnose(nominal, records(play(nominal)))


@pytest.mark.parametrize("rate", [200, 1000, 10_000])
def test_the_kind_does_not_ask_for_the_sampling_rate(rate):
    t = np.arange(4 * rate) / rate
    drives = {
        "sine": 600 + 300 * np.sin(2 * np.pi * 1.5 * t),
        "steps": 600 + 300 * np.repeat([0.1, 0.9, 0.4, 0.7], rate),
        "broadband": 600 + 40 * sum(np.sin(2 * np.pi * f * t + f**2) for f in (0.5, 1.25, 2.0, 3.25, 4.5)),
    }
    assert [kind(pitp.Record(name, t, u, t)) for name, u in drives.items()] == list(drives)


def test_the_next_experiment_is_one_that_the_amplifier_can_play():
    """Nothing below zero where nothing was, from zero volts and back, within the slew that was played."""
    dt, slew, top = 4e-3, 2e4, 950.0
    for size in (1.0, 0.5):
        for voltage in excitations(0.0, top, slew, 5.0, dt, size).values():
            assert abs(voltage[0]) <= slew * dt and abs(voltage[-1]) <= slew * dt
            assert voltage.min() >= 0 and voltage.max() <= top
            assert np.abs(np.diff(voltage)).max() <= slew * dt * (1 + 1e-9)
    carriers = [u for name, u in excitations(-600.0, 600.0, slew, 5.0, dt, 1.0).items() if "about zero" in name]
    assert carriers and min(u.min() for u in carriers) < 0 <= max(u.max() for u in carriers)


@pytest.mark.slow
def test_the_next_experiment_moves_no_further_than_what_was_played(nominal):
    """A lightly damped rig driven at its resonance with the whole voltage went 2.6 times as far."""
    case = build_case(nominal, play(nominal, noise=0.0))
    search = Search(case, False)
    slots = case.nominal.copy()
    slots[INDEX["electrode_rc: one lag, tau"]] = 0.02
    lagging = replace(search.given, fit=search.given.fit.again(slots=slots))
    found = separate(case, search.scale, search.given, lagging, ("a", "b"))
    assert found is not None and found.difference > 1
    record = pitp.Record("next", found.time, found.voltage, 0 * found.time)
    reach = max(np.nanmax(s.output) for s in case.series) * nominal.scales.state[0]
    assert np.nanmax(pitp.predict(nominal, [record])[0].displacement) < 1.06 * reach
    assert str(found) == f"{found.excitation} for {round(found.time[-1])} s, to separate a from b"
    assert found.excitation.startswith("a sine of ") or found.excitation == "steps of six levels"


@pytest.mark.slow
def test_a_set_without_moved_numbers_moves_none_and_a_holds_delay_is_none(nominal):
    """A set kept them free and was as good without `parameters`: a second mode was said where 98 % were parameters."""
    case = build_case(nominal, play(nominal, noise=0.0))
    slots = case.nominal.copy()
    slots[INDEX[DELAY]] = 0.5 * case.dt
    search = Search(replace(case, nominal=slots), False)
    assert DELAY in search.core and search.linear.fit.free == search.movable == ("a0", "a1", "a2")
    assert search.linear.fit.value(DELAY) == 0.5 * case.dt
    fit = search.linear.fit.again(names=(PARAMETERS, "drag"), free=("a0", "a1", "a2", DRAG), unit=np.zeros(0))
    fit.slots[INDEX[DRAG]] = 1e-3
    search._again(replace(search.linear, fit=replace(fit, unit=np.ones(4))), frozenset(["drag"]))
    assert search.every[frozenset(["drag"])].fit.free == (DRAG,)


def test_a_rig_of_negative_voltage_is_inverted(nominal):
    """Squared, the sign is the amplifier's affair: limits come from the largest voltage of either sign."""
    mirrored = replace(nominal, domain=replace(nominal.domain, voltage_range=(-1e3, 0.0)))
    target = pitp.Target(TIME, 2e-4 * (1 - np.cos(2 * np.pi * TIME)) ** 2)
    plain, found = (pitp.feedforward(m, target) for m in (nominal, mirrored))
    np.testing.assert_array_equal(found.voltage, plain.voltage)
    assert found.self_check_e_rms_percent < 0.1 and not plain.warnings
    (line,) = found.warnings
    assert "its negative" in line


@pytest.mark.slow
def test_notes_are_in_the_words_and_in_the_file(nominal):
    known = Fitted(nominal, Origin(misfit=1.0))
    found = pitp.diagnose(known, [*play(nominal, seed=7), resting("rest", 2e-6)], exclude=OTHERS)
    assert found.verdict == "no_gap" and "rest" not in (*found.fitted, *found.heldout)
    assert "note: left out" in str(found) and json.loads(json.dumps(found.as_json()))["notes"] == list(found.notes)


def test_a_model_is_known_to_be_made_from_its_own_recordings(linear, tmp_path):
    """Sums of files, whatever part of them was read, and of samples; through a file, and behind a later step."""
    time = np.arange(200) / 100
    memory = pitp.Record("a", time, np.ones(200), np.sin(time))
    (tmp_path / "b.csv").write_text("time_s,voltage_V,displacement_m\n0,1,2\n")
    file = pitp.Record("b", time, np.ones(200), np.cos(time), source=str(tmp_path / "b.csv"))
    other = replace(memory, displacement=memory.displacement + 1e-9)
    made = descended(descended(linear(), "identify", [memory]), "adapt", [file])
    save(tmp_path / "model", made)
    made = load(tmp_path / "model")
    part = replace(file, time=time[::2], voltage=np.ones(100), displacement=np.cos(time[::2]))
    assert was_made_from(made, [memory, part]) and was_made_from(made, [part])
    assert not was_made_from(made, [memory, other]) and not was_made_from(linear(), [memory])

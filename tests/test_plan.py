"""Planned recordings: within every limit, informative by the closed form, playable, deterministic."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete, lfilter

import pitp_jax as pitp
from pitp_jax import rest_state
from pitp_jax.application.commands.main import main
from pitp_jax.application.commands.plan import _sorted
from pitp_jax.application.pages.plan import page
from pitp_jax.application.plan.expected_error import information, knowledge
from pitp_jax.application.plan.next_recordings import choose, greedy, variance
from pitp_jax.application.plan.strokes import strokes
from pitp_jax.method.effects import lookup
from pitp_jax.method.fit.parameters import parameters, with_parameters
from pitp_jax.method.model.fitted import Fitted
from pitp_jax.method.model.origin import Origin
from pitp_jax.method.signal.excited import tabulate
from pitp_jax.method.simulate import ports
from pitp_jax.method.simulate.decoder import rollout

RIG = {"max_voltage": 6000.0, "band": (1.0, 10.0), "rate": 200.0}


def keeps(found, high, slew):
    """Every voltage within the limits, from zero to zero, the slew kept between samples."""
    for r in found.recordings:
        assert np.abs(r.voltage).max() <= high * (1 + 1e-9)
        assert r.voltage[0] == r.voltage[-1] == 0
        dt = np.diff(r.time)
        np.testing.assert_allclose(dt, 1 / found.limits.rate, rtol=1e-6)
        assert np.abs(np.diff(r.voltage)).max() * found.limits.rate <= slew * (1 + 1e-9)


@given(
    high=st.floats(10.0, 1e4), slow=st.floats(0.05, 20.0), octaves=st.floats(1.0, 4.0), pace=st.floats(0.05, 3.0),
    per_period=st.floats(20.0, 60.0), seed=st.integers(0, 99), alternate=st.booleans(),
)  # fmt: skip
@settings(max_examples=25, deadline=None)
def test_every_drive_keeps_the_rigs_limits(high, slow, octaves, pace, per_period, seed, alternate):
    band = slow, slow * 2**octaves
    slew = pace * 2 * np.pi * band[1] * high / 2  # down to a twentieth of what a full sine of the band asks for
    found = pitp.plan(
        max_voltage=high, max_slew=slew, band=band, rate=per_period * band[1], alternate=alternate, seed=seed
    )
    keeps(found, high, slew)
    if not alternate:
        assert min(r.voltage.min() for r in found.recordings) >= 0


def test_a_first_session_grows_then_sweeps_then_fills_and_repeats():
    found = pitp.plan(**RIG, duration=60.0, rest=3.0, max_displacement=2e-3)
    names = [r.name.split("_", 1)[1] for r in found.recordings]
    assert [n[:6] for n in names[:5]] == ["growth"] * 4 + ["sweep"] and names[-1] == names[5]
    tops = [float(r.voltage.max()) for r in found.recordings]
    assert tops[:4] == sorted(tops[:4]) and tops[5:-1] == sorted(tops[5:-1])
    assert found.seconds == pytest.approx(60.0, rel=0.02) and all(r.rest == 3.0 for r in found.recordings)
    for before, r in zip(found.recordings, found.recordings[1:4], strict=False):  # the stroke grows by the square
        ratio = before.voltage.max() / r.voltage.max()
        assert r.go_on == pytest.approx(2e-3 * ratio**2, rel=0.1)


@pytest.mark.parametrize("duration", [90.0, 125.0, 250.0])
@pytest.mark.parametrize("rig", [{"band": (0.1, 20.0)}, {"band": (0.5, 20.0), "max_slew": 1e5}, {"band": (2.0, 9.0)}])
def test_a_first_session_takes_the_duration_asked_for(rig, duration):
    found = pitp.plan(max_voltage=6000.0, rate=500.0, duration=duration, **rig)
    first, *_, again = [r for r in found.recordings if r.kind == "sine"]
    assert found.seconds == pytest.approx(duration, rel=5e-3)
    np.testing.assert_array_equal(first.voltage, again.voltage)


def test_no_drive_exceeds_the_stroke_with_half_the_damping(linear, bounded):
    """By an independent integration of the equation, at a resonance the band holds."""
    model = bounded(linear(2, 5.0, 0.04), high=1000.0, slew=1e5)
    found = pitp.plan(model, max_displacement=2.5e-3, duration=40.0, rate=500.0)
    a = model.physical_coefficients * [1, 0.5, 1]
    b, c = cont2discrete(([1.0], a[::-1]), 1 / 500, method="foh")[:2]  # pyright: ignore[reportIndexIssue]
    assert found.recordings
    for r in found.recordings:
        reached = np.abs(lfilter(np.ravel(b), np.ravel(c), r.voltage**2)).max()
        assert reached <= 2.5e-3 * 1.01
        assert r.stroke_half_damped == pytest.approx(reached, rel=0.02)
        assert r.stroke <= r.stroke_half_damped * 1.01


def test_a_plan_is_the_same_for_a_seed_and_another_for_another():
    first, same, other = (pitp.plan(**RIG, seed=k) for k in (3, 3, 4))
    assert all(np.array_equal(a.voltage, b.voltage) for a, b in zip(first.recordings, same.recordings, strict=True))
    assert not np.array_equal(first.recordings[6].voltage, other.recordings[6].voltage)


def test_alternating_polarity_turns_every_second_drive_over():
    plain, turned = (pitp.plan(**RIG, alternate=a).recordings for a in (False, True))
    for k, (a, b) in enumerate(zip(plain, turned, strict=True)):
        np.testing.assert_array_equal(b.voltage, -a.voltage if k % 2 else a.voltage)


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        ({"band": (1.0, 10.0)}, "--max-voltage"),
        ({"max_voltage": 1e3}, "--band"),
        (RIG | {"rate": 150.0}, "is too high for --rate"),
        (RIG | {"duration": 5.0}, "--duration 5 s is too short"),
        (RIG | {"max_slew": -1.0}, "--max-slew"),
    ],
)
def test_what_cannot_be_met_is_refused_in_one_line(limits, says):
    with pytest.raises(pitp.BadInput, match=says) as refused:
        pitp.plan(**limits)
    assert "\n" not in str(refused.value)


# information --------------------------------------------------------------------------------------------------------


def linear_design(seed, candidates=12, numbers=6):
    """Prior precision, candidates' information and what is to be predicted, of a linear model y = J p + e."""
    rng = np.random.default_rng(seed)
    rows = [rng.standard_normal((5, numbers)) * rng.uniform(0.1, 2, numbers) for _ in range(candidates)]
    test = rng.standard_normal((40, numbers))
    return np.eye(numbers), rows, test


@pytest.mark.parametrize("seed", range(5))
def test_the_choice_informs_at_least_as_much_as_any_single_one(seed):
    prior, rows, test = linear_design(seed)
    judged = test.T @ test / len(test)
    (best, second), (_, first_left, second_left) = choose(prior, [r.T @ r for r in rows], judged, 2)
    closed = [np.mean(np.sum(test @ np.linalg.inv(prior + r.T @ r) * test, axis=1)) for r in rows]
    assert best == int(np.argmin(closed))
    assert first_left == pytest.approx(min(closed), rel=1e-6)
    pairs = [np.trace(np.linalg.inv(prior + rows[best].T @ rows[best] + r.T @ r) @ judged) for r in rows]
    pairs[best] = np.inf
    assert second == int(np.argmin(pairs)) and second_left <= first_left


def test_the_variance_is_that_of_bayesian_least_squares():
    prior, rows, test = linear_design(7)
    rng, j = np.random.default_rng(0), rows[0]
    truth = rng.standard_normal((20000, 6))
    y = truth @ j.T + rng.standard_normal((20000, 5))
    fitted = y @ j @ np.linalg.inv(prior + j.T @ j)
    seen = np.mean(((fitted - truth) @ test.T) ** 2)
    assert variance(prior + j.T @ j, test.T @ test / len(test)) == pytest.approx(seen, rel=0.03)


# with a model -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def model(nonlinear, bounded):
    """A trained-like model at 5 Hz and 200 Hz sampling, 1 mm at 1000 V."""
    return bounded(nonlinear(2, size=0.3, dt=5e-3), high=2000.0, slew=2e5)


def read(model, u):
    """Scaled displacement of a free run from rest at 200 Hz."""
    states = rollout(model, jnp.asarray(u, jnp.float32), 5e-3, rest_state(model))
    return np.asarray(ports.readings(model, states), np.float64)


@pytest.fixture(scope="module")
def records(model):
    """Two records of it with a little noise."""
    t = np.arange(600) * 5e-3
    rng, found = np.random.default_rng(0), []
    for hz in (1.0, 4.0):
        u = 900 - 900 * np.cos(2 * np.pi * hz * t)
        x = 1e-3 * read(model, u)
        found.append(pitp.Record(f"sine{hz}", t, u, x + 2e-6 * rng.standard_normal(len(t))))
    return found


LENGTHS = {"band": (4 / 3, 10.0), "duration": 9.0}  # recordings of 3 s: one compiled program for all


@pytest.fixture(scope="module")
def following(model, records):
    return pitp.plan(model, records, **LENGTHS)


@pytest.mark.slow
def test_a_runs_information_is_that_of_its_jacobian(model, records):
    u, every = jnp.asarray(records[0].voltage, jnp.float32), 4  # ten samples to a period of 5 Hz at 200 Hz
    here = jnp.asarray(parameters(model)[0], jnp.float32)

    def reading(p):
        return ports.readings(model, rollout(with_parameters(model, p), u, 5e-3, rest_state(model)))

    (told,) = information(model, [records[0].voltage], 5e-3)
    along = jax.jit(lambda v: jax.jvp(reading, (here,), (v,)))
    for seed in range(3):
        v = np.random.default_rng(seed).standard_normal(len(here))
        x, moved = (np.asarray(a, np.float64) for a in along(jnp.asarray(v, jnp.float32)))
        wanted = 1e4 * every / len(x) / np.ptp(x) ** 2 * np.sum(moved[::every] ** 2)
        assert v @ told @ v == pytest.approx(wanted, rel=2e-3)
    assert strokes(model, [records[0].voltage], 5e-3)[0, 0] == pytest.approx(
        1e-3 * np.abs(read(model, u)).max(), rel=1e-4
    )


def test_a_level_informs_where_an_equilibrium_exists_and_otherwise_from_rest(linear):
    """A held level moves a spring nowhere; without a spring nothing holds, and the run starts at rest."""
    row, level = lookup("coulomb_friction", "smooth"), np.full(400, 500.0)
    sprung = replace(linear(2, dt=5e-3), effects=(row(jnp.asarray(0.1), jnp.asarray(0.006)),))
    free = replace(sprung, coefficients=sprung.coefficients * jnp.asarray([0.0, 1.0, 1.0]))
    others = [level, 500 * np.sin(np.arange(400) / 20)]
    assert [one.any() for one in information(sprung, others, 5e-3)] == [False, True]
    assert [one.any() for one in information(free, others, 5e-3)] == [True, True]


@pytest.mark.slow
def test_the_next_recordings_lower_the_expected_error(model, following):
    assert following.recordings and not following.stop
    assert (np.diff(following.expected) < 0).all() and len(following.expected) == len(following.recordings) + 1
    keeps(following, 2000.0, 2e5)


@pytest.mark.slow
def test_nothing_is_left_to_learn_where_everything_is_known(model, records):
    known, dt = knowledge(model, records), 5e-3
    told = information(model, [r.voltage for r in records], dt, known.floor)
    seconds = 3.0
    vague, sure = (replace(known, precision=k * known.precision) for k in (1e-6, 1e9))
    assert greedy(vague, told, told, seconds, 1)[2] == 1
    places, expected, worth = greedy(sure, told, told, seconds, 2)
    assert worth == 0 and len(places) == 2 and expected[0] < 1e-3


@pytest.mark.slow
def test_drives_beyond_the_membranes_stroke_are_left_out(model, records, following):
    strokes = sorted(r.stroke for r in following.recordings)
    limit = 0.75 * strokes[-1]
    found = pitp.plan(model, records, max_displacement=limit, **LENGTHS)
    assert all(r.stroke <= limit for r in found.recordings) and "left out" in found.notes[0]
    for r in found.recordings[:1]:
        assert 1e-3 * np.abs(read(model, r.voltage)).max() == pytest.approx(r.stroke, rel=1e-3)
    with pytest.raises(pitp.BadInput, match="every planned input is predicted to exceed it"):
        pitp.plan(model, records, max_displacement=1e-9, **LENGTHS)


def test_an_identified_model_gets_a_space_filling_set(actuator):
    found = pitp.plan(actuator, band=(0.5, 5.0), duration=40.0)
    assert len(found.recordings) == 8 and not found.expected
    assert all(r.kind == "sine" and np.isfinite(r.stroke) for r in found.recordings)
    keeps(found, 2000.0, 5e4)
    # what the model was not trained with comes first, within the same time
    slow = tabulate([1000 * np.sin(2 * np.pi * 0.7 * 1e-3 * np.arange(20_000))], 1e-3)
    again = pitp.plan(Fitted(actuator, Origin(excited_input=slow)), band=(0.5, 5.0), duration=40.0)
    first = again.recordings[0]
    assert "not trained" in first.purpose and again.seconds <= 40.0 + 1e-6
    power = np.abs(np.fft.rfft(first.voltage - first.voltage.mean())) ** 2
    hz = np.fft.rfftfreq(len(first.voltage), first.time[1] - first.time[0])
    assert power[(hz > 0.75) & (hz < 5.5)].sum() > 0.8 * power.sum()


# the command --------------------------------------------------------------------------------------------------------


def test_the_command_writes_drives_that_are_read_back_as_played(tmp_path, capsys):
    out = tmp_path / "plan"
    limits = ["--max-voltage", "6000", "--band", "1", "10", "--rate", "200", "--rest", "2", "--max-displacement", "3"]
    assert main(["plan", *limits, "--out", str(out), "--json", str(tmp_path / "j")]) == 0
    assert (tmp_path / "j").read_text() == (out / "plan.json").read_text()
    told, expected = json.loads((out / "plan.json").read_text()), pitp.plan(**RIG, rest=2.0, max_displacement=3e-3)
    assert len(told["files"]) == len(told["recordings"]) == len(expected.recordings)
    text = (out / "plan.html").read_text()
    assert "<script" not in text and "http" not in text and "growth_25" in text
    taken = tmp_path / "taken"
    taken.mkdir()
    for file, r in zip(told["files"], expected.recordings, strict=True):  # as the DAQ writes it beside the laser's
        lines = (out / file).read_text().splitlines()
        assert lines[0] == "time_s,voltage_V"
        rows = [f"{line},{1e-6 * k:.6f}" for k, line in enumerate(lines[1:])]
        (taken / file).write_text("\n".join([f"{lines[0]},displacement_m", *rows]))
        assert r.name == file.removesuffix(".csv")
    for r, back in zip(expected.recordings, pitp.read(taken), strict=True):
        np.testing.assert_allclose(back.voltage, r.voltage, atol=1e-4)
        assert back.dt == pytest.approx(1 / 200)
    assert "14 recordings" in capsys.readouterr().out


def test_the_command_refuses_with_nothing_written(tmp_path, capsys):
    out = str(tmp_path / "plan")
    assert main(["plan", "--max-voltage", "6000", "--band", "1", "10", "--rate", "50", "--out", out]) == 2
    assert "is too high for --rate" in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_the_command_takes_model_and_records_in_either_order(tmp_path, capsys, linear):
    """Only the model file can be the model; of none or two the message says what is missing."""
    model, other = tmp_path / "m.pitp", tmp_path / "n.pitp"
    pitp.save(model, linear(2))
    pitp.save(other, linear(2))
    assert _sorted(["records", str(model)]) == (str(model), ["records"]) == _sorted([str(model), "records"])
    assert main(["plan", str(tmp_path), "--out", str(tmp_path / "plan")]) == 2
    assert "is not a model file; give one model file" in capsys.readouterr().err
    assert main(["plan", str(model), str(other), "--out", str(tmp_path / "plan")]) == 2
    assert "several model files" in capsys.readouterr().err


def test_the_page_says_when_to_stop():
    first = pitp.plan(**RIG)
    assert "Stop" in page(type(first)((), first.limits, (0.02,), True), "model").html()
    assert "Stop" not in page(first, "model").html()


@pytest.mark.slow
def test_the_page_tells_the_error_that_is_expected(following):
    assert "the expected error of the model is" in page(following, "model").html()


@pytest.mark.parametrize("slew", [2e5, 3e4, 5e6])
def test_a_first_session_raises_voltage_and_slew_by_its_growth_alone(slew):
    """Names and texts of the growth are the voltage played; no later file exceeds what an earlier one was raised to."""
    session = pitp.plan(max_voltage=6000.0, max_slew=slew, band=(0.5, 20.0), duration=120.0)
    growth = [r for r in session.recordings if "growth" in r.name]
    peaks = [float(np.abs(r.voltage).max()) for r in growth]
    for r, peak in zip(growth, peaks, strict=True):
        percent = round(100 * peak / 6000.0)
        assert r.name.endswith(f"growth_{percent}") and f"bears {percent} %" in r.purpose
    assert (np.diff(peaks) > 0).all()
    assert all(r.slew <= slew for r in session.recordings)
    steepest = max(r.slew for r in growth)
    for r in session.recordings[len(growth) :]:
        assert np.abs(r.voltage).max() <= max(peaks) * (1 + 1e-9) and r.slew <= steepest * (1 + 1e-9)


def test_the_growth_plays_all_of_the_voltage_where_the_slew_allows_it_at_the_low_end():
    """At 0.5 Hz 6 kV take 9.4 kV/s; at 20 Hz 377 kV/s, above the limit."""
    session = pitp.plan(max_voltage=6000.0, max_slew=2e5, band=(0.5, 20.0), duration=120.0)
    assert [r.name for r in session.recordings[:4]] == [f"0{k}_growth_{p}" for k, p in enumerate((25, 50, 71, 100), 1)]


def test_rests_last_until_the_model_is_at_rest(linear, bounded):
    """exp(-zeta w t) = 0.005 for damping 0.1 at 5 Hz: 1.69 s, and half a period at most for the phase."""
    model = bounded(linear(2, 5.0, 0.1), high=1000.0, slew=1e5)
    rests = {r.rest for r in pitp.plan(model, duration=40.0, rate=500.0).recordings}
    assert len(rests) == 1 and rests.pop() == pytest.approx(np.log(200) / (0.1 * 2 * np.pi * 5), abs=0.2)
    assert {r.rest for r in pitp.plan(model, duration=40.0, rate=500.0, rest=0.0).recordings} == {0.0}


def test_with_a_model_that_is_right_no_recording_is_forbidden(linear, bounded):
    """The strokes that the plant shows, played in order, allow each next file; one 30 % softer forbids what exceeds."""
    model = bounded(linear(2, 5.0, 0.1), high=1000.0, slew=1e5)
    found = pitp.plan(model, max_displacement=2.2e-3, duration=60.0, rate=500.0)
    assert len(found.recordings) > 3
    for softer in (1.0, 1.3):
        reached = [softer * r.stroke for r in found.recordings]
        for k, r in enumerate(found.recordings[1:], 1):
            allowed = max(reached[:k]) <= r.go_on
            assert allowed if softer == 1.0 else not allowed or reached[k] <= 2.2e-3


def test_recordings_that_the_slew_limit_makes_long_are_reported():
    """6 kV up and down at 500 V/s take 24 s, and a recording holds several swings; at 2e5 V/s none is long."""
    slow, quick = (pitp.plan(max_voltage=6000.0, band=(0.5, 10.0), max_slew=slew) for slew in (500.0, 2e5))
    assert max(r.seconds for r in slow.recordings) > 60 > max(r.seconds for r in quick.recordings)
    (note,) = slow.notes
    assert "--max-slew" in note and "takes 24 s" in note and quick.notes == ()

"""Comparisons: two of a kind, and known differences between them."""

import json
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy.signal import lsim

import pitp_jax as pitp
from pitp_jax.application.compare.pairing import pair_records
from pitp_jax.application.compare.remarks import remarks_on
from pitp_jax.application.demo import joint
from pitp_jax.application.pages.compare import figures
from pitp_jax.common.numbers import number
from pitp_jax.method.model.encoder import CompactEncoder
from pitp_jax.method.model.fitted import Fitted
from pitp_jax.method.model.origin import Origin

A = np.array([1.0, 0.05, 1 / 400.0])  # rad s^i / rad: a joint of 3.2 Hz and damping ratio 0.5


def drives(time):
    """Three drives that begin after `time` 0."""
    t = np.clip(time, 0, 8)
    return {
        "chirp": 0.3 * np.sin(2 * np.pi * (0.2 * t + 0.3 * t**2)),
        "slow": 0.5 * np.sin(2 * np.pi * 0.4 * t),
        "fast": 0.2 * np.sin(2 * np.pi * 2.0 * t),
    }


def machine(coefficients=A, rate=200.0, lead=0.0, clock=0.0, late=0.0, gain=1.0, rename=lambda name: name, noise=1e-5):
    """Recordings of a linear machine, its log begun `lead` seconds before the drive by a clock that shows `clock`."""
    time = np.arange(round(rate * (9 + lead))) / rate - lead
    made = []
    for k, (name, u) in enumerate(drives(time).items()):
        y = gain * lsim(([1.0], coefficients[::-1]), drives(time - late)[name], time + lead)[1]
        y = y + noise * np.random.default_rng(k).standard_normal(len(time))
        made.append(pitp.Record(rename(name), time + lead + clock, u, y, displacement_unit="m"))
    return made


def test_recordings_are_paired_by_their_drives_and_clocks_told_apart():
    real = machine(rate=500.0, lead=0.7, clock=3.0, rename=lambda n: f"log_{len(n)}{n[-1]}")
    simulated = machine()[::-1]
    found = pair_records(real, simulated)
    assert [p.second.name for p in found.pairs] == ["chirp", "slow", "fast"]
    assert [p.offset for p in found.pairs] == pytest.approx([3.7] * 3, abs=1e-4)
    assert min(p.correlation for p in found.pairs) > 0.999
    assert remarks_on(found, "robot", "simulator") == [
        "Paired by their commands (robot with simulator): log_5p with chirp, log_4w with slow, log_4t with fast.",
        "The clock of the robot is 3.7 s ahead of that of the simulator. This is not a delay.",
    ]
    assert np.nanmax(np.abs(found.pairs[0].output() - real[0].displacement)) < 1e-3


def test_clocks_of_different_origins_are_reported_without_a_figure():
    found = remarks_on(pair_records(machine(clock=1.796e9), machine()), "robot", "sim")
    assert found == ["The logs of robot and sim use different clocks, more than a day apart. Ignored."]


def test_a_drive_of_another_size_or_shape_has_no_partner():
    real, simulated = machine(), machine()
    larger = pitp.Record("larger", real[1].time, 3 * real[1].voltage, real[1].displacement)
    found = pair_records([real[0], larger], simulated[:2])
    assert [p.first.name for p in found.pairs] == ["chirp"]
    assert "another size (factor 3)" in found.first_alone[0][1]
    assert [name for name, _ in found.second_alone] == ["slow"]
    found = pair_records(real[2:], simulated[:1])
    assert not found.pairs and "no command correlates by" in found.first_alone[0][1]


LOADS = {"light": A, "middle": A * [1, 1, 1.5], "heavy": A * [1, 1, 2.2]}


def _loads(rename=lambda name: name, **of_machine):
    """One recording a command and load, named LOAD_COMMAND or as `rename` makes of that."""
    return [
        record
        for load, coefficients in LOADS.items()
        for record in machine(coefficients, rename=lambda name, load=load: rename(f"{load}_{name}"), **of_machine)
    ]


def test_repeated_commands_are_paired_by_their_responses():
    """Three loads under the same commands: the robot lags and moves less, and its files carry running numbers."""
    simulated = _loads()
    order = np.random.default_rng(3).permutation(len(simulated))
    running = {simulated[k].name: f"run_{n}" for n, k in enumerate(order)}
    robot = sorted(_loads(running.__getitem__, late=0.03, gain=0.85, noise=1e-3), key=lambda r: r.name)
    found = pair_records(simulated, robot)
    assert {p.first.name: p.second.name for p in found.pairs} == running
    told = " ".join(remarks_on(found, "sim", "robot"))
    assert "Several recordings of the sim have the same command (light_chirp, middle_chirp, heavy_chirp;" in told
    assert not found.undecided


@pytest.mark.parametrize("shared", ["first", "second"])
def test_one_simulation_serves_every_repeat(shared):
    repeats = [
        record
        for k in range(3)
        for record in machine(late=0.03, gain=0.9, noise=1e-3 * (k + 1), rename=lambda name, k=k: f"{name}_{k}")
    ]
    sets = (machine(), repeats) if shared == "first" else (repeats, machine())
    found = pair_records(*sets, shared=shared)
    names = [(p.first.name, p.second.name) for p in found.pairs]
    assert sorted(sorted(pair, key=len) for pair in names) == sorted(
        [name, f"{name}_{k}"] for name in drives(np.zeros(1)) for k in range(3)
    )
    assert not found.first_alone and not found.second_alone and found.repeated == ((), ())
    # nobody said which set may serve: repeats are recognised as such
    assert len(pair_records(*sets[::-1], shared="first").pairs) == len(pair_records(*sets, shared="first").pairs) == 9


def test_a_load_that_was_not_simulated_has_no_partner():
    found = pair_records(_loads()[:6], _loads(late=0.001))
    assert {(p.first.name, p.second.name) for p in found.pairs} == {(r.name, r.name) for r in _loads()[:6]}
    assert [name for name, _ in found.second_alone] == ["heavy_chirp", "heavy_slow", "heavy_fast"]
    assert "has a closer partner" in found.second_alone[0][1]


def test_equal_recordings_go_by_their_names_and_are_reported():
    twice = [*machine()[:1], *machine(rename=lambda name: f"{name}_again")[:1]]
    found = pair_records(twice, twice[::-1])
    assert [(p.first.name, p.second.name) for p in found.pairs] == [("chirp", "chirp"), ("chirp_again", "chirp_again")]
    assert found.undecided == (("chirp", "chirp", ("chirp_again",)), ("chirp_again", "chirp_again", ("chirp",)))
    assert "chirp fits chirp_again as well as chirp" in " ".join(remarks_on(found, "a", "b"))


@pytest.mark.parametrize(("command", "output"), [(1, 1), (-1, -1), (1, -1), (-1, 1)])
def test_a_mirrored_axis_is_turned_and_reported(command, output):
    simulated, robot = machine(), machine(gain=0.9, clock=2.0)
    robot = [
        pitp.Record(r.name, r.time, command * r.voltage, output * r.displacement, displacement_unit="m") for r in robot
    ]
    found = pitp.compare(simulated, robot, names=("sim", "robot"))
    assert found.pairs is not None and found.pairs.mirrored == (command < 0, output < 0)
    assert [p.offset for p in found.pairs.pairs] == pytest.approx([-2.0] * 3, abs=1e-4)
    assert [np.sign(p.correlation) for p in found.pairs.pairs] == [command] * 3
    assert np.allclose(found.pairs.pairs[1].command(), simulated[1].voltage, atol=1e-9)
    rows: list[Any] = [r for r in found.rows if "size of the motion" in r.what]
    sizes = [r.b / r.a for r in rows]
    assert sizes == pytest.approx([0.9] * 3, abs=2e-3)
    told = " ".join(found.remarks)
    assert ("input-scale = -1" in told) == (command < 0) and ("output-scale = -1" in told) == (output < 0)


def test_two_commands_that_mirror_each_other_keep_their_signs():
    both = [
        pitp.Record(f"{r.name}_{s}", r.time, s * r.voltage, s * r.displacement) for r in machine()[:2] for s in (1, -1)
    ]
    found = pair_records(both, both[::-1])
    assert all(p.first.name == p.second.name and p.correlation > 0 for p in found.pairs) and len(found.pairs) == 4


def test_a_constant_offset_of_the_output_is_printed_and_is_no_difference():
    """An encoder that reads 2048 at rest: robot and simulator were drawn and told apart by 2048."""
    robot = machine(late=0.02, gain=0.9)
    ticks = [replace(r, displacement=r.displacement + 2048.0) for r in robot]
    plain, raw = (pitp.compare(machine(), other, names=("sim", "robot")) for other in (robot, ticks))
    for one, two in zip(plain.rows, raw.rows, strict=True):
        assert (two.what.split(" (")[0], two.differs) == (one.what.split(" (")[0], one.differs)
        assert two.b == pytest.approx(one.b, rel=1e-3, abs=1e-6)
    assert not any("constant offset" in line for line in plain.remarks)
    (line,) = (line for line in raw.remarks if "constant offset" in line)
    assert "2.05e+03" in line or "2048" in line
    assert raw.as_json()["pairs"][0]["output_offset"] == pytest.approx(2048.0, abs=0.02)
    caption = figures(raw)[0].caption
    drawn = figures(raw)[0].drawn.axes[0]
    assert "2048" in caption or "2.05e+03" in caption
    assert np.nanmax(np.abs(drawn.lines[1].get_ydata())) < 2.0


@pytest.mark.parametrize("constant", [0.0, 3.14159])
def test_commands_are_told_apart_beside_a_constant_offset(constant):
    """A robot that recorded the larger of two commands, or the upper of two centres, in registers or without."""
    simulated = machine()
    larger = [replace(r, name="larger", voltage=1.06 * r.voltage, displacement=1.06 * r.displacement)
              for r in simulated[:1]]  # fmt: skip
    upper = [replace(r, name="upper", voltage=r.voltage + 0.4, displacement=r.displacement + 0.4)
             for r in simulated[1:2]]  # fmt: skip
    robot = [
        pitp.Record(str(k), r.time, r.voltage + constant, 0.9 * r.displacement + constant, displacement_unit="m")
        for k, r in enumerate([*larger, *upper, simulated[2]])
    ]
    found = pair_records(robot, [*simulated, *larger, *upper], shared="second")
    pairs = {(p.first.name, p.second.name) for p in found.pairs}
    assert pairs == {("0", "larger"), ("1", "upper"), ("2", "fast"), ("0", "chirp"), ("1", "slow")}  # the others alike
    assert found.offsets[0] == pytest.approx(constant, abs=1e-9)


def test_two_sets_of_records_differ_by_size_and_lag_that_were_made():
    found = pitp.compare(machine(), machine(late=0.02, gain=0.9, clock=5.0), names=("sim", "robot"))
    rows: dict[str, Any] = {r.what: r for r in found.rows}
    for name in ("chirp", "slow", "fast"):
        size, late = rows[f"{name}: size of the motion"], rows[f"{name}: time behind sim"]
        assert size.b / size.a == pytest.approx(0.9, abs=2e-3) and size.differs
        assert late.b == pytest.approx(20.0, abs=0.3) and late.differs
    assert found.remarks == ("The clock of the sim is 5 s behind that of the robot. This is not a delay.",)
    assert len(repr(found).splitlines()) <= 10
    assert found.frame().shape[0] == len(found.rows)
    json.dumps(found.as_json())


def test_two_recordings_of_one_machine_do_not_differ():
    again = [
        pitp.Record(
            r.name, r.time, r.voltage, r.displacement + 1e-5 * np.random.default_rng(9).standard_normal(r.samples)
        )
        for r in machine()
    ]
    found = pitp.compare(machine(), again)
    assert not found.different


@pytest.mark.slow
def test_models_of_two_machines_differ_by_what_was_changed():
    stiffer = A * [1.0, 1.0, 1.25]
    models = [pitp.identify(machine(a), order=2, input_map="linear") for a in (A, stiffer)]
    found = pitp.compare(*models)
    rows: dict[str, Any] = {r.what: r for r in found.rows}
    assert rows["inertia (a2)"].differs and rows["inertia (a2)"].b / rows["inertia (a2)"].a == pytest.approx(
        1.25, rel=5e-3
    )
    low, high = rows["inertia (a2)"].ci95
    assert low <= stiffer[2] - A[2] <= high
    assert not rows["order"].differs and not rows["stiffness (a0)"].differs
    assert "inertia (a2)" in repr(found)
    alike = [pitp.identify(machine(noise=n), order=2, input_map="linear") for n in (1e-5, 2e-5)]
    assert not any(r.differs for r in pitp.compare(*alike).rows if "(a" in r.what)


def _model(linear, bounded, factors=(1.0, 1.0, 1.0), encoder=None):
    """A model of order 2 with its own error of 0.3 % on one record, coefficients times `factors`."""
    model = bounded(linear(2), high=2000.0)
    coefficients = model.coefficients * np.asarray(factors, np.float32)
    changed = replace(model, coefficients=coefficients, **({} if encoder is None else {"encoder": encoder}))
    return Fitted(changed, Origin(training={"errors": {"sine": [1.0, 0.3]}}))


def test_models_of_unknown_error_are_not_said_to_be_equal(linear, bounded):
    one, two = (replace(_model(linear, bounded, f), origin=Origin(level=np.inf)) for f in ((1.0,) * 3, (1.3, 1.0, 1.0)))
    rows = [r for r in pitp.compare(one, two).rows if "free runs" in r.what]
    assert [r.differs for r in rows] == [None]


def test_responses_of_linear_models_are_those_of_the_closed_form(linear, bounded):
    """x = U^2 / a0, dF/dx = a0, w = sqrt(a0 / a2), zeta = a1 / (2 sqrt(a0 a2)); 1.3 times as stiff is seen in each."""
    one, two = _model(linear, bounded), _model(linear, bounded, (1.3, 1.0, 1.0))
    found = {r.what: r for r in pitp.compare(one, two).rows}
    for side, model in (("a", one), ("b", two)):
        a0, a1, a2 = model.physical_coefficients
        for level in (500.0, 1200.0, 1900.0):
            at = f"at {number(level)} V"
            expected = {
                f"settled displacement {at}": level**2 / a0, f"stiffness dF/dx {at}": a0,
                f"resonance {at}": np.sqrt(a0 / a2) / 2 / np.pi, f"damping ratio {at}": a1 / 2 / np.sqrt(a0 * a2),
            }  # fmt: skip
            for what, value in expected.items():
                assert getattr(found[what], side) == pytest.approx(value, rel=2e-3), what
    same = [
        what for what, r in found.items() if what.startswith(("stiffness dF", "resonance", "free")) and not r.differs
    ]
    assert not same


@pytest.mark.slow
def test_a_trained_model_is_compared_by_what_it_does(linear, bounded):
    """The same network on a spring 1.3 times as stiff differs; on one 1.0005 times as stiff it does not."""
    encoder = CompactEncoder(2, 0, width=4, key=jax.random.key(3))
    encoder = jax.tree.map(lambda leaf: leaf + 0.1, encoder, is_leaf=eqx.is_inexact_array)
    one = _model(linear, bounded, encoder=encoder)
    stiffer = pitp.compare(one, _model(linear, bounded, (1.3, 1.0, 1.0), encoder))
    rows: dict[str, Any] = {r.what: r for r in stiffer.rows}
    soft = rows["stiffness dF/dx at 500 V"]  # where the network has hardly moved on
    assert soft.differs and 1.2 < soft.b / soft.a < 1.35
    assert "do not differ beyond" not in stiffer.headline() and rows["input seen"].differs is False
    same = pitp.compare(one, _model(linear, bounded, (1.0005, 1.0, 1.0), encoder))
    assert not same.different and "do not differ beyond" in same.headline()


def test_factors_of_adapt_are_compared(linear, bounded):
    one = _model(linear, bounded)
    entry = {"changed": {"stiffness": {"factor": 1.3, "ci95": [1.287, 1.313]}}}
    two = Fitted(one.model, replace(one.origin, adapted=(entry,)))
    (row,) = [r for r in pitp.compare(one, two).rows if "adapt" in r.what]
    assert (row.a, row.b, row.differs) == (1.0, 1.3, True) and row.ci95 == pytest.approx((0.287, 0.313))


def test_two_kinds_are_refused(linear):
    with pytest.raises(pitp.BadInput, match="A is a model, B a set of recordings; give two of the same kind"):
        pitp.compare(linear(2), machine())
    with pytest.raises(pitp.BadInput, match="cannot be compared; give pitp.load"):
        pitp.compare("a.pitp", linear(2))


def test_the_joints_recordings_differ_as_friction_and_delay_make_them(tmp_path):
    """The demo's simulator and robot: other rates, a clock 0.7 s off, which is no delay."""
    joint.write(tmp_path, quick=True)
    sets = [
        [_record(path, factor) for path in sorted((tmp_path / home).glob("*.csv"))]
        for home, factor in (("sim", 1.0), ("robot", np.pi / 180))
    ]
    found = pitp.compare(*sets, names=("sim", "robot"))
    assert found.pairs is not None
    assert [p.offset for p in found.pairs.pairs] == pytest.approx([-0.7] * 6, abs=3e-3)
    late: dict[str, Any] = {r.what: r.b for r in found.different if "time behind" in r.what}
    assert late["sine_2.5Hz: time behind sim"] > 20.0  # ms; 20 of delay, and what friction and play add


def _record(path, factor):
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    return pitp.Record(path.stem, table[:, 0], factor * table[:, 1], factor * table[:, 2])


def test_a_range_that_rounding_moved_is_the_same_range(linear, bounded):
    one, two = (bounded(linear(2), high=high) for high in (6000.0, 6000.0 - 4e-6))
    by = {row.what: row.differs for row in pitp.compare(one, two).rows}
    assert not by["input seen"]
    assert {row.what: row.differs for row in pitp.compare(one, bounded(linear(2), high=5900.0)).rows}["input seen"]

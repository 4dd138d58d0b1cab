"""A robot beside its simulator: corrections, units and names, and the demo's joint from end to end."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import diagnosis_cases
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim

import pitp_jax as pitp
from pitp_jax.application.against import entry
from pitp_jax.application.against.correction import corrections
from pitp_jax.application.against.entry import model_of_simulator, parameters_of
from pitp_jax.application.against.mjcf import with_shared_weight
from pitp_jax.application.against.result import SimToReal
from pitp_jax.application.compare.pairing import Pairing
from pitp_jax.application.demo import joint
from pitp_jax.application.demo.joint import Joint, commands, simulate
from pitp_jax.method.diagnose.joint import parameters
from pitp_jax.method.effects import CATALOGUE
from pitp_jax.method.effects.physical import physical, physical_factor
from pitp_jax.method.model.fitted import Fitted
from pitp_jax.method.model.origin import Origin

A = np.array([1.0, 0.045, 0.0025])  # the demo's ideal joint over its position gain
TIME = np.arange(1600) / 200
OPTIONS = {"progress": lambda line: None}


def recordings(coefficients=A, late=0.0):
    """A linear joint's recordings; units are volts for want of a plant that moves by radians in this module."""
    return list(_recordings(tuple(coefficients), late))


@cache
def _recordings(coefficients, late):
    made = []
    for k, hertz in enumerate((0.5, 1.5, 3.0)):
        u = 0.3 * np.sin(2 * np.pi * hertz * np.clip(TIME - 0.5, 0, None))
        y = lsim(
            ([1.0], coefficients[::-1]), 0.3 * np.sin(2 * np.pi * hertz * np.clip(TIME - 0.5 - late, 0, None)), TIME
        )[1]
        noise = 1e-5 * np.random.default_rng(k).standard_normal(len(TIME))
        made.append(pitp.Record(f"sine{hertz}", TIME, u, y + noise, displacement_unit="V"))
    return made


@pytest.fixture(scope="module")
def simulator():
    return pitp.identify(recordings(), order=2, input_map="linear").model


def test_a_correction_gives_the_robots_output_when_the_simulator_plays_it(simulator):
    """The simulator under the corrected command, solved by SciPy, moves as a robot that is late and heavier."""
    robot = recordings(A * [1.0, 1.1, 1.3], late=0.02)
    for record, added in zip(robot, corrections(simulator, robot), strict=True):
        before = lsim(([1.0], A[::-1]), record.voltage, TIME)[1] - record.displacement
        after = lsim(([1.0], A[::-1]), record.voltage + added, TIME)[1] - record.displacement
        assert np.sqrt(np.mean(after**2)) < 0.05 * np.sqrt(np.mean(before**2))


def _robot(model, effects=(), shift=(1.0, 1.0, 1.0)):
    """A diagnosis that adds these effects and moves the coefficients, as the layer above reads it."""
    form: Any = {f.name: f for f in reversed(CATALOGUE)}
    scale = {"coulomb_friction": model.scales.force, "delay": 1.0, "backlash": model.scales.state[0]}
    added = tuple(form[name](jnp.asarray(value / scale[name], jnp.float32)) for name, value in effects)
    moved = model.changed(np.asarray(shift))
    told = [SimpleNamespace(effect=n, parameters={}) for n, _ in effects]
    names = tuple(n for n, _ in effects) + (("parameter_change",) if any(s != 1 for s in shift) else ())
    rows = {f"a_{i} over given": {"value": s, "unit": "1", "stderr": 0.01} for i, s in enumerate(shift)}
    told.append(SimpleNamespace(effect="parameter_change", parameters=rows))
    return SimpleNamespace(model=replace(moved, effects=added), added=told, effects=names, handed_back=())


def test_numbers_after_position_commands_are_torques_with_a_gain_and_ratios_without(simulator):
    robot: Any = _robot(simulator, [("delay", 0.02), ("coulomb_friction", 0.035), ("backlash", 0.02)], (1.0, 1.2, 1.0))
    rows = {p.name: p for p in parameters(simulator, robot, recordings(), 20.0)}
    friction, damping, inertia = rows["coulomb_friction level"], rows["damping"], rows["inertia"]
    assert friction.robot == pytest.approx(0.7, rel=1e-3) and friction.simulator == 0.0
    assert friction.mujoco == "joint frictionloss" and friction.certain
    assert damping.simulator == pytest.approx(0.9, rel=5e-3)
    assert damping.difference == pytest.approx(0.18, rel=5e-3)
    assert damping.stderr == pytest.approx(0.01 * damping.simulator)
    assert inertia.simulator == pytest.approx(0.05, rel=5e-3) and inertia.difference == 0.0
    # taken as a line between samples: of its 20 ms half a sample of 5 ms is the command's own hold
    assert rows["delay time"].robot == pytest.approx(0.0175, rel=1e-3) and rows["delay time"].unit == "s"
    assert rows["backlash width"].robot == pytest.approx(0.02, rel=1e-3)  # no force, although commands have its unit
    ratios = {p.name: p for p in parameters(simulator, robot, recordings(), None)}
    assert ratios["coulomb_friction level"].robot == pytest.approx(0.035, rel=1e-3)
    assert ratios["damping"].unit == "Kp s" and ratios["damping"].simulator == pytest.approx(0.045, rel=5e-3)


def test_a_delay_that_includes_half_a_sample_is_related_to_the_one_to_enter(simulator):
    robot: Any = _robot(simulator, [("delay", 0.02)], (1.0, 1.0, 1.0))
    pairs = Pairing((), (), ())
    told = parameters(simulator, robot, recordings(), 20.0)
    found: Any = SimpleNamespace(
        robot=robot,
        nominal=simulator,
        pairs=pairs,
        parameters=told,
        own=0.0,
        _share=0.0,
        records=recordings(),
    )
    (line,) = [line for line in SimToReal.lines(found) if "Enter a delay" in line]
    assert "17.5 ms" in line and "half a sample (2.5 ms)" in line


@pytest.mark.slow
@pytest.mark.parametrize("other", [5.0, 3.0])
def test_what_one_model_misses_of_two_loads_is_stated_with_the_remedy(other):
    """Both commands by a mode of 5 Hz and by another one: two loads, or one of them twice."""
    records = []
    for hz in (5.0, other):
        w = 2 * np.pi * hz
        for r in recordings():
            y = lsim(([w**2], [1.0, 0.6 * w, w**2]), r.voltage, r.time - r.time[0], interp=False)[1]
            records.append(replace(r, name=f"{len(records)}", displacement=y))
    model, _, own = model_of_simulator(records, 1e-4, OPTIONS)
    found: Any = SimpleNamespace(own=own, _share=0.0, pairs=Pairing((), (), ()), parameters=(), records=records,
                                 nominal=model)  # fmt: skip
    lines = [line for line in SimToReal.remarks(found) if "folder of its own" in line]
    assert len(lines) == (other != 5.0)
    assert all(f"misses {own:.2g} % of range of the simulator's recordings" in line for line in lines)


def test_coefficients_scaled_alike_are_a_position_gain_or_its_twin(simulator):
    """A controller of twice the gain: Kp q + D q' + J q'' = Kp c has D / Kp and J / Kp halved."""
    robot: Any = _robot(simulator, [], (1.0, 0.5, 0.505))
    rows = {p.name: p for p in parameters(simulator, robot, recordings(), 20.0)}
    gain = rows["position gain"]
    assert gain.simulator == 20.0 and gain.robot == pytest.approx(40.0, rel=0.01) and gain.mujoco == "actuator kp"
    assert "if the position gain is the simulator's" in rows["inertia"].words
    ratio = {p.name: p for p in parameters(simulator, robot, recordings(), None)}["position gain"]
    assert ratio.unit == "Kp" and ratio.robot == pytest.approx(2.0, rel=0.01)
    for shift in ((1.0, 1.0, 0.5), (0.5, 0.5, 0.5), (1.0, 1.01, 1.0)):
        other: Any = _robot(simulator, [], shift)
        assert "position gain" not in {p.name for p in parameters(simulator, other, recordings(), 20.0)}


@pytest.fixture(scope="module")
def turning(simulator):
    """The simulator of a joint whose commands and angles are radians."""
    return Fitted(simulator.model, replace(simulator.origin, voltage_unit="rad", displacement_unit="rad"))


def _rows(simulator, *effects, parts=()):
    """Numbers beside a robot that has these (name, form, numbers in physical units) besides, Kp = 20."""
    scales = (simulator.scales.state, simulator.scales.force)
    made = []
    for name, form, *values in effects:
        row = next(f for f in CATALOGUE if (f.name, f.form) == (name, form))
        factors = [physical_factor(p, *scales) for p in row.parameters]
        made.append(row(*(jnp.asarray(v / f, jnp.float32) for v, f in zip(values, factors, strict=True))))
    names = tuple(name for name, *_ in effects)
    robot: Any = SimpleNamespace(model=replace(simulator, effects=tuple(made)), added=[], effects=names, parts=parts)
    records = [replace(r, voltage_unit="rad", displacement_unit="rad") for r in recordings()]
    return {p.name: p for p in parameters(simulator, robot, records, 20.0)}


def test_numbers_that_help_are_in_the_headline_though_no_cause_is_certain():
    gap = SimpleNamespace(before=5.28, after=0.1)
    for handed_back, expected in ((("drag",), "from 5.3 % to 0.10 % of range; no single cause"), ((), "no effect in")):
        found = object.__new__(SimToReal)
        robot = SimpleNamespace(verdict="unknown", effects=(), handed_back=handed_back, gap=gap)
        object.__setattr__(found, "robot", robot)
        assert expected in found.headline()


def test_a_hanging_arm_and_a_limit_of_the_drive_are_torques(turning):
    """m g l = 1.2 N m and a limit of 2 N m of a joint with a position gain of 20 N m/rad."""
    rows = _rows(turning, ("softening", "weight on an arm", 0.06, 1.0), ("force_limit", "inside the loop", 20 / 2.0))
    assert rows["softening weight"].robot == pytest.approx(1.2, rel=1e-3)
    assert rows["softening weight"].unit == "N m/rad"
    limit = rows["force_limit inverse"]
    assert (limit.robot, limit.unit, limit.mujoco) == (pytest.approx(2.0, rel=1e-3), "N m", "actuator forcerange")
    assert limit.simulator == np.inf


def test_a_body_on_a_spring_is_told_as_inertia_spring_and_damper(turning):
    """kappa K = J2 omega^2 and 2 zeta omega J2 of a body of 0.004 kg m^2 at 4 Hz behind a joint of 20 N m/rad."""
    omega = 2 * np.pi * 4
    rows = _rows(turning, ("second_mode", "hung on", 0.004 * omega**2 / 20, omega, 0.06))
    assert rows["second_mode inertia"].robot == pytest.approx(0.004, rel=0.01)
    assert rows["second_mode spring"].robot == pytest.approx(0.004 * omega**2, rel=0.01)
    assert rows["second_mode damper"].robot == pytest.approx(0.12 * omega * 0.004, rel=0.01)
    assert rows["second_mode inertia"].unit == "kg m^2" and rows["second_mode inertia"].certain


def test_a_weight_on_an_arm_is_told_as_such_and_the_spring_without_it(turning):
    """K sin(c q) / c about 0 is a spring of K and a cubic of K c^2 / 6: a pendulum of K c^2, a spring of the rest."""
    rows = _rows(turning, ("softening", "gravity", 0.5))
    assert rows["softening weight"].robot == pytest.approx(0.25 * 20, rel=0.01)
    assert rows["stiffness"].difference == pytest.approx(-0.25 * 20, rel=0.01)


def test_stops_at_two_places_are_two_numbers_and_mass_is_inertia(turning):
    rows = _rows(
        turning, ("end_stop", "above", 30.0, 0.3), ("end_stop", "below", 30.0, 0.4), ("added_mass", "share", 0.5)
    )
    assert rows["end_stop place, above"].robot == pytest.approx(0.3, rel=1e-3)
    assert rows["end_stop place, below"].robot == pytest.approx(0.4, rel=1e-3)
    assert rows["inertia"].difference == pytest.approx(0.5 * rows["inertia"].simulator, rel=1e-3)
    assert rows["inertia"].certain and not rows["damping"].certain
    both = _rows(turning, ("end_stop", "each side, damped", 30.0, 0.3, 0.4, 0.01))
    assert [both[f"end_stop place, {side}"].robot for side in ("above", "below")] == pytest.approx([0.3, 0.4])


@pytest.mark.parametrize(("speed", "names"), [(110.0, {"level"}), (1.0, {"level", "rise", "speed"})])
def test_friction_whose_speed_was_not_recorded_is_the_friction_at_the_recorded_speeds(turning, speed, names):
    """Level 0.0017 and rise 12 at 110 rad/s are 0.0221 at every recorded speed (some 3 rad/s)."""
    rows = _rows(turning, ("coulomb_friction", "Stribeck", 0.0017, 12.0, speed))
    friction = {k.split()[1]: row for k, row in rows.items() if k.startswith("coulomb_friction")}
    assert set(friction) == names
    told = 0.0017 * (13 if "rise" not in names else 1) * 20
    assert friction["level"].robot == pytest.approx(told, rel=5e-3) and friction["level"].determined


@pytest.mark.parametrize(("certainty", "determined"), [("likely", True), ("none", False)])
def test_what_the_diagnosis_does_not_determine_is_marked(turning, certainty, determined):
    """The friction at the recorded speeds is known where the effect is; each of its parameters by its interval."""
    unknown = {name: {"value": 1.0, "unit": "", "ci95": None} for name in ("level", "rise", "speed")}
    part = SimpleNamespace(effect="coulomb_friction", parameters=unknown, certainty=certainty)
    for speed, wanted in ((110.0, determined), (1.0, False)):
        rows = _rows(turning, ("coulomb_friction", "Stribeck", 0.0017, 12.0, speed), parts=(part,))
        assert rows["coulomb_friction level"].determined == wanted and rows["damping"].determined


def test_a_third_pole_stands_as_a_lag_behind_two_in_the_robots_model(turning):
    """(a0 + a1 s + a2 s^2)(1 + tau s) is the simulator's polynomial: then no number differs."""
    lag, third = 0.002, pitp.identify(recordings(np.convolve(A, [1.0, 0.002])), order=3, input_map="linear").model
    row = next(f for f in CATALOGUE if (f.name, f.form) == ("sensor_lag", "one lag"))
    model = replace(turning, effects=(row(jnp.asarray(lag, jnp.float32)),))
    robot: Any = SimpleNamespace(model=model, added=[], effects=())
    rows = {p.name: p for p in parameters(third, robot, recordings(), None)}
    assert set(rows) == {"gain", "stiffness", "damping", "inertia", "a3"}
    assert all(abs(p.difference) < 0.02 * abs(p.robot) for p in rows.values() if p.name in ("damping", "inertia"))


def _moved(records, sign, command, output):
    """The same log of a mirrored axis, or in registers that read these constants at rest."""
    return [
        replace(r, voltage=sign * r.voltage + command, displacement=sign * r.displacement + output) for r in records
    ]


@cache
def _identified(*drives):
    """An identification of the drives and outputs of these bytes."""
    columns = ((np.frombuffer(column) for column in drive) for drive in drives)
    records = [pitp.Record(f"r{k}", t, u, y, displacement_unit="V") for k, (t, u, y) in enumerate(columns)]
    return pitp.identify(records)


def _identify(records):
    """Identify once what is identified again: the same bytes."""
    return _identified(*((r.time.tobytes(), r.voltage.tobytes(), r.displacement.tobytes()) for r in records))


def _asked_of_diagnosis(robot, monkeypatch):
    """The simulator's model and the robot's recordings, with which the diagnosis would begin."""
    asked = []
    monkeypatch.setattr(entry, "identify", _identify)

    def diagnosed(model, records, **options):
        asked.append((model, records))
        raise KeyboardInterrupt

    monkeypatch.setattr(entry, "diagnose_model", diagnosed)
    with pytest.raises(KeyboardInterrupt):
        pitp.diagnose(robot, against=recordings())
    return asked[0]


@pytest.fixture(scope="module")
def plain():
    """The same of recordings without constants."""
    with pytest.MonkeyPatch.context() as patch:
        return _asked_of_diagnosis(recordings(A * [1.0, 1.2, 1.3], late=0.02), patch)


@pytest.mark.parametrize(
    ("sign", "constants"),
    [(1, (np.pi, np.pi)), (-1, (np.pi, np.pi)), (1, (0.0, 3.0)), (1, (0.004, -0.003))],
)
def test_a_constant_of_the_log_is_no_distance(plain, sign, constants, monkeypatch):
    """Raw ticks and ticks less 2048: the same model of the simulator, the same recordings for the diagnosis."""
    model, records = plain
    moved = _moved(recordings(A * [1.0, 1.2, 1.3], late=0.02), sign, *constants)
    other, same = _asked_of_diagnosis(moved, monkeypatch)
    np.testing.assert_allclose(other.physical_coefficients, model.physical_coefficients, rtol=1e-3)
    if max(map(abs, constants)) > 1:  # smaller ones are left to each recording's sensor offset
        for a, b in zip(records, same, strict=True):
            np.testing.assert_allclose(sign * b.displacement, a.displacement, atol=1e-3 * np.ptp(a.displacement))
            np.testing.assert_allclose(sign * b.voltage, a.voltage, atol=1e-3 * np.ptp(a.voltage))


@pytest.mark.parametrize(("own", "verdict"), [(0.3, "unknown"), (0.0, "no_gap")])
def test_a_gap_below_the_error_of_the_simulators_model_is_unknown(simulator, own, verdict, monkeypatch):
    found = diagnosis_cases.no_gap(diagnosis_cases.explained(simulator))
    monkeypatch.setattr(entry, "diagnose_model", lambda model, records, **options: replace(found, model=model))
    monkeypatch.setattr(entry, "model_of_simulator", lambda simulated, noise, options: (simulator, None, own))
    said = []
    told = pitp.diagnose(recordings(), against=recordings(), progress=said.append)
    pitp.diagnose(recordings(), against=recordings(), progress=said.append, seconds=9.0)
    assert ["no limit of time" in line for line in said if "identifying" in line] == [True, False]
    assert told.verdict == verdict and ("may hide" in told.robot.reason) == (verdict == "unknown")
    assert told.budget["simulator"]["share"] >= 0


def test_a_spring_that_both_carry_is_no_difference_where_the_position_gain_differs():
    """K + Kp = 1.5 + 20 N m/rad in the simulator, 1.5 + 28 in the robot: one number differs, the others are equal."""
    inertia, damping, spring = 0.05, 0.9, 1.5
    a, b = (np.array([1 + spring / gain, damping / gain, inertia / gain]) for gain in (20.0, 28.0))
    simulated = pitp.identify(recordings(a), order=2, input_map="linear").model
    robot: Any = _robot(simulated, [("coulomb_friction", 0.5 / 28)], b / a)
    for given, scale in ((20.0, 1.0), (None, 20.0)):
        rows = {p.name: p for p in parameters_of(simulated, robot, recordings(), given)}
        assert scale * rows["position gain"].robot == pytest.approx(28.0, rel=5e-3)
        for name, value in (("stiffness", spring), ("damping", damping), ("inertia", inertia)):
            assert scale * rows[name].robot == pytest.approx(value, rel=2e-2)
            assert scale * abs(rows[name].difference) < 0.02 * value and "if the" not in rows[name].words
        assert scale * rows["coulomb_friction level"].difference == pytest.approx(0.5, rel=5e-3)


def test_a_weight_that_both_carry_is_no_difference_where_the_position_gain_differs(turning):
    """A weight of 1.2 N m beside Kp = 20 and 28: the robot's model keeps the curvature, which hardly acts."""
    row = next(f for f in CATALOGUE if (f.name, f.form) == ("softening", "gravity"))
    a, b = (np.array([1 + 1.2 / gain, 0.9 / gain, 0.05 / gain]) for gain in (20.0, 28.0))
    factor = physical_factor(row.parameters[0], turning.scales.state, turning.scales.force)
    law = row(jnp.asarray(np.sqrt(1.2 / 21.2) / factor, jnp.float32))
    simulated = replace(turning.changed(a / turning.physical_coefficients), effects=(law,))
    robot: Any = SimpleNamespace(model=simulated.changed(b / a), added=[], effects=("parameter_change",), parts=())
    records = [replace(r, voltage_unit="rad", displacement_unit="rad") for r in recordings()]
    rows = {p.name: p for p in parameters_of(simulated, robot, records, 20.0)}
    assert rows["softening weight"].simulator == pytest.approx(1.2, rel=0.01)
    assert rows["position gain"].robot == pytest.approx(28.0, rel=0.01)
    for name in ("softening weight", "stiffness"):
        assert abs(rows[name].difference) < 0.02
    given = {p.name: p for p in with_shared_weight(parameters(simulated, robot, records, 20.0), robot)}
    assert given["softening weight"].difference == 0  # the MuJoCo file keeps its weight
    assert 28 / 20 * given["stiffness"].robot == pytest.approx(rows["stiffness"].robot, abs=1e-3)


def _served(joint, rate, seconds=6.0):
    """Recordings of the demo's joint in units of its position gain."""
    time = np.arange(round(seconds * rate)) / rate
    return [
        pitp.Record(name, time, command(time - 0.5), simulate(joint, command, time - 0.5), displacement_unit="V")
        for name, command in commands(seconds - 1.0).items()
    ]


@pytest.mark.slow
def test_the_simulators_own_friction_is_no_difference_and_hides_none():
    """Dry friction of 0.4 N m in both; the robot has a play of 0.03 rad besides (0.054 without the simulator's own)."""
    simulated, robot = _served(Joint(friction=0.4), 200), _served(Joint(friction=0.4, backlash=0.03), 100)
    noisy = [
        replace(r, displacement=r.displacement + 3e-4 * np.random.default_rng(k).standard_normal(r.samples))
        for k, r in enumerate(robot)
    ]
    found = pitp.diagnose(noisy, against=simulated, position_gain=20.0)
    rows = {p.name: p for p in found.parameters}
    assert found.nominal.order == 2 and found.effects == ("backlash",)
    assert rows["coulomb_friction level"].simulator == pytest.approx(0.4, rel=0.05)
    assert rows["coulomb_friction level"].difference == pytest.approx(0.0, abs=0.02)
    assert rows["backlash width"].difference == pytest.approx(0.03, rel=0.1)
    assert found.budget["simulator"]["share"] < 0.05


@pytest.mark.slow
def test_a_gap_below_what_the_simulators_model_leaves_is_unknown_with_the_reason():
    """Cogging of 0.5 N m, 25 times a radian, is in no catalogue. The robot has 2 % more damping, a tenth of that."""

    def cogging(damping, rate):
        time = np.arange(5 * rate) / rate
        made = []
        for name, command in list(commands(4.0).items())[1:]:

            def forces(t, y, command=command):
                torque = 20 * (command(np.array(t - 0.5)) - y[0]) - damping * y[1] - 0.5 * np.sin(25 * y[0])
                return [y[1], float(torque) / 0.05]

            y = solve_ivp(forces, (0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-6, atol=1e-8, max_step=0.01).y[0]
            noise = 3e-4 * np.random.default_rng(len(made)).standard_normal(len(time)) * (rate == 100)
            made.append(pitp.Record(name, time, command(time - 0.5), y + noise, displacement_unit="V"))
        return made

    found = pitp.diagnose(cogging(0.918, 100), against=cogging(0.9, 200), position_gain=20.0)
    assert found.verdict == "unknown" and not found.effects and "may hide in that error" in found.robot.reason
    assert found.budget["simulator"]["share"] > 0.7 and not found.nominal.effects
    rows = {p.name: p for p in found.parameters}
    assert rows["damping"].simulator == pytest.approx(0.9, rel=0.05)


@pytest.mark.slow
def test_a_held_command_lasts_one_sample_of_its_own_log():
    """A joint that holds its commands, logged at 200 and at 100 Hz: no gap, and a delay of 18 ms is 18 ms."""

    def held(rate, late):
        fine, made = np.arange(12_000) / 2000, []
        for name, command in commands(5.0).items():
            time = np.arange(6 * rate) / rate
            played = command(np.floor((fine - late) * rate + 1e-6) / rate - 0.5)
            y = lsim(([1.0], A[::-1]), played, fine, interp=False)[1][:: 2000 // rate]
            noise = 3e-4 * np.random.default_rng(len(made)).standard_normal(len(time)) * (rate == 100)
            made.append(pitp.Record(name, time, command(time - 0.5), y + noise, displacement_unit="V"))
        return made

    assert pitp.diagnose(held(100, 0.0), against=held(200, 0.0)).verdict == "no_gap"
    late = {p.name: p for p in pitp.diagnose(held(100, 0.018), against=held(200, 0.0)).parameters}["delay time"]
    assert late.difference == pytest.approx(0.018, abs=4e-4)


@pytest.mark.slow
def test_a_simulators_lag_is_an_effect_and_no_pole_of_its_joint():
    """A third pole at 20 Hz is a lag of 8 ms behind two; what the robot's sensor cannot show is left out."""
    lag = 1 / (2 * np.pi * 20)
    simulated = recordings(np.convolve(A, [1.0, lag]))
    model, _, own = model_of_simulator(simulated, 1e-4, OPTIONS)
    times = {e.name: float(e.numbers()[0][1]) for e in model.effects}
    assert model.order == 2 and own == 0 and times["sensor_lag"] > 0.9 * lag
    assert sum(times.values()) == pytest.approx(lag, rel=0.02)  # a part of it may be a delay
    np.testing.assert_allclose(model.physical_coefficients, A, rtol=0.02)
    coarse, found, _ = model_of_simulator(simulated, 0.05, OPTIONS)
    assert coarse.order == 2 and found is None


def test_what_cannot_be_meant_is_refused(simulator):
    other = [pitp.Record("x", TIME, np.sin(20 * TIME), np.cos(TIME), displacement_unit="V")]
    with pytest.raises(pitp.BadInput, match="no recording of the simulator has the same command"):
        pitp.diagnose(recordings(), against=other)
    wrongly: Any = pitp.diagnose  # type checkers refuse these calls as well
    with pytest.raises(pitp.BadInput, match="no model and no refit_nominal"):
        wrongly(recordings(), against=recordings(), refit_nominal=True)
    with pytest.raises(pitp.BadInput, match="position_gain only works with against"):
        wrongly(simulator, recordings(), position_gain=1.0)


@pytest.mark.exhaustive  # the notebook for robots asserts the same of these recordings at their full length
def test_the_joints_friction_and_delay_are_recovered(tmp_path):
    """Simulator at 200 Hz, robot at 500 Hz with a log begun 0.7 s earlier; 0.7 N m, 20 ms and 0.02 rad were made."""
    joint.write(tmp_path, quick=True)
    simulated, robot = (
        [_record(path, factor) for path in sorted((tmp_path / home).glob("*.csv"))]
        for home, factor in (("sim", 1.0), ("robot", np.pi / 180))
    )
    found = pitp.diagnose(robot, against=simulated, position_gain=joint.POSITION_GAIN)
    rows = {p.name: p for p in found.parameters}
    assert "coulomb_friction" in found.effects
    assert rows["coulomb_friction level"].difference == pytest.approx(0.7, rel=0.2)
    assert rows["delay time"].difference == pytest.approx(0.020, abs=2e-3)
    assert sum(p.offset for p in found.pairs.pairs) / 6 == pytest.approx(0.7, abs=3e-3)
    assert found.budget["simulator"]["share"] < 0.05
    assert len(repr(found).splitlines()) <= 10 and len(found._repr_html_()) < 200_000


def _record(path, factor):
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    return pitp.Record(path.stem, table[:, 0], factor * table[:, 1], factor * table[:, 2], displacement_unit="V")


def test_numbers_behind_a_command_are_in_its_unit(linear):
    """A dead zone of a joint that is told angles is an angle in its unit; a film's is a voltage."""
    joint = Fitted(linear(), Origin(voltage_unit="deg"))
    row = next(c for c in CATALOGUE if c.name == "dead_zone")
    value, unit = physical(joint, row.parameters[0], 0.1)
    assert (value, unit) == (pytest.approx(np.rad2deg(0.1)), "deg")
    assert physical(linear(), row.parameters[0], 45.0) == (45.0, "V")

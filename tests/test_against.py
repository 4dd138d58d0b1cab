"""A robot beside its simulator: corrections, units and names, and the demo's joint from end to end."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lsim

import pitp_jax as pitp
from pitp_jax._against.correction import corrections
from pitp_jax._against.parameters import parameters
from pitp_jax._demo import joint
from pitp_jax._effects import CATALOGUE
from pitp_jax._effects.physical import physical
from pitp_jax._model.fitted import Fitted
from pitp_jax._model.origin import Origin

A = np.array([1.0, 0.045, 0.0025])  # the demo's ideal joint over its position gain
TIME = np.arange(1600) / 200


def recordings(coefficients=A, late=0.0):
    """A linear joint's recordings; units are volts for want of a plant that moves by radians in this module."""
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
    ranking = [SimpleNamespace(effect="parameter_change", parameters=rows)]
    return SimpleNamespace(model=replace(moved, effects=added), added=told, effects=names, ranking=ranking)


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


def test_what_cannot_be_meant_is_refused(simulator):
    other = [pitp.Record("x", TIME, np.sin(20 * TIME), np.cos(TIME), displacement_unit="V")]
    with pytest.raises(pitp.BadInput, match="no recording of the simulator has the drive"):
        pitp.diagnose(recordings(), against=other)
    wrongly: Any = pitp.diagnose  # type checkers refuse these calls as well
    with pytest.raises(pitp.BadInput, match="no model and no refit_nominal"):
        wrongly(recordings(), against=recordings(), refit_nominal=True)
    with pytest.raises(pitp.BadInput, match="position_gain is for against"):
        wrongly(simulator, recordings(), position_gain=1.0)


@pytest.mark.slow
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
    """A dead zone of a joint that is told angles is an angle; a film's is a voltage."""
    joint = Fitted(linear(), Origin(voltage_unit="deg"))
    row = next(c for c in CATALOGUE if c.name == "dead_zone")
    assert physical(joint, row.parameters[0], 0.1) == (0.1, "rad")
    assert physical(linear(), row.parameters[0], 45.0) == (45.0, "V")

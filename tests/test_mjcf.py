"""MuJoCo files: the text keeps every byte but the changed attributes, MuJoCo compiles what is meant, and plays it."""

import ast
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import pitp_jax as pitp
from pitp_jax.application.commands.each import once_per_joint
from pitp_jax.application.commands.main import main
from pitp_jax.files.mjcf.document import Edit, assets, edited, read_document
from pitp_jax.files.mjcf.joint import joint_of
from pitp_jax.files.mjcf.play import first_state, play
from pitp_jax.files.mjcf.verify import Played, Verification
from pitp_jax.files.mjcf.write import write_numbers
from pitp_jax.method.diagnose.joint import Parameter

ARM = """<mujoco model='two "links"'>
  <!-- a comment with <joint name="elbow"/> in it -->
  <compiler angle="degree"/>
  <option timestep="0.0005" gravity="0 0 0" integrator="implicitfast"/>
  <default>
    <joint damping="9"/>
    <default class="arm"><default class="elbow"><joint damping="0.3"   armature='0.02'/>
      <position kp="20" kv="0.4"/></default></default>
  </default>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 1 0"/><geom size="0.05" mass="1"/>
      <include file="parts/lower.xml"/>
    </body>
  </worldbody>
  <actuator><position name="a" class="elbow" joint="shoulder"/>
    <position name="b" class="elbow" joint="elbow" ctrlrange='-2   2'/></actuator>
</mujoco>
"""
LOWER = """<mujocoinclude>
  <body pos="0 0 .3">\r
\t<joint name="elbow" class="elbow"
       axis="0 1 0" frictionloss="0.1" range="-90 90" />
    <geom size="0.05" pos="0 0 0.1" mass="0.5"/>
  </body>
</mujocoinclude>
"""


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "arm.xml").write_bytes(ARM.encode())
    (tmp_path / "parts" / "lower.xml").write_bytes(LOWER.encode())
    return tmp_path / "arm.xml"


def _tag(document, element, **attributes):
    return next(t for t in document.tags if t.name == element and attributes.items() <= t.attributes.items())


def test_every_other_byte_of_a_file_and_its_includes_is_kept(arm):
    """Comments and new attributes taken out again, and old values put back, the files are what they were."""
    document = read_document(arm)
    elbow = _tag(document, "joint", name="elbow")
    assert elbow.path == ("mujoco", "worldbody", "body", "body") and elbow.file.name == "lower.xml"
    edits = [Edit(elbow, {"frictionloss": "0.25", "damping": "0.5"}, ["frictionloss: 0.1 -> 0.25"]),
             Edit(_tag(document, "position", name="b"), {"ctrlrange": "-1 1"}, ["ctrlrange"])]  # fmt: skip
    made = edited(document, edits, "where from")
    lower = made[elbow.file].decode()
    assert '<!-- frictionloss: 0.1 -> 0.25 -->\n\t<joint name="elbow"' in lower
    undone = re.sub(r"<!-- frictionloss.*?-->\n\t", "", lower).replace('"0.25" range', '"0.1" range')
    assert undone.replace(' damping="0.5"', "") == LOWER
    main = made[arm].decode()
    assert 'ctrlrange="-1 1"' in main and main.startswith("<mujoco model='two \"links\"'>\n<!-- where from -->")
    undone = main.replace("\n<!-- where from -->", "", 1).replace("<!-- ctrlrange -->\n    ", "")
    assert undone.replace('ctrlrange="-1 1"', "ctrlrange='-2   2'") == ARM


@pytest.mark.parametrize(
    ("text", "words"),
    [("<mujoco><worldbody></mujoco>", "is not XML"), ("<robot/>", "is not a MuJoCo model"),
     ('<mujoco><include file="gone.xml"/></mujoco>', "No such file"),
     ('<mujoco><include file="arm.xml"/></mujoco>', "twice")],
)  # fmt: skip
def test_a_file_that_cannot_be_read_is_refused_with_its_name(tmp_path, text, words):
    (tmp_path / "arm.xml").write_text(text)
    with pytest.raises(pitp.BadInput, match=words):
        read_document(tmp_path / "arm.xml")


def test_meshes_are_found_in_the_folders_that_the_compiler_names(tmp_path):
    """Those inside the model's folder: what lies outside it stays where it is."""
    home = tmp_path / "robot"
    (home / "meshes").mkdir(parents=True)
    for place in (home / "meshes" / "link.stl", home / "out.stl"):
        place.write_bytes(b"solid")
    (home / "arm.xml").write_text(
        '<mujoco><compiler meshdir="meshes"/><asset><mesh file="link.stl"/><mesh file="../out.stl"/></asset></mujoco>'
    )
    assert [p.as_posix() for p in assets(read_document(home / "arm.xml"))] == ["meshes/link.stl"]


def _record(drive, angle, dt=0.005, unit="rad"):
    return pitp.Record("r", np.arange(len(drive)) * dt, drive, angle, voltage_unit=unit, displacement_unit="rad")


def _row(name, simulator, robot, stderr=None, unit=""):
    return Parameter(name, name, simulator, robot, robot - simulator, stderr, unit, "-", "-", "-", True)


def _written(arm, rows, joint="elbow"):
    """The joint before, what was written, and the joint of the new file as MuJoCo compiles it."""
    records = [_record(np.zeros(100), np.linspace(0, 1, 100))]
    written = write_numbers(rows, records, np.array([1.0, 0.035, 0.0013]), arm, joint, arm.parent / "gap")
    return joint_of(read_document(arm), joint), written, joint_of(read_document(written.file), joint)


def test_differences_over_the_gain_become_numbers_of_the_joint(arm):
    """F = kp: inertia, damping and friction over F in the table; what the class gives is overruled on the joint."""
    mujoco = pytest.importorskip("mujoco")
    rows = [_row("inertia", 0.001, 0.003), _row("damping", 0.035, 0.045), _row("coulomb_friction level", 0.005, 0.0125),
            _row("delay time", 0.0, 0.012), _row("end_stop place, above", np.inf, 0.5, 0.001),
            _row("backlash width", 0.0, 0.01)]  # fmt: skip
    before, written, after = _written(arm, rows)
    assert before.torque_per_command == 20 and before.damping == 0.3 and before.armature == 0.02
    assert after.armature == pytest.approx(0.02 + 20 * 0.002)
    assert after.damping == pytest.approx(0.3 + 20 * 0.01)
    assert after.frictionloss == pytest.approx(0.1 + 20 * 0.0075)
    assert after.limits == pytest.approx((-np.pi / 2, 0.5))  # written in degrees, the other side kept
    assert after.delay == pytest.approx(0.012) if _knows_delay(mujoco) else "has no position delay" in str(written.left)
    assert written.left[0].words == "backlash width" and "second hinge" in written.left[0].way


def test_a_number_that_the_diagnosis_does_not_determine_is_not_written(arm):
    pytest.importorskip("mujoco")
    friction = replace(_row("coulomb_friction level", 0.0, 0.0022), determined=False)
    before, written, after = _written(arm, [_row("inertia", 0.001, 0.003), friction])
    assert after.frictionloss == before.frictionloss and after.armature == pytest.approx(0.02 + 20 * 0.002)
    (left,) = written.left
    assert left.words == "coulomb_friction level" and "do not determine it" in left.way


def test_coefficients_that_moved_alike_are_the_gain(arm):
    pytest.importorskip("mujoco")
    rows = [
        _row("inertia", 0.004, 0.002, 1e-5),
        _row("damping", 0.035, 0.0175, 1e-4),
        _row("coulomb_friction level", 0, 0.005),
    ]
    _, written, after = _written(arm, rows)
    assert after.kp == pytest.approx(40.0) and "or inertia and damping x 0.5 each" in str(written.changes)
    assert after.armature == 0.02 and after.damping == 0.3
    assert after.frictionloss == pytest.approx(0.1 + 40 * 0.005)  # a torque of the robot's gain


def test_a_motor_has_its_gain_in_the_gear(tmp_path):
    pytest.importorskip("mujoco")
    file = tmp_path / "arm.xml"
    file.write_text(
        '<mujoco><worldbody><body><joint name="elbow" damping="0.1"/><geom size="0.1" mass="1"/></body></worldbody>'
        '<actuator><motor joint="elbow" gear="5"/></actuator></mujoco>'
    )
    before, _, after = _written(file, [_row("inertia", 0.02, 0.016, 1e-5), _row("damping", 0.02, 0.016, 1e-5)])
    assert not before.position and after.gear == pytest.approx(6.25) and after.damping == 0.1


@pytest.mark.parametrize(
    ("joint", "actuator", "words"),
    [("wrist", None, "has no hinge or slide joint 'wrist'; it has shoulder, elbow"), ("elbow", "a", "it has b")],
)
def test_a_joint_that_is_not_there_is_refused_with_those_that_are(arm, joint, actuator, words):
    pytest.importorskip("mujoco")
    with pytest.raises(pitp.BadInput, match=re.escape(words)):
        play(arm, joint, [], actuator)


def test_two_actuators_or_none_on_a_joint_are_refused_with_their_names(arm):
    pytest.importorskip("mujoco")
    arm.write_text(ARM.replace('joint="shoulder"', 'joint="elbow"'))
    with pytest.raises(pitp.BadInput, match="2 actuators drive joint 'elbow': a, b; choose with --actuator"):
        play(arm, "elbow", [])
    with pytest.raises(pitp.BadInput, match="no actuator drives joint 'shoulder' itself"):
        play(arm, "shoulder", [])


SERVO = """<mujoco><option timestep="0.0002" gravity="0 0 0"/><worldbody><body>
  <joint name="q" axis="0 1 0" damping="0.4"/>
  <inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 0.05"/></body></worldbody>
  <actuator><position joint="q" kp="20" {}/></actuator></mujoco>"""


def _knows_delay(mujoco):
    return hasattr(mujoco.MjModel.from_xml_string("<mujoco/>"), "actuator_delay")


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_a_servo_plays_its_commands_as_scipy_does(tmp_path, late):
    """J q'' + D q' + kp (q - c(t - late)) = 0, each command held for 5 ms."""
    if late and not _knows_delay(pytest.importorskip("mujoco")):
        pytest.skip("this version of MuJoCo has no delay")
    pytest.importorskip("mujoco")
    time = np.arange(400) * 0.005
    drive = 0.4 * np.sin(2 * np.pi * 1.5 * time) + 0.2
    (tmp_path / "q.xml").write_text(SERVO.format(f'delay="{late}" nsample="101"' if late else ""))

    def pushed(_, y, command):
        return [y[1], (20 * (command - y[0]) - 0.4 * y[1]) / 0.05]

    state = np.array([0.2, 0.0])
    exact = [0.2]
    for k in range(len(time) - 1):  # late is a whole number of samples
        command = drive[max(k - round(late / 0.005), 0)]
        state = solve_ivp(pushed, (0.0, 0.005), state, args=(command,), rtol=1e-9).y[:, -1]
        exact.append(state[0])
    (angle,) = play(tmp_path / "q.xml", "q", [_record(drive, np.array(exact))])
    assert np.max(np.abs(angle - exact)) < 2e-3  # of 0.8 rad; MuJoCo takes Euler steps of 0.2 ms


def test_the_first_state_is_a_line_through_the_first_samples():
    time = np.arange(100) * 0.005
    assert first_state(_record(np.zeros(100), 0.3 + 2.0 * time)) == pytest.approx((0.3, 2.0))
    noisy = 0.3 + 2.0 * time + 1e-4 * np.random.default_rng(1).standard_normal(100)
    assert first_state(_record(np.zeros(100), noisy)) == pytest.approx((0.3, 2.0), abs=0.03)
    still = 0.3 + 1e-4 * np.random.default_rng(0).standard_normal(100)
    start, speed = first_state(_record(np.zeros(100), still))
    assert speed == 0.0 and start == pytest.approx(0.3, abs=2e-4)


def test_a_gap_that_shrinks_is_told_and_one_that_does_not(tmp_path):
    """The robot is the second file itself: its gap is the noise, that of the first is not; the other way round.

    The start is read from noisy samples too: the gap may be half as large again.
    """
    pytest.importorskip("mujoco")
    files = tmp_path / "a.xml", tmp_path / "b.xml"
    for file, kp in zip(files, (20, 24), strict=True):
        file.write_text(SERVO.format("").replace('kp="20"', f'kp="{kp}"'))
    time = np.arange(400) * 0.005
    drive = 0.4 * np.sin(2 * np.pi * 2 * time) * np.minimum(time, 1)
    (angle,) = play(files[1], "q", [_record(drive, np.zeros(400))])
    robot = _record(drive, angle + 1e-4 * np.random.default_rng(0).standard_normal(400))
    found = pitp.verify_mjcf([robot], files[1], "q", before=files[0])
    gap, noise = found.gap(False), 1e-2 / np.ptp(robot.displacement)
    assert found.better and gap is not None and 0.9 * noise < gap < 1.5 * noise
    turned = pitp.verify_mjcf([robot], files[0], "q", before=files[1])
    assert turned.better is False and "not significantly better" in str(turned)
    assert pitp.verify_mjcf([robot], files[1], "q").better is None


def test_a_held_out_recording_that_the_diagnosis_used_is_refused(tmp_path):
    pytest.importorskip("mujoco")
    from pitp_jax.method.model.lineage import sums

    record = _record(np.zeros(100), np.linspace(0, 1e-3, 100))
    (tmp_path / "q.xml").write_text(f"<!-- {sums([record])[0]['sha256']} -->" + SERVO.format(""))
    with pytest.raises(pitp.BadInput, match="the diagnosis used this recording"):
        pitp.verify_mjcf([replace(record, name="other")], tmp_path / "q.xml", "q", held_out=[record])


def test_a_written_file_lies_beside_what_it_includes_and_says_where_its_numbers_are_from(arm, tmp_path):
    """Written into a folder of its own, with its include, MuJoCo loads it; the user's file stays as it is."""
    mujoco = pytest.importorskip("mujoco")
    rows = [_row("damping", 0.035, 0.045, 1e-4), _row("coulomb_friction level", 0.0, 0.035)]
    _, written, _ = _written(arm, rows)
    assert written.file == tmp_path / "gap" / "arm_identified.xml"
    assert (tmp_path / "gap" / "parts" / "lower.xml").read_text().count("<!--") == 2  # friction, damping
    model = mujoco.MjModel.from_xml_path(str(written.file))
    assert model.dof_frictionloss[1] == pytest.approx(0.1 + 20 * 0.035)
    assert model.dof_damping[1] == pytest.approx(0.3 + 20 * 0.01)
    assert "held for 5 ms" in written.file.read_text() and arm.read_bytes() == ARM.encode()


def test_the_command_prints_the_gap_and_ends_with_3_where_it_does_not_shrink(tmp_path, monkeypatch, capsys):
    """The robot's file as the new one, then as the old one; the page and a table for each recording lie beside."""
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    for name, kp in (("sim", 20), ("robot", 24)):
        (tmp_path / f"{name}.xml").write_text(SERVO.format("").replace('kp="20"', f'kp="{kp}"'))
    time = np.arange(400) * 0.005
    drive = 0.4 * np.sin(2 * np.pi * 2 * time) * np.minimum(time, 1)
    (angle,) = play("robot.xml", "q", [_record(drive, np.zeros(400))])
    rows = np.column_stack([time, np.degrees(drive), np.degrees(angle)])
    np.savetxt("log.csv", rows, delimiter=",", header="time_s,input_deg,output_deg", comments="")
    of = ["verify", "log.csv", "--joint", "q", "--force"]
    assert main([*of, "--mjcf", "robot.xml", "--before", "sim.xml", "--out", "check"]) == 0
    assert "on recordings of the diagnosis" in capsys.readouterr().out
    assert {p.name for p in (tmp_path / "check").iterdir()} >= {"log.csv", "report.html"}
    assert (tmp_path / "check" / "figures" / "log.png").stat().st_size > 5000
    assert main([*of, "--mjcf", "sim.xml", "--before", "robot.xml"]) == 3
    assert "not significantly better than robot.xml" in capsys.readouterr().err


def test_an_actuators_lag_is_written_where_its_element_has_one(arm):
    """`position` has `timeconst`; `general` has `dynprm` and a type; a motor has none."""
    pytest.importorskip("mujoco")
    _, _, after = _written(arm, [_row("sensor_lag tau", 0.0, 0.02, 1e-4)])
    assert after.lag == pytest.approx(0.02)


def test_the_same_numbers_for_other_simulators(arm):
    """Isaac Lab's call, read back as Python, and Newton's JSON hold what MuJoCo compiles."""
    pytest.importorskip("mujoco")
    rows = [_row("damping", 0.035, 0.045, 1e-4), _row("delay time", 0.0, 0.012)]
    _, written, after = _written(arm, rows)
    folder = written.file.parent
    call: Any = ast.parse((folder / "isaac_actuator_cfg.py").read_text()).body[-1]
    told = {k.arg: ast.literal_eval(k.value) for k in call.value.keywords}
    assert told["joint_names_expr"] == ["elbow"] and told["stiffness"] == 20 and told["damping"] == 0.4
    assert told["viscous_friction"] == pytest.approx(after.damping) and told["friction"] == after.frictionloss
    assert told.get("max_delay", 0) == round(after.delay / 0.0005)
    newton = json.loads((folder / "newton_actuator.json").read_text())
    assert newton["damping"] == after.damping and newton["limit_upper"] == pytest.approx(np.pi / 2)
    assert f'friction="{after.frictionloss:g}"' in (folder / "urdf_dynamics.xml").read_text()


def test_a_gear_counts_once_in_the_torque_of_a_command(tmp_path):
    """torque = g kp (c - g q): under gravity's torque tau the servo of gear 2 stands at c / g - tau / (kp g^2)."""
    pytest.importorskip("mujoco")
    file = tmp_path / "arm.xml"
    file.write_text(SERVO.format('gear="2"').replace('damping="0.4"', 'damping="4" stiffness="10"'))
    before, _, after = _written(file, [_row("damping", 0.1, 0.2)], "q")
    assert before.torque_per_command == 40 and after.damping == pytest.approx(4 + 40 * 0.1)
    (angle,) = play(file, "q", [_record(np.full(2000, 0.5), np.full(2000, 0.1))])
    assert angle[-1] == pytest.approx(40 * 0.5 / (80 + 10), rel=1e-3)
    text = (file.parent / "gap" / "isaac_actuator_cfg.py").read_text()
    assert "stiffness=80," in text


def test_an_inertia_below_that_of_the_links_is_a_larger_gain(arm):
    """The armature of 0.02 cannot fall by 0.06: the gain is twice as large, damping and stiffness follow it."""
    pytest.importorskip("mujoco")
    rows = [_row("inertia", 0.006, 0.003, 1e-5), _row("damping", 0.035, 0.03, 1e-5), _row("stiffness", 0.0, 0.01, 1e-4)]
    _, written, after = _written(arm, rows)
    assert after.kp == pytest.approx(40) and after.armature == 0.02 and "each" not in str(written.changes)
    assert after.damping == pytest.approx(0.3 + 20 * (2 * 0.03 - 0.035))
    assert after.stiffness == pytest.approx(2 * 20 * 0.01)


def test_limits_are_written_about_zero_in_the_actuators_own_unit(arm):
    """forcerange is before the gear, ctrlrange in the command's unit; a stop below is told by its distance."""
    pytest.importorskip("mujoco")
    arm.write_text(ARM.replace('joint="elbow" ctrlrange', 'joint="elbow" gear="2" ctrlrange'))
    inf = np.inf
    rows = [_row("force_limit inverse", inf, 0.1), _row("voltage_clip inverse", inf, 0.6),
            _row("end_stop place, below", inf, 0.4)]  # fmt: skip
    _, written, after = _written(arm, rows)
    assert after.effort == pytest.approx(40 * 0.1)
    assert "joint_effort_limit=4," in (arm.parent / "gap" / "isaac_actuator_cfg.py").read_text()
    assert 'ctrlrange="-0.6 0.6"' in written.file.read_text()
    assert after.limits == pytest.approx((-0.4, np.pi / 2))


def test_a_number_within_its_error_is_left_alone_and_an_interval_is_two_sided(arm):
    pytest.importorskip("mujoco")
    rows = [_row("inertia", 0.001, 0.003, 5e-4), _row("stiffness", 0.0, 0.01, 6e-3)]
    _, written, after = _written(arm, rows)
    assert after.stiffness == 0.0 and len(written.changes) == 1
    new, error = 0.02 + 20 * 0.002, 20 * 5e-4
    assert f"({new - 1.96 * error:.4g} to {new + 1.96 * error:.4g})" in written.changes[0].text


def test_a_general_servo_keeps_gain_and_bias_alike(tmp_path):
    """Its lag stands in dynprm; gain and bias change together, or MuJoCo would make it no servo."""
    pytest.importorskip("mujoco")
    file = tmp_path / "arm.xml"
    servo = '<general joint="q" gainprm="20" biastype="affine" biasprm="0 -20 -0.4"/>'
    file.write_text(SERVO.format("").replace('<position joint="q" kp="20" />', servo))
    rows = [
        _row("inertia", 0.0025, 0.00125, 1e-6),
        _row("damping", 0.04, 0.02, 1e-5),
        _row("electrode_rc tau", 0, 0.03),
    ]
    _, written, after = _written(file, rows, "q")
    assert after.kp == pytest.approx(40) and after.position and after.lag == pytest.approx(0.03)
    assert 'dyntype="filterexact"' in written.file.read_text()
    assert any("inertia of 0.026, the file 0.05" in line for line in written.remarks)  # 20 times 0.0013


def test_another_actuators_lag_and_other_servos_stay_where_they_are(arm):
    """The shoulder is lagged and held at its reference; the elbow has no lag of its own to set."""
    pytest.importorskip("mujoco")
    arm.write_text(ARM.replace('joint="shoulder"/>', 'joint="shoulder" timeconst="0.05"/>'))
    (still,) = play(arm, "elbow", [_record(np.full(400, 0.3), np.full(400, 0.3))])
    assert np.max(np.abs(still - 0.3)) < 1e-6


def test_a_written_delay_shifts_the_motion_by_itself(tmp_path):
    """12 ms are 24 steps of 0.5 ms; MuJoCo keeps so many commands only where nsample asks for them."""
    if not _knows_delay(pytest.importorskip("mujoco")):
        pytest.skip("this version of MuJoCo has no delay")
    file = tmp_path / "arm.xml"
    file.write_text(SERVO.format("").replace("0.0002", "0.0005"))
    _, written, _ = _written(file, [_row("delay time", 0.0, 0.012, 1e-5)], "q")
    step = _record(0.1 * (np.arange(400) >= 100), np.zeros(400), dt=0.0005)
    (early,), (late,) = play(file, "q", [step]), play(written.file, "q", [step])
    np.testing.assert_allclose(late[24:], early[:-24], rtol=0, atol=1e-9)
    assert np.ptp(early) > 0.05


def test_a_gap_is_pooled_over_recordings_each_in_its_own_range():
    """Errors of 0.1 in a range of 4 and of 0.3 in a range of 2: sqrt((2.5^2 + 15^2) / 2) %."""
    played = []
    for size, error in ((2.0, 0.1), (1.0, 0.3)):
        y = size * np.sin(2 * np.pi * np.arange(400) / 400)
        played.append(Played(_record(np.zeros(400), y), False, None, y + error))
    found = Verification("arm.xml", "q", "", tuple(played))
    assert found.gap(False) == pytest.approx(np.sqrt((2.5**2 + 15**2) / 2)) and found.gap(True) is None


def test_a_gain_within_the_noise_is_no_gain():
    """Better in every second eighth and worse by nearly as much in the others: on average a hair better."""
    y = np.sin(2 * np.pi * np.arange(800) / 400)
    odd = np.repeat(np.arange(8) % 2 == 1, 100)
    before, after = y + np.where(odd, 0.10, 0.20), y + np.where(odd, 0.199, 0.10)
    assert Verification("a", "q", "", (Played(_record(y, y), False, before, after),)).better is False
    assert Verification("a", "q", "", (Played(_record(y, y), False, y + 0.2, after),)).better is True


def test_the_file_of_several_joints_holds_all_of_them_in_the_end(tmp_path):
    """Each joint of a log has its own folder; its file goes on from that of the joint before."""
    told = {"each": ["a=u1,y1", "b=u2,y2"], "reading": {}, "joint": ["shoulder", "elbow"], "mjcf": "arm.xml",
            "out": str(tmp_path), "report": None, "json_file": None}  # fmt: skip
    seen = []
    for own in once_per_joint(told):
        seen.append((own["joint"], own["mjcf"]))
        Path(own["out"]).mkdir()
        (Path(own["out"]) / "arm_identified.xml").write_text("<mujoco/>")
    assert seen == [(["shoulder"], "arm.xml"), (["elbow"], str(tmp_path / "a" / "arm_identified.xml"))]


HANGING = """<mujoco><option timestep="0.0005" gravity="0 0 -9.81"/><worldbody><body pos="0.1 0 1" euler="0 {turned} 0">
  <joint name="q" axis="0 1 0" pos="0 0 0.02" damping="0.4" armature="0.02"/>{load}
  <inertial pos="0 0 0.02" mass="1" diaginertia="0.05 0.05 0.05"/></body></worldbody>
  <actuator><position joint="q" kp="20" kv="0.4"/></actuator></mujoco>"""


@pytest.mark.parametrize(("turned", "side"), [(0, 1), (40, 1), (0, -1)])
def test_a_weight_on_the_arm_hangs_in_the_written_file_as_on_the_robot(tmp_path, turned, side):
    """The robot: 0.2 kg at 0.25 m below (or above) the axis where q = 0; its inertia is known with the armature."""
    pytest.importorskip("mujoco")
    angle = np.deg2rad(turned)
    x, z = -0.25 * side * np.sin(-angle), -0.25 * side * np.cos(angle)
    ball = f'<body pos="{x} 0 {z + 0.02}"><inertial pos="0 0 0" mass="0.2" diaginertia="1e-9 1e-9 1e-9"/></body>'
    (tmp_path / "sim.xml").write_text(HANGING.format(turned=turned, load=""))
    (tmp_path / "robot.xml").write_text(HANGING.format(turned=turned, load=ball))
    weight = side * 0.2 * 9.81 * 0.25
    rows = [_row("inertia", 0.0, 0.2 * 0.25**2 / 20, 1e-6), _row("softening weight", 0.0, weight / 20, 1e-4)]
    _, written, after = _written(tmp_path / "sim.xml", rows, "q")
    time = np.arange(600) * 0.005
    step = _record(np.where(time > 0.1, 0.9, 0.0), np.zeros(600))
    (true,), (found,), (before,) = (
        play(f, "q", [step]) for f in (tmp_path / "robot.xml", written.file, tmp_path / "sim.xml")
    )
    np.testing.assert_allclose(found, true, rtol=0, atol=1e-4)
    assert np.abs(true - before).max() > 0.01 and "only the product" in str(written.lines()) and not written.left
    assert after.armature >= 0


def test_a_joint_that_moves_a_tendon_is_refused_with_the_others(arm):
    pytest.importorskip("mujoco")
    tendon = '<tendon><fixed name="belt"><joint joint="elbow" coef="1"/></fixed></tendon>\n</mujoco>'
    arm.write_text(ARM.replace("</mujoco>", tendon))
    with pytest.raises(pitp.BadInput, match="moves tendon belt.*joints with an actuator: shoulder"):
        play(arm, "elbow", [])
    assert joint_of(read_document(arm), "shoulder").name == "shoulder"


def test_a_file_of_the_users_is_not_replaced_by_the_identified_one(arm, capsys):
    pytest.importorskip("mujoco")
    (arm.parent / "gap").mkdir()
    mine = arm.parent / "gap" / "arm_identified.xml"
    mine.write_text("<mujoco/>")
    told = ["diagnose", "robot", "--against", "sim", "--mjcf", str(arm), "--joint", "elbow", "--out", str(mine.parent)]
    assert main(told) == 2 and "was not written by pitp" in capsys.readouterr().err
    mine.write_text("<mujoco>\n<!-- pitp: numbers identified on recordings; ... --></mujoco>")
    assert main(told) == 2 and "robot" in capsys.readouterr().err  # the recordings are looked for: ours is replaced
    again = ["--mjcf", str(arm), "--joint", "elbow", "--out", str(arm.parent)]
    arm.rename(arm.parent / "arm_identified.xml")
    again[1] = str(arm.parent / "arm_identified.xml")
    assert main([*told[:4], *again]) == 2 and "would overwrite an input file" in capsys.readouterr().err

"""Recordings of one simulator, or of several: a load or a gain per file is seen where a command is repeated."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim

import pitp_jax as pitp
from pitp_jax.application.commands import diagnose as command
from pitp_jax.application.compare.groups import groups_of

TIME = np.arange(800) / 200


def commands():
    rng = np.random.default_rng(0)
    steps = np.repeat(rng.uniform(-1, 1, 20), 40)
    return {"chirp": np.sin(2 * np.pi * (0.3 * TIME + 0.5 * TIME**2)), "steps": steps}


def recorded(plant, hz, damping=0.3, gain=1.0, noise=0.0):
    """Recordings of both commands by a mode."""
    w = 2 * np.pi * hz
    made = []
    for k, (name, u) in enumerate(commands().items()):
        y = lsim(([gain * w**2], [1.0, 2 * damping * w, w**2]), u, TIME, interp=False)[1]
        y = y + noise * np.random.default_rng([k, int(10 * hz)]).standard_normal(len(TIME))
        made.append(pitp.Record(f"{plant}_{name}", TIME, u, y, "rad", "rad"))
    return made


@pytest.mark.parametrize("other", [{"hz": 3.0}, {"hz": 5.0, "gain": 1.2}, {"hz": 5.0, "damping": 0.6}])
def test_a_load_a_gain_and_a_damper_make_groups(other):
    mixed = [r for pair in zip(recorded("a", 5.0), recorded("b", **other), strict=True) for r in pair]
    found = groups_of(mixed)
    assert found is not None
    assert found.members == (("a_chirp", "a_steps"), ("b_chirp", "b_steps"))
    assert found.own < 0.05 and found.common > 2 * found.own
    assert "2 groups" in str(found) and "--by-group" in str(found)


def test_repeats_and_noise_make_no_groups():
    assert groups_of([*recorded("a", 5.0, noise=0.05), *recorded("b", 5.0, noise=0.07)]) is None


def test_without_a_repeated_command_nothing_shows_several_plants():
    third = recorded("c", 4.0)[1]
    half = pitp.Record("c_half", TIME, third.voltage / 2, third.displacement / 2, "rad", "rad")
    assert groups_of([recorded("a", 5.0)[0], recorded("b", 3.0)[1], half]) is None


def test_friction_that_linear_models_do_not_describe_makes_no_groups():
    """Small and large strokes of one plant with a nonlinear spring, each of them twice."""
    made = []
    for k, size in enumerate((0.2, 0.2, 1.0, 1.0)):
        for r in recorded("a", 5.0):
            y = size * r.displacement
            made.append(pitp.Record(f"{k}{r.name}", TIME, size * r.voltage, y - 0.2 * y**3, "rad", "rad"))
    assert groups_of(made) is None


def test_each_group_is_diagnosed_beside_its_robots_recordings(tmp_path, monkeypatch, capsys):
    for folder in ("sim", "robot"):
        (tmp_path / folder).mkdir()
        for r in [*recorded("a", 5.0), *recorded("b", 3.0)]:
            table = np.column_stack([r.time, r.voltage, (1.0 if folder == "sim" else 1.02) * r.displacement])
            np.savetxt(tmp_path / folder / f"{r.name}.csv", table, delimiter=",", header="time_s,input_rad,output_rad")
    calls = []
    monkeypatch.setattr(command, "diagnose", lambda records, nominal, **said: calls.append((records, said)))
    command._by_group([str(tmp_path / "robot")], [str(tmp_path / "sim")], "gap", "d.json", {}, {"seconds": 5.0})
    assert [[Path(f).stem for f in records] for records, _ in calls] == [
        ["a_chirp", "a_steps"], ["b_chirp", "b_steps"],
    ]  # fmt: skip
    for k, (records, said) in enumerate(calls, 1):
        assert [Path(f).name for f in said["against"]] == [Path(f).name for f in records]
        assert (said["out"], said["json_file"], said["seconds"]) == (f"gap/group{k}", f"d.group{k}.json", 5.0)
    assert "2 groups" in capsys.readouterr().out

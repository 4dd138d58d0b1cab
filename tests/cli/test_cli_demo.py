"""`pitp demo`, and the four verbs end to end."""

import json
import shutil
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from cli_cases import COEFFICIENTS, columns_of, refused, tree
from scipy.signal import lsim

from pitp_jax import ComputationFailed
from pitp_jax.application.demo import files, joint, protocol
from pitp_jax.files.model_file import model_file
from pitp_jax.method.train import settings


def test_demo_keeps_whole_or_nothing(call, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise ComputationFailed("no order")

    monkeypatch.setattr("pitp_jax.application.commands.demo.run", fail)
    refused(call("demo", "--out", tmp_path / "d"), code=3)
    (tmp_path / "r" / "records").mkdir(parents=True)
    (tmp_path / "r" / "records" / "sine_010Hz_500V.csv").write_text("")
    assert "another demo" in refused(call("demo", "--plant", "cone100", "--out", tmp_path / "r"))
    shutil.rmtree(tmp_path / "r")
    (tmp_path / "f").write_text("")
    refused(call("demo", "--out", tmp_path / "f"))
    assert tree(tmp_path) == ["f"]


@pytest.mark.parametrize("name", ["cone100", "cone122", "cone150", "roll"])
@pytest.mark.parametrize("quick", [False, True])
def test_demo_trains_on_every_cell_of_the_tables(name, quick):
    train = [e.name for e in protocol.excitations(name, "train", quick)]
    test = [e.name for e in protocol.excitations(name, "test", quick)]
    amplitude = protocol.SCALES[protocol.kind(name)].amplitude
    for f in (*protocol.PREDICTION_PAPER[name], *protocol.TRACKING_PAPER[name]):
        assert f"sine_{f:03.0f}Hz_{amplitude:.0f}V" in train
    assert not set(train) & set(test)
    assert len(protocol.excitations(name, "sweep", quick)) == 1


@pytest.mark.exhaustive
def test_demo_quick(call, tmp_path):
    code, text, _ = call("demo", "--plant", "cone100", "--quick", "--out", tmp_path / "d", "--json", tmp_path / "j")
    assert code == 0
    assert "Table I" in text
    assert all(table["title"] in text for table in json.loads((tmp_path / "j").read_text())["tables"])
    left = {*files.FILES, *files.recordings("cone100", quick=True), files.RECORDS, files.HELD_OUT, "figures"}
    assert tree(tmp_path / "d") == sorted(left)
    assert call("predict", tmp_path / "d" / "model.pitp", tmp_path / "d" / "held_out")[0] == 0
    assert model_file.load(tmp_path / "d" / "model.pitp").order >= 2


@pytest.mark.slow
def test_end_to_end(call, bench, tmp_path, monkeypatch):
    """The four verbs themselves, on a linear actuator, with little training."""
    short = replace(settings.PRESETS["default"], epochs=3, stages=1, refine_steps=3, width=4, memories=2)
    monkeypatch.setitem(settings.PRESETS, "default", short)
    nominal, model, records = tmp_path / "nominal", tmp_path / "model", bench / "records"
    assert call("identify", records / "sweep.csv", "--out", nominal, "--order", "2")[0] == 0
    code, text, err = call("fit", records, "--nominal", nominal, "--out", model)
    assert code == 0, err
    assert call("info", model)[0] == 0
    assert call("predict", model, records, "--json", tmp_path / "j", "--out", tmp_path / "d")[0] == 0
    assert json.loads((tmp_path / "j").read_text())["median_e_rms_percent"] < 5
    out = tmp_path / "v.csv"
    code, _, err = call("invert", model, bench / "target.csv", "--out", out, "--json", tmp_path / "i")
    assert code == 0, err
    told = json.loads((tmp_path / "i").read_text())
    assert told["self_check_e_rms_percent"] < 5
    header, values = columns_of(out)
    assert header == ["time_s", "voltage_V", "target_mm", "infeasible", "saturated"]
    assert len(values) == told["samples"]
    assert values[:, 1].max() <= 2001.0
    x = lsim(([1.0], COEFFICIENTS[::-1]), values[:, 1] ** 2, np.arange(len(values)) * 0.002)[1]
    assert 1e3 * x.max() == pytest.approx(1.5, rel=0.1)
    assert jnp.isfinite(model_file.load(model).coefficients).all()


def test_joint_follows_its_equation():
    """The ideal joint is a linear second-order system; friction, delay and backlash act as their closed forms say."""
    time = np.arange(2000) / 500.0
    command = joint.commands(9.0)["sine_2.5Hz"]
    j = joint.IDEAL
    a = [j.inertia, j.damping, j.position_gain]
    exact = lsim(([j.position_gain], a), command(time), time, interp=False)[1]
    ideal = joint.simulate(j, command, time)
    assert np.abs(ideal - exact).max() < 2e-3 * np.ptp(exact)
    late = joint.simulate(replace(j, delay=0.02), command, time)
    assert np.abs(late[10:] - ideal[:-10]).max() < 1e-12  # 10 samples
    step = joint.simulate(replace(j, friction=0.7), lambda t: np.full_like(t, 0.03), time)
    assert np.abs(step).max() == 0.0  # 20 N m/rad times 0.03 rad is less than 0.7 N m
    loose = joint.simulate(replace(j, backlash=0.02), command, time)
    assert np.abs(loose - ideal).max() == pytest.approx(0.01)


def test_demo_joint_writes_both_folders(call, tmp_path):
    code, text, _ = call("demo", "--plant", "joint", "--quick", "--out", tmp_path / "d", "--json", tmp_path / "j")
    assert code == 0
    assert "--against" in text
    assert tree(tmp_path / "d") == sorted({*joint.recordings(), "sim", "robot"})
    told = json.loads((tmp_path / "j").read_text())
    assert told["robot"]["friction"] == joint.REAL.friction
    header, simulated = columns_of(tmp_path / "d" / "sim" / "sine_1Hz.csv")
    assert header == ["time_s", "input_rad", "output_rad"]
    header, robot = columns_of(tmp_path / "d" / "robot" / "sine_1Hz.csv")
    assert header == ["time_s", "input_deg", "output_deg"]
    # the robot's command comes 0.7 s after the log's begin, the same in degrees
    begins = 350
    assert np.allclose(np.radians(robot[begins : begins + 1000 : 5, 1]), simulated[:400:2, 1], atol=1e-6)
    refused(call("demo", "--plant", "joint", "--out", tmp_path / "j"))

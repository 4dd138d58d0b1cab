"""Robots simulated in MuJoCo: the joint is its stated equation, and identified numbers close the gap."""

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim

EXPERIMENTS = Path(__file__).resolve().parents[1] / "experiments"


@pytest.mark.slow
def test_the_ideal_joint_is_its_equation(monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.syspath_prepend(str(EXPERIMENTS))
    bank = import_module("mujoco_bank")
    torque = bank.torques(2.0)["chirp"]
    j, steps = bank.IDEAL, round(bank.DT / bank.STEP)
    held = np.repeat(torque, steps)
    _, y, _ = lsim(
        ([1.0], [j.armature + 0.01, j.damping, j.stiffness]), held, np.arange(len(held)) * bank.STEP, interp=False
    )
    angle = bank.simulate(j, torque)
    assert np.abs(angle - y[::steps]).max() < 0.02 * np.ptp(y)  # MuJoCo's step of 0.25 ms is of first order


@pytest.mark.parametrize(
    "number",
    [pytest.param(9, marks=pytest.mark.slow), *(pytest.param(n, marks=pytest.mark.exhaustive) for n in (5, 11))],
)
def test_identified_numbers_close_the_gap_on_held_out_commands(monkeypatch, number):
    """A torque motor with three differences; the written file is played by MuJoCo on commands that were not used."""
    pytest.importorskip("mujoco", reason="needs the extra mujoco")
    monkeypatch.syspath_prepend(str(EXPERIMENTS))
    row = import_module("mjcf_bank").run(1, number, 5.0)
    assert len(row["differences"]) == 3 and row["typed"]
    assert row["better"] and row["left"] < 0.1

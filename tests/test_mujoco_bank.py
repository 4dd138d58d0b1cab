"""The joint that MuJoCo simulates is the equation it is said to be."""

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

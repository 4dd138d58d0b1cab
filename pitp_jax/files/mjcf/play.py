"""Simulate recorded commands in MuJoCo: each command is held for one sample, from the recording's initial state.

q(t_k) at the recording's own times;   q(0), q'(0) from its first samples;   other joints stay at their reference
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...method.signal.record import Record
from .document import read_document
from .joint import Joint, joint_of, load_model, mujoco_package

_FIRST = 4  # samples that determine initial position and speed


def play(mjcf: str | Path, joint: str, records: Sequence[Record], actuator: str | None = None) -> list[np.ndarray]:
    """Simulate the motion of a joint in MuJoCo under recorded commands.

    Args:
        mjcf: MuJoCo file.
        joint, actuator: names.
        records: their `voltage` is the command, in the base unit of ctrl (rad, m, N m or N).

    Returns:
        joint position at every sample, rad or m, shape (T,) each; nan after a simulation that diverged.

    Raises:
        BadInput: as `joint_of`.
    """
    driven = joint_of(read_document(mjcf), joint, actuator)
    model = load_model(mjcf)
    mujoco = mujoco_package()
    return [_played(mujoco, model, driven, record) for record in records]


def _played(mujoco: Any, model: Any, driven: Joint, record: Record) -> np.ndarray:
    joint, actuator = driven.numbers
    place, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    step = float(model.opt.timestep)
    data = mujoco.MjData(model)
    _hold_the_others(mujoco, model, data, actuator)
    data.qpos[place], data.qvel[dof] = first_state(record)
    data.ctrl[actuator] = record.voltage[0]
    if (place_of_lag := int(model.actuator_actadr[actuator])) >= 0:  # the lag has settled on the first command
        data.act[place_of_lag] = record.voltage[0]
    position, speed = np.array(data.qpos), np.array(data.qvel)
    if driven.delay:  # the first command fills the actuator's history
        for _ in range(math.ceil(driven.delay / step) + 1):
            mujoco.mj_step(model, data)
            data.qpos[:], data.qvel[:] = position, speed
    times = record.time - record.time[0]
    # 1e-6 of a step: rounding must not add a step, or repeat the command before
    count = math.ceil(times[-1] / step - 1e-6)
    held = record.voltage[np.minimum((np.arange(count) * step / record.dt + 1e-6).astype(int), len(times) - 1)]
    angle = np.full(count + 1, np.nan)
    angle[0] = data.qpos[place]
    before = data.time
    for k in range(count):
        data.ctrl[actuator] = held[k]
        mujoco.mj_step(model, data)
        if data.time < before or not np.isfinite(data.qpos[place]):  # MuJoCo restarts a simulation that diverged
            break
        before, angle[k + 1] = data.time, data.qpos[place]
    return np.interp(times, np.arange(count + 1) * step, angle)


def first_state(record: Record) -> tuple[float, float]:
    """Return position and speed at the first sample, from a line through four samples; speed 0 if it is within noise.

    The noise is that of third differences, s^2 = mean (d^3 y)^2 / 20, which no smooth motion has.
    """
    y = record.displacement[: 16 * _FIRST]
    # a smooth motion has almost no third differences
    third = np.diff(y, 3)
    noise = math.sqrt(float(np.nanmean(third**2)) / 20) if np.isfinite(third).any() else 0.0
    t, y = (record.time - record.time[0])[:_FIRST], y[:_FIRST]
    if not np.all(np.isfinite(y)):
        # a position without a speed, where the first samples are missing
        return float(np.nanmedian(record.displacement[: 16 * _FIRST])), 0.0
    slope, start = np.polyfit(t, y, 1)
    if abs(slope) <= 3 * noise / math.sqrt(float(np.sum((t - t.mean()) ** 2))):
        return float(np.mean(y)), 0.0
    return float(start), float(slope)


def _hold_the_others(mujoco: Any, model: Any, data: Any, actuator: int) -> None:
    """Command all other position servos to the present positions of the joints that they drive."""
    for k in range(model.nu):
        joint, of_joint = model.actuator_trnid[k][0], int(model.actuator_trntype[k]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        if k != actuator and of_joint and model.actuator_biasprm[k][1] < 0:
            data.ctrl[k] = model.actuator_gear[k][0] * data.qpos[model.jnt_qposadr[joint]]

"""Simulate the displacement from the position at 0 V under a voltage, without a recording.

start (at rest, or settled at u(0)) -> rollout -> displacement in the one coordinate (`method.model.coordinate`)
"""

from typing import Literal

import numpy as np

from ...common.errors import BadInput, refuse_traced
from ..model.coordinate import Zero, from_model
from ..model.fitted import Fitted, model_of
from ..model.model import Model
from .beginnings import settled_states, still
from .model_runs import evaluate, model_runs
from .prediction import FAR, at_rate


def rollout(
    model: Model | Fitted, voltage: np.ndarray, dt: float | None = None, *,
    begins: Literal["rest", "held"] | None = None, start_time: float = 0.0, zero: Zero = "rest",
) -> np.ndarray:  # fmt: skip
    """Compute the displacement (m) under a voltage (V): a simulation without a recording.

    Args:
        model: identified, trained, or with effects.
        voltage: input in V, shape (T,) or (runs, T).
        dt: sampling interval in s; None is the model's own. A coarser one is simulated with finer steps.
        begins: "rest" (x = 0, uncharged: a step from 0 V) or "held" (settled at u(0)); None: rest if u(0) = 0.
        start_time: clock of the session at the first sample, s; used only by effects that age.
        zero: where the displacement is 0: "rest", at 0 V, growing as the actuator extends; "sensor", the sensor's own
            readings; or the value at 0 V.

    Returns:
        displacement in base units (m), shape of `voltage`; nan from the sample where the run diverged.

    Raises:
        BadInput: not a model, a voltage that is not a finite array of these shapes, or a dt that is not positive.

    Examples:
        >>> x = pitp.rollout(model, 1000 * np.ones(200), dt=1e-3, begins="rest")
        >>> x.shape, bool(x[0] == 0.0), bool(x[-1] > 0)
        ((200,), True, True)
    """
    refuse_traced("rollout", "free_run", model, voltage)
    model = model_of(model)
    dt = model.dt if dt is None else dt
    drive = _checked(voltage, dt, begins)
    rows = drive.reshape(-1, drive.shape[-1])
    x = _displacement(at_rate(model, dt), rows, float(dt), begins, start_time)
    return from_model(model, x, zero).reshape(drive.shape)


def _checked(voltage, dt, begins) -> np.ndarray:
    """Return the voltage as an array; refuse invalid arguments in one line with all problems."""
    problems = []
    try:
        drive = np.asarray(voltage, np.float64)
    except (TypeError, ValueError):
        raise BadInput(f"voltage is a {type(voltage).__name__}, not an array of numbers (V)") from None
    if drive.ndim not in (1, 2) or drive.shape[-1] < 2:
        problems.append(f"voltage has shape {drive.shape}; give (T,) or (runs, T), T at least 2")
    elif not np.isfinite(drive).all():
        problems.append("voltage holds values that are missing or infinite")
    if isinstance(dt, bool) or not isinstance(dt, (int, float, np.number)) or not np.isfinite(dt) or dt <= 0:
        problems.append(f"dt {dt!r} is not a positive number of seconds")
    if begins not in (None, "rest", "held"):
        problems.append(f"begins {begins!r} is not 'rest' or 'held'")
    if problems:
        raise BadInput("; ".join(problems))
    return drive


def _displacement(model: Model, rows: np.ndarray, dt: float, begins: str | None, start_time: float) -> np.ndarray:
    """Simulate all voltages, shape (rows, time); return the displacement (m) in the model's own direction."""
    ages = np.full(len(rows), model.domain.age(start_time))
    # a record that starts under a voltage was most likely held there before
    held = np.full(len(rows), begins == "held") if begins else rows[:, 0] != 0
    start = evaluate(still, model, 0.0, 0.0, ages)
    if held.any():
        start = np.where(held[:, None], settled_states(model, rows[:, 0], dt, ages), start)
    states, x = model_runs(model, rows, dt, start)
    lost = ~(np.isfinite(states).all(-1) & (np.abs(states[..., 0]) < FAR))
    x = x * model.scales.state[0]
    return np.where(np.maximum.accumulate(lost, axis=1), np.nan, x)  # a run that returns is a coincidence

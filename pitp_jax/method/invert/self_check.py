"""Simulate a planned voltage with the model and compare the reading with the target; no prediction of tracking."""

from dataclasses import dataclass

import numpy as np

from ...common.metrics import e_rms_percent, rmse
from ..model.model import Model
from ..simulate.model_runs import model_runs
from .limits import Limits
from .motion import Motion


@dataclass(frozen=True)
class Played:
    """A voltage (V), the scaled states of its simulation, and its reading (m), at least up to the target's end."""

    voltage: np.ndarray
    states: np.ndarray
    reading: np.ndarray


def play(model: Model, voltage: np.ndarray, dt: float, start) -> Played:
    """Simulate a voltage (V) in float64 from a scaled state. Float32 derivatives would be wrong by several volts."""
    states, reading = model_runs(model, voltage[None], dt, np.asarray(start)[None])
    return Played(voltage, states[0], reading[0] * model.scales.state[0])


def missed(played: Played, motion: Motion) -> float:
    """Compute the rms error of a simulated reading on the target's own samples, m."""
    return rmse(played.reading[motion.target], motion.wanted)


def stroke(played: Played) -> float:
    """Return the largest absolute displacement of a simulated reading, m."""
    return float(np.abs(played.reading).max())


def beyond(played: Played, limits: Limits) -> bool:
    """Return whether a simulated displacement exceeds its limit."""
    # not <= instead of >, so that nan counts as exceeding
    return not stroke(played) <= limits.farthest


@dataclass(frozen=True)
class Checked:
    """The errors of a planned voltage, simulated with the model itself.

    Attributes:
        percent: error of the voltage by eq. 15, % of range; nan if the range is zero.
        equation_percent: the same of eq. 13 clipped at the limits.
        missed: rms error on the target's own samples, m.
        stroke: the largest displacement, m.
    """

    percent: float
    equation_percent: float
    missed: float
    stroke: float


def check(motion: Motion, cut: Played, best: Played) -> Checked:
    """Compute the errors of the planned voltage, and of the clipped voltage of the inverse model (eq. 13)."""
    own = motion.target
    percent, clipped = (e_rms_percent(played.reading[own], motion.wanted) for played in (best, cut))
    return Checked(percent, clipped, missed(best, motion), stroke(best))

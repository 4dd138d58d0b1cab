"""Compute the best change of a voltage within the limits, by a quadratic programme on a linearised simulation.

    y_t = y_t(u) + C_t z,   u_t + c + j d within its range,   |u_{t+1} - u_t + d| <= slew dt,   |y_t| <= farthest

Displacements are in units of the first voltage's error, voltages in units of U. The change is linear over stages of at
most a fortieth of the resonance's period (one sample if the horizon is short); the number of stages sets the time of a
step. Where F = u^2 has no slope, at u = 0, the slope of a small voltage is used: the step is allowed, and the rollout
decides whether it helps. A delay shifts all voltages against the readings.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from ..model.model import Model
from ..simulate import ports
from ..simulate.prediction import FAR
from .linearised import linearise
from .self_check import Played
from .stage_qp import StageQP, solve_stage_qp

_FLOOR = 0.03  # of U: the lowest film voltage of a linearisation
_FREE = 4.0  # a bound in units of U that is never active
_MARGIN = 1e-3  # of the limit on the displacement


@dataclass(frozen=True)
class Wish:
    """The wanted reading over time, and the limits on the voltage that produces it.

    Attributes:
        reading: in model coordinates, m, shape (T,).
        counted: where it is wanted, shape (T,).
        dt: sampling interval, s.
        low, high: V, shape (T,).
        slew: V/s.
        budget: total variation, V.
        start: scaled state at the first sample.
        farthest: largest |reading|, m.
    """

    reading: np.ndarray
    counted: np.ndarray
    dt: float
    low: np.ndarray
    high: np.ndarray
    slew: float
    budget: float
    start: np.ndarray
    farthest: float = np.inf

    @property
    def unit(self) -> float:
        """Return the range U of the allowed voltages, V."""
        return float(self.high.max() - self.low.min())


def best_change(model: Model, wish: Wish, now: Played, size: float, rho: float) -> np.ndarray:
    """Compute the change of the voltage (V) that brings the linearised reading closest to the wanted one.

    Args:
        model: in float64.
        wish: the motion and the limits.
        now: the voltage to change, and its rollout.
        size: the unit of lengths, m.
        rho: weight of the second differences.
    """
    count, period = len(now.voltage), 2 * np.pi / model.natural_frequency
    late = min(sum(round(float(e.time) / wish.dt) for e in model.effects if e.delays), count - 1)
    # about 4,000 stages, as long as one is at most a fortieth of the resonance's period
    length = int(np.clip(-(-count // 4000), 1, max(period / wish.dt / 40, 1)))
    cut = _Cut(_padded(-(-count // length)), length)
    seen = _readings(model, wish, now, cut, late)
    programme = _programme(wish, now, cut, late, size, rho, *seen)
    z = solve_stage_qp(programme)[1:]
    # the last two entries of z: the change c at a stage's first sample, and its slope d
    change = (z[:, -2, None] + np.arange(length) * z[:, -1, None]).reshape(-1)[:count]
    return change * wish.unit


class _Cut:
    """A function that cuts a series into rows of equal length, with a fill value after the last sample."""

    def __init__(self, stages: int, length: int):
        self.stages, self.length = stages, length

    def __call__(self, values: np.ndarray, fill: float) -> np.ndarray:
        full = np.full((self.stages * self.length, *values.shape[1:]), fill)
        full[: len(values)] = values
        return full.reshape(self.stages, self.length, *values.shape[1:])


def _padded(stages: int) -> int:
    """Round a number of stages up by at most an eighth, so that similar horizons share a compiled program."""
    unit = 2 ** max(int(np.log2(stages)) - 3, 3)
    return -(-stages // unit) * unit


def _readings(model: Model, wish: Wish, now: Played, cut: _Cut, late: int) -> tuple[np.ndarray, np.ndarray]:
    """Linearise the reading (m) along the simulation, from the first sample that the voltage affects."""
    u = jnp.asarray(now.voltage)
    film = np.asarray(model.drive.film(ports.delayed(model, u, wish.dt, True), wish.dt, jnp.asarray(True)))
    if model.input_map.one_sided:  # the slope of a square at 0 is 0, so a film at rest would never move
        film = np.maximum(film, _FLOOR * wish.unit)
    pairs = np.stack([film, np.append(film[1:], film[-1])], -1)[late:]
    sound = np.where(np.abs(now.states[late:]) < FAR, now.states[late:], 0.0)  # after the target it may diverge
    states = jnp.asarray(cut(sound, 0.0)), jnp.asarray(cut(pairs, wish.unit))
    onward, reading = linearise(model, *states, wish.dt, jnp.asarray(wish.unit))
    return np.asarray(onward), np.asarray(reading) * model.scales.state[0]


def _programme(wish, now, cut: _Cut, late: int, size: float, rho: float, onward, reading) -> StageQP:
    """Build the quadratic programme; its first stage only chooses the first slope of the voltage change."""
    v = now.voltage / wish.unit
    counted = cut(wish.counted[late:].astype(float), 0.0)
    C = reading * counted[..., None] / size
    missed = cut(np.where(wish.counted, now.reading - wish.reading, 0.0)[late:], 0.0) / size
    rise = np.diff(v, append=v[-1:])
    G, low, high = _inequalities(wish, now, cut, late, rise, reading)
    free = np.full((1, low.shape[1]), _FREE)
    inside = cut(np.ones(len(v)), 0.0)[:, 0]
    bends = cut(second_differences(np.append(v, v[-1]))[1:], 0.0)[:, 0]

    def after_none(values):
        return np.concatenate([np.zeros((1, *values.shape[1:])), values])

    return StageQP(
        A=after_none(onward),
        Q=after_none(np.einsum("kjn,kjm->knm", C, C)),
        q=after_none(np.einsum("kjn,kj->kn", C, missed)),
        b=np.append(bends, 0.0),
        rho=rho,
        G=after_none(G),
        low=np.concatenate([-free, low]),
        high=np.concatenate([free, high]),
        g=after_none(cut.length * inside),
        h=after_none(cut(rise, 0.0).sum(1)),
        budget=wish.budget / wish.unit,
    )


def _inequalities(wish, now, cut: _Cut, late: int, rise: np.ndarray, reading: np.ndarray):
    """Return the inequality rows and their bounds: voltages, slopes over the slew limit, limited readings."""
    v, step = now.voltage / wish.unit, min(wish.slew * wish.dt / wish.unit, 1.0)
    n, j = reading.shape[-1], np.arange(cut.length)
    G = np.zeros((cut.stages, cut.length + 1, n))
    G[:, :-1, -2], G[:, :-1, -1], G[:, -1, -1] = 1.0, j, 1 / step
    # one slope holds for all samples of a stage, so the tightest bound counts
    slope_low, slope_high = cut(-1 - rise / step, -_FREE).max(1), cut(1 - rise / step, _FREE).min(1)
    low = np.concatenate([cut(wish.low / wish.unit - v, -_FREE), slope_low[:, None]], 1)
    high = np.concatenate([cut(wish.high / wish.unit - v, _FREE), slope_high[:, None]], 1)
    if np.isfinite(wish.farthest):
        far = (1 - _MARGIN) * wish.farthest
        y = np.nan_to_num(now.reading[late:], posinf=0.0, neginf=0.0)
        G = np.concatenate([G, reading / far], 1)
        low = np.concatenate([low, cut(-1 - y / far, -_FREE)], 1)
        high = np.concatenate([high, cut(1 - y / far, _FREE)], 1)
    return G, low, high


def second_differences(u: np.ndarray) -> np.ndarray:
    """Compute the second differences of u at every sample; before the first sample, u is constant."""
    return np.diff(np.concatenate([np.full(2, u[0]), u]), 2)

"""Find the motion nearest to a target within all limits, by constrained least squares over its length.

    minimise    sum_target (y_t - w_t)^2 / m^2  +  rho sum (u_{t+1} - 2 u_t + u_{t-1})^2 / U^2         y = rollout(u)
    subject to  low_t <= u_t <= high_t,  |u_{t+1} - u_t| <= slew dt,  sum |u_{t+1} - u_t| <= budget,  |y_t| <= farthest

Gauss-Newton about the current rollout: every change of the voltage solves a quadratic programme with the limits
(`change_programme`, `stage_qp`) and is halved until the rollout improves. All limits of u are convex, so every iterate
keeps them. m is the error of the first voltage, U the range of voltages. 10,000 samples take a second or two.
"""

import jax
import numpy as np

from ..model.model import Model
from ..model.programs import in_double
from .change_programme import Wish, best_change, second_differences
from .self_check import Played, play

_GAIN = 2e-3  # relative gain of the objective below which it ends
_SWING = 1e-4  # of the first voltage's error: the cost of a voltage that oscillates at the resonance
_SMOOTH = 0.03  # of it at most: the cost of the first voltage's own curvature
_BEYOND = 1e3  # weight of a reading beyond its limit


def nearest_motion(model: Model, wish: Wish, first: np.ndarray) -> np.ndarray:
    """Find the voltage (V, shape (T,)) within the limits whose simulated reading is nearest to the wanted one.

    Args:
        model: any.
        wish: the motion and the limits.
        first: a voltage within the limits of range and slew to begin with.
    """
    # float32 would lose small changes beside voltages of order one
    with jax.enable_x64(True):
        model = in_double(model)
        now = play(model, first, wish.dt, wish.start)
        size = np.sqrt(sum((part**2).sum() for part in _misses(wish, now)))
        if not 0 < size < np.inf:
            return first
        rho = _smoothness(model, wish, first)
        cost = _cost(wish, now, size, rho)
        for _ in range(10):  # steps of Gauss-Newton
            change = best_change(model, wish, now, size, rho)
            length = 1.0
            while True:
                tried = play(model, now.voltage + length * change, wish.dt, wish.start)
                if (ahead := _cost(wish, tried, size, rho)) < cost:
                    break
                length /= 2
                if length < 1 / 16:
                    return now.voltage
            now, gain, cost = tried, cost - ahead, ahead
            if gain < _GAIN * (cost + gain):
                break
    return now.voltage


def _misses(wish: Wish, played: Played) -> tuple[np.ndarray, np.ndarray]:
    """Return the error to the target, and the weighted excess over the displacement limit, m."""
    missed = (played.reading - wish.reading)[wish.counted]
    if not np.isfinite(wish.farthest):
        return missed, np.zeros(0)
    return missed, np.sqrt(_BEYOND) * np.maximum(np.abs(played.reading) - wish.farthest, 0.0)


def _cost(wish: Wish, played: Played, size: float, rho: float) -> float:
    missed = sum((part**2).sum() for part in _misses(wish, played)) / size**2
    cost = missed + rho * (second_differences(played.voltage / wish.unit) ** 2).sum()
    return float(cost) if np.isfinite(cost) else np.inf


def _smoothness(model: Model, wish: Wish, first: np.ndarray) -> float:
    """Return the weight rho of curvature: an oscillation of U/4 at the resonance costs 1e-4 of the first error.

    The second differences of the first voltage cost at most a few hundredths of the error.
    """
    swing = len(first) * (model.natural_frequency * wish.dt) ** 4 / 32
    bent = float((second_differences(first / wish.unit) ** 2).sum())
    return min(_SWING / swing, _SMOOTH / max(bent, 1e-30))

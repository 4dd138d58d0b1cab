"""Choose the pause between two recordings, after which the actuator is at rest again.

with a model    last time at which |x| is above 0.5 % of its largest value, after a hold at the largest voltage
without one     ln(200) / (zeta w), zeta = 0.05, w the geometric mean of the band
"""

import numpy as np

from ...method.model.model import Model
from ...method.simulate.voltage_only import rollout

_SETTLED = 0.005  # of the stroke: hidden in sensor noise
_LONGEST = 30.0  # s


def first_rest(band: tuple[float, float]) -> float:
    """Return the pause between recordings of a first session, s, rounded up to tenths."""
    # the damping ratio of an actuator without a model is taken as 0.05
    w = 2 * np.pi * np.sqrt(band[0] * band[1])
    return min(float(np.ceil(-10 * np.log(_SETTLED) / (0.05 * w)) / 10), _LONGEST)


def rest_after(model: Model, volts: float, rate: float) -> float:
    """Return the time after which the model is at rest again from a constant voltage, s, rounded up to tenths."""
    held = round(3.0 * rate)  # seconds of voltage before the rest
    u = np.append(np.full(held, volts), np.zeros(round(_LONGEST * rate)))
    x = np.abs(rollout(model, u, 1 / rate, begins="rest"))
    if not np.isfinite(x).all():
        return _LONGEST
    moving = np.flatnonzero(x[held:] > _SETTLED * x.max())
    return float(np.ceil(10 * (1 + max(moving[-1:], default=-1)) / rate) / 10)

"""Convert a plan to the clock of its player, for example a DAQ with another rate than the target's.

slower    the target is taken along its interpolating spline (quintic), and planned at that rate
faster    the voltage runs straight between the plan's samples, as an order-one hold takes it: no limit is lost
"""

from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

from .._errors import BadInput
from .._record.reading import Target
from .feedforward_plan import Feedforward
from .target_path import MOST

_SAME = 1e-6  # relative, between rates
_DEGREE = 5


def at_slower_rate(target: Target, rate: float | None) -> Target:
    """Return the target resampled at `rate` (Hz) if that is below its own; otherwise unchanged.

    Raises:
        BadInput: too few samples would be left, or too many would be played.
    """
    if rate is None:
        return target
    seconds = float(target.time[-1] - target.time[0])
    count = int(seconds * rate * (1 + _SAME)) + 1
    if count > MOST:
        raise BadInput(f"--rate {rate:g} Hz gives {count} samples, more than {MOST}; lower it")
    if rate > (1 - _SAME) / target.dt:
        return target
    if count <= _DEGREE or len(target.time) <= _DEGREE:
        raise BadInput(f"--rate {rate:g} Hz gives only {count} samples of the target; raise it")
    time = target.time[0] + np.arange(count) / rate
    spline = make_interp_spline(target.time, target.displacement, k=_DEGREE)
    # rounding may put the last time after the target's end, where a spline of degree 5 diverges
    return replace(target, time=time, displacement=spline(np.minimum(time, target.time[-1])))


def at_faster_rate(plan: Feedforward, rate: float | None) -> Feedforward:
    """Return the plan resampled at `rate` (Hz) if that is above its own; flags are those of the sample before."""
    spacing = float(plan.time[-1] - plan.time[0]) / (len(plan.time) - 1)
    if rate is None or rate < (1 + _SAME) / spacing:
        return plan
    count = int(np.ceil((plan.time[-1] - plan.time[0]) * rate * (1 - _SAME))) + 1
    time = plan.time[0] + np.arange(count) / rate
    before = np.minimum((np.arange(count) / (rate * spacing) * (1 + _SAME)).astype(int), len(plan.time) - 1)
    return replace(
        plan,
        time=time,
        voltage=np.interp(time, plan.time, plan.voltage),
        infeasible=plan.infeasible[before],
        saturated=plan.saturated[before],
        target=plan.target[before],
        wanted=np.interp(time, plan.time, plan.wanted),
    )

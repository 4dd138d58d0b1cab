"""Resample a target to the clock of the model or of its player, and remove the rounding of its file.

coarser   a target of a few way points is interpolated by its cubic spline at the model's rate
slower    the player's rate is below the target's: the target is taken along its quintic spline
rounded   the target is replaced by the coarsest spline that stays within one last digit of every sample, because
          derivatives amplify rounding:  q of a file at a step dt is  q / dt^n  in x^(n)
"""

from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline, make_lsq_spline

from ...common.errors import BadInput
from ...common.units import from_base, to_base
from ..signal.target import Target

MOST = 20_000_000  # samples of a plan
SAME = 1e-6  # relative, between rates
_CLOSE = 0.01  # relative, between the step of a target and that of a model
_DEGREE = 5  # of a spline that is continuous up to the fourth derivative
_POWERS, _EXACT = 11, 4.0  # powers of ten that are tried; double-precision roundings of a multiple


def at_rate_of_model(target: Target, dt: float) -> Target:
    """Resample a target that is coarser than the model's sampling interval `dt` (s) to that interval.

    Raises:
        BadInput: too many samples would be planned.
    """
    if target.dt < (1 + _CLOSE) * dt:
        return target
    # the step that divides the spacing of the way points, so that each of them is met
    pieces = int(np.ceil(target.dt / dt * (1 - _CLOSE)))
    count = pieces * (len(target.time) - 1) + 1
    if count > MOST:
        raise BadInput(f"the target has {count} samples at the model's rate, more than {MOST}; shorten it")
    time = np.linspace(target.time[0], target.time[-1], count)
    spline = make_interp_spline(target.time, target.displacement, k=3 if len(target.time) > 3 else 1)
    return replace(target, time=time, displacement=spline(time))


def at_slower_rate(target: Target, rate: float | None) -> Target:
    """Resample a target at `rate` (Hz), if that is below its own rate.

    Raises:
        BadInput: too few samples would be left, or too many would be played.
    """
    if rate is None:
        return target
    seconds = float(target.time[-1] - target.time[0])
    count = int(seconds * rate * (1 + SAME)) + 1
    if count > MOST:
        raise BadInput(f"--rate {rate:g} Hz gives {count} samples, more than {MOST}; lower it")
    if rate > (1 - SAME) / target.dt:
        return target
    if count <= _DEGREE or len(target.time) <= _DEGREE:
        raise BadInput(f"--rate {rate:g} Hz gives only {count} samples of the target; raise it")
    time = target.time[0] + np.arange(count) / rate
    # the spline's values are not decimals, so the rounding of the file could not be recognised afterwards
    spline = make_interp_spline(target.time, without_rounding(target, _DEGREE).displacement, k=_DEGREE)
    # rounding may put the last time after the target's end, where a spline of degree 5 diverges
    return replace(target, time=time, displacement=spline(np.minimum(time, target.time[-1])))


def last_digit(target: Target) -> float:
    """Return the largest power of ten of which all values are multiples, base unit; 0 if there is none.

    A step above a thousandth of the range is a choice of the user, not the rounding of a file.
    """
    unit = target.displacement_unit
    values = np.asarray(from_base(target.displacement, unit))
    span = float(np.ptp(values))
    if span == 0:
        return 0.0
    coarsest = int(np.floor(np.log10(span)))
    for power in range(coarsest, coarsest - _POWERS, -1):
        multiple = values / 10.0**power
        error = np.abs(multiple - np.round(multiple))
        if (error <= _EXACT * np.finfo(float).eps * np.maximum(np.abs(multiple), 1.0)).all():
            return float(to_base(10.0**power, unit)) * (10.0**power <= 1e-3 * span)
    return 0.0


def without_rounding(target: Target, degree: int) -> Target:
    """Return the coarsest spline within one last digit of every sample; the target unchanged without one."""
    digit, count = last_digit(target), len(target.time)
    spacing = 2 ** int(np.log2(max(count // (degree + 1), 1)))
    place = np.arange(count, dtype=float)
    while digit and spacing > 1:
        inner = np.arange(spacing, count - 1 - spacing // 2, spacing, dtype=float)
        knots = np.concatenate([np.zeros(degree + 1), inner, np.full(degree + 1, count - 1.0)])
        smooth = make_lsq_spline(place, target.displacement, knots, k=degree)(place)
        if np.abs(smooth - target.displacement).max() <= digit:
            return replace(target, displacement=smooth)
        spacing //= 2
    return target

"""Lead a wanted motion in from rest, and lead its voltage back at the end.

x^(i): quintic (order + 3) spline through the samples, differentiated
lead-in: the smoothest bounded force that swings the nominal ODE from rest to the target's first state, within the
         force at the target's first sample where that arrives
down:  u_ends + (u - u_ends) (1 + cos(pi t / T)) / 2,  T = pi |u - u_ends| / (2 slew) at least

Both last as long as the slowest mode needs (`motion.settling`).
"""

from dataclasses import replace

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import expm
from scipy.optimize import lsq_linear

from ..effects.kernels import total_delay
from ..numerics.spline_derivative import derivatives
from .limits import Limits
from .motion import Motion

_NEAR, _MET = 0.02, 1e-5  # of the target's size: a first state counts as reached, also within the narrower bounds
_SUDDEN = 0.05  # of the largest x^(i), i = 2 ... n - 1: more at the first sample is not a start from rest


def led_in(motion: Motion, limits: Limits) -> Motion:
    """Add a lead-in to a motion that does not start at rest, or whose voltage must start early (delay).

    Rest is S = 0; from order 3 on this includes the acceleration. Order 2 can change it at once, except for the first
    sample, which stays at the voltage of the ends.

    The lead-in is doubled while its voltage exceeds the slew limit or it misses its final state: once within the force
    that the first sample needs, then twice within the limits.
    """
    model, dt, order = motion.model, motion.dt, motion.model.order
    a, voltage_of = model.physical_coefficients, model.input_map.voltage
    wanted = motion.displacement - motion.stands
    states = derivatives(wanted, dt, order)
    still, low, high = (float(model.input_map.force(np.asarray(u))) for u in (limits.ends, limits.low, limits.high))
    first = float(np.asarray(voltage_of(still + a @ states[0])))
    if _rests(wanted, states, order) and abs(first - limits.ends) <= limits.unnoticed:
        early = int(np.ceil(total_delay(model.effects) / dt))
        # at rest, because delayed input must be played before
        return _after(motion, np.zeros(early + 2 * order if early else 0))
    low, high = low - still, high - still
    # with no more than the force of the first sample, damped motion arrives late
    own = 1.02 * float(a @ states[0])
    narrow = max(low, min(own, 0.0)), min(high, max(own, 0.0))
    size = max(np.ptp(wanted), abs(wanted).max(), 1e-30) * model.natural_frequency ** np.arange(order)
    # no more force than the first sample needs, if that suffices
    tried = [(narrow, stretch, _MET) for stretch in (1, 2, 4) if narrow[0] < narrow[1]]
    lead, kept, reached = np.zeros(0), False, False
    for bounds, stretch, near in [*tried, *(((0.98 * low, 0.98 * high), stretch, _NEAR) for stretch in (1, 2, 4))]:
        count = max(int(np.ceil(stretch * motion.settling[0] / dt)), 64)
        lead, force, end = swing_in(a, states[0], count, dt, *bounds)
        slew = np.abs(np.diff(np.asarray(voltage_of(still + force)))).max() / dt
        # the plan differentiates again, and near 0 V a root amplifies errors
        kept = bool(slew <= 0.95 * limits.slew)
        reached = bool((np.abs(end - states[0])[:order] / size <= near).all())
        if kept and reached:
            break
    return _after(motion, lead, kept, reached)


def _after(motion: Motion, lead: np.ndarray, slew_kept: bool = True, reached: bool = True) -> Motion:
    """Prepend a lead-in (m, from the displacement at the start voltage) to a motion."""
    count = len(lead)
    return replace(
        motion,
        displacement=np.append(motion.stands + lead, motion.displacement),
        target=slice(count, count + len(motion.wanted)),
        begins=motion.begins - count * motion.dt,
        slew_kept=slew_kept,
        reached=reached,
    )


def _rests(wanted: np.ndarray, states: np.ndarray, order: int) -> bool:
    """Return whether a motion starts at rest: its first derivatives are small against their largest values."""
    first = np.abs(states[0, 1:]) / np.maximum(np.abs(states[:, 1:]).max(0), 1e-30)
    size = max(np.ptp(wanted), abs(wanted).max(), 1e-30)
    return not (abs(states[0, 0]) > 1e-3 * size or first[0] > 1e-2 or (first[1 : order - 1] > _SUDDEN).any())


def ramp_down(voltage: float, limits: Limits, seconds: float, dt: float) -> np.ndarray:
    """Return a raised cosine from the last voltage to the end voltage, within the slew limit, at least `seconds`."""
    far = voltage - limits.ends
    count = max(int(np.ceil(max(np.pi * abs(far) / (2 * limits.slew), seconds) / dt)), 2)
    tail = limits.ends + far * 0.5 * (1 + np.cos(np.pi * np.arange(1, count + 1) / count))
    tail[-1] = limits.ends
    return tail


def swing_in(a: np.ndarray, end: np.ndarray, count: int, dt: float, low: float, high: float):
    """Find a motion from rest to [x, ..., x^(n)] = `end` by the nominal model, with a force in [low, high].

        F = sum_k c_k B_k(t),   minimise |D^2 c|^2 + |c / F_max|^2  subject to  X(T) = end,  low <= c <= high

    A polynomial ramp would need a negative force, which a squared voltage cannot produce. To reach the lower end of a
    resonant swing, the actuator must be swung up. Cubic B-splines, 8 per period of the resonance, at least 40.

    Returns:
        displacement (count,) in m and force (count,), whose next sample is the target's first; and the final state [x,
            ..., x^(n)]: `end` if the force's bounds allow it.
    """
    pieces = int(np.clip(count // 4, 8, 40))
    knots = np.concatenate([np.zeros(3), np.linspace(0, count * dt, pieces + 1), np.full(3, count * dt)])
    t = np.arange(count + 1) * dt
    # rounding must not put the last instant behind the last knot
    design = BSpline.design_matrix(np.minimum(t, count * dt * (1 - 1e-12)), knots, 3)
    basis = np.asarray(design.todense(), np.float64)[:, 2:]  # without the first two: F(0) = F'(0) = 0
    states = _respond(a, basis, dt)  # (time, n, coefficients)
    last = np.vstack([states[-1], (basis[-1] - a[:-1] @ states[-1]) / a[-1]])  # X(T) per coefficient
    size = np.abs(last).max(1)
    size = np.where(size > 0, size, 1.0)
    smooth = np.diff(np.eye(basis.shape[1]), 2, axis=0)
    unit = max(abs(high), abs(low))
    # the end state by a weight of 1e4, not as a constraint: if the bounds exclude it, the nearest one is reached
    rows = np.vstack([1e4 * last / size[:, None], smooth, 1e-2 * np.eye(basis.shape[1])])
    rhs = np.concatenate([1e4 * end / size / unit, np.zeros(len(smooth) + basis.shape[1])])
    c = lsq_linear(rows, rhs, bounds=(low / unit, high / unit)).x * unit
    return (states[:, 0] @ c)[:-1], (basis @ c)[:-1], last @ c


def _respond(a: np.ndarray, forces: np.ndarray, dt: float) -> np.ndarray:
    """Simulate the nominal model from rest under forces (T, k), linear between samples; return (T, n, k)."""
    n = len(a) - 1
    # the force and its rise over a sample as two more states: one matrix exponential is the exact step
    chained = np.zeros((n + 2, n + 2))
    chained[:n, :n] = np.vstack([np.eye(n)[1:], -a[:-1][None] / a[-1]])
    chained[n - 1, n], chained[n, n + 1] = 1 / a[-1], 1 / dt
    exact = expm(chained * dt)
    states = np.zeros((len(forces), n, forces.shape[1]))
    for t in range(len(forces) - 1):
        driven = np.outer(exact[:n, n], forces[t]) + np.outer(exact[:n, n + 1], forces[t + 1] - forces[t])
        states[t + 1] = exact[:n, :n] @ states[t] + driven
    return states

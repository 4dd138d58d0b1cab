"""Path of the inverse: a target, its lead-in from rest and the ramp back to zero.

coarser: a target of a few way points is interpolated by its cubic spline at the model's rate
x^(i): quintic (order + 3) spline through the samples, differentiated
lead-in: the smoothest bounded force that swings the nominal ODE from rest to the target's first state, within the
         force at the target's first sample where that arrives
down:  u_ends + (u - u_ends) (1 + cos(pi t / T)) / 2,  T = pi |u - u_ends| / (2 slew) at least

Both last as long as the slowest mode needs: 5 and 3 periods if it oscillates, 1/2 period if not (3 time constants). A
memory counts as at most 5 periods of the slowest pole, because slow creep excites no oscillation.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg import expm
from scipy.optimize import lsq_linear

from .._effects.kernels import total_delay
from .._errors import BadInput
from .._model.drive import ElectrodeLag
from .._model.memory import FadingMemory, RingingMemory
from .._model.model import Model
from .._numerics.spline_derivative import derivatives
from .._record.reading import Target
from .limits import Limits

MOST = 20_000_000  # samples of a plan
_CLOSE = 0.01  # relative, between the step of a target and that of a model
_NEAR, _MET = 0.02, 1e-5  # of the target's size: a first state counts as reached, also within the narrower bounds
_SPARE = 0.95  # of the slew limit, because the plan differentiates again, and near 0 V a root amplifies errors
_BEYOND = 1.02  # of the force at the first sample; otherwise damped motion arrives late
_RINGS = 0.7  # damping below which a pole oscillates
_IN, _OUT, _SMOOTH = 5.0, 3.0, 0.5  # periods: lead-in and lead-out with oscillation, both without
_SUDDEN = 0.05  # of the largest x^(i), i = 2 ... n - 1: more at the first sample is not a start from rest


@dataclass(frozen=True)
class Path:
    """A target with its lead-in.

    Attributes:
        displacement: model coordinates, m, shape (M,), from its initial position.
        target: samples of the target itself.
        slew_kept: the nominal force of the lead-in stays within the slew limit.
        reached: the lead-in ends in the target's first state: x^(i) within 2 % of omega_0^i times the target's size.
        lead_out: how long the voltage takes to its end at least, s.
    """

    displacement: np.ndarray
    target: slice
    slew_kept: bool
    reached: bool
    lead_out: float

    def ramp_down(self, voltage: float, limits: Limits, dt: float) -> np.ndarray:
        """Return a raised cosine from the last voltage to the one at the ends, within the slew limit."""
        far = voltage - limits.ends
        count = max(int(np.ceil(max(np.pi * abs(far) / (2 * limits.slew), self.lead_out) / dt)), 2)
        tail = limits.ends + far * 0.5 * (1 + np.cos(np.pi * np.arange(1, count + 1) / count))
        tail[-1] = limits.ends
        return tail


def at_rate_of_model(target: Target, dt: float) -> Target:
    """Return a target coarser than the model's step `dt` (s) resampled to that step; otherwise unchanged.

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


def settling(model: Model) -> tuple[float, float]:
    """Return the durations of lead-in and lead-out by the slowest mode, s."""
    poles = np.roots(model.physical_coefficients[::-1])
    poles = poles[np.abs(poles) > 0]
    memory, electrode = model.memory, model.drive
    lags = np.exp(np.asarray(memory.log_tau, float)) if isinstance(memory, (FadingMemory, RingingMemory)) else []
    beside: list[complex] = [-1 / float(tau) for tau in lags]
    if isinstance(memory, RingingMemory):
        omega, zeta = map(float, memory.ring)
        beside.append(omega * complex(-zeta, np.sqrt(1 - zeta**2)))
    if isinstance(electrode, ElectrodeLag):
        beside.append(-float(np.exp(-electrode.log_tau)))

    def longest(modes, periods: float) -> float:
        size = np.abs(modes)
        rings = -np.real(modes) < _RINGS * size
        return float((np.where(rings, periods, _SMOOTH) * 2 * np.pi / size).max(initial=0.0))

    most = _IN * longest(poles, 1.0)
    lead_in, lead_out = (max(longest(poles, n), min(longest(beside, n), most)) for n in (_IN, _OUT))
    return lead_in, lead_out


def extend(wanted: np.ndarray, dt: float, model: Model, limits: Limits, stands: float = 0.0) -> Path:
    """Add a lead-in to a target that does not start at rest at its initial position (m), or whose voltage is late.

    Rest is S = 0; from order 3 on this includes the acceleration. Order 2 can change it at once, except for the first
    sample, which stays at the voltage of the ends.

    The lead-in is doubled while its voltage exceeds the slew limit or it misses its final state: once within the force
    that the first sample needs, then twice within the limits.
    """
    order, force_of = model.order, model.input_map.force
    wanted = wanted - stands
    states = derivatives(wanted, dt, order)
    lead_in, lead_out = settling(model)
    still = float(force_of(np.asarray(limits.ends)))
    first = float(np.asarray(model.input_map.voltage(still + model.physical_coefficients @ states[0])))
    span = max(np.ptp(wanted), abs(wanted).max(), 1e-30)
    # the first sample's derivatives relative to the largest of the target
    first_of = np.abs(states[0, 1:]) / np.maximum(np.abs(states[:, 1:]).max(0), 1e-30)
    moves = abs(states[0, 0]) > 1e-3 * span or first_of[0] > 1e-2 or (first_of[1 : order - 1] > _SUDDEN).any()
    if not moves and abs(first - limits.ends) <= limits.unnoticed:
        early = int(np.ceil(total_delay(model.effects) / dt))
        lead = np.zeros(early + 2 * order if early else 0)  # at rest, because delayed input must be played before
        return Path(stands + np.append(lead, wanted), slice(len(lead), len(lead) + len(wanted)), True, True, lead_out)
    high = float(force_of(np.asarray(limits.high))) - still
    low = (0.0 if limits.low == 0 else float(force_of(np.asarray(limits.low)))) - still
    own = _BEYOND * float(model.physical_coefficients @ states[0])
    wide = 0.98 * low, 0.98 * high
    narrow = max(low, min(own, 0.0)), min(high, max(own, 0.0))
    lead, count, kept, reached = np.zeros(0), 0, False, False
    # no more force than the first sample needs, if that suffices
    tried = [(narrow, stretch, _MET) for stretch in (1, 2, 4) if narrow[0] < narrow[1]]
    for bounds, stretch, near in [*tried, *((wide, stretch, _NEAR) for stretch in (1, 2, 4))]:
        count = max(int(np.ceil(stretch * lead_in / dt)), 64)
        lead, force, end = swing_in(model.physical_coefficients, states[0], count, dt, *bounds)
        slew = np.abs(np.diff(np.asarray(model.input_map.voltage(still + force)))).max() / dt
        off = np.abs(end - states[0])[:order] / (span * model.natural_frequency ** np.arange(order))
        kept, reached = bool(slew <= _SPARE * limits.slew), bool((off <= near).all())
        if kept and reached:
            break
    path = stands + np.concatenate([lead, wanted])
    return Path(path, slice(count, count + len(wanted)), kept, reached, lead_out)


def swing_in(a: np.ndarray, end: np.ndarray, count: int, dt: float, low: float, high: float):
    """Find a motion from rest to [x, ..., x^(n)] = `end` with a force within [low, high], by the nominal ODE.

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
    """Simulate the nominal ODE from rest under forces (T, k), linear between samples; return states (T, n, k)."""
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

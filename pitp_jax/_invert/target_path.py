"""Trajectories for the inverse: a target, its lead-in from rest and the ramp back to zero.

x^(i): quintic (order + 3) spline through the samples, differentiated
lead-in: the smoothest bounded force that swings the nominal ODE from rest to the target's first state
down:  u_end (1 + cos(pi t / T)) / 2,  T = pi u_end / (2 slew) at least
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import expm
from scipy.optimize import lsq_linear

from .._effects.kernels import total_delay
from .._model.model import Model
from .._numerics.spline_derivative import derivatives
from .limits import Limits

_NEAR = 0.02
_SUDDEN = 0.05  # of the largest x^(i), i = 2 ... n - 1: more at the first sample is no start from rest


@dataclass(frozen=True)
class Path:
    """A target with its lead-in.

    Attributes:
        displacement: model coordinates, m, shape (M,), from rest.
        target: where the target itself lies.
        slew_kept: the nominal force of the lead-in stays within the slew limit.
        reached: the lead-in ends in the target's first state: x^(i) within 2 % of omega_0^i times the target's size.
        period: of the nominal's resonance, s.
    """

    displacement: np.ndarray
    target: slice
    slew_kept: bool
    reached: bool
    period: float

    def ramp_down(self, voltage: float, limits: Limits, dt: float) -> np.ndarray:
        """Raised cosine from the last voltage to zero within the slew limit."""
        duration = max(np.pi * abs(voltage) / (2 * limits.slew), 2 * self.period)
        count = max(int(np.ceil(duration / dt)), 2)
        tail = voltage * 0.5 * (1 + np.cos(np.pi * np.arange(1, count + 1) / count))
        tail[-1] = 0.0
        return tail


def extend(wanted: np.ndarray, dt: float, model: Model, limits: Limits) -> Path:
    """Put a lead-in from rest in front of a target that does not start there, or whose voltage is late.

    Rest is S = 0: at order 3 and up the acceleration counts, which one of order 2 can take up at once.

    The lead-in lasts 5 periods of the nominal resonance (3 time constants at order 1, which has none to rock at),
    doubled, twice at most, while its voltage breaks the slew limit or it does not arrive.
    """
    order = model.order
    states = derivatives(wanted, dt, order)
    period = 2 * np.pi / model.natural_frequency
    span = max(np.ptp(wanted), abs(wanted).max(), 1e-30)
    share = np.abs(states[0, 1:]) / np.maximum(np.abs(states[:, 1:]).max(0), 1e-30)
    if not (abs(states[0, 0]) > 1e-3 * span or share[0] > 1e-2 or (share[1 : order - 1] > _SUDDEN).any()):
        early = int(np.ceil(total_delay(model.effects) / dt))
        lead = np.zeros(early + 2 * order if early else 0)  # at rest: what is late has to be played before
        return Path(np.append(lead, wanted), slice(len(lead), len(lead) + len(wanted)), True, True, period)
    high = float(model.input_map.force(jnp.asarray(limits.high)))
    low = 0.0 if limits.low == 0 else float(model.input_map.force(jnp.asarray(limits.low)))
    lead, count, kept, reached = np.zeros(0), 0, False, False
    for stretch in (1, 2, 4):
        count = max(int(np.ceil((5 if order > 1 else 0.5) * stretch * period / dt)), 64)
        lead, force, end = swing_in(model.physical_coefficients, states[0], count, dt, low, high)
        slew = np.abs(np.diff(np.asarray(model.input_map.voltage(force)))).max() / dt
        off = np.abs(end - states[0])[:order] / (span * model.natural_frequency ** np.arange(order))
        kept, reached = bool(slew <= limits.slew), bool((off <= _NEAR).all())
        if kept and reached:
            break
    return Path(np.concatenate([lead, wanted]), slice(count, count + len(wanted)), kept, reached, period)


def swing_in(a: np.ndarray, end: np.ndarray, count: int, dt: float, low: float, high: float):
    """A way from rest to [x, ..., x^(n)] = `end` that a force within [low, high] can drive, by the nominal ODE.

        F = sum_k c_k B_k(t),   minimise |D^2 c|^2 + |c / F_max|^2  subject to  X(T) = end,  low <= c <= high

    A polynomial ramp would ask the square of a voltage to pull back: from rest to the lower end of a resonant swing
    the actuator has to be rocked. Cubic B-splines, 8 to a period of the resonance, at least 40.

    Returns:
        displacement (count,) in m and force (count,), whose next sample is the target's first; and the state [x, ...,
            x^(n)] in which it arrives: `end`, where the force's bounds let it.
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
    rows = np.vstack([1e4 * last / size[:, None], smooth, 1e-2 * np.eye(basis.shape[1])])
    rhs = np.concatenate([1e4 * end / size / unit, np.zeros(len(smooth) + basis.shape[1])])
    c = lsq_linear(rows, rhs, bounds=(0.98 * low / unit, 0.98 * high / unit)).x * unit
    return (states[:, 0] @ c)[:-1], (basis @ c)[:-1], last @ c


def _respond(a: np.ndarray, forces: np.ndarray, dt: float) -> np.ndarray:
    """States [x, ..., x^(n-1)] of the nominal ODE from rest under forces (T, k), linear between samples: (T, n, k)."""
    n = len(a) - 1
    chained = np.zeros((n + 2, n + 2))
    chained[:n, :n] = np.vstack([np.eye(n)[1:], -a[:-1][None] / a[-1]])
    chained[n - 1, n], chained[n, n + 1] = 1 / a[-1], 1 / dt
    exact = expm(chained * dt)
    states = np.zeros((len(forces), n, forces.shape[1]))
    for t in range(len(forces) - 1):
        driven = np.outer(exact[:n, n], forces[t]) + np.outer(exact[:n, n + 1], forces[t + 1] - forces[t])
        states[t + 1] = exact[:n, :n] @ states[t] + driven
    return states

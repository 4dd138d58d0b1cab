"""Find the voltage of a wanted motion within all limits: by the inverse model (eq. 13), shooting, or a search.

    r_0 = target,   u_k = inverse(r_k),   r_{k+1} = r_k + target - rollout(u_k)          where no limit is active
    min |target - rollout(u)|^2  over the u within the limits (`nearest_motion`)         otherwise

Eq. 13 inverts the continuous equation; the decoder holds its tokens over a step, so a few iterations move the reference
until the rollout meets the target. If a limit clips the voltage, moving the reference would make it jump where the
clipping starts and ends. The nearest motion's total variation is at most 1.2 times that of eq. 13 clipped at the
limits, and its error is never larger.
"""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from ..numerics.spline_derivative import fast_derivatives
from ..simulate import ports
from .equation import invert_path, scaled_equation, tolerance, unreachable
from .lead_in import ramp_down
from .limits import Limits, limit_slew, travel
from .motion import Motion
from .nearest_motion import Wish, nearest_motion
from .self_check import Played, beyond, missed, play, stroke

_TRAVEL = 1.2  # largest total variation, relative to that of eq. 13 cut at the limits
_HEADROOM = 0.95  # fraction of it in the first try
_INTERIOR = 1e-6  # an interior point stops closer to a limit than this


@dataclass(frozen=True)
class Planned(Played):
    """The inverse model's voltage, clipped at the limits, with features and where force or voltage are infeasible."""

    features: np.ndarray
    infeasible: np.ndarray
    saturated: np.ndarray


def equation_voltage(motion: Motion, limits: Limits, reference: np.ndarray | None = None) -> Planned:
    """Compute the voltage of a motion, or of a `reference` (m), by the inverse model; clip it, and add a ramp down."""
    model, dt = motion.model, motion.dt
    wanted = motion.displacement if reference is None else reference
    if model.effects:  # the target is a sensor reading, and the equation needs the motion itself
        scale = model.scales.state[0]
        wanted = np.asarray(ports.moves(model, jnp.asarray(wanted / scale), dt), np.float64) * scale
    equation = scaled_equation(model, fast_derivatives(wanted, dt, model.order))
    force, voltage, features = invert_path(model, equation, dt, jnp.asarray(motion.age, equation.dtype))
    asked = np.asarray(voltage, np.float64)
    u, saturated = limit_slew(asked, limits, dt)
    missing = model.input_map.force(asked) - model.input_map.force(u)
    saturated &= np.abs(missing) > float(tolerance(model)) * model.scales.force
    full = np.append(u, ramp_down(u[-1], limits, motion.settling[1], dt))
    # the ramp counts only for the stroke
    played = play(model, full if np.isfinite(limits.farthest) else u, dt, motion.start)
    infeasible = np.asarray(unreachable(model, force, dt))
    return Planned(full, played.states, played.reading, np.asarray(features), infeasible, saturated)


def best_voltage(motion: Motion, limits: Limits, cut: Planned, shots: int) -> Played:
    """Improve the inverse model's voltage by shooting; if a limit is active, search the nearest motion instead."""
    wanted = reference = motion.displacement
    most = _TRAVEL * travel(cut.voltage)
    best = now = cut
    bites = shots > 0 and bool(cut.infeasible.any() or cut.saturated.any())
    for _ in range(shots):
        off = wanted - now.reading[: len(wanted)]
        # where the voltage is cut, a larger reference has no effect and distorts the edges of the cut
        reference = reference + np.where(now.saturated | ~np.isfinite(off), 0.0, off)
        now = equation_voltage(motion, limits, reference)
        bites = bites or bool(now.saturated.any())
        if not missed(now, motion) < missed(best, motion) or (bites and travel(now.voltage) > _HEADROOM * most):
            break
        best = now
    if bites and travel(best.voltage) > most:  # shots taken before a limit was active
        best = cut
    if bites or beyond(best, limits):
        return _nearest(motion, limits, cut, best, most)
    return best


def _nearest(motion: Motion, limits: Limits, cut: Planned, best: Planned, most: float) -> Played:
    """Search the nearest motion with a total variation of at most `most` (V); return it only if it is better."""
    if most == 0:  # eq. 13 clipped at the limits is constant, and so is every voltage of no more total variation
        return best
    wish, near = _wish(motion, limits, best.voltage, _HEADROOM * most), best
    for _ in range(3):
        near = _kept(nearest_motion(motion.model, wish, best.voltage), wish, motion, limits)
        turned, reached = travel(near.voltage) / most, stroke(near) / limits.farthest
        if turned <= 1 and not reached > 1:
            break
        # reduce what exceeded its bound by the same factor
        wish = replace(wish, budget=wish.budget / max(turned, 1.0), farthest=wish.farthest / max(reached, 1.0))
    if (turned := travel(near.voltage)) > most:
        # total variation is convex, so a mixture has at most the same mixture of total variations
        part = (most - travel(best.voltage)) / (turned - travel(best.voltage))
        near = _kept(best.voltage + part * (near.voltage - best.voltage), wish, motion, limits)
    if beyond(best, limits):  # the displacement limit comes first: the smallest stroke, whatever its error
        return min((near, best, cut), key=lambda p: np.nan_to_num(stroke(p), nan=np.inf))
    better = missed(near, motion) < missed(best, motion) and travel(near.voltage) <= most * (1 + _INTERIOR)
    return near if better and not beyond(near, limits) else best


def _wish(motion: Motion, limits: Limits, begun: np.ndarray, budget: float) -> Wish:
    """Return the target with its limits; after its end, the voltage range shrinks to the end voltage."""
    last, count, ends = motion.target.stop, len(begun), limits.ends
    cosine = 0.5 * (1 + np.cos(np.pi * np.arange(1, count - last + 1) / (count - last)))
    down = np.append(np.ones(last), np.maximum(cosine, 0.0))
    tail = np.append(np.full(last, ends), begun[last:])
    low = np.minimum(ends + (limits.low - ends) * down, tail)
    high = np.maximum(ends + (limits.high - ends) * down, tail)
    near = min(limits.slew * motion.dt, limits.unnoticed) / 10  # so that the programme has an interior
    low[0], high[0] = max(low[0], ends - near), min(high[0], ends + near)
    counted = np.zeros(count, bool)
    counted[motion.target] = True
    reading = np.append(motion.displacement, np.zeros(count - last))
    start = np.asarray(motion.start)
    return Wish(reading, counted, motion.dt, low, high, limits.slew, budget, start, limits.farthest)


def _kept(voltage: np.ndarray, wish: Wish, motion: Motion, limits: Limits) -> Played:
    """Clip a voltage exactly to the limits, and simulate it."""
    # First move outward by the interior point's distance, so that a requested limit is met exactly.
    middle = (limits.low + limits.high) / 2
    outward = middle + (1 + _INTERIOR) * (voltage - middle)
    u, _ = limit_slew(np.clip(outward, wish.low, wish.high), limits, motion.dt)
    return play(motion.model, u, motion.dt, motion.start)

"""Plan a feedforward from rest along the target and back, by eq. 13, shooting, or the nearest motion.

    r_0 = target,   u_k = inverse(r_k),   r_{k+1} = r_k + target - rollout(u_k)          where no limit is active
    min |target - rollout(u)|^2  over the u within the limits (`nearest_motion`)         otherwise

Eq. 13 inverts the continuous equation; the decoder holds its tokens over a step, so a few iterations move the reference
until the rollout meets the target. If a limit clips the voltage, moving the reference would make it jump where the
clipping starts and ends. The nearest motion's total variation is at most 1.2 times that of eq. 13 clipped at the
limits, and its error is never larger.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._metrics import e_rms_percent, rmse
from .._model.model import Model
from .._model.programs import in_double
from .._numerics.spline_derivative import fast_derivatives
from .._simulate import ports
from .._simulate.batched_rollout import fast_rollout
from .equation import invert_path, scaled_equation, unreachable
from .limits import Limits, limit_slew, travel
from .nearest_motion import Wish, nearest_motion
from .target_path import Path

_TRAVEL = 1.2  # largest total variation, relative to that of eq. 13 cut at the limits
_HEADROOM = 0.95  # fraction of it in the first try
_TRIES = 3
_INTERIOR = 1e-6  # an interior point stops closer to a limit than this


@dataclass(frozen=True)
class Played:
    """A voltage with its ramp down (V), and the reading of its rollout (m), at least up to the target's end."""

    voltage: np.ndarray
    reading: np.ndarray


@dataclass(frozen=True)
class Planned(Played):
    """The solution of eq. 13 clipped at the limits: features, and where force or voltage were infeasible."""

    features: np.ndarray
    infeasible: np.ndarray
    saturated: np.ndarray


@dataclass(frozen=True)
class Course:
    """A target with its way from and to rest, for one model (substeps set), scaled initial state and age (s)."""

    model: Model
    path: Path
    limits: Limits
    dt: float
    age: float
    start: Float[Array, " state"]

    def missed(self, played: Played) -> float:
        """Compute the rms error on the target's own samples, m."""
        where = self.path.target
        return rmse(played.reading[where], self.path.displacement[where])

    def error(self, played: Played) -> float:
        """Compute the error by eq. 15, % of range; nan if the range is zero."""
        where = self.path.target
        return e_rms_percent(played.reading[where], self.path.displacement[where])

    def beyond(self, played: Played) -> bool:
        """Return whether the displacement exceeds its limit."""
        # not <= instead of >, so that nan counts as exceeding
        return not np.abs(played.reading).max() <= self.limits.farthest

    def play(self, voltage: np.ndarray) -> np.ndarray:
        """Simulate a voltage in float64; return the reading, m. Rounding of float32 derivatives is several volts."""
        with jax.enable_x64(True):
            model, start = in_double((self.model, self.start))
            states = fast_rollout(model, jnp.asarray(voltage[None], jnp.float64), self.dt, start[None])[0]
            return np.asarray(ports.readings(model, states)) * model.scales.state[0]

    def plan(self, reference: np.ndarray) -> Planned:
        """Solve eq. 13 along a reference, clip it at the limits, and add the ramp down."""
        model, motion = self.model, reference
        if model.effects:  # the target is a sensor reading, and the equation needs the motion itself
            scale = model.scales.state[0]
            motion = np.asarray(ports.moves(model, jnp.asarray(reference / scale), self.dt), np.float64) * scale
        equation = scaled_equation(model, fast_derivatives(motion, self.dt, model.order))
        force, voltage, features = invert_path(model, equation, self.dt, jnp.asarray(self.age, equation.dtype))
        u, saturated = limit_slew(np.asarray(voltage, np.float64), self.limits, self.dt)
        full = np.append(u, self.path.ramp_down(u[-1], self.limits, self.dt))
        reading = self.play(full if np.isfinite(self.limits.farthest) else u)  # the ramp counts only for the stroke
        return Planned(full, reading, np.asarray(features), np.asarray(unreachable(model, force, self.dt)), saturated)

    def best(self, cut: Planned, shots: int) -> Played:
        """Repeat shooting while it helps; if a limit is active, take the nearest motion, started from the best shot."""
        wanted = reference = self.path.displacement
        most = _TRAVEL * travel(cut.voltage)
        best = now = cut
        bites = shots > 0 and bool(cut.infeasible.any() or cut.saturated.any())
        for _ in range(shots):
            missed = wanted - now.reading[: len(wanted)]
            # where the voltage is cut, a larger reference has no effect and distorts the edges of the cut
            reference = reference + np.where(now.saturated | ~np.isfinite(missed), 0.0, missed)
            now = self.plan(reference)
            bites = bites or bool(now.saturated.any())
            if not self.missed(now) < self.missed(best) or (bites and travel(now.voltage) > _HEADROOM * most):
                break
            best = now
        if bites and travel(best.voltage) > most:  # shots taken before a limit was active
            best = cut
        return self.nearest(cut, best, most) if bites or self.beyond(best) else best

    def nearest(self, cut: Planned, best: Planned, most: float) -> Played:
        """Return the nearest motion of total variation `most`, V; eq. 13's or the best shot if it is not better."""
        wish, near = self._wish(best, _HEADROOM * most), best
        for _ in range(_TRIES):
            near = self._kept(nearest_motion(self.model, wish, best.voltage), wish)
            turned, reached = travel(near.voltage) / most, np.abs(near.reading).max() / self.limits.farthest
            if turned <= 1 and not reached > 1:
                break
            # reduce what exceeded its bound by the same factor
            wish = replace(wish, budget=wish.budget / max(turned, 1.0), farthest=wish.farthest / max(reached, 1.0))
        if (turned := travel(near.voltage)) > most:
            # total variation is convex, so a mixture has at most the same mixture of total variations
            part = (most - travel(best.voltage)) / (turned - travel(best.voltage))
            near = self._kept(best.voltage + part * (near.voltage - best.voltage), wish)
        if self.beyond(best):  # the displacement limit comes first: the smallest stroke, whatever its error
            return min((near, best, cut), key=lambda p: np.nan_to_num(np.abs(p.reading).max(), nan=np.inf))
        better = self.missed(near) < self.missed(best) and travel(near.voltage) <= most * (1 + _INTERIOR)
        return near if better and not self.beyond(near) else best

    def _wish(self, begun: Planned, budget: float) -> Wish:
        """Return the target within its horizon; after it the voltage returns to its end below a raised cosine."""
        last, count = self.path.target.stop, len(begun.voltage)
        cosine = 0.5 * (1 + np.cos(np.pi * np.arange(1, count - last + 1) / (count - last)))
        inside = np.ones(last)
        down = np.append(inside, np.maximum(cosine, 0.0))
        ends, limits, most = self.limits.ends, self.limits, self.limits.slew * self.dt
        tail = np.append(np.full(last, ends), begun.voltage[last:])
        low = np.minimum(ends + (limits.low - ends) * down, tail)
        high = np.maximum(ends + (limits.high - ends) * down, tail)
        near = min(most, limits.unnoticed) / 10  # so that the programme has an interior
        low[0], high[0] = max(low[0], ends - near), min(high[0], ends + near)
        counted = np.zeros(count, bool)
        counted[self.path.target] = True
        return Wish(
            reading=np.append(self.path.displacement, np.zeros(count - last)),
            counted=counted,
            dt=self.dt,
            low=low,
            high=high,
            slew=self.limits.slew,
            budget=budget,
            farthest=self.limits.farthest,
            start=np.asarray(self.start),
        )

    def _kept(self, voltage: np.ndarray, wish: Wish) -> Played:
        """Play a voltage, clipped exactly to the limits."""
        # First move outward by the interior point's distance, so that a requested limit is met exactly.
        middle = (self.limits.low + self.limits.high) / 2
        outward = middle + (1 + _INTERIOR) * (voltage - middle)
        u, _ = limit_slew(np.clip(outward, wish.low, wish.high), self.limits, self.dt)
        return Played(u, self.play(u))

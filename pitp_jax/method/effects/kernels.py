"""The memories of all effects, with exact time steps where known.

    lag          tau z' = w - z                                                            (exact for w linear)
    each way     the same with a time constant up and one down
    oscillator   z'' = w_0^2 (w - z) - 2 zeta w_0 z'                                       (implicit midpoint)
    play         z stays within w - r <= z <= w + r                                        (exact for w monotonic)
    coasting     the same, but z'' = -rate z' until it is caught, then z' = w'              (exact but for the instant)
    dahl         dz = dw - |dw| z / r, of w or of its integral                             (exact for w monotonic)
    bouc_wen     dz = dw (1 - (sgn(dw z) + gamma) |z| / r)                                 (midpoint rule)
    rounded      dz = dw (1 - sgn(dw z) (q + sharp (q^4 - q))),  q = |z| / r               (midpoint rule)
    farthest     z = max |w| so far,                clock   z' = 1                         (exact)
    slew         |z'| <= s towards u                                                       (exact for one step's goal)
    present      z = w                                                                     (exact)
    delay        a shift of the whole record: no state of a step

w is the memory's input: u at the port IN, x for forces and sensors. A kernel reads its parameters by name from `p`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..model.drive import slope
from ..numerics.linear_recurrence import lag_followed, lag_weights


def _same(p, z, *others):
    return z


def _settled(p, w, age):
    return jnp.full((1,), w)


def _unloaded(p, w, age):
    return jnp.zeros((1,))


@dataclass(frozen=True)
class Kernel:
    """A memory with a fixed number of states.

    Attributes:
        size: number of states.
        start: fn(p, w, age), the states settled at w; `age` of the session in s.
        advance: fn(p, z, before, after, h), the states after w ran linearly from `before` to `after` in h seconds.
        ahead: fn(p, z, now), the states half a step later, for the force of a frozen step.
        resumed: fn(p, z, reached), the states after the session has reached |x| = `reached`; most do not change.
    """

    size: int
    start: Callable[..., Any]
    advance: Callable[..., Any] = _same
    ahead: Callable[..., Any] = _same
    resumed: Callable[..., Any] = _same


NOTHING = Kernel(0, lambda p, w, age: jnp.zeros((0,)))
# the input itself, for a reading that contains it
PRESENT = Kernel(1, _settled, lambda p, z, before, after, h: jnp.full_like(z, after))
DELAY = Kernel(0, NOTHING.start)  # differs from NOTHING by identity: the shift acts on records, see `shifted`


def lag(of: Callable = lambda p, w: w) -> Kernel:
    """Build a first-order lag with the time constant tau, whose input is `of` w."""

    def present(p):  # the smallest number represents no lag, and keeps h / tau finite
        return jnp.maximum(p.tau, 1e-9)

    def advance(p, z, before, after, h):
        return lag_followed(z, of(p, before), of(p, after), *lag_weights(present(p), h))

    def ahead(p, z, now):  # x held over half a step, because its end is not known yet
        return z - (now.x - z) * jnp.expm1(-now.h / 2 / present(p))

    return Kernel(1, lambda p, w, age: jnp.full((1,), of(p, w)), advance, ahead)


def lag_each_way() -> Kernel:
    """Build a lag with the time constant `up` where |w| exceeds |z|, and `down` where it does not."""

    def advance(p, z, before, after, h):
        rises = jnp.abs(before + after) / 2 > jnp.abs(z)
        # 1e-9 s stands for no lag, as in `lag`
        up, down = (lag_followed(z, before, after, *lag_weights(jnp.maximum(t, 1e-9), h)) for t in (p.up, p.down))
        return jnp.where(rises, up, down)

    return Kernel(1, _settled, advance)


def lead(values: Float[Array, " time"], dt: float, tau) -> Float[Array, " time"]:
    """Compute the input of a first-order lag from its smooth output v: v + tau v'."""
    return values + tau * slope(values, dt)


def oscillator(frequency: Callable = lambda p: p.omega) -> Kernel:
    """Build the memory (z, z' in 1/s) of a mass that is moved through a spring, initially at rest at w."""

    def advance(p, z, before, after, h):
        w = frequency(p)
        # by the mean of w over the step: unconditionally stable, so a resonance near the sampling rate stays bounded
        middle = (z[1] + h / 2 * w**2 * ((before + after) / 2 - z[0])) / (1 + (h * w / 2) ** 2 + h * p.zeta * w)
        return jnp.stack([z[0] + h * middle, 2 * middle - z[1]])

    def start(p, w, age):
        return jnp.stack([jnp.asarray(w), jnp.zeros_like(w)])

    return Kernel(2, start, advance, lambda p, z, now: jnp.stack([z[0] + now.h / 2 * z[1], z[1]]))


def play(*ratios: float) -> Kernel:
    """Build backlash elements (plays) of the half widths ratio * width, initially in their middle."""

    def inside(p, z, w):
        r = p.width * jnp.asarray(ratios, jnp.result_type(p.width))
        return jnp.clip(z, w - r, w + r)

    return Kernel(
        len(ratios),
        lambda p, w, age: jnp.full((len(ratios),), w),
        lambda p, z, before, after, h: inside(p, z, after),
        lambda p, z, now: inside(p, z, now.x),
    )


def coasting() -> Kernel:
    """Build a play whose follower coasts until either end catches it, with the states (z, z')."""

    def advance(p, z, before, after, h):
        slowed = jnp.exp(-p.rate * h)
        alone = z[0] + z[1] * (1 - slowed) / jnp.maximum(p.rate, 1e-9)
        caught = jnp.clip(alone, after - p.width / 2, after + p.width / 2)
        return jnp.stack([caught, jnp.where(caught == alone, z[1] * slowed, (after - before) / h)])

    return Kernel(2, lambda p, w, age: jnp.stack([w, 0.0 * w]), advance)


def _travelled(advance: Callable, size: int = 1) -> Kernel:
    """Build a memory whose states depend on the travelled distance alone, initially zero."""

    def ahead(p, z, now):  # the distance to half a step later, at the velocity of the step; unknown at order 1
        way = now.h / 2 * now.rates[0] * now.state[1] if len(now.state) > 1 else 0.0 * now.x
        return advance(p, z, 0.0 * way, way, 0.0)

    return Kernel(size, lambda p, w, age: jnp.zeros((size,)), advance, ahead)


def dahl(width: str = "width") -> Kernel:
    """Build Dahl's hysteresis state, which saturates at a displacement; `width`: name of this parameter."""

    def advance(p, z, before, after, h):
        r = getattr(p, width)
        # towards the yield on the side of the motion, exponentially with the distance
        end = jnp.sign(after - before) * r
        return end + (z - end) * jnp.exp(-jnp.abs(after - before) / r)

    return _travelled(advance)


def dahl_of_integral() -> Kernel:
    """Build a Dahl state of the input's integral, between -1 and 1, that saturates over the parameter `width`."""

    def advance(p, z, before, after, h):
        way = h / 2 * (before + after)  # exact while the input keeps its sign
        end = jnp.sign(way)
        return end + (z - end) * jnp.exp(-jnp.abs(way) / p.width)

    return Kernel(1, _unloaded, advance)


def bouc_wen() -> Kernel:
    """Build a Bouc-Wen state: |z| / width slows it, times gamma + 1 on loading and gamma - 1 on unloading."""

    def advance(p, z, before, after, h):
        way = after - before

        def slope_at(z):
            return 1 - (p.gamma + jnp.where(z * way > 0, 1, -1)) * jnp.abs(z) / p.width

        middle = z + way / 2 * slope_at(z)
        # without resistance z grows without limit; ten widths are more than any recording shows
        most = p.width / jnp.clip(p.gamma + 1, 0.1, None)
        return jnp.clip(z + way * slope_at(middle), -most, most)

    return _travelled(advance)


def rounded(*powers: int) -> Kernel:
    """Build Dahl states of several widths, width * spread^(power / 2) each, with a parameter `sharp` from 0 to 1."""

    def advance(p, z, before, after, h):
        way, root = after - before, jnp.sqrt(p.spread)
        r = p.width * jnp.stack([root**k for k in powers])

        def slope_at(z):
            q = jnp.abs(z) / r
            return 1 - jnp.sign(way * z) * q * (1 - p.sharp + p.sharp * q**3)

        middle = jnp.clip(z + way / 2 * slope_at(z), -r, r)
        return jnp.clip(z + way * slope_at(middle), -r, r)

    return _travelled(advance, len(powers))


FARTHEST = Kernel(
    1,
    lambda p, w, age: jnp.reshape(jnp.abs(w), (1,)),
    lambda p, z, before, after, h: jnp.maximum(z, jnp.abs(after)),
    lambda p, z, now: jnp.maximum(z, jnp.abs(now.x)),
    lambda p, z, reached: jnp.maximum(z, reached),
)
CLOCK = Kernel(
    1,
    lambda p, w, age: jnp.reshape(jnp.asarray(age, jnp.result_type(w)), (1,)),
    lambda p, z, before, after, h: z + h,
)


def slew() -> Kernel:
    """Build a state that follows its input with a limited rate of 1 / inverse."""

    def advance(p, z, before, after, h):
        most = h / jnp.maximum(p.inverse, 1e-30)  # inverse 0: no limit
        return z + jnp.clip(after - z, -most, most)

    return Kernel(1, _settled, advance)


def shifted(values: Float[Array, " time"], samples, before) -> Float[Array, " time"]:
    """Delay a series by a number of samples, linearly between them; `before` precedes the first value."""
    # by index and weight instead of interp, because a fitted delay needs the slope of the line between samples
    at = jnp.arange(values.shape[0]) - samples
    index = jnp.floor(at)
    weight = (at - index).astype(values.dtype)
    index = index.astype(int)
    padded = jnp.concatenate([jnp.reshape(before, (1,)), values])
    earlier, later = (padded[jnp.clip(index + k, 0, values.shape[0])] for k in (1, 2))
    return earlier + weight * (later - earlier)


def advanced(values: Float[Array, " time"], samples) -> Float[Array, " time"]:
    """Advance a series by a number of samples, to compensate for a delay. The last value is repeated."""
    # interp suffices here: no fit differentiates an inverse, and it repeats the last value beyond the end
    place = jnp.arange(values.shape[0], dtype=values.dtype)
    return jnp.interp(place + samples, place, values)


def total_delay(effects: Sequence) -> float:
    """Return the sum of the delays in a list of effects, s."""
    return sum(float(e.time) for e in effects if e.spec.kernel is DELAY)

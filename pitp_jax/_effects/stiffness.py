"""Restoring forces beside the nominal's k x (port K), k = sigma_0 of the nominal.

stiffening   k c x^3          k c x |x|^p            k x (1 / (1 - (x/L)^2) - 1)          the spring hardens
softening   -k c x^2    k (L tanh(x/L) - x)    k ((1 - exp(-b x)) / b - x)               the spring gives way
mullins     -k d (1 - exp(-m / L)) x,   m = max |x| so far       what was stretched is softer
end stop     k kappa max(x - x_s, 0)   above, below, on both sides;  k kappa max(x - x_s, 0)^(3/2) (1 + lambda x')
             (Hunt and Crossley, above or on both sides)

A Gent-like spring fitted by a cubic alone lost to an end stop, hence several forms under one name.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .base import AbstractForceEffect, Instant, Parameter, Surroundings, bounded, nothing

_LIMIT = 0.97  # of the Gent-like spring's length; beyond, it goes on linearly


class _Memoryless(AbstractForceEffect):
    """A force of x and x' of the same instant."""

    def initial(self, x, age):
        """None."""
        return nothing()

    def advance(self, states, x, after, h):
        """None."""
        return states


class CubicStiffening(_Memoryless):
    """f = k c x^3 (Duffing)."""

    name, form, family, port = "stiffening", "cubic", "stiffness", "K"
    PARAMETERS = (Parameter("c", "1/x^2", length=-2, neutral=0.0),)
    c: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """A third of the linear force at the largest displacement."""
        unit = 1 / s.reach**2
        return [bounded((0.2 * unit,), (1e-4 * unit,), (30 * unit,))]

    def act(self, states, now: Instant, tokens, offset):
        """The extra force."""
        return tokens, offset + now.coefficients[0] * self.c * now.state[0] ** 3


class PowerStiffening(_Memoryless):
    """f = k c x |x|^p."""

    name, form, family, port = "stiffening", "power", "stiffness", "K"
    PARAMETERS = (Parameter("c", "1", neutral=0.0), Parameter("p"), Parameter("reach", "x", length=1))
    c: Float[Array, ""]
    p: Float[Array, ""]
    reach: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """C at the largest displacement; exponents between a square and a wall."""
        return [bounded((0.3, p, s.reach), (1e-4, 0.7, s.reach), (30, 10, s.reach)) for p in (1.5, 4.0)]

    def act(self, states, now: Instant, tokens, offset):
        """The extra force."""
        x = now.state[0]
        grown = jnp.exp(self.p * jnp.log(jnp.abs(x / self.reach) + 1e-9))
        return tokens, offset + now.coefficients[0] * self.c * x * jnp.minimum(grown, 1e3)


class GentStiffening(_Memoryless):
    """f = k x (1 / (1 - r^2) - 1), r = |x| / L: the chain can be stretched no further than L."""

    name, form, family, port = "stiffening", "limited chain", "stiffness", "K"
    PARAMETERS = (Parameter("curvature", "1/x", length=-1, neutral=0.0, linear=False),)
    curvature: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """1 / L, L just beyond and far beyond what was reached."""
        return [bounded((share / s.reach,), (0.02 / s.reach,), (1.02 / s.reach,)) for share in (0.5, 0.85)]

    def act(self, states, now: Instant, tokens, offset):
        """The extra force."""
        x = now.state[0]
        square = (self.curvature * x) ** 2
        top = _LIMIT**2
        extra = jnp.where(
            square < top, square / (1 - jnp.minimum(square, top)), top / (1 - top) + (square - top) / (1 - top) ** 2
        )
        return tokens, offset + now.coefficients[0] * x * extra


class QuadraticSoftening(_Memoryless):
    """f = -k c x^2, no further than where the spring's slope is a tenth of k."""

    name, form, family, port = "softening", "quadratic", "stiffness", "K"
    PARAMETERS = (Parameter("c", "1/x", length=-1, neutral=0.0),)
    c: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """A tenth of the linear force."""
        return [bounded((0.1 / s.reach,), (1e-4 / s.reach,), (3 / s.reach,))]

    def act(self, states, now: Instant, tokens, offset):
        """The missing force."""
        x, c = now.state[0], self.c
        turn = 0.45 / jnp.maximum(c, 1e-9)
        x = jnp.where(x > turn, turn + 0 * x, x)
        beyond = jnp.maximum(now.state[0] - turn, 0.0)
        return tokens, offset - now.coefficients[0] * (c * x**2 + 0.9 * beyond * (c > 0))


class SaturatingSoftening(_Memoryless):
    """f = 0.97 k (L tanh(x / L) - x): 3 % of the spring stay, or nothing would bring it back."""

    name, form, family, port = "softening", "saturating", "stiffness", "K"
    PARAMETERS = (Parameter("curvature", "1/x", length=-1, neutral=0.0, linear=False),)
    curvature: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """1 / L."""
        return [bounded((0.6 / s.reach,), (0.02 / s.reach,), (4 / s.reach,))]

    def act(self, states, now: Instant, tokens, offset):
        """The missing force."""
        x = now.state[0]
        r = self.curvature * x
        share = jnp.where(jnp.abs(r) < 0.03, -(r**2) / 3, jnp.tanh(r) / jnp.where(jnp.abs(r) < 0.03, 1.0, r) - 1)
        return tokens, offset + 0.97 * now.coefficients[0] * x * share


class ExponentialSoftening(_Memoryless):
    """f = k ((1 - exp(-b x)) / b - x): softer the further it is stretched, harder the other way."""

    name, form, family, port = "softening", "exponential", "stiffness", "K"
    PARAMETERS = (Parameter("b", "1/x", length=-1, neutral=0.0, linear=False),)
    b: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """A spring half gone at the largest displacement."""
        return [bounded((0.5 / s.reach,), (0.01 / s.reach,), (3 / s.reach,))]

    def act(self, states, now: Instant, tokens, offset):
        """The missing force."""
        x = now.state[0]
        r = jnp.clip(self.b * x, -3.0, 6.0)
        small = jnp.abs(r) < 0.03
        share = jnp.where(small, -r / 2 + r**2 / 6, -jnp.expm1(-r) / jnp.where(small, 1.0, r) - 1)
        return tokens, offset + now.coefficients[0] * x * share


def _hertz(depth):
    """Depth^(3/2), linear again where it is deeper than any contact (slope bounded: the step stays stable)."""
    deep = jnp.maximum(depth, 0.0)
    return deep * jnp.sqrt(jnp.minimum(deep, 2.0))


def _stop_starts(s: Surroundings, far: float, parameters: int):
    """Thresholds inside what was reached; hard and soft."""
    if far <= 0.05 * s.reach:
        return []
    hardest = (1.0 / (s.dt * s.omega)) ** 2 + 1
    rest, low, high = (0.3,) * (parameters - 2), (1e-3,) * (parameters - 2), (30.0,) * (parameters - 2)
    return [
        bounded((kappa, share * far, *rest), (1e-2, 0.1 * far, *low), (hardest, 0.999 * far, *high))
        for kappa, share in ((3.0, 0.85), (min(15.0, hardest), 0.6), (3.0, 0.4))
    ]


class MullinsSoftening(AbstractForceEffect):
    """f = -k d (1 - exp(-m / L)) x, m the largest |x| so far: the first large cycle differs from the next."""

    name, form, family, port, states = "mullins", "exponential", "stiffness", "K", 1
    PARAMETERS = (Parameter("d", neutral=0.0), Parameter("length", "x", length=1))
    d: Float[Array, ""]
    length: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Lost within a part of the stroke, or all along it."""
        low, high = (1e-4, 0.03 * s.reach), (0.9, 3 * s.reach)
        return [bounded((0.2, share * s.reach), low, high) for share in (0.3, 1.0)]

    def initial(self, x, age):
        """Stretched to X."""
        return jnp.reshape(jnp.abs(x), (1,))

    def resumed(self, states, reached):
        """As far as the session went before."""
        return jnp.maximum(states, reached)

    def act(self, states, now: Instant, tokens, offset):
        """What is gone of the spring."""
        x = now.state[0]
        gone = self.d * -jnp.expm1(-jnp.maximum(states[0], jnp.abs(x)) / self.length)
        return tokens, offset - now.coefficients[0] * gone * x

    def advance(self, states, x, after, h):
        """Exact for X monotonic within the step."""
        return jnp.maximum(states, jnp.abs(after))


class UpperStop(_Memoryless):
    """f = k kappa max(x - x_s, 0)."""

    name, form, family, port = "end_stop", "above", "stiffness", "K"
    PARAMETERS = (Parameter("kappa", neutral=0.0), Parameter("place", "x", length=1))
    kappa: Float[Array, ""]
    place: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """From the highest displacement."""
        return _stop_starts(s, s.top, 2)

    def act(self, states, now: Instant, tokens, offset):
        """The contact force."""
        return tokens, offset + now.coefficients[0] * self.kappa * jnp.maximum(now.state[0] - self.place, 0.0)


class LowerStop(_Memoryless):
    """f = -k kappa max(-x - x_s, 0)."""

    name, form, family, port = "end_stop", "below", "stiffness", "K"
    PARAMETERS = UpperStop.PARAMETERS
    kappa: Float[Array, ""]
    place: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """From the lowest displacement."""
        return _stop_starts(s, -s.bottom, 2)

    def act(self, states, now: Instant, tokens, offset):
        """The contact force."""
        return tokens, offset - now.coefficients[0] * self.kappa * jnp.maximum(-now.state[0] - self.place, 0.0)


class DampedStop(_Memoryless):
    """f = k kappa max(x - x_s, 0)^(3/2) max(1 + lambda x', 0): a bumper that takes energy (Hertz's contact)."""

    name, form, family, port = "end_stop", "above, damped", "stiffness", "K"
    PARAMETERS = (
        Parameter("kappa", "1/x^(1/2)", length=-0.5, neutral=0.0),
        Parameter("place", "x", length=1),
        Parameter("loss", "s/x", speed=-1),
    )
    kappa: Float[Array, ""]
    place: Float[Array, ""]
    loss: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """From the highest displacement."""
        return _stop_starts(s, s.top, 3)[:2]

    def act(self, states, now: Instant, tokens, offset):
        """The contact force, never a pull."""
        deep = _hertz(now.state[0] - self.place)
        speed = now.velocity(tokens, offset)
        return tokens, offset + now.coefficients[0] * self.kappa * deep * jnp.clip(1 + self.loss * speed, 0.0, 10.0)


class BothStops(_Memoryless):
    """f = k kappa (max(x - x_s, 0) - max(-x - x_s, 0))."""

    name, form, family, port = "end_stop", "both sides", "stiffness", "K"
    PARAMETERS = UpperStop.PARAMETERS
    kappa: Float[Array, ""]
    place: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """From the nearer end of what was reached."""
        return _stop_starts(s, min(s.top, -s.bottom), 2)[:2]

    def act(self, states, now: Instant, tokens, offset):
        """The contact force."""
        x = now.state[0]
        deep = jnp.maximum(x - self.place, 0.0) - jnp.maximum(-x - self.place, 0.0)
        return tokens, offset + now.coefficients[0] * self.kappa * deep


class DampedStops(_Memoryless):
    """Both sides, each with a loss."""

    name, form, family, port = "end_stop", "both sides, damped", "stiffness", "K"
    PARAMETERS = DampedStop.PARAMETERS
    kappa: Float[Array, ""]
    place: Float[Array, ""]
    loss: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """From the nearer end of what was reached."""
        return _stop_starts(s, min(s.top, -s.bottom), 3)[:2]

    def act(self, states, now: Instant, tokens, offset):
        """The contact forces, never a pull."""
        x, speed = now.state[0], now.velocity(tokens, offset)
        above = _hertz(x - self.place) * jnp.clip(1 + self.loss * speed, 0.0, 10.0)
        below = _hertz(-x - self.place) * jnp.clip(1 - self.loss * speed, 0.0, 10.0)
        return tokens, offset + now.coefficients[0] * self.kappa * (above - below)

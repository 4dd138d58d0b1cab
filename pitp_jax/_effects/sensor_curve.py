"""What the sensor reads the same at any speed (port OUT): a curved scale, and play before it.

sensor_nonlinearity   y = x + c_2 x^2 + c_3 x^3            one of the two, or both
backlash              y follows x as soon as it is w / 2 away:  x - w/2 <= y <= x + w/2
"""

from abc import abstractmethod

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._model.drive import slope
from .base import AbstractSensorEffect, Parameter, Surroundings, bounded, nothing

_STEEP = 0.1  # the least slope of a curve that is undone; within the starts' bounds no curve is flatter
_TURN = 50.0  # samples a play takes to be crossed at the speed from which a motion has one direction


class _Curve(AbstractSensorEffect):
    """A curve through zero with the slope 1 there."""

    name, family, port = "sensor_nonlinearity", "sensor", "OUT"

    @property
    @abstractmethod
    def factors(self) -> tuple:
        """(c_2, c_3)."""

    def initial(self, x):
        """None."""
        return nothing()

    def advance(self, states, x, after, h):
        """None."""
        return states

    def reading(self, states, x):
        """The curve."""
        second, third = self.factors
        return x + second * x**2 + third * x**3

    def undo(self, y, dt):
        """By Newton's method, where the curve rises."""
        x, (second, third) = y, self.factors
        for _ in range(8):
            rise = 1 + 2 * second * x + 3 * third * x**2
            x = x - (self.reading(nothing(), x) - y) / jnp.maximum(rise, _STEEP)
        return x


_SECOND = Parameter("c2", "1/x", length=-1, positive=False, neutral=0.0)
_THIRD = Parameter("c3", "1/x^2", length=-2, positive=False, neutral=0.0)


class QuadraticSensor(_Curve):
    """y = x + c_2 x^2."""

    form, PARAMETERS = "quadratic", (_SECOND,)
    c2: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Either sign, the curve rising as far as the records go."""
        return [bounded((0.1 / s.reach,), (-0.45 / s.reach,), (2 / s.reach,))]

    @property
    def factors(self):
        """One of them."""
        return self.c2, 0.0


class CubicSensor(_Curve):
    """y = x + c_3 x^3."""

    form, PARAMETERS = "cubic", (_THIRD,)
    c3: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Either sign, the curve rising as far as the records go."""
        return [bounded((0.1 / s.reach**2,), (-0.3 / s.reach**2,), (2 / s.reach**2,))]

    @property
    def factors(self):
        """The other."""
        return 0.0, self.c3


class CurvedSensor(_Curve):
    """y = x + c_2 x^2 + c_3 x^3."""

    form, PARAMETERS = "quadratic and cubic", (_SECOND, _THIRD)
    c2: Float[Array, ""]
    c3: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """As the quadratic one; the cubic part by the fit."""
        low, high = (-0.3 / s.reach, -0.1 / s.reach**2), (2 / s.reach, 2 / s.reach**2)
        return [bounded((0.1 / s.reach, 0.0), low, high)]

    @property
    def factors(self):
        """Both."""
        return self.c2, self.c3


class Backlash(AbstractSensorEffect):
    """y within w / 2 of x, moved by x alone: a dead band between what moves and what is measured."""

    name, form, family, port, states = "backlash", "play", "dissipation", "OUT", 1
    PARAMETERS = (Parameter("width", "x", length=1, neutral=0.0, linear=False),)
    width: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Narrow and wide beside the largest displacement."""
        return [bounded((share * s.reach,), (1e-3 * s.reach,), (1.5 * s.reach,)) for share in (0.05, 0.2)]

    def initial(self, x):
        """In the middle of the play."""
        return jnp.reshape(x, (1,))

    def advance(self, states, x, after, h):
        """Exact for X monotonic within the step."""
        return jnp.clip(states, after - self.width / 2, after + self.width / 2)

    def reading(self, states, x):
        """Where the play has been pushed to."""
        return jnp.clip(states[0], x - self.width / 2, x + self.width / 2)

    def undo(self, y, dt):
        """X = y + w/2 sgn(y'): across the play at every reversal, no faster than a smooth motion can."""
        least = jnp.maximum(self.width, 1e-12) / (_TURN * dt)
        return y + self.width / 2 * jnp.tanh(slope(y, dt) / least)

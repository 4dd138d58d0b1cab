"""What the film makes of its voltage at the square (port SQ).

stretch_coupling        F (1 + b x)          F (1 + b x / 2)^2       thinner film, larger area: more force
                      F exp(b x)                              electrodes that zip up, b < 0: less and less
dielectric_saturation   F / (1 + |F| / F_s)  F_s tanh(F / F_s)        the permittivity falls at high field
"""

from abc import abstractmethod

import jax.numpy as jnp
from jaxtyping import Array, Float

from .base import AbstractCouplingEffect, Parameter, Surroundings, bounded


class _Stretched(AbstractCouplingEffect):
    """F times a factor of x that stays positive: never a push, and undone by division."""

    name, family, port = "stretch_coupling", "coupling", "SQ"
    PARAMETERS = (Parameter("b", "1/x", length=-1, positive=False, neutral=0.0),)
    b: Float[Array, ""]

    @abstractmethod
    def factor(self, x) -> Array:
        """Of the force, at X."""

    def couple(self, force, x):
        """Never a push."""
        return force * self.factor(x)

    def uncouple(self, force, x):
        """By division."""
        return force / self.factor(x)


class StretchCoupling(_Stretched):
    """F (1 + b x)."""

    form = "linear"

    @classmethod
    def starts(cls, s: Surroundings):
        """Either sign; far up, since an actuator that snaps in one record has a reach its others never see."""
        return [bounded((sign * 0.1 / s.reach,), (-0.95 / s.reach,), (12.0 / s.reach,)) for sign in (1, -1)]

    def factor(self, x):
        """At least 0.05."""
        return jnp.maximum(1 + self.b * x, 0.05)


class SquaredCoupling(_Stretched):
    """F (1 + b x / 2)^2."""

    form = "quadratic"

    @classmethod
    def starts(cls, s: Surroundings):
        """Either sign, as far up."""
        return [bounded((sign * 0.1 / s.reach,), (-1.0 / s.reach,), (12.0 / s.reach,)) for sign in (1, -1)]

    def factor(self, x):
        """At least 0.01."""
        return jnp.maximum(1 + self.b * x / 2, 0.1) ** 2


class ExponentialCoupling(_Stretched):
    """F exp(b x)."""

    form = "exponential"

    @classmethod
    def starts(cls, s: Surroundings):
        """Either sign; far down, where the grid must come close: an exponent is not a strength."""
        return [bounded((b / s.reach,), (-6.0 / s.reach,), (3.0 / s.reach,)) for b in (0.3, -0.3, -1.0, -3.0)]

    def factor(self, x):
        """Within exp(+-8)."""
        return jnp.exp(jnp.clip(self.b * x, -8.0, 8.0))


class DielectricSaturation(AbstractCouplingEffect):
    """F / (1 + |F| / F_s); `inverse` is 1 / F_s."""

    name, form, family, port = "dielectric_saturation", "rational", "coupling", "SQ"
    PARAMETERS = (Parameter("inverse", "1/V^2", force=-1, neutral=0.0, linear=False),)
    inverse: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """A tenth and a half of the force at the largest voltage."""
        return [bounded((share,), (1e-4,), (20.0,)) for share in (0.1, 0.5)]

    def couple(self, force, x):
        """What the field still makes."""
        return force / (1 + self.inverse * jnp.abs(force))

    def uncouple(self, force, x):
        """In closed form below F_s."""
        left = 1 - self.inverse * jnp.abs(force)
        return jnp.where(left > 0, force / jnp.where(left > 0, left, 1.0), jnp.sign(force) * jnp.inf)


class TanhSaturation(AbstractCouplingEffect):
    """F_s tanh(F / F_s)."""

    name, form, family, port = "dielectric_saturation", "tanh", "coupling", "SQ"
    PARAMETERS = DielectricSaturation.PARAMETERS
    inverse: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Half of the force at the largest voltage."""
        return [bounded((0.5,), (1e-2,), (10.0,))]

    def couple(self, force, x):
        """What the field still makes."""
        r = self.inverse * force
        small = jnp.abs(r) < 0.03
        return force * jnp.where(small, 1 - r**2 / 3, jnp.tanh(r) / jnp.where(small, 1.0, r))

    def uncouple(self, force, x):
        """In closed form below F_s."""
        r = self.inverse * force
        inside = jnp.abs(r) < 1
        small = jnp.abs(r) < 0.03
        grown = jnp.arctanh(jnp.where(inside, r, 0.0)) / jnp.where(small, 1.0, r)
        return jnp.where(inside, force * jnp.where(small, 1 + r**2 / 3, grown), jnp.sign(force) * jnp.inf)

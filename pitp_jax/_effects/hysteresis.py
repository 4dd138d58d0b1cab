"""Forces that remember where X turned (port K): the loop's area does not depend on how fast it is run through.

f = k kappa mean_j (x - p_j),  p_j a play of half width r_j                   (Prandtl and Ishlinskii)
f = k kappa z  or  k kappa (z - x),   dz = dx (1 - sgn(dx) z / r)             (Dahl; Bouc and Wen)
f = k kappa z,   dz = dx (1 - |z / r|^n) on loading, dx on unloading          (Wen, beta = gamma)

Plays and Dahl's z advance by their exact rules.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from .base import AbstractForceEffect, Instant, Parameter, Surroundings, bounded

_WIDTHS = (0.15, 0.4, 1.0, 2.2)


class PlayHysteresis(AbstractForceEffect):
    """Four stops side by side."""

    name, form, family, port, states = "hysteresis", "plays", "dissipation", "K", 4
    PARAMETERS = (Parameter("kappa", neutral=0.0), Parameter("width", "x", length=1))
    kappa: Float[Array, ""]
    width: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Narrow and wide beside the largest displacement."""
        return [bounded((0.4, share * s.reach), (1e-4, 0.02 * s.reach), (20, 0.8 * s.reach)) for share in (0.08, 0.3)]

    def initial(self, x, age):
        """Relaxed at X."""
        return jnp.full((4,), x)

    def _inside(self, states, x):
        r = self.width * jnp.asarray(_WIDTHS, jnp.result_type(self.width))
        return jnp.clip(states, x - r, x + r)

    def act(self, states, now: Instant, tokens, offset):
        """The stops' mean force."""
        x = now.state[0]
        return tokens, offset + now.coefficients[0] * self.kappa * (x - self._inside(states, x)).mean()

    def advance(self, states, x, after, h):
        """Exact for X monotonic within the step."""
        return self._inside(states, after)


class _Dahl(AbstractForceEffect):
    """One state that saturates at the yield displacement r."""

    name, family, port, states = "hysteresis", "dissipation", "K", 1
    PARAMETERS = (Parameter("kappa", neutral=0.0), Parameter("width", "x", length=1))
    yields: ClassVar[bool]
    kappa: Float[Array, ""]
    width: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Narrow and wide beside the largest displacement."""
        most = 0.9 if cls.yields else 20.0
        return [bounded((0.3, share * s.reach), (1e-4, 0.04 * s.reach), (most, 2 * s.reach)) for share in (0.1, 0.4)]

    def initial(self, x, age):
        """Relaxed at X."""
        return jnp.zeros((1,))

    def act(self, states, now: Instant, tokens, offset):
        """The force half a step on."""
        half = self.advance(states, 0.0, now.h / 2 * now.rates[0] * now.state[1] if len(now.state) > 1 else 0.0, 0.0)
        pull = half[0] - now.state[0] if self.yields else half[0]
        return tokens, offset + now.coefficients[0] * self.kappa * pull

    def advance(self, states, x, after, h):
        """Exact for X monotonic within the step."""
        end = jnp.sign(after - x) * self.width
        return end + (states - end) * jnp.exp(-jnp.abs(after - x) / self.width)


class DahlHysteresis(_Dahl):
    """f = k kappa z."""

    form, yields = "Dahl", False


class BoucWenHysteresis(_Dahl):
    """f = k kappa (z - x): part of the spring yields."""

    form, yields = "Bouc-Wen", True


class WenHysteresis(_Dahl):
    """dz = dx (1 - |z / r|^n) on loading, dz = dx on unloading: between a smooth yield (n < 1) and a stop (n large)."""

    form, yields = "Wen", False
    PARAMETERS = (*_Dahl.PARAMETERS, Parameter("sharpness"))
    sharpness: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Narrow and wide, of the sharpness that is usual."""
        low, high = (1e-4, 0.04 * s.reach, 0.4), (20.0, 3 * s.reach, 8.0)
        return [bounded((0.3, share * s.reach, 1.5), low, high) for share in (0.1, 0.4)]

    def advance(self, states, x, after, h):
        """By the midpoint rule, inside the yield."""

        def slope(z):
            loading = z * (after - x) > 0
            return 1 - loading * (jnp.abs(z) / self.width + 1e-9) ** self.sharpness

        middle = states + (after - x) / 2 * slope(states)
        return jnp.clip(states + (after - x) * slope(middle), -self.width, self.width)

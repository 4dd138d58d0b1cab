"""Forces that take energy.

hysteresis        f = k kappa mean_j (x - p_j),  p_j a play of half width r_j          (Prandtl and Ishlinskii)
                  f = k kappa z  or  k kappa (z - x),   dz = dx (1 - sgn(dx) z / r)    (Dahl; Bouc and Wen)
                  f = k kappa z,   dz = dx (1 - |z / r|^n) on loading, dx on unloading   (Wen, beta = gamma)
coulomb_friction  f = F_c z / g,  dz = dx - |dx| z / g  (bristles: Dahl's hysteresis with a give too small to see)
                  f = F_c sgn(x'),  F_c tanh(x' / v_s),  or with a rise r exp(-(x'/v_s)^2) at low speed (Stribeck)
drag              f = c x' |x'|  or  c x' |x'|^p

Plays and Dahl's z advance by their exact rules. Friction is resolved: f is what brings x' to rest within the step, no
more than F_c (order 2); at other orders it is regularised at a hundredth of the usual speed.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from .base import AbstractForceEffect, Instant, Known, Parameter, Surroundings, bounded, nothing

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


class _Friction(AbstractForceEffect):
    """What stops the motion, up to a level."""

    name, family, port = "coulomb_friction", "dissipation", "C"

    def initial(self, x, age):
        """None."""
        return nothing()

    def advance(self, states, x, after, h):
        """None."""
        return states

    def _force(self, now: Instant, tokens, offset, level):
        n = now.state.shape[0]
        if n == 2:
            rest = tokens[2] * (now.state[1] / (now.h * now.rates[1]) + now.highest(tokens, offset))
            return jnp.clip(rest, -level, level)
        return level * jnp.tanh(100.0 * now.velocity(tokens, offset))


class CoulombFriction(_Friction):
    """f = F_c sgn(x')."""

    form = "Coulomb"
    PARAMETERS = (Parameter("level", "V^2", force=1, neutral=0.0),)
    level: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """A few hundredths of the largest restoring force."""
        force = s.stiffness * s.reach
        return [bounded((share * force,), (1e-4 * force,), (force,)) for share in (0.02, 0.1)]

    def act(self, states, now: Instant, tokens, offset):
        """Stick or slip."""
        return tokens, offset + self._force(now, tokens, offset, self.level)


class SmoothFriction(_Friction):
    """f = F_c tanh(x' / v_s): it creeps under a small force. Solved for the step's end, so v_s may be small."""

    form = "smooth"
    PARAMETERS = (Parameter("level", "V^2", force=1, neutral=0.0), Parameter("speed", "x/s", speed=1))
    level: Float[Array, ""]
    speed: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """A few hundredths of the largest restoring force; sharp and soft beside the usual speed."""
        force = s.stiffness * s.reach
        low, high = (1e-4 * force, 1e-3 * s.speed), (force, 3 * s.speed)
        return [bounded((0.05 * force, share * s.speed), low, high) for share in (0.02, 0.2)]

    def act(self, states, now: Instant, tokens, offset):
        """Two Newton steps from the piecewise linear answer; explicit where x' is known, or at other orders."""
        if now.state.shape[0] != 2 or isinstance(now, Known):
            return tokens, offset + self.level * jnp.tanh(now.velocity(tokens, offset) / self.speed)
        reply = now.h * now.rates[1] / tokens[2]
        free = now.state[1] + now.h * now.rates[1] * now.highest(tokens, offset)
        most, knee = reply * self.level, self.speed + reply * self.level
        v = jnp.where(jnp.abs(free) < knee, free * self.speed / knee, free - jnp.sign(free) * most)
        for _ in range(2):
            t = jnp.tanh(v / self.speed)
            v = v - (v + most * t - free) / (1 + most / self.speed * (1 - t * t))
        return tokens, offset + self.level * jnp.tanh(v / self.speed)


class StribeckFriction(_Friction):
    """f = F_c (1 + r exp(-(x' / v_s)^2)) sgn(x')."""

    form = "Stribeck"
    PARAMETERS = (
        Parameter("level", "V^2", force=1, neutral=0.0),
        Parameter("rise"),
        Parameter("speed", "x/s", speed=1),
    )
    level: Float[Array, ""]
    rise: Float[Array, ""]
    speed: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """A few hundredths of the largest restoring force; the rise within a tenth of the usual speed."""
        force = s.stiffness * s.reach
        low, high = (1e-4 * force, 0.02, 0.01 * s.speed), (force, 3.0, 2 * s.speed)
        return [bounded((0.04 * force, 0.3, 0.1 * s.speed), low, high)]

    def act(self, states, now: Instant, tokens, offset):
        """Stick or slip."""
        speed = now.state[1] / self.speed if len(now.state) > 1 else 0.0
        level = self.level * (1 + self.rise * jnp.exp(-(speed**2)))
        return tokens, offset + self._force(now, tokens, offset, level)


class _Drag(AbstractForceEffect):
    """A force of the velocity alone."""

    name, family, port = "drag", "dissipation", "C"
    c: Float[Array, ""]

    def initial(self, x, age):
        """None."""
        return nothing()

    def advance(self, states, x, after, h):
        """None."""
        return states


class QuadraticDrag(_Drag):
    """f = c x' |x'|."""

    form = "quadratic"
    PARAMETERS = (Parameter("c", "V^2 s^2/x^2", speed=-2, force=1, neutral=0.0),)

    @classmethod
    def starts(cls, s: Surroundings):
        """As much as the linear damping at the usual speed."""
        unit = s.damping / s.speed
        return [bounded((0.5 * unit,), (1e-4 * unit,), (100 * unit,))]

    def act(self, states, now: Instant, tokens, offset):
        """The extra force."""
        speed = now.velocity(tokens, offset)
        return tokens, offset + self.c * speed * jnp.abs(speed)


class PowerDrag(_Drag):
    """f = c x' |x' / v|^p, v the usual speed."""

    form = "power"
    PARAMETERS = (
        Parameter("c", "V^2 s/x", speed=-1, force=1, neutral=0.0),
        Parameter("p"),
        Parameter("usual", "x/s", speed=1),
    )
    p: Float[Array, ""]
    usual: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """As much as the linear damping at the usual speed."""
        low, high = (1e-4 * s.damping, 0.3, s.speed), (100 * s.damping, 3.0, s.speed)
        return [bounded((0.4 * s.damping, p, s.speed), low, high) for p in (0.7, 1.5)]

    def act(self, states, now: Instant, tokens, offset):
        """The extra force."""
        v = now.velocity(tokens, offset)
        return tokens, offset + self.c * v * jnp.exp(self.p * jnp.log(jnp.abs(v / self.usual) + 1e-9))


class BristleFriction(_Friction):
    """f = F_c z / g,  dz = dx - |dx| z / g: bristles give by g before they slide (Dahl 1968)."""

    form, states = "bristles", 1
    PARAMETERS = (Parameter("level", "V^2", force=1, neutral=0.0), Parameter("give", "x", length=1))
    level: Float[Array, ""]
    give: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """A few hundredths of the largest restoring force; a give of a hundredth of the largest displacement."""
        force = s.stiffness * s.reach
        low, high = (1e-4 * force, 1e-3 * s.reach), (force, 0.04 * s.reach)
        return [bounded((0.04 * force, share * s.reach), low, high) for share in (0.005, 0.02)]

    def initial(self, x, age):
        """Relaxed."""
        return jnp.zeros((1,))

    def act(self, states, now: Instant, tokens, offset):
        """The bristles half a step on."""
        ahead = now.h / 2 * now.rates[0] * now.state[1] if len(now.state) > 1 else 0.0 * now.h
        half = self.advance(states, 0.0 * ahead, ahead, 0.0)
        return tokens, offset + self.level * half[0] / self.give

    def advance(self, states, x, after, h):
        """Exact for X monotonic within the step."""
        end = jnp.sign(after - x) * self.give
        return end + (states - end) * jnp.exp(-jnp.abs(after - x) / self.give)

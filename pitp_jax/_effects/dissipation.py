"""Forces that take energy.

coulomb_friction  f = F_c z / g,  dz = dx - |dx| z / g  (bristles: Dahl's hysteresis with a give too small to see)
                  f = F_c sgn(x'),  F_c tanh(x' / v_s),  or with a rise r exp(-(x'/v_s)^2) at low speed (Stribeck)
drag              f = c x' |x'|  or  c x' |x'|^p

Friction is resolved: f is what brings x' to rest within the step, no more than F_c (order 2); at other orders it is
regularised at a hundredth of the usual speed.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .base import AbstractForceEffect, Instant, Known, Parameter, Surroundings, bounded, nothing


def resolved_friction(now: Instant, tokens, offset, level):
    """What stops the motion within the step, up to a level."""
    if now.state.shape[0] == 2:
        rest = tokens[2] * (now.state[1] / (now.h * now.rates[1]) + now.highest(tokens, offset))
        return jnp.clip(rest, -level, level)
    return level * jnp.tanh(100.0 * now.velocity(tokens, offset))


class _Friction(AbstractForceEffect):
    """What stops the motion, up to a level."""

    name, family, port = "coulomb_friction", "dissipation", "C"

    def initial(self, x, age):
        """None."""
        return nothing()

    def advance(self, states, x, after, h):
        """None."""
        return states


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
        return tokens, offset + resolved_friction(now, tokens, offset, self.level)


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
        return tokens, offset + resolved_friction(now, tokens, offset, level)


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

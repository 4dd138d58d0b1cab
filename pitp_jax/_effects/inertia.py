"""Masses the nominal does not have (port M).

added_mass    d a_2 x''
second_mode   f = k kappa (x - z),  z'' = w^2 (x - z) - 2 zeta w z'            a mass carried along by a spring
              f = p a_2 (w^2 (x - z) + 2 zeta w (x' - z') - x'')               or a share of the mass come loose
              y = x + g (z - x)                                                or standing between film and sensor
slack         x'' >= -g, sharp or soft: a load that is only pulled falls freely once the film lets go
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .base import AbstractForceEffect, AbstractSensorEffect, Instant, Parameter, Surroundings, bounded, nothing
from .lags import oscillate


class AddedMass(AbstractForceEffect):
    """A share d more mass."""

    name, form, family, port = "added_mass", "share", "inertia", "M"
    only = True
    PARAMETERS = (Parameter("d", positive=False, neutral=0.0),)
    d: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """More or less; an order-1 nominal has no mass."""
        return [bounded((d,), (-0.8,), (5.0,)) for d in (0.15, -0.15)] if s.inertia > 0 else []

    def initial(self, x, age):
        """None."""
        return nothing()

    def act(self, states, now: Instant, tokens, offset):
        """The coefficient of x'', or of x^(n) below order 2."""
        place = min(2, tokens.shape[0] - 1)
        return tokens.at[place].add(self.d * now.coefficients[place]), offset

    def advance(self, states, x, after, h):
        """None."""
        return states


def _mode_starts(s: Surroundings, strength, *, most=20.0, ratios=(0.6, 1.6, 2.5, 4.5)):
    """Resonances below and above the nominal's, within reach of the sampling; `most`: bound of the strength."""
    high = min(20 * s.omega, 1.5 / s.dt)
    bounds = (1e-4, 0.2 * s.omega, 1e-3), (most, high, 0.4)  # with more damping it is a lag
    return [bounded((strength, min(m * s.omega, 0.9 * high), 0.04), *bounds) for m in ratios]


class Carried(AbstractForceEffect):
    """A mass carried along by a spring, at rest beside X at first."""

    name, family, port, states = "second_mode", "inertia", "M", 2
    omega: eqx.AbstractVar[Array]
    zeta: eqx.AbstractVar[Array]

    def initial(self, x, age):
        """At rest beside X."""
        return jnp.stack([jnp.asarray(x), jnp.zeros_like(x)])

    def apart(self, states, now: Instant):
        """The spring's length, half a step on."""
        return now.state[0] - states[0] - now.h / 2 * states[1]

    def advance(self, states, x, after, h):
        """By the mean displacement of the step."""
        return oscillate(states, (x + after) / 2, self.omega, self.zeta, h)


class AttachedMode(Carried):
    """One more mass on a spring."""

    form = "attached"
    PARAMETERS = (Parameter("kappa", neutral=0.0), Parameter("omega", "rad/s"), Parameter("zeta"))
    kappa: Float[Array, ""]
    omega: Float[Array, ""]
    zeta: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Over the band."""
        return _mode_starts(s, 0.2)

    def act(self, states, now: Instant, tokens, offset):
        """The spring's pull."""
        return tokens, offset + now.coefficients[0] * self.kappa * self.apart(states, now)


class LoosenedMode(Carried):
    """A share p of the mass that has come loose and hangs on a spring."""

    form = "come loose"
    PARAMETERS = (Parameter("p", neutral=0.0), Parameter("omega", "rad/s"), Parameter("zeta"))
    p: Float[Array, ""]
    omega: Float[Array, ""]
    zeta: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Over the band; an order-1 nominal has no mass."""
        return _mode_starts(s, 0.1, most=0.9, ratios=(1.2, 1.6, 2.5, 4.5)) if s.inertia > 0 else []

    def act(self, states, now: Instant, tokens, offset):
        """Its pull on the rest of the mass."""
        if now.state.shape[0] < 2:
            return tokens, offset
        mass = self.p * now.coefficients[2]
        slip = now.rates[0] * now.state[1] - states[1]
        pull = self.omega**2 * self.apart(states, now) + 2 * self.zeta * self.omega * slip
        return tokens.at[2].add(-mass), offset + mass / (now.rates[0] * now.rates[1]) * pull


class MountedMode(AbstractSensorEffect):
    """A mass between film and sensor."""

    name, form, family, port, states = "second_mode", "between film and sensor", "inertia", "OUT", 2
    PARAMETERS = (Parameter("gain", neutral=0.0), Parameter("omega", "rad/s"), Parameter("zeta"))
    gain: Float[Array, ""]
    omega: Float[Array, ""]
    zeta: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Over the band."""
        return _mode_starts(s, 0.3)

    def initial(self, x):
        """At rest on X."""
        return jnp.stack([jnp.asarray(x), jnp.zeros_like(x)])

    def advance(self, states, x, after, h):
        """By the mean displacement of the step."""
        return oscillate(states, (x + after) / 2, self.omega, self.zeta, h)

    def reading(self, states, x):
        """A share g of the relative motion is seen."""
        return x + self.gain * (states[0] - x)

    def undo(self, y, dt):
        """Not known: left to the shooting on the rollout."""
        return y


class Slack(AbstractForceEffect):
    """No acceleration below -g (order 2); `inverse` is 1 / g."""

    name, family, port = "slack", "stiffness", "M"
    PARAMETERS = (Parameter("inverse", "s^2/x", acceleration=-1, neutral=0.0, linear=False),)
    sign: ClassVar[float]
    inverse: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Within the accelerations reached."""
        if s.inertia <= 0 or s.acceleration <= 0:
            return []
        unit = 1 / s.acceleration
        return [bounded((share * unit,), (0.7 * unit,), (50 * unit,)) for share in (1.3, 2.5)]

    def initial(self, x, age):
        """None."""
        return nothing()

    def act(self, states, now: Instant, tokens, offset):
        """As much push as is missing."""
        if now.state.shape[0] != 2:
            return tokens, offset
        free = self.sign * now.highest(tokens, offset)
        missing = jnp.maximum(-1 / jnp.maximum(self.inverse, 1e-30) - free, 0.0)
        return tokens, offset - self.sign * tokens[2] * missing

    def advance(self, states, x, after, h):
        """None."""
        return states


class LoadSlack(Slack):
    """The load falls."""

    form, sign = "free fall", 1.0


class HangingSlack(Slack):
    """The load falls in the direction of motion."""

    form, sign = "free fall, hanging", -1.0


class SoftSlack(AbstractForceEffect):
    """x'' = -g + w log(1 + exp((a + g) / w)), a what it would be without, w the softness times g; the load falls."""

    name, form, family, port = "slack", "free fall, soft", "stiffness", "M"
    PARAMETERS = (
        Parameter("inverse", "s^2/x", acceleration=-1, neutral=0.0, linear=False),
        Parameter("softness", "1"),
    )
    inverse: Float[Array, ""]
    softness: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Within the accelerations reached, a tenth of g soft."""
        if s.inertia <= 0 or s.acceleration <= 0:
            return []
        unit = 1 / s.acceleration
        return [bounded((share * unit, 0.1), (0.7 * unit, 0.01), (50 * unit, 1.0)) for share in (1.3, 3.0)]

    def initial(self, x, age):
        """None."""
        return nothing()

    def act(self, states, now: Instant, tokens, offset):
        """As much push as is missing."""
        if now.state.shape[0] != 2:
            return tokens, offset
        g = 1 / jnp.maximum(self.inverse, 1e-12)
        width = self.softness * g
        missing = width * jax.nn.softplus(-(now.highest(tokens, offset) + g) / width)
        return tokens, offset - tokens[2] * missing * (self.inverse > 0)

    def advance(self, states, x, after, h):
        """None."""
        return states

"""What the amplifier does before the square (port IN): u to V.

voltage_clip    V = min(max(u, -u_max), u_max), hard or rounded     voltage_offset  V = u + V_0
slew_limit      |V'| <= s, as V' = (u - V) / tau                    delay           V(t) = u(t - T)
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._model.drive import slope
from .._numerics.linear_recurrence import lag_after
from .base import AbstractDriveEffect, AbstractEffect, Parameter, Surroundings, bounded, nothing


class _Static(AbstractDriveEffect):
    """No states."""

    family, port = "drive", "IN"

    def initial(self, voltage):
        """None."""
        return nothing()

    def advance(self, states, before, after, h):
        """None."""
        return states


class VoltageClip(_Static):
    """V = u up to u_max; `inverse` is 1 / u_max, so that zero is no clip."""

    name, form = "voltage_clip", "hard"
    PARAMETERS = (Parameter("inverse", "1/V", neutral=0.0, linear=False),)
    inverse: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """A little below the largest voltage."""
        low, high = 1.0 / s.voltage, 4.0 / s.voltage
        return [bounded((share / s.voltage,), (low,), (high,)) for share in (1.08, 1.3)]

    def film(self, states, voltage):
        """The cut voltage."""
        top = 1.0 / jnp.maximum(self.inverse, 1e-30)
        return jnp.clip(voltage, -top, top)

    def undo(self, film, dt):
        """Below the limit u is V."""
        return film

    def passes(self, film, dt):
        """Up to u_max."""
        return jnp.abs(film) * self.inverse <= 1.0


class RoundedClip(_Static):
    """V = u / (1 + (|u| / u_max)^8)^(1/8)."""

    name, form = "voltage_clip", "rounded"
    PARAMETERS = VoltageClip.PARAMETERS
    inverse: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """A little below the largest voltage."""
        return [bounded((1.1 / s.voltage,), (0.8 / s.voltage,), (4.0 / s.voltage,))]

    def film(self, states, voltage):
        """The rounded voltage."""
        return voltage * (1 + (self.inverse * voltage) ** 8) ** (-1 / 8)

    def undo(self, film, dt):
        """In closed form, as far as 99 % of u_max."""
        r = jnp.clip(jnp.abs(self.inverse * film), 0.0, 0.99)
        return film * (1 - r**8) ** (-1 / 8)

    def passes(self, film, dt):
        """Up to u_max."""
        return jnp.abs(film) * self.inverse <= 0.99


class VoltageOffset(_Static):
    """V = u + V_0."""

    name, form = "voltage_offset", "constant"
    only = True
    PARAMETERS = (Parameter("offset", "V", positive=False, neutral=0.0),)
    offset: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Either sign."""
        return [bounded((sign * 0.03 * s.voltage,), (-0.5 * s.voltage,), (0.5 * s.voltage,)) for sign in (1, -1)]

    def film(self, states, voltage):
        """The shifted voltage."""
        return voltage + self.offset

    def undo(self, film, dt):
        """By algebra."""
        return film - self.offset

    def passes(self, film, dt):
        """Always."""
        return jnp.ones(film.shape, bool)


class _Slewing(AbstractDriveEffect):
    """|V'| <= 1 / `inverse`, zero being no limit."""

    name, family, port, states = "slew_limit", "drive", "IN", 1
    inverse: eqx.AbstractVar[Array]

    @staticmethod
    def limits(s: Surroundings) -> list[tuple[float, float, float]]:
        """(start, low, high): below the fastest slew of the drive (steps aside), down to a slow amplifier."""
        fast = min(s.slew, 2 * s.omega * s.voltage)
        return [(1 / (share * fast), 0.5 / s.slew, 200 / fast) for share in (0.6, 0.25, 0.1)]

    def initial(self, voltage):
        """Settled at the voltage before the record."""
        return jnp.reshape(voltage, (1,))

    def towards(self, states, goal, h):
        """As far as the amplifier gets in h."""
        most = h / jnp.maximum(self.inverse, 1e-30)
        return states + jnp.clip(goal - states, -most, most)

    def film(self, states, voltage):
        """The limited voltage."""
        return jnp.where(self.inverse > 0, states[0], voltage)

    def passes(self, film, dt):
        """As fast as the amplifier gets."""
        return jnp.abs(slope(film, dt)) * self.inverse <= 1.0


class SlewLimit(_Slewing):
    """V follows u as fast as it may."""

    form = "rate limit"
    PARAMETERS = (Parameter("inverse", "s/V", neutral=0.0, linear=False),)
    inverse: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Three limits."""
        return [bounded(*zip(limit, strict=True)) for limit in cls.limits(s)]

    def advance(self, states, before, after, h):
        """Towards u."""
        return self.towards(states, after, h)

    def undo(self, film, dt):
        """Below the limit u is V."""
        return film


class SlewingLag(_Slewing):
    """V' = (u - V) / tau as far as it may: an amplifier that nears its limit gradually."""

    form = "rate limit and lag"
    PARAMETERS = (Parameter("inverse", "s/V", neutral=0.0, linear=False), Parameter("tau", "s"))
    inverse: Float[Array, ""]
    tau: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Three limits, behind a lag that alone would hardly be seen."""
        lag = 0.1 / s.omega, 0.3 * s.dt, 2.0 / s.omega
        return [bounded(*zip(limit, lag, strict=True)) for limit in cls.limits(s)]

    def advance(self, states, before, after, h):
        """Along the lag."""
        return self.towards(states, lag_after(states, before, after, self.tau, h), h)

    def undo(self, film, dt):
        """U = V + tau V' below the limit."""
        return film + jnp.where(self.inverse > 0, self.tau * slope(film, dt), 0.0)


class Delay(AbstractEffect):
    """V(t) = u(t - T): a shift of the whole record, so it is no step but a map of the array."""

    name, form, family, port = "delay", "pure", "drive", "IN"
    only = True
    PARAMETERS = (Parameter("time", "s", neutral=0.0, linear=False),)
    time: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """A part of a sample to a period of the resonance: behind a bus or a filter it may be that late."""
        low, high = 0.02 * s.dt, max(6.0 / s.omega, 4 * s.dt)
        return [bounded((share / s.omega,), (low,), (high,)) for share in (0.1, 0.4, 1.5)]

    def shifted(self, voltage: Float[Array, " time"], dt, before):
        """U a time T earlier, linear between samples; `before` the first one."""
        at = jnp.arange(voltage.shape[0]) - self.time / dt
        index = jnp.floor(at)
        share = (at - index).astype(voltage.dtype)
        index = index.astype(int)
        padded = jnp.concatenate([jnp.reshape(before, (1,)), voltage])
        left, right = (padded[jnp.clip(index + k, 0, voltage.shape[0])] for k in (1, 2))
        return left + share * (right - left)

    def ahead(self, film: Float[Array, " time"], dt) -> Float[Array, " time"]:
        """V a time T later: what must be played now. The last T repeats the last value."""
        place = jnp.arange(film.shape[0], dtype=film.dtype)
        return jnp.interp(place + self.time / dt, place, film)

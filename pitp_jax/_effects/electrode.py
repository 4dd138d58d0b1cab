"""What the electrodes and the film do before the square (port IN): u to the film's V.

electrode_rc        tau V' = u - V, once or three times in a row
charge_leak         V = u - kappa q,  q' = (u - q) / tau
charge_retention    V = u + q,        q' = (k |u| - q) / tau        what stays when the drive is gone

u runs linearly between samples, and lags are exact for it. A record that rests starts uncharged.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._numerics.linear_recurrence import first_order_lags, lag_after
from .base import AbstractDriveEffect, Parameter, Surroundings, bounded
from .lags import lag_starts, lags_in_a_row, lead


class _Lag(AbstractDriveEffect):
    """Lags in a row."""

    name, family, port = "electrode_rc", "drive", "IN"
    PARAMETERS = (Parameter("tau", "s", neutral=0.0, linear=False),)
    sections: ClassVar[tuple[float, ...]]
    tau: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Around and below the time scale of the resonance."""
        return lag_starts(s)

    @property
    def _taus(self):
        return [share * self.tau for share in self.sections]

    def initial(self, voltage):
        """Settled at the voltage before the record."""
        return jnp.full((len(self.sections),), voltage)

    def advance(self, states, before, after, h):
        """Exact for the first lag; its output is taken as linear for the next."""
        return lags_in_a_row(states, before, after, self._taus, h)

    def film(self, states, voltage):
        """The last lag's output."""
        return jnp.where(self.tau > 0, states[-1], voltage)

    def undo(self, film, dt):
        """By lead, lag by lag."""
        return lead(film, self._taus, dt)

    def passes(self, film, dt):
        """Always."""
        return jnp.ones(film.shape, bool)


class ElectrodeRC(_Lag):
    """Sheet resistance and film capacitance, lumped."""

    form, states, sections = "one lag", 1, (1.0,)


class ElectrodeLadder(_Lag):
    """A resistive electrode charges from its edge inwards: three lags of a diffusion line."""

    form, states, sections = "ladder", 3, (0.8, 0.15, 0.05)


class ChargeLeak(AbstractDriveEffect):
    """V = u - kappa q: charge creeps into traps and screens the field."""

    name, form, family, port, states = "charge_leak", "one trap", "drive", "IN", 1
    PARAMETERS = (Parameter("kappa", neutral=0.0), Parameter("tau", "s"))
    kappa: Float[Array, ""]
    tau: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Slower than the resonance, down to the longest record."""
        low, high = 1.0 / s.omega, 3 * s.duration
        return [
            bounded((0.15, tau), (1e-4, low), (0.9, high))
            for tau in np.geomspace(max(8 / s.omega, s.duration / 100), s.duration / 3, 3)
        ]

    def initial(self, voltage):
        """Settled at the voltage before the record."""
        return jnp.reshape(voltage, (1,))

    def advance(self, states, before, after, h):
        """Exact for u linear."""
        return lag_after(states, before, after, self.tau, h)

    def film(self, states, voltage):
        """What the traps leave."""
        return voltage - self.kappa * states[0]

    def undo(self, film, dt):
        """U = V + kappa q with q' = (V - (1 - kappa) q) / tau: the trap's own lag, slower by 1 / (1 - kappa)."""
        tau = self.tau / (1 - self.kappa)
        level = first_order_lags(film / (1 - self.kappa), tau[None], dt, jnp.zeros((1,), film.dtype))[:, 0]
        return film + self.kappa * level

    def passes(self, film, dt):
        """Always."""
        return jnp.ones(film.shape, bool)


class ChargeRetention(AbstractDriveEffect):
    """V = u + q, q' = (k |u| - q) / tau: charge stays in the film after the drive is gone."""

    name, form, family, port, states = "charge_retention", "one store", "drive", "IN", 1
    PARAMETERS = (Parameter("k", neutral=0.0), Parameter("tau", "s"))
    k: Float[Array, ""]
    tau: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """The time constants of a charge leak."""
        return [bounded((0.1, start.values[1]), start.low, (3.0, start.high[1])) for start in ChargeLeak.starts(s)]

    def initial(self, voltage):
        """Settled at the voltage before the record."""
        return jnp.reshape(self.k * jnp.abs(voltage), (1,))

    def advance(self, states, before, after, h):
        """Exact for u linear and of one sign."""
        return lag_after(states, self.k * jnp.abs(before), self.k * jnp.abs(after), self.tau, h)

    def film(self, states, voltage):
        """With what is stored."""
        return voltage + states[0]

    def stored(self, q, drive, film, dt):
        """The charge a sample on, where the film goes to `film`: q + c k |u| with u = V - q, solved for either sign."""
        open_ = film - lag_after(q, self.k * jnp.abs(drive), 0.0, self.tau, dt)
        gain = self.k * lag_after(0.0, 0.0, 1.0, self.tau, dt)
        return film - open_ / jnp.where(open_ > 0, 1 + gain, 1 - gain)

    def undo(self, film, dt):
        """U = V - q along the sampled V, uncharged at first."""

        def sample(before, now):
            q = self.stored(before[0], before[1], now, dt)
            return (q, now - q), now - q

        start = (jnp.zeros_like(film[0]), film[0])
        return jnp.append(film[0], jax.lax.scan(sample, start, film[1:])[1])

    def passes(self, film, dt):
        """Always."""
        return jnp.ones(film.shape, bool)

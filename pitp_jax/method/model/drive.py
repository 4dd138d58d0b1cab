"""Drives: the dynamics between the amplifier's voltage u and the voltage V across the film, before the square.

direct        V = u
electrode     tau V' = u - V          u linear between samples; V = 0 at rest, settled where a record starts moving

An electrode's sheet resistance charges the film's capacitance through a lag. It acts before the square, so no lag of
the force or of the sensor replaces it (its benefit: docs/decisions/parts.md).
"""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..numerics.linear_recurrence import first_order_lags, lag_after, lag_weights, scalar_recurrence


class AbstractDrive(eqx.Module):
    """A causal, invertible map from the amplifier's voltage u to the film's voltage V."""

    @abstractmethod
    def film(self, voltage: Float[Array, " time"], dt: float, rest: Bool[Array, ""]) -> Float[Array, " time"]:
        """Compute the film voltage V for a sampled voltage u; `rest`: whether the record starts at rest, uncharged."""

    @abstractmethod
    def after(self, film: Float[Array, ""], before: Float[Array, ""], now: Float[Array, ""], dt: float) -> Array:
        """Compute the film voltage V one sample later, for u linear from `before` to `now`."""

    @abstractmethod
    def lead(self, film: Float[Array, " time"], dt: float) -> Float[Array, " time"]:
        """Compute the amplifier's voltage u that gives a smooth film voltage V, by the continuous equation."""

    @abstractmethod
    def undo(self, film: Float[Array, " time"], dt: float, first: Float[Array, ""]) -> Float[Array, " time"]:
        """Compute the amplifier's voltage u whose `film` is exactly V, sample by sample, given u(0)."""


class DirectDrive(AbstractDrive):
    """An ideal amplifier and perfect electrodes: the film voltage V equals the amplifier's voltage u."""

    def film(self, voltage, dt, rest):
        """Return the film voltage, which equals the amplifier's `voltage` u (V), shape (time,)."""
        return voltage

    def after(self, film, before, now, dt):
        """Return the film voltage one sample later (V): the amplifier's voltage `now`."""
        return now

    def lead(self, film, dt):
        """Return the amplifier's voltage, which equals the `film` voltage V (V), shape (time,)."""
        return film

    def undo(self, film, dt, first):
        """Return the amplifier's voltage, which equals the `film` voltage V (V), shape (time,); `first` is not used."""
        return film


class ElectrodeLag(AbstractDrive):
    """A first-order lag from u to V with the time constant `exp(log_tau)` (s), learned with the encoder."""

    log_tau: Float[Array, ""]

    def film(self, voltage, dt, rest):
        """Compute the film voltage V behind the lag (V), shape (time,), exactly for u linear between samples."""
        # a record cut from a longer one shows no charging: the film already has the input voltage
        start = jnp.where(rest, 0.0, voltage[0])
        return first_order_lags(voltage, jnp.exp(self.log_tau)[None], dt, start[None])[:, 0]

    def after(self, film, before, now, dt):
        """Compute the film voltage V one sample later (V), exactly for u linear from `before` to `now`."""
        return lag_after(film, before, now, jnp.exp(self.log_tau), dt)

    def lead(self, film, dt):
        """Compute the amplifier's voltage u = V + tau V' (V), shape (time,), with the derivative V' by `slope`."""
        return film + jnp.exp(self.log_tau) * slope(film, dt)

    def undo(self, film, dt, first):
        """Compute the amplifier's voltage u (V), shape (time,), exactly: the inverse of `film`, sample by sample.

            u_{t+1} = (V_{t+1} - q V_t - (1 - q - c) u_t) / c,    u_0 = `first`
            q = exp(-dt / tau),    c = 1 - (1 - q) tau / dt

        An error of `first` alternates in sign and decays by dt / (3 tau) a sample.
        """
        # 1 - q, and c: the part of u_{t+1} that reaches V_{t+1}
        settle, rise = (w.astype(film.dtype) for w in lag_weights(jnp.exp(self.log_tau), dt))
        drive = (film[1:] - (1 - settle) * film[:-1]) / rise
        keep = -(settle - rise) / rise  # between -1 and 0: the inverse is stable for any tau
        return scalar_recurrence(keep, drive, first)


def slope(values: Float[Array, " time"], dt: float) -> Float[Array, " time"]:
    """Compute the derivative by central differences of 4th order (2nd next to the ends, one-sided 1st at the ends)."""
    inner = (8 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) / (12 * dt)
    return jnp.asarray(jnp.gradient(values, dt)).at[2:-2].set(inner)

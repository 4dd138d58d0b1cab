"""Memories: features for the tokens beside the current state S.

    none        m = ()
    elapsed     m = t / T                       seconds since the excitation began (paper, eq. 4)
    fading      z_k' = (x - z_k) / tau_k        m_k = z_k: known for any wanted x, so the inverse stays closed-form
    ringing     r'' = w^2 (x - r) - 2 zeta w r' m = r, r'/w, then the fading ones: a mass attached to the moved one

All memories are linear in x, so a decoder step with frozen tokens stays affine in the force. Raw time cannot
extrapolate past the longest training record; fading memories can.
"""

from abc import abstractmethod
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._numerics.linear_recurrence import first_order_lags, oscillator
from .constants import Constants, number
from .rows import Rows


class AbstractMemory(eqx.Module):
    """Additional states that depend on the displacement x alone, in the model's scaled coordinates."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Return the number of memory states K."""

    @abstractmethod
    def initial(self, x: Float[Array, ""]) -> Float[Array, " memory"]:
        """Compute the memory of an actuator settled at x (at rest: x = 0), shape (K,)."""

    @abstractmethod
    def rate(self) -> Callable[[Rows, Array], list[Array]]:
        """Return fn(memory, x): its time derivatives in 1/s, row by row; constant parts are computed here once."""

    @abstractmethod
    def trajectory(
        self, x: Float[Array, " time"], dt: float, start: Float[Array, " memory"]
    ) -> Float[Array, "time memory"]:
        """Compute the memory along a known x, linear between samples, in one parallel pass, shape (time, K)."""


class NoMemory(AbstractMemory):
    """No memory: tokens depend on the state only."""

    @property
    def size(self):
        """Return 0, the number of memory states."""
        return 0

    def initial(self, x):
        """Return an empty vector."""
        return jnp.zeros((0,), jnp.result_type(x))

    def rate(self):
        """Return the function that returns no rows."""
        return lambda memory, x: []

    def trajectory(self, x, dt, start):
        """Return rows without columns, shape (time, 0)."""
        return jnp.zeros((x.shape[0], 0), x.dtype)


class ElapsedTime(AbstractMemory, Constants):
    """Time since the excitation started over `horizon` (s): the paper's time input (eq. 4)."""

    horizon: float = eqx.field(converter=number)

    @property
    def size(self):
        """Return 1: the only memory state is the time."""
        return 1

    def initial(self, x):
        """Return zero, the time of the record's first sample."""
        return jnp.zeros((1,), jnp.result_type(x))

    def rate(self):
        """Return the function with the value 1 / T, T the horizon."""
        return lambda memory, x: [jnp.full_like(x, 1.0 / jnp.asarray(self.horizon, x.dtype))]

    def trajectory(self, x, dt, start):
        """Compute t / T, T the horizon."""
        return (start + jnp.arange(x.shape[0], dtype=x.dtype)[:, None] * dt / self.horizon).astype(x.dtype)


class FadingMemory(AbstractMemory):
    """A bank of first-order lags of x with time constants `exp(log_tau)` in s."""

    log_tau: Float[Array, " memory"]

    @property
    def size(self):
        """Return K, the number of time constants."""
        return self.log_tau.shape[0]

    def initial(self, x):
        """Return x for every lag, because all have settled."""
        return jnp.full((self.size,), 1.0, jnp.result_type(x)) * x

    def rate(self):
        """Return the function (x - z_k) / tau_k."""
        pace = jnp.exp(-self.log_tau)  # computed outside the function: once for a rollout, not at every step
        return lambda memory, x: [(x - z) * pace[k] for k, z in enumerate(memory)]

    def trajectory(self, x, dt, start):
        """Solve the lags exactly for x linear between samples."""
        return first_order_lags(x, jnp.exp(self.log_tau), dt, start)


class RingingMemory(AbstractMemory):
    """A second mass on a spring, and a bank of lags: eigenfrequency `exp(log_omega)` (rad/s), damping ratio zeta.

    Its force kappa (r - x) is linear in the memory and in x, so the offset token contains it. A mode within the band
    also acts well below its frequency; without this memory the other parameters would imitate it
    (docs/decisions/second_resonance.md).
    """

    log_omega: Float[Array, ""]
    log_zeta: Float[Array, ""]
    log_tau: Float[Array, " lags"]

    @property
    def size(self):
        """Return 2 for the mass plus the number of time constants."""
        return 2 + self.log_tau.shape[0]

    @property
    def ring(self) -> tuple[Array, Array]:
        """Return eigenfrequency (rad/s) and damping ratio of the second mass."""
        # an overdamped mass would be two more lags, and the closed form's sqrt(1 - zeta^2) would be nan
        return jnp.exp(self.log_omega), jnp.minimum(jnp.exp(self.log_zeta), 0.99)

    def initial(self, x):
        """Return the mass at rest at x, with every lag settled."""
        return jnp.full((self.size,), 1.0, jnp.result_type(x)).at[1].set(0.0) * x

    def rate(self):
        """Return the function (w v, w (x - r - 2 zeta v)) with v = r' / w, then (x - z_k) / tau_k."""
        # v = r' / w, so that position and speed have similar size and float32 resolves both
        (omega, zeta), lags = self.ring, FadingMemory(self.log_tau).rate()

        def rates(memory: Rows, x: Array) -> list[Array]:
            # the mass first, then the lags, as in `trajectory`
            place, speed, *others = memory
            return [omega * speed, omega * (x - place - 2 * zeta * speed), *lags(others, x)]

        return rates

    def trajectory(self, x, dt, start):
        """Solve mass and lags exactly for x linear between samples."""
        lags = first_order_lags(x, jnp.exp(self.log_tau), dt, start[2:])
        return jnp.concatenate([oscillator(x, *self.ring, dt, start[:2]), lags], -1)

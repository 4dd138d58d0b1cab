"""Memories: features that summarise the past of the displacement, in addition to the current state S.

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

from ..numerics.linear_recurrence import first_order_lags, oscillator
from .constants import Constants, number
from .rows import Rows


class AbstractMemory(eqx.Module):
    """Additional states that depend on the past of the displacement x alone, in the model's scaled coordinates."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Return the number of memory states K."""

    @abstractmethod
    def initial(self, x: Float[Array, ""]) -> Float[Array, " memory"]:
        """Compute the memory states after a long constant displacement x (at rest: x = 0), shape (K,)."""

    @abstractmethod
    def rate(self) -> Callable[[Rows, Array], list[Array]]:
        """Return a function of (memory, x) for the time derivatives of the memory states (1/s), one array each."""

    @abstractmethod
    def trajectory(
        self, x: Float[Array, " time"], dt: float, start: Float[Array, " memory"]
    ) -> Float[Array, "time memory"]:
        """Compute the memory states along a known x, linear between samples, in one parallel pass, shape (time, K)."""


class NoMemory(AbstractMemory):
    """No memory: the coefficients depend on the current state only."""

    @property
    def size(self):
        """Return 0, the number of memory states."""
        return 0

    def initial(self, x):
        """Return an empty vector, shape (0,), because there are no memory states."""
        return jnp.zeros((0,), jnp.result_type(x))

    def rate(self):
        """Return a function that gives an empty list, because there are no memory states."""
        return lambda memory, x: []

    def trajectory(self, x, dt, start):
        """Return an array without columns, shape (time, 0)."""
        return jnp.zeros((x.shape[0], 0), x.dtype)


class ElapsedTime(AbstractMemory, Constants):
    """The time since the excitation started, divided by `horizon` (s): the paper's time input (eq. 4).

    `horizon`: longest recording of the training, s, so that the encoder sees 0 to 1.
    """

    horizon: float = eqx.field(converter=number)

    @property
    def size(self):
        """Return 1: the only memory state is the time."""
        return 1

    def initial(self, x):
        """Return zero, the time of the record's first sample, shape (1,)."""
        return jnp.zeros((1,), jnp.result_type(x))

    def rate(self):
        """Return a function with the constant value 1 / T, where T is the horizon (s)."""
        return lambda memory, x: [jnp.full_like(x, 1.0 / jnp.asarray(self.horizon, x.dtype))]

    def trajectory(self, x, dt, start):
        """Compute t / T at every sample, where T is the horizon (s), shape (time, 1)."""
        return (start + jnp.arange(x.shape[0], dtype=x.dtype)[:, None] * dt / self.horizon).astype(x.dtype)


class FadingMemory(AbstractMemory):
    """First-order lags of x with the time constants `exp(log_tau)` (s)."""

    log_tau: Float[Array, " memory"]

    @property
    def size(self):
        """Return K, the number of time constants and memory states."""
        return self.log_tau.shape[0]

    def initial(self, x):
        """Return x for every lag: the values after a long constant displacement x, shape (K,)."""
        return jnp.full((self.size,), 1.0, jnp.result_type(x)) * x

    def rate(self):
        """Return a function of (memory, x) for the derivatives (x - z_k) / tau_k of the lags z_k, 1/s."""
        pace = jnp.exp(-self.log_tau)  # computed outside the function: once for a rollout, not at every step
        return lambda memory, x: [(x - z) * pace[k] for k, z in enumerate(memory)]

    def trajectory(self, x, dt, start):
        """Compute the lags along x, exactly for x linear between samples, shape (time, K)."""
        return first_order_lags(x, jnp.exp(self.log_tau), dt, start)


class RingingMemory(AbstractMemory):
    """A second mass on a spring (`exp(log_omega)` in rad/s, damping ratio zeta), and first-order lags of x.

    Its force kappa (r - x) is linear in the memory and in x, so the offset token contains it. A mode within the band
    also acts well below its frequency; without this memory the other parameters would imitate it
    (docs/decisions/second_resonance.md).
    """

    log_omega: Float[Array, ""]
    log_zeta: Float[Array, ""]
    log_tau: Float[Array, " lags"]

    @property
    def size(self):
        """Return the number of memory states: 2 for the second mass, and one per time constant."""
        return 2 + self.log_tau.shape[0]

    @property
    def ring(self) -> tuple[Array, Array]:
        """Return the eigenfrequency (rad/s) and the damping ratio (below 1) of the second mass."""
        # an overdamped mass would be two more lags, and the closed form's sqrt(1 - zeta^2) would be nan
        return jnp.exp(self.log_omega), jnp.minimum(jnp.exp(self.log_zeta), 0.99)

    def initial(self, x):
        """Return the states after a long constant x: the second mass rests at x, every lag equals x, shape (K,)."""
        return jnp.full((self.size,), 1.0, jnp.result_type(x)).at[1].set(0.0) * x

    def rate(self):
        """Return a function of (memory, x) for the derivatives (1/s) of r, v = r' / w and the lags z_k.

        They are w v, w (x - r - 2 zeta v) and (x - z_k) / tau_k.
        """
        # v = r' / w, so that position and speed have similar size and float32 resolves both
        (omega, zeta), lags = self.ring, FadingMemory(self.log_tau).rate()

        def rates(memory: Rows, x: Array) -> list[Array]:
            # the mass first, then the lags, as in `trajectory`
            place, speed, *others = memory
            return [omega * speed, omega * (x - place - 2 * zeta * speed), *lags(others, x)]

        return rates

    def trajectory(self, x, dt, start):
        """Compute mass and lags along x, exactly for x linear between samples, shape (time, K)."""
        lags = first_order_lags(x, jnp.exp(self.log_tau), dt, start[2:])
        return jnp.concatenate([oscillator(x, *self.ring, dt, start[:2]), lags], -1)

"""Memories: what a token may know besides the current state S.

    none        m = ()
    elapsed     m = t / T                       seconds since the excitation began (paper, eq. 4)
    fading      z_k' = (x - z_k) / tau_k        m_k = z_k: known for any wanted x, so the inverse stays closed-form

All memories are linear in x, so a decoder step with frozen tokens stays affine in the force. Raw time cannot
extrapolate past the longest training record; fading memories can (50 s record, 10 s training: 0.5 % against 6 %).
"""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._recurrence import first_order_lags


class AbstractMemory(eqx.Module):
    """States beside S that follow x alone; `x` is in the model's scaled coordinates throughout."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of memory states K."""

    @abstractmethod
    def initial(self, x: Float[Array, ""]) -> Float[Array, " memory"]:
        """The memory of an actuator that has been held at x for ever (at rest: x = 0)."""

    @abstractmethod
    def rate(self, memory: Float[Array, " memory"], x: Float[Array, ""]) -> Float[Array, " memory"]:
        """Time derivative of the memory in 1/s."""

    @abstractmethod
    def trajectory(
        self, x: Float[Array, " time"], dt: float, start: Float[Array, " memory"]
    ) -> Float[Array, "time memory"]:
        """The memory along a known x, linear between samples, in one parallel pass."""


class NoMemory(AbstractMemory):
    """Tokens see the state only."""

    @property
    def size(self):
        """Zero."""
        return 0

    def initial(self, x):
        """Nothing."""
        return jnp.zeros((0,), jnp.result_type(x))

    def rate(self, memory, x):
        """Nothing."""
        return jnp.zeros((0,), jnp.result_type(x))

    def trajectory(self, x, dt, start):
        """Nothing."""
        return jnp.zeros((x.shape[0], 0), x.dtype)


class ElapsedTime(AbstractMemory):
    """Seconds since the excitation began over `horizon` (s): the paper's time input (eq. 4)."""

    horizon: float = eqx.field(static=True)

    @property
    def size(self):
        """One."""
        return 1

    def initial(self, x):
        """Zero at the record's first sample."""
        return jnp.zeros((1,), jnp.result_type(x))

    def rate(self, memory, x):
        """1/T."""
        return jnp.full((1,), 1.0 / self.horizon, jnp.result_type(x))

    def trajectory(self, x, dt, start):
        """T/T."""
        return (start + jnp.arange(x.shape[0], dtype=x.dtype)[:, None] * dt / self.horizon).astype(x.dtype)


class FadingMemory(AbstractMemory):
    """A bank of first-order lags of x with time constants `exp(log_tau)` in s."""

    log_tau: Float[Array, " memory"]

    @property
    def size(self):
        """K, the number of time constants."""
        return self.log_tau.shape[0]

    def initial(self, x):
        """Every lag has settled at x."""
        return jnp.full((self.size,), 1.0, jnp.result_type(x)) * x

    def rate(self, memory, x):
        """(x - z) / tau."""
        return (x - memory) * jnp.exp(-self.log_tau)

    def trajectory(self, x, dt, start):
        """Exact for x linear between samples."""
        return first_order_lags(x, jnp.exp(self.log_tau), dt, start)

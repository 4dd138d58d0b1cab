"""Memories: what a token may know besides the current state S.

    none        m = ()
    elapsed     m = t / T                       seconds since the excitation began (paper, eq. 4)
    fading      z_k' = (x - z_k) / tau_k        m_k = z_k: known for any wanted x, so the inverse stays closed-form
    ringing     r'' = w^2 (x - r) - 2 zeta w r' m = r, r'/w, then the fading ones: a mass that hangs on the moved one

All memories are linear in x, so a decoder step with frozen tokens stays affine in the force. Raw time cannot
extrapolate past the longest training record; fading memories can (50 s record, 10 s training: 0.5 % against 6 %).
"""

from abc import abstractmethod
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._numerics.linear_recurrence import first_order_lags, oscillator
from .rows import Rows


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
    def rate(self) -> Callable[[Rows, Array], list[Array]]:
        """fn(memory, x): its time derivatives in 1/s, row by row; what is constant is computed here, once."""

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

    def rate(self):
        """Nothing."""
        return lambda memory, x: []

    def trajectory(self, x, dt, start):
        """Nothing."""
        return jnp.zeros((x.shape[0], 0), x.dtype)


class ElapsedTime(AbstractMemory):
    """Seconds since the excitation began over `horizon` (s): the paper's time input (eq. 4)."""

    horizon: float = eqx.field(converter=np.float64)

    @property
    def size(self):
        """One."""
        return 1

    def initial(self, x):
        """Zero at the record's first sample."""
        return jnp.zeros((1,), jnp.result_type(x))

    def rate(self):
        """1/T."""
        return lambda memory, x: [jnp.full_like(x, 1.0 / jnp.asarray(self.horizon, x.dtype))]

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

    def rate(self):
        """(x - z) / tau."""
        pace = jnp.exp(-self.log_tau)
        return lambda memory, x: [(x - z) * pace[k] for k, z in enumerate(memory)]

    def trajectory(self, x, dt, start):
        """Exact for x linear between samples."""
        return first_order_lags(x, jnp.exp(self.log_tau), dt, start)


class RingingMemory(AbstractMemory):
    """A second mass on a spring beside the bank of lags: eigenfrequency `exp(log_omega)` (rad/s), damping ratio zeta.

    What it pulls with, kappa (r - x), is linear in the memory and in x, so the offset token has it; above zeta = 0.99
    it would be two lags. A mode within the driven band is felt well below it too: without one the whole model bends
    to imitate it: free runs of a roll with one at 1.7 times its first resonance met their records to 0.38 % without,
    to 0.27 % with it (the first second of each, noise 0.17 %).
    """

    log_omega: Float[Array, ""]
    log_zeta: Float[Array, ""]
    log_tau: Float[Array, " lags"]

    @property
    def size(self):
        """Two, and the number of time constants."""
        return 2 + self.log_tau.shape[0]

    @property
    def ring(self) -> tuple[Array, Array]:
        """Eigenfrequency (rad/s) and damping ratio of the second mass."""
        return jnp.exp(self.log_omega), jnp.minimum(jnp.exp(self.log_zeta), 0.99)

    def initial(self, x):
        """At rest beside x, every lag settled."""
        return jnp.full((self.size,), 1.0, jnp.result_type(x)).at[1].set(0.0) * x

    def rate(self):
        """(w v, w (x - r - 2 zeta v)) with v = r' / w, then (x - z) / tau."""
        (omega, zeta), lags = self.ring, FadingMemory(self.log_tau).rate()

        def rates(memory: Rows, x: Array) -> list[Array]:
            place, speed, *others = memory
            return [omega * speed, omega * (x - place - 2 * zeta * speed), *lags(others, x)]

        return rates

    def trajectory(self, x, dt, start):
        """Exact for x linear between samples."""
        lags = first_order_lags(x, jnp.exp(self.log_tau), dt, start[2:])
        return jnp.concatenate([oscillator(x, *self.ring, dt, start[:2]), lags], -1)

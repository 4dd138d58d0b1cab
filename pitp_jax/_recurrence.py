"""Linear recurrences over time, evaluated in two short passes instead of one long one.

    s_{t+1} = A s_t + b_t

The T steps are cut into about sqrt(T) blocks that run side by side from zero; the block ends are then chained with
A^L and their free responses added. Same result as the plain loop to rounding, ~sqrt(T) sequential steps.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def _powers(matrix, count):
    """A^1 ... A^count, shape (count, n, n)."""

    def next_power(power, _):
        power = matrix @ power
        return power, power

    return jax.lax.scan(next_power, jnp.eye(matrix.shape[0], dtype=matrix.dtype), None, length=count)[1]


def linear_recurrence(
    matrix: Float[Array, "n n"], drive: Float[Array, "time n"], start: Float[Array, " n"]
) -> Float[Array, "time n"]:
    """All s_t with s_{t+1} = A s_t + b_t; row 0 is `start` and the last row of `drive` is not used."""
    steps, n = drive.shape
    length = max(int(steps**0.5), 1)
    blocks = -(-(steps - 1) // length)
    if blocks == 0:
        return start[None]
    padded = jnp.zeros((blocks * length, n), drive.dtype).at[: steps - 1].set(drive[:-1])

    def step(state, b):
        state = state @ matrix.T + b
        return state, state

    zero = jnp.zeros((blocks, n), drive.dtype)
    forced = jax.lax.scan(step, zero, padded.reshape(blocks, length, n).swapaxes(0, 1))[1]  # (length, blocks, n)
    powers = _powers(matrix, length)

    def chain(state, end):
        return powers[-1] @ state + end, state

    starts = jax.lax.scan(chain, start, forced[-1])[1]  # (blocks, n)
    free = jnp.einsum("lij,bj->bli", powers, starts)
    states = (forced.swapaxes(0, 1) + free).reshape(blocks * length, n)[: steps - 1]
    return jnp.concatenate([start[None], states])


def first_order_lags(
    x: Float[Array, " time"], tau: Float[Array, " memory"], dt: float, start: Float[Array, " memory"]
) -> Float[Array, "time memory"]:
    """Solve z_k' = (x - z_k) / tau_k exactly for x linear between samples.

    With q = exp(-dt/tau):  z_{t+1} = q z_t + (1 - q) x_t + (1 - (1 - q) tau/dt) (x_{t+1} - x_t).
    Blocks of about sqrt(T) samples run side by side, as in `linear_recurrence`.
    """
    fraction = (dt / tau).astype(x.dtype)
    settle = -jnp.expm1(-fraction)
    slope = 1 - settle / fraction
    steps = x.shape[0]
    length = max(int(steps**0.5), 1)
    blocks = -(-(steps - 1) // length)
    if blocks == 0:
        return start[None]
    drive = settle * x[:-1, None] + slope * jnp.diff(x)[:, None]
    padded = jnp.zeros((blocks * length, tau.shape[0]), x.dtype).at[: steps - 1].set(drive)
    keep = 1 - settle

    def step(z, b):
        z = keep * z + b
        return z, z

    zero = jnp.zeros((blocks, tau.shape[0]), x.dtype)
    forced = jax.lax.scan(step, zero, padded.reshape(blocks, length, -1).swapaxes(0, 1))[1]
    decay = jnp.exp(-fraction * jnp.arange(1, length + 1, dtype=x.dtype)[:, None])  # (length, memory)

    def chain(z, end):
        return decay[-1] * z + end, z

    starts = jax.lax.scan(chain, start, forced[-1])[1]
    states = forced.swapaxes(0, 1) + decay[None] * starts[:, None]
    return jnp.concatenate([start[None], states.reshape(blocks * length, -1)[: steps - 1]])

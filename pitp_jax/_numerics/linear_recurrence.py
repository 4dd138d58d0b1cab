"""Compute first-order lags and oscillators over time, exactly for an input that is linear between samples.

s_{t+1} = q s_t + b_t           as an associative scan: |q| <= 1, about log2(T) steps one after the other
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def scalar_recurrence(keep: Float[Array, ""], drive: Float[Array, " steps"], start: Float[Array, ""]) -> Array:
    """Compute s_t of s_{t+1} = keep s_t + b_t in parallel, shape (steps + 1,), for |keep| <= 1."""

    def compose(first, second):  # s -> p s + q and then s -> p' s + q' is s -> p'p s + (p'q + q')
        return first[0] * second[0], second[0] * first[1] + second[1]

    powers, sums = jax.lax.associative_scan(compose, (jnp.full_like(drive, keep), drive))
    return jnp.append(start, powers * start + sums)


# compiled, because outside any program the inner scans would compile anew for every record
_compiled = partial(jax.jit, static_argnames="dt")


@_compiled
def first_order_lags(
    x: Float[Array, " time"], tau: Float[Array, " memory"], dt: float, start: Float[Array, " memory"]
) -> Float[Array, "time memory"]:
    """Solve z_k' = (x - z_k) / tau_k exactly for x linear between samples, shape (time, lags).

    With q = exp(-dt/tau):  z_{t+1} = q z_t + (1 - q) x_t + (1 - (1 - q) tau/dt) (x_{t+1} - x_t).
    """
    fraction = (dt / tau).astype(x.dtype)[:, None]
    settle = -jnp.expm1(-fraction)  # 1 - q, which a plain difference loses to rounding if tau is many samples
    slope = 1 - settle / fraction

    def free(steps, z):  # q^k by one exponential, so that no error accumulates over many steps
        return jnp.exp(-_along(fraction, z) * steps) * z

    return _states(free, settle * x[:-1] + slope * jnp.diff(x), start)


@_compiled
def oscillator(
    x: Float[Array, " time"], omega: Float[Array, ""], zeta: Float[Array, ""], dt: float, start: Float[Array, "2"]
) -> Float[Array, "time 2"]:
    """Solve r'' = w^2 (x - r) - 2 zeta w r' exactly for x linear between samples; columns r and r' / w.

    Along a ramp x + a t it settles at (x + a t - 2 zeta a / w, a / w), and the initial deviation decays.
    """
    pace = jnp.diff(x) / (omega * dt)  # a / w
    settled = jnp.stack([-2 * zeta * pace, pace])

    def free(steps, z):  # the matrix exponential of the damped oscillator, written out; zeta < 1
        root = jnp.sqrt(1 - zeta**2)
        cos, sin = jnp.cos(omega * dt * root * steps), jnp.sin(omega * dt * root * steps) / root
        first, second = z
        rows = cos * first + sin * (zeta * first + second), cos * second - sin * (first + zeta * second)
        return jnp.exp(-zeta * omega * dt * steps) * jnp.stack(rows)

    def ends(at):
        return settled.at[0].add(at)

    # only the distance from the settled motion oscillates: z_{t+1} = E (z_t - s(x_t)) + s(x_{t+1}), E = free(1, .)
    return _states(free, ends(x[1:]) - free(1.0, ends(x[:-1])), start)


def _levels() -> int:
    """Return the number of loops, of T^(1/levels) steps each: many on a GPU, where a step of any size takes 10 us."""
    return 2 if jax.default_backend() == "cpu" else 4


def _states(free, drive: Float[Array, "n steps"], start: Float[Array, " n"]) -> Float[Array, "time n"]:
    return jnp.concatenate([start[:, None], _after(free, drive, start, _levels())], 1).T


def _after(free, drive: Float[Array, "n steps"], start: Float[Array, " n"], levels: int) -> Float[Array, "n steps"]:
    """Compute the states after each step of a linear recurrence s_{t+1} = free(1, s_t) + b_t.

    Blocks of steps run side by side from zero. The states at their beginnings follow the same recurrence, with blocks
    as steps, to so many levels. `free(k, s)` advances s, shape (n, ...), by k steps without input.
    """
    if levels == 1:
        return _one_by_one(free, drive, start)
    steps, length = drive.shape[1], max(round(drive.shape[1] ** (1 / levels)), 1)
    blocks = -(-steps // length)
    # steps after the end have zero input and are cut off again
    parts = jnp.pad(drive, ((0, 0), (0, blocks * length - steps))).reshape(len(drive), blocks, length)
    forced = _one_by_one(free, parts, jnp.zeros_like(parts[:, :, 0]))
    starts = _after(lambda count, s: free(length * count, s), forced[:, :-1, -1], start, levels - 1)
    starts = jnp.concatenate([start[:, None], starts], 1)
    # superposition: the response to the input from zero, and the free response from the block's true start
    states = forced + free(jnp.arange(1, length + 1, dtype=drive.dtype), starts[:, :, None])
    return states.reshape(len(drive), -1)[:, :steps]


def _one_by_one(free, drive: Float[Array, "*n steps"], start: Float[Array, "*n"]) -> Float[Array, "*n steps"]:
    def advance(s, b):
        s = free(1.0, s) + b
        return s, s

    return jnp.moveaxis(jax.lax.scan(advance, start, jnp.moveaxis(drive, -1, 0))[1], 0, -1)


def _along(numbers: Float[Array, "n 1"], states: Array) -> Array:
    """Add axes so that numbers, one for each state, multiply states of shape (n, ...)."""
    return numbers.reshape(-1, *[1] * (states.ndim - 1))


def lag_after(start, before, now, tau, dt) -> Array:
    """Return first-order lags of x one sample of dt (s) later, for x linear from `before` to `now`."""
    return lag_followed(start, before, now, *lag_weights(tau, dt))


def lag_weights(tau, dt) -> tuple[Array, Array]:
    """Return the two weights that `lag_followed` needs for samples of dt (s)."""
    settle = -jnp.expm1(-dt / tau)
    return settle, 1 - settle * tau / dt


def lag_followed(start, before, now, settle, ramp) -> Array:
    """Return first-order lags one sample later, from the weights of `lag_weights`."""
    return start + settle * (before - start) + ramp * (now - before)

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
    fraction = (dt / tau).astype(x.dtype)
    settle, slope = (weight.astype(x.dtype) for weight in lag_weights(tau, dt))
    drive = settle * x[:-1, None] + slope * jnp.diff(x)[:, None]
    keep = 1 - settle

    def free(steps, z):  # q^k by one exponential, so that no error accumulates over a block
        return jnp.exp(-fraction * steps[..., None]) * z

    return _blocked(lambda z, b: keep * z + b, free, drive, start)


@_compiled
def oscillator(
    x: Float[Array, " time"], omega: Float[Array, ""], zeta: Float[Array, ""], dt: float, start: Float[Array, "2"]
) -> Float[Array, "time 2"]:
    """Solve r'' = w^2 (x - r) - 2 zeta w r' exactly for x linear between samples; columns r and r' / w.

    Along a ramp x + a t it settles at (x + a t - 2 zeta a / w, a / w), and the initial deviation decays.
    """
    pace = jnp.diff(x) / (omega * dt)  # a / w
    settled = jnp.stack([-2 * zeta * pace, pace], -1)

    def free(steps, z):  # the matrix exponential of the damped oscillator, written out; zeta < 1
        root = jnp.sqrt(1 - zeta**2)
        cos, sin = jnp.cos(omega * dt * root * steps), jnp.sin(omega * dt * root * steps) / root
        first, second = z[..., 0], z[..., 1]
        place = cos * first + sin * (zeta * first + second)
        speed = cos * second - sin * (first + zeta * second)
        return jnp.exp(-zeta * omega * dt * steps)[..., None] * jnp.stack([place, speed], -1)

    def ends(at):
        return settled.at[:, 0].add(at)

    one = jnp.ones((), x.dtype)
    # only the distance from the settled motion oscillates: z_{t+1} = E (z_t - s(x_t)) + s(x_{t+1}), E = free(1, .)
    return _blocked(lambda z, b: free(one, z) + b, free, ends(x[1:]) - free(one, ends(x[:-1])), start)


def _levels() -> int:
    """Return the number of loops, of T^(1/levels) steps each: many on a GPU, where a step of any size takes 10 us."""
    return 2 if jax.default_backend() == "cpu" else 4


def _blocked(
    step, free, drive: Float[Array, "steps n"], start: Float[Array, " n"], levels: int | None = None
) -> Float[Array, "time n"]:
    """Compute s_t of a linear recurrence s_{t+1} = step(s_t, b_t) in parallel blocks.

    `free(k, s)` advances s by k steps without input; s may be one state or many. The states at which the blocks start
    follow the same recurrence, with blocks as steps, to so many `levels`.
    """
    steps, size = drive.shape
    levels = levels or _levels()
    length = max(int((steps + 1) ** (1 / levels)), 1)
    blocks = -(-steps // length)
    if blocks == 0:
        return start[None]
    # steps after the end have zero input and are cut off again
    padded = jnp.zeros((blocks * length, size), drive.dtype).at[:steps].set(drive)

    def advance(z, b):
        z = step(z, b)
        return z, z

    zero = jnp.zeros((blocks, size), drive.dtype)
    forced = jax.lax.scan(advance, zero, padded.reshape(blocks, length, -1).swapaxes(0, 1))[1]
    ages = jnp.arange(1, length + 1, dtype=drive.dtype)

    def chain(z, end):
        return free(ages[-1], z) + end, z

    if levels > 2:
        many = _blocked(
            lambda z, end: chain(z, end)[0], lambda k, z: free(length * k, z), forced[-1], start, levels - 1
        )
        starts = many[:-1]
    else:
        starts = jax.lax.scan(chain, start, forced[-1])[1]
    # superposition: the response to the input from zero, and the free response from the block's true start
    states = forced.swapaxes(0, 1) + jax.vmap(lambda z: free(ages, z))(starts)
    return jnp.concatenate([start[None], states.reshape(blocks * length, -1)[:steps]])


def lag_after(start, before, now, tau, dt) -> Array:
    """Return first-order lags of x one sample of dt (s) later, for x linear from `before` to `now`."""
    return lag_followed(start, before, now, *lag_weights(tau, dt))


def lag_weights(tau, dt) -> tuple[Array, Array]:
    """Return the two weights that `lag_followed` needs for samples of dt (s)."""
    settle = -jnp.expm1(-dt / tau)  # 1 - q, which a plain difference loses to rounding if tau is many samples
    return settle, 1 - settle * tau / dt


def lag_followed(start, before, now, settle, ramp) -> Array:
    """Return first-order lags one sample later, from the weights of `lag_weights`."""
    return start + settle * (before - start) + ramp * (now - before)

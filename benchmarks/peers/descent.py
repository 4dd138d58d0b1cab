"""Truncated back-propagation for simulators:  s_{k+1} = step(s_k, inputs_k),   x_k = read(s_k),   s_0 = rest.

    minimise  mean over records of  mean_k (x_k - target_k)^2 / range^2

All records run side by side; a window's last state starts the next window, without its gradient. Windows grow, the
rate of Adam falls as a cosine of the time spent, and the parameters with the best full free run are kept.
"""

import sys
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

OPTIMISER = optax.chain(optax.clip_by_global_norm(1.0), optax.scale_by_adam())
UNROLL = 4


def run(network, state, inputs):
    """States' readings after every step of one record, and the last state; inputs (K, 4)."""

    def advance(s, item):
        s = network.step(s, item)
        return s, network.read(s)

    return jax.lax.scan(advance, state, inputs, unroll=UNROLL)


@eqx.filter_jit
def free_run(network, inputs):
    """Free run of one record from rest, shape (K + 1,)."""
    start = network.rest()
    return jnp.append(network.read(start), run(network, start, inputs)[1])


@eqx.filter_jit
def score(network, inputs, targets, weights):
    """Mean squared relative error of the full free runs."""
    runs = jax.vmap(lambda i: free_run(network, i))(inputs)
    return jnp.mean(((runs - targets) * weights[:, None]) ** 2)


@eqx.filter_jit
def epoch(params, static, memory, rate, inputs, targets, weights):
    """One pass over windows (N, R, L, 4), (N, R, L), an update in each; the mean loss."""

    def objective(p, state, i, t):
        last, x = jax.vmap(lambda s, i: run(eqx.combine(p, static), s, i))(state, i)
        return jnp.mean(((x - t) * weights[:, None]) ** 2), last

    def update(carry, window):
        p, memory, state = carry
        (loss, state), slope = jax.value_and_grad(objective, has_aux=True)(p, state, *window)
        moves, memory = OPTIMISER.update(slope, memory, p)
        p = optax.apply_updates(p, jax.tree.map(lambda m: -rate * m, moves))
        return (p, memory, state), loss

    rest = eqx.combine(params, static).rest()
    state = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (inputs.shape[1], *leaf.shape)), rest)
    (params, memory, _), losses = jax.lax.scan(update, (params, memory, state), (inputs, targets))
    return params, memory, losses.mean()


def windows(array, length: int):
    """(R, K, ...) to (N, R, length, ...); an incomplete window at the end is left out."""
    count = array.shape[1] // length
    cut = array[:, : count * length].reshape(array.shape[0], count, length, *array.shape[2:])
    return jnp.moveaxis(jnp.asarray(cut), 1, 0)


def cosine(spent: float, top: float) -> float:
    """Learning rate after a share of the time."""
    return top * (0.005 + 0.995 * 0.5 * (1 + np.cos(np.pi * min(spent, 1.0))))


def descend(network, inputs, targets, weights, seconds, *, lengths=(60, 200, 500), shares=(0.15, 0.75, 1.0), top=4e-3):
    """Fit a network (`rest`, `step`, `read`) to coarse records; lengths and the shares of time at which each ends."""
    params, static = eqx.partition(network, eqx.is_inexact_array)
    memory, began, best, kept, count = OPTIMISER.init(params), time.monotonic(), np.inf, network, 0
    spent = 0.0
    for length, share in zip(lengths, shares, strict=True):
        length = min(length, inputs.shape[1])
        parts = windows(inputs, length), windows(targets[:, 1:], length)
        while spent < share:
            params, memory, loss = epoch(params, static, memory, cosine(spent, top), *parts, weights)
            count += 1
            if count % 5 == 0 or spent > 0.9:
                found = float(score(eqx.combine(params, static), inputs, targets, weights))
                if found < best:
                    best, kept = found, eqx.combine(params, static)
            spent = (time.monotonic() - began) / seconds
            if count % 25 == 0:
                line = (
                    f"  epoch {count}, window {length}: {100 * float(loss) ** 0.5:.2f} %, best {100 * best**0.5:.2f} %"
                )
                print(line, file=sys.stderr)
    final = eqx.combine(params, static)
    return final if float(score(final, inputs, targets, weights)) < best else kept

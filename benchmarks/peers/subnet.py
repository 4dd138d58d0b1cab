"""SUBNET-style: a neural state space fitted by multiple shooting behind an encoder (Beintema et al. 2021).

    s_{k+1} = A s_k + B v_k + net(s_k, v_k),   x_k = C s_k + net(s_k),   v_k = (u_k, u_k^2, u_{k+1}, u_{k+1}^2)
    s_k = encoder(x_{k-n} ... x_k, v_{k-n} ... v_{k-1})       minimise over windows of T steps from random k

An actuator at rest is the encoder's answer to a past of zeros, and every record starts there. The first share of the
time goes to short windows, the last to free runs from rest: slow states are not in an encoder's short past.
"""

import sys
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

from .descent import OPTIMISER, cosine, descend, free_run, run
from .grid import batch, make_grid

LATENT, WIDTH, PAST, BATCH = 6, 40, 20, 256
SHOOTING = 0.3  # share of the time on encoder windows


class Subnet(eqx.Module):
    """Encoder, state transition and output, each a linear map plus a small net."""

    encoder: eqx.nn.MLP
    linear: eqx.nn.Linear
    net: eqx.nn.MLP
    out: eqx.nn.Linear
    out_net: eqx.nn.MLP

    def __init__(self, *, key):
        keys = jax.random.split(key, 5)
        size = PAST + 1 + 4 * PAST
        self.encoder = eqx.nn.MLP(size, LATENT, WIDTH, 1, jnp.tanh, key=keys[0])
        linear = eqx.nn.Linear(LATENT + 4, LATENT, key=keys[1])
        near_one = jnp.concatenate([0.97 * jnp.eye(LATENT), jnp.zeros((LATENT, 4))], 1)
        self.linear = eqx.tree_at(lambda m: m.weight, linear, near_one + 0.03 * linear.weight)
        self.net = _quiet(eqx.nn.MLP(LATENT + 4, LATENT, WIDTH, 1, jnp.tanh, key=keys[2]))
        self.out = eqx.nn.Linear(LATENT, 1, key=keys[3])
        self.out_net = _quiet(eqx.nn.MLP(LATENT, 1, WIDTH, 1, jnp.tanh, key=keys[4]))

    def encode(self, x, v):
        """Latent state from the past x (PAST + 1,) and inputs v (PAST, 4)."""
        return self.encoder(jnp.concatenate([x, v.ravel()]))

    def rest(self):
        """Latent state behind a past of zeros."""
        return self.encode(jnp.zeros(PAST + 1), jnp.zeros((PAST, 4)))

    def step(self, state, inputs):
        """Advance one coarse sample."""
        both = jnp.concatenate([state, inputs])
        return self.linear(both) + self.net(both)

    def read(self, state):
        """Scaled displacement."""
        return (self.out(state) + self.out_net(state))[0]


def _quiet(net):
    """The net with its last layer at a tenth: training starts near linear."""
    return eqx.tree_at(lambda m: m.layers[-1].weight, net, replace_fn=lambda w: 0.1 * w)


@eqx.filter_jit
def shoot(params, static, memory, rate, inputs, targets, weights, picks, length):
    """One Adam step a row of picks (N, BATCH, 2): record and start within the padded data."""

    def window(network, pick):
        row, begin = pick
        past_x = jax.lax.dynamic_slice(targets[row], (begin,), (PAST + 1,))
        past_v = jax.lax.dynamic_slice(inputs[row], (begin, 0), (PAST, 4))
        ahead = jax.lax.dynamic_slice(inputs[row], (begin + PAST, 0), (length, 4))
        aim = jax.lax.dynamic_slice(targets[row], (begin + PAST,), (length + 1,))
        start = network.encode(past_x, past_v)
        x = jnp.append(network.read(start), run(network, start, ahead)[1])
        return jnp.mean((x - aim) ** 2) * weights[row] ** 2

    def update(carry, pick):
        p, memory = carry
        loss, slope = jax.value_and_grad(
            lambda p: jnp.mean(jax.vmap(lambda one: window(eqx.combine(p, static), one))(pick))
        )(p)
        moves, memory = OPTIMISER.update(slope, memory, p)
        return (optax.apply_updates(p, jax.tree.map(lambda m: -rate * m, moves)), memory), loss

    (params, memory), losses = jax.lax.scan(update, (params, memory), picks)
    return params, memory, losses.mean()


def fit(nominal, records, seconds, key):
    """Encoder windows of 40, then 120 steps; then free runs with the encoder's rest as the start."""
    grid = make_grid(nominal, records)
    inputs, targets, weights = batch(grid, records)
    padded = np.pad(inputs, ((0, 0), (PAST, 0), (0, 0))), np.pad(targets, ((0, 0), (PAST, 0)))
    padded, generator = tuple(map(jnp.asarray, padded)), np.random.default_rng(np.asarray(jax.random.key_data(key)))
    params, static = eqx.partition(Subnet(key=key), eqx.is_inexact_array)
    memory, began, spent = OPTIMISER.init(params), time.monotonic(), 0.0
    for length, share in ((40, 0.5), (120, 1.0)):
        while spent < share:
            rows = generator.integers(len(inputs), size=(20, BATCH))
            begins = generator.integers(inputs.shape[1] - length + 1, size=(20, BATCH))
            picks = jnp.asarray(np.stack([rows, begins * (generator.random((20, BATCH)) > 0.1)], -1))
            params, memory, loss = shoot(
                params, static, memory, cosine(spent / 2, 4e-3), *padded, jnp.asarray(weights), picks, length
            )
            spent = (time.monotonic() - began) / (SHOOTING * seconds)
        print(f"  windows of {length}: {100 * float(loss) ** 0.5:.2f} %", file=sys.stderr)
    left = max(seconds - (time.monotonic() - began), 1.0)
    stages = {"lengths": (200, 500), "shares": (0.75, 1.0), "top": 4e-3}
    network = descend(eqx.combine(params, static), inputs, targets, weights, left, **stages)
    return lambda record: grid.restore(record, free_run(network, grid.inputs(record)))

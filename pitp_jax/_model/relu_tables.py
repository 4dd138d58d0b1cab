"""The paper's branches as tables: a ReLU layer of one number is piecewise linear in it, and so is its fusion.

    sum_j W_oj relu(a_j x + b_j) = s_o(k) x + c_o(k)   between the k-th and (k+1)-th of the sorted knots -b_j / a_j
    s_o(k) = sum_{j active} W_oj a_j,                  c_o(k) = sum_{j active} W_oj b_j

Exact, and the layer from (features x 128) to 128 becomes one table row per feature: 33 k instead of 82 k products per
token and instant at order 2. Blocks of about a thousand instants keep the activations of all tokens in the cache.
On two shared cores 120,000 instants took 0.35-0.45 s; vmapped 2.0-3.2 s; PyTorch compiled 2.4 s.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .rows import affine

_BLOCK = 1000
_FAR = 1e30  # the knot of a branch without slope


def tables(
    networks,
) -> tuple[
    Float[Array, "tokens features width"],
    Float[Array, "tokens features pieces width"],
    Float[Array, "tokens features pieces width"],
]:
    """Sorted knots, and slope and intercept of every piece (width + 1 of them) in every fusion unit."""
    weight, b = affine(networks.branches)
    a = weight[..., 0]
    tokens, features, width = a.shape
    fusion = networks.fusion.weight.reshape(tokens, -1, features, width)
    knots = jnp.sort(jnp.clip(jnp.where(a == 0, _FAR, -b / jnp.where(a == 0, 1.0, a)), -_FAR, _FAR), -1)
    inside = (knots[..., 1:] + knots[..., :-1]) / 2
    low, high = knots[..., :1], knots[..., -1:]
    inside = jnp.concatenate([low - jnp.abs(low) - 1, inside, high + jnp.abs(high) + 1], -1)
    active = a[..., None, :] * inside[..., None] + b[..., None, :] > 0  # tokens, features, pieces, width
    slope = jnp.einsum("tfpw,tofw->tfpo", active * a[..., None, :], fusion)
    return knots, slope, jnp.einsum("tfpw,tofw->tfpo", active * b[..., None, :], fusion)


def logits_by_tables(networks, features: Float[Array, "features time"]) -> Float[Array, "tokens time"]:
    """Logits of every instant, without the offset's, in blocks."""
    kinds, count = features.shape
    blocks = -(-count // _BLOCK)
    padded = jnp.pad(features, ((0, 0), (0, blocks * _BLOCK - count)))
    made = tables(networks)
    found = jax.lax.map(lambda f: _block(networks, made, f), padded.reshape(kinds, blocks, _BLOCK).swapaxes(0, 1))
    return found.swapaxes(0, 1).reshape(found.shape[1], -1)[:, :count]


def _block(networks, made, features: Float[Array, "features block"]) -> Float[Array, "tokens block"]:
    knots, slope, intercept = made
    (_, fusion), (readout, last) = affine(networks.fusion), affine(networks.readout)
    enhance = [affine(layer) for layer in networks.enhance]
    find = jax.vmap(lambda k, x: jnp.searchsorted(k, x, method="scan"))
    logits = []
    for t in range(knots.shape[0]):
        at, h = find(knots[t], features), fusion[t]
        for i, x in enumerate(features):
            h = h + slope[t, i][at[i]] * x[:, None] + intercept[t, i][at[i]]
        h = jax.nn.relu(h)
        for weight, bias in enhance:
            h = jax.nn.relu(h @ weight[t].T + bias[t])
        logits.append((h @ readout[t].T)[:, 0] + last[t, 0])
    return jnp.stack(logits)

"""Evaluate the paper's network by tables: a ReLU layer with one input is piecewise linear.

    sum_j W_oj relu(a_j x + b_j) = s_o(k) x + c_o(k)   between the k-th and (k+1)-th of the sorted knots -b_j / a_j
    s_o(k) = sum_{j active} W_oj a_j,                  c_o(k) = sum_{j active} W_oj b_j

Exact, and the layer from (features x 128) to 128 becomes one table row per feature (docs/decisions/decoder.md).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .rows import affine


def tables(
    networks,
) -> tuple[
    Float[Array, "tokens features width"],
    Float[Array, "tokens features pieces width"],
    Float[Array, "tokens features pieces width"],
]:
    """Return the sorted knots, and for every fusion unit the slope and intercept of each of the width + 1 pieces."""
    weight, b = affine(networks.branches)
    a = weight[..., 0]
    tokens, features, width = a.shape
    fusion = networks.fusion.weight.reshape(tokens, -1, features, width)
    far = 1e30  # knot of a branch without slope; the sum of two is finite in float32
    knots = jnp.sort(jnp.clip(jnp.where(a == 0, far, -b / jnp.where(a == 0, 1.0, a)), -far, far), -1)
    # a point inside every piece shows which units are active there, whatever the order of equal knots
    inside = (knots[..., 1:] + knots[..., :-1]) / 2
    low, high = knots[..., :1], knots[..., -1:]
    # beyond the ends: 1 further for a knot at 0, its own size further if 1 is lost to rounding
    inside = jnp.concatenate([low - jnp.abs(low) - 1, inside, high + jnp.abs(high) + 1], -1)
    active = a[..., None, :] * inside[..., None] + b[..., None, :] > 0  # tokens, features, pieces, width
    slope = jnp.einsum("tfpw,tofw->tfpo", active * a[..., None, :], fusion)
    return knots, slope, jnp.einsum("tfpw,tofw->tfpo", active * b[..., None, :], fusion)


def logits_by_tables(networks, features: Float[Array, "features time"]) -> Float[Array, "tokens time"]:
    """Compute the logits of every instant from tables, in blocks of instants, without the offset token's logit."""
    kinds, count = features.shape
    size = 1000  # instants at once, so that the activations of all tokens stay in the cache
    blocks = -(-count // size)
    padded = jnp.pad(features, ((0, 0), (0, blocks * size - count)))
    made = tables(networks)
    logits = jax.lax.map(lambda f: _block(networks, made, f), padded.reshape(kinds, blocks, size).swapaxes(0, 1))
    return logits.swapaxes(0, 1).reshape(logits.shape[1], -1)[:, :count]


def _block(networks, made, features: Float[Array, "features block"]) -> Float[Array, "tokens block"]:
    knots, slope, intercept = made
    (_, fusion), (readout, last) = affine(networks.fusion), affine(networks.readout)
    enhance = [affine(layer) for layer in networks.enhance]
    find = jax.vmap(lambda k, x: jnp.searchsorted(k, x, method="scan"))
    logits = []
    for t in range(knots.shape[0]):  # a few tokens: written out, so that one token's tables are in the cache at a time
        at, h = find(knots[t], features), fusion[t]
        for i, x in enumerate(features):
            h = h + slope[t, i][at[i]] * x[:, None] + intercept[t, i][at[i]]
        h = jax.nn.relu(h)
        for weight, bias in enhance:
            h = jax.nn.relu(h @ weight[t].T + bias[t])
        logits.append((h @ readout[t].T)[:, 0] + last[t, 0])
    return jnp.stack(logits)

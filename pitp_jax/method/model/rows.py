"""Write a network layer once for scalars, time series and batches: one array per quantity, all of one shape.

    y_o = b_o + sum_i W_oi f_i

Rows are scalars at one instant, instants along a motion or records side by side. A small vmapped net is a product with
an 8 by 7 matrix, which product routines compute slowly. Written out over instants it is one kernel within the registers
(docs/decisions/decoder.md).
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

Rows = Sequence[Array] | Array  # the array's first axis: one quantity each


def written_out(weight: Array, bias: Rows) -> Callable[[Rows], list[Array]]:
    """Return a function that applies the layer with every sum written term by term."""

    def layer(rows: Rows) -> list[Array]:
        outputs = list(bias)
        for o in range(len(outputs)):
            for k, row in enumerate(rows):
                outputs[o] = outputs[o] + weight[o, k] * row  # one index: a slice of the weight would be a kernel
        return outputs

    return layer


def as_product(weight: Array, bias: Rows) -> Callable[[Rows], Array]:
    """Return a function that applies the layer as one matrix product."""

    def layer(rows: Rows) -> Array:
        sums, start = jnp.tensordot(weight, jnp.asarray(rows), 1), jnp.asarray(bias)
        # A bias is one number per output, or another layer's output rows; axes of length 1 are inserted.
        return sums + start.reshape(len(start), *[1] * (sums.ndim - start.ndim), *start.shape[1:])

    return layer


def affine(layer: eqx.nn.Linear) -> tuple[Array, Array]:
    """Return weight and bias of a linear layer."""
    assert layer.bias is not None  # every layer of these networks has one
    return layer.weight, layer.bias


def vmapped(function: Callable[[Array], Array], rows: Rows) -> list[Array]:
    """Apply a function of one instant's vector to arrays of any shape, one array per quantity."""
    flat = jnp.stack([row.reshape(-1) for row in rows], -1)
    return [row.reshape(rows[0].shape) for row in jax.vmap(function)(flat).T]

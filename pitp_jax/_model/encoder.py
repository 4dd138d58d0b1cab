"""Encoders: from what the model sees now (state S and memory m, scaled) to tokens (paper, eqs. 4 and 5).

    sigma_i = sigma_i^0 g(l_i),    sigma_off = l_off,    l = encoder(S, m)

An encoder returns the logits l, one per token and one for the offset; l = 0 is exactly the identified linear model.
It never sees x^(n), which the tokens themselves define (PAPER_READINGS: a rollout would be an algebraic loop).
"""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray


class AbstractEncoder(eqx.Module):
    """A map from features (S, m) of one instant to n + 2 logits: n + 1 tokens, then the offset token."""

    @abstractmethod
    def __call__(
        self, features: Float[Array, " features"], *, key: PRNGKeyArray | None = None
    ) -> Float[Array, " tokens"]:
        """Logits, shape (n + 2,); `key` turns dropout on where the encoder has any."""


class ConstantEncoder(AbstractEncoder):
    """Constant tokens: the identified linear model."""

    outputs: int = eqx.field(static=True)

    def __call__(self, features, *, key=None):
        """Zeros."""
        return jnp.zeros((self.outputs,), features.dtype)


class CompactEncoder(AbstractEncoder):
    """A shared tanh trunk, one matmul per layer (preset `default`).

    Args at init: number of features, outputs, width, depth (hidden layers). The last layer starts at zero.
    """

    hidden: list[eqx.nn.Linear]
    readout: eqx.nn.Linear

    def __init__(self, features: int, outputs: int, *, width: int, depth: int, key: PRNGKeyArray):
        keys = jax.random.split(key, depth + 1)
        sizes = [features] + [width] * depth
        self.hidden = [eqx.nn.Linear(a, b, key=k) for a, b, k in zip(sizes[:-1], sizes[1:], keys[:-1], strict=True)]
        self.readout = _zero(eqx.nn.Linear(width, outputs, key=keys[-1]))

    def __call__(self, features, *, key=None):
        """Logits of one instant."""
        h = features
        for layer in self.hidden:
            h = jnp.tanh(layer(h))
        return self.readout(h)


class _Branches(eqx.Module):
    """One token's network (paper, Fig. 3): a branch per input, fusion, feature enhancement, one output."""

    branches: eqx.nn.Linear
    fusion: eqx.nn.Linear
    enhance: list[eqx.nn.Linear]
    readout: eqx.nn.Linear
    dropout: eqx.nn.Dropout

    def __init__(self, features, width, depth, dropout, key):
        keys = jax.random.split(key, depth + 3)
        one = eqx.filter_vmap(lambda k: eqx.nn.Linear(1, width, key=k))
        self.branches = one(jax.random.split(keys[0], features))
        self.fusion = eqx.nn.Linear(features * width, width, key=keys[1])
        self.enhance = [eqx.nn.Linear(width, width, key=k) for k in keys[2:-1]]
        self.readout = _zero(eqx.nn.Linear(width, 1, key=keys[-1]))
        self.dropout = eqx.nn.Dropout(dropout)

    def __call__(self, features, key):
        keys = [None] * len(self.enhance) if key is None else jax.random.split(key, len(self.enhance))
        branch = eqx.filter_vmap(lambda layer, x: jax.nn.relu(layer(x[None])))
        h = jax.nn.relu(self.fusion(branch(self.branches, features).reshape(-1)))
        for layer, k in zip(self.enhance, keys, strict=True):
            h = self.dropout(jax.nn.relu(layer(h)), key=k, inference=k is None)
        return self.readout(h)[0]


class PaperEncoder(AbstractEncoder):
    """The paper's encoder: one network per token (Fig. 3; 128 wide, 2 layers, dropout 0.4), no offset token."""

    networks: _Branches  # stacked: leading axis = token

    def __init__(self, features: int, tokens: int, *, key: PRNGKeyArray, width=128, depth=2, dropout=0.4):
        build = eqx.filter_vmap(lambda k: _Branches(features, width, depth, dropout, k))
        self.networks = build(jax.random.split(key, tokens))

    def __call__(self, features, *, key=None):
        """Logits of one instant; the offset logit is always zero."""
        count = self.networks.readout.weight.shape[0]
        if key is None:
            logits = eqx.filter_vmap(lambda net: net(features, None))(self.networks)
        else:
            keys = jax.random.split(key, count)
            logits = eqx.filter_vmap(lambda net, k: net(features, k))(self.networks, keys)
        return jnp.concatenate([logits, jnp.zeros((1,), logits.dtype)])


def _zero(layer: eqx.nn.Linear) -> eqx.nn.Linear:
    return eqx.tree_at(lambda m: (m.weight, m.bias), layer, replace_fn=jnp.zeros_like)

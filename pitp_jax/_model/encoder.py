"""Encoders: from what the model sees now (state S and memory m, scaled) to tokens (paper, eqs. 4 and 5).

    sigma_i = sigma_i^0 g(l_i),    sigma_off = l_off,    l = encoder(S, m)

An encoder returns the logits l, one per token and one for the offset; l = 0 is exactly the identified linear model.
It never sees x^(n), which the tokens themselves define (PAPER_READINGS: a rollout would be an algebraic loop).
"""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
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


class _Trunk(eqx.Module):
    """A tanh network beside a quadratic in the first `states` features; zero until trained.

    A tanh saturates outside the data; a hardening spring does not. Its secant stiffness is quadratic in x, so the
    logits add a linear readout of S and its products: on Silverbox's arrow, 30 % beyond the training range, the error
    fell from 2.3 to 0.9 mV.
    """

    hidden: list[eqx.nn.Linear]
    readout: eqx.nn.Linear
    quadratic: eqx.nn.Linear
    states: int = eqx.field(static=True)

    def __init__(self, features, outputs, states, width, depth, key):
        keys = jax.random.split(key, depth + 2)
        sizes = [features] + [width] * depth
        self.hidden = [eqx.nn.Linear(a, b, key=k) for a, b, k in zip(sizes[:-1], sizes[1:], keys[:-2], strict=True)]
        self.readout = _zero(eqx.nn.Linear(width, outputs, key=keys[-2]))
        products = states + states * (states + 1) // 2
        self.quadratic = _zero(eqx.nn.Linear(products, outputs, use_bias=False, key=keys[-1]))
        self.states = states

    def __call__(self, features):
        h = features
        for layer in self.hidden:
            h = jnp.tanh(layer(h))
        state = features[: self.states]
        rows, columns = np.triu_indices(self.states)
        return self.readout(h) + self.quadratic(jnp.concatenate([state, state[rows] * state[columns]]))


class CompactEncoder(AbstractEncoder):
    """Two small trunks, one matmul per layer (preset `default`): restoring tokens apart from the rest.

        sigma_0, sigma_off = restoring(x, m),        sigma_1 ... sigma_n = dynamic(S, m)

    Any force f(x, v, m) is f(x, 0, m) + v sigma_1; with a positive sigma_1 the velocity cannot feed energy in through
    the spring or the offset. One trunk for all fits as well and extrapolates worse: Peano-HASEL at 7 Hz from steps
    and 3 Hz, 134 % nrmse against 31 %. The leading token sees the velocity too (33 % without): its load is pulled up
    and falls freely.

    Args at init: order n, number of memories, width and depth (hidden layers) of each trunk, and whether there is an
    offset token (without one no token can express a force left over when x crosses zero).
    """

    restoring: _Trunk
    dynamic: _Trunk
    order: int = eqx.field(static=True)
    offset: bool = eqx.field(static=True)

    def __init__(self, order: int, memories: int, *, width: int, depth: int, offset: bool = True, key: PRNGKeyArray):
        first, second = jax.random.split(key)
        self.order, self.offset = order, offset
        self.restoring = _Trunk(1 + memories, 2, 1, width, depth, first)
        self.dynamic = _Trunk(order + memories, order, order, width, depth, second)

    def __call__(self, features, *, key=None):
        """Logits of one instant."""
        still = jnp.concatenate([features[:1], features[self.order :]])
        first, offset = self.restoring(still)
        offset = offset if self.offset else jnp.zeros_like(offset)
        return jnp.concatenate([first[None], self.dynamic(features), offset[None]])


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
    return jax.tree.map(jnp.zeros_like, layer)

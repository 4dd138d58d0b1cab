"""Encoders: networks that compute the model's coefficients (tokens) from its features (paper, eqs. 4 and 5).

    sigma_i = sigma_i^0 g(l_i),    sigma_off = l_off,    l = encoder(S, m)

An encoder returns the logits l, one per token and one for the offset; l = 0 is exactly the identified linear model.
It never sees x^(n), which the tokens themselves define (docs/readings.md: a rollout would be an algebraic loop).
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from .constants import ConstantArray, constant_array, map_parameters
from .positive import logit_of, positive_factor
from .relu_tables import logits_by_tables
from .rows import Rows, affine, as_product, vmapped, written_out

# at one instant (vmapped, differentiated) layers are products, over many written out
Way = Literal["instant", "instants"]


class AbstractEncoder(eqx.Module):
    """A map from features (S, m) of one instant to n + 2 logits: n + 1 tokens, then the offset token."""

    @abstractmethod
    def __call__(
        self, features: Float[Array, " features"], *, key: PRNGKeyArray | None = None
    ) -> Float[Array, " tokens"]:
        """Compute the logits, shape (n + 2,); `key` turns dropout on."""

    def over(self, way: Way = "instants") -> Callable[[Rows], Rows]:
        """Return a function from features to logits for many instants: one array per token, one for the offset token.

        Constant parts are computed once here, not at every step of a scan. `way`: "instant" if it is called for one
        instant at a time (vmapped or differentiated), "instants" for arrays of many; both give the same logits.
        """
        return lambda features: vmapped(self, features)

    @abstractmethod
    def scaled(self, factor: float) -> "AbstractEncoder":
        """Return the encoder with its last layer multiplied by `factor`; factor 0 gives the identified linear model."""

    def token_nets(self) -> "AbstractEncoder":
        """Return the encoder with 1 for every weight of a net beside a polynomial of the same inputs, 0 for all others.

        Training gives these weights a stronger prior, so that the polynomial describes what it can.
        """
        return map_parameters(jnp.zeros_like, self)


class ConstantEncoder(AbstractEncoder):
    """An encoder whose logits are zero: the coefficients are constant, as in the identified linear model."""

    outputs: int = eqx.field(static=True)

    def __call__(self, features, *, key=None):
        """Return zero logits for any features."""
        return jnp.zeros((self.outputs,), features.dtype)

    def over(self, way="instants"):
        """Return a function that gives zero logits for any features."""
        return lambda features: [jnp.zeros_like(features[0])] * self.outputs

    def scaled(self, factor):
        """Return the encoder itself, because its logits are zero for any factor."""
        return self


class _Net(eqx.Module):
    """A hidden tanh layer and an output layer that starts at zero, so that an untrained net changes nothing."""

    hidden: eqx.nn.Linear
    readout: eqx.nn.Linear

    def __init__(self, features, outputs, width, key):
        # the hidden layer is random, because with zeros in both no gradient would reach either
        first, second = jax.random.split(key)
        self.hidden = _linear(features, width, key=first)
        self.readout = _zero(width, outputs, second)

    def __call__(self, features):
        return self.readout(jnp.tanh(self.hidden(features)))


def _nets(nets: Sequence[tuple[_Net, list[int]]], way: Way) -> Callable[[Rows], Sequence[Rows]]:
    """Return a function from features to the outputs of several nets, each of which sees some of the features."""
    widest = max(len(net.hidden.weight) for net, _ in nets)
    # from 33 hidden units on a matrix product is faster and compiles faster
    layer = as_product if way == "instant" or widest > 32 else written_out
    layers = [(layer(*affine(net.hidden)), layer(*affine(net.readout)), columns) for net, columns in nets]
    return lambda rows: [
        outer(jax.tree.map(jnp.tanh, inner([rows[c] for c in columns]))) for inner, outer, columns in layers
    ]


class CompactEncoder(AbstractEncoder):
    """Small nets with low-order polynomials; each coefficient (token) depends on few inputs (preset `default`).

    Inputs are scaled: the state S = [x, x', ..., x^(n-1)], the memories m, of which m_fast are the fast ones. Outputs
    set the tokens of sigma_off + sum_i sigma_i x^(i) = F; spring, damping and past are nets.

        sigma_0, sigma_n           = spring(x)                    + sum_{k=1}^{3} w_k x^k
        sigma_1 ... sigma_{n-1}    = damping(S, m)                + linear and quadratic in S
        sigma_off                  = past(x, m_fast)              + sum_k (a_k + b_k x + c_k x^2) m_k

    A tanh saturates outside the data and a hardening spring does not, hence the polynomials. Every restoring force f(x,
    m) is sigma_0 x + sigma_off, so sigma_0 and sigma_n need neither velocity nor memory. Without them neither token can
    add energy. The net receives only the fast memories, because its dependence on slow ones does not hold beyond the
    training records (docs/decisions/training.md).

    Features are first clipped to `bounds`, so tokens stay in their trained range: outside, the spring is linear.

    `frugal`: without nets of memories, for few excitations, because such nets would memorise the inputs.

        sigma_1 ... sigma_{n-1} = damping(S) + linear and quadratic in S,   no net past(x, m_fast)
        all tokens and sigma_off times exp(sum_{k=1}^{3} c_k x^k):          how hard V^2 pulls at x

    `remainder`: of model files written before `fit --structure both` was removed. All logits are multiplied by a factor
    that is 1 in the inner half of `bounds` (the trained region) and 0 outside of them:

        prod_i s(2 - |S_i - c_i| / h_i)    s(t) = t^2 (3 - 2 t) on [0, 1];  c: centre, h: quarter of the bounds' width

    Args at init: order n, number of memories, width of the hidden layers, whether there is an offset token (without
    one no token can express a remaining force at x = 0), `frugal`, `remainder`, bounds: lowest and highest trained
    value of every S and m, shape (2, features).
    """

    spring: _Net
    damping: _Net | None
    past: _Net | None
    spring_poly: Float[Array, "two three"]
    damping_poly: Float[Array, "tokens products"]
    fading: Float[Array, "memory three"]
    coupling: Float[Array, " three"] | None
    bounds: ConstantArray
    order: int = eqx.field(static=True)
    offset: bool = eqx.field(static=True)
    frugal: bool = eqx.field(static=True)
    remainder: bool = eqx.field(static=True)

    def __init__(
        self,
        order: int,
        memories: int,
        *,
        width: int,
        offset: bool = True,
        frugal: bool = False,
        remainder: bool = False,
        bounds: np.ndarray | None = None,
        key: PRNGKeyArray,
    ):
        first, second, third = jax.random.split(key, 3)
        self.order, self.offset, self.frugal, self.remainder = order, offset, frugal, remainder
        # at order 1 sigma_0 and sigma_n are all the tokens: there is no damping between them
        moving, reads_past = order + (0 if frugal else memories), offset and not frugal
        self.spring = _Net(1, 2, width, first)
        self.damping = _Net(moving, order - 1, width, second) if order > 1 else None
        self.past = _Net(1 + fast_memories(memories), 1, width, third) if reads_past else None
        products = order + order * (order + 1) // 2  # S, and the products of two of its entries
        self.spring_poly = jnp.zeros((2, 3), jnp.float32)
        self.damping_poly = jnp.zeros((order - 1, products), jnp.float32)
        self.fading = jnp.zeros((memories if offset else 0, 3), jnp.float32)
        self.coupling = jnp.zeros((3,), jnp.float32) if frugal else None
        # scaled features are of order one: the default is no bound
        wide = np.broadcast_to([[-1e6], [1e6]], (2, order + memories))
        self.bounds = constant_array(wide if bounds is None else bounds)

    def __call__(self, features, *, key=None):
        """Compute the logits of one instant, shape (n + 2,)."""
        return jnp.stack(self.over("instant")(list(features)))

    def over(self, way="instants"):
        """Return the function of the class docstring, from features to logits, for arrays of any shape."""
        n, (low, high) = self.order, self.bounds.array(self.spring_poly.dtype)
        memories, sums = len(low) - n, as_product if way == "instant" else written_out
        moving, past = list(range(n if self.frugal else n + memories)), [0, *range(n, n + fast_memories(memories))]
        seen_by = [(self.spring, [0]), (self.damping, moving), (self.past, past)]
        nets = _nets([(net, c) for net, c in seen_by if net is not None], way)

        def logits(features: Rows) -> Rows:
            # a cubic diverges outside the data; with clipping, tokens stay constant and the spring continues linearly
            seen = [jnp.clip(f, low[i], high[i]) for i, f in enumerate(features)]
            (x, *_), state, memory, outputs = seen, seen[:n], seen[n:], iter(nets(seen))
            powers = [x, x * x, x * x * x]
            # the polynomial is added to a net's outputs as a bias
            first, last = sums(self.spring_poly, next(outputs))(powers)
            products = [*state, *(state[i] * state[k] for i, k in zip(*np.triu_indices(n), strict=True))]
            middle = [] if self.damping is None else sums(self.damping_poly, next(outputs))(products)
            (offset,) = [jnp.zeros_like(x)] if self.past is None else next(outputs)
            for k, row in enumerate(memory[: len(self.fading)]):  # none without an offset token
                offset = offset + (self.fading[k, 0] + self.fading[k, 1] * x + self.fading[k, 2] * powers[1]) * row
            raw = [first, *middle, last]
            if self.coupling is not None:
                common = jnp.exp(sum(c * power for c, power in zip(self.coupling, powers, strict=True)))
                # the token g(l) is multiplied, not the logit: a force coupling divides every token by the same factor
                for k in np.flatnonzero(shared_by(n)):
                    raw[k] = logit_of(positive_factor(raw[k]) * common)
                offset = offset * common
            if not self.remainder:
                return [*raw, offset]
            fade = _fade(features[:n], low, high)
            return [fade * row for row in (*raw, offset)]

        return logits

    def scaled(self, factor):
        """Return the encoder with output layers, polynomials, memory weights and coupling multiplied by `factor`.

        The logits are linear in all of them except the coupling.
        """

        def outputs(e):
            readouts = [net.readout for net in (e.spring, e.damping, e.past) if net is not None]
            parts = *readouts, e.spring_poly, e.damping_poly, e.fading, e.coupling
            return tuple(part for part in parts if part is not None)

        return eqx.tree_at(outputs, self, jax.tree.map(lambda a: factor * a, outputs(self)))

    def token_nets(self):
        """Return the encoder with 1 for every weight of the nets spring and damping, 0 for all others."""

        def nets(e):
            return tuple(net for net in (e.spring, e.damping) if net is not None)

        return eqx.tree_at(nets, super().token_nets(), jax.tree.map(jnp.ones_like, nets(self)))


class AdaptedEncoder(AbstractEncoder):
    """An encoder adapted to another day: creep and restoring force are multiplied by factors that vary with x.

        logits(S, m) = inner(S, x + creep_k (m_k - x)),       t = clip(x, low, high) - middle
        all tokens and sigma_off times exp(tilt_0 t),         sigma_0 and sigma_off also times exp(tilt_1 t)
        sigma_off times offset

    A settled memory (m = x) does not change, so the long-term behaviour is kept and the transient is scaled. `creep`: a
    factor for each of the last features, which are lags of x. `reach`: low, middle, high. From order 3 on sections are
    not changed one by one, and the second slope applies to the offset alone.
    """

    inner: AbstractEncoder
    offset: Float[Array, ""]
    creep: Float[Array, " lags"]
    tilt: Float[Array, "2"]
    reach: ConstantArray = eqx.field(converter=constant_array)

    def __call__(self, features, *, key=None):
        """Compute the logits of one instant, shape (n + 2,)."""
        rows = list(features)
        return jnp.stack(self._tilted(rows[0], list(self.inner(jnp.stack(self._seen(rows)), key=key))))

    def over(self, way="instants"):
        """Return the function of the class docstring around the inner encoder, from features to logits."""
        inner = self.inner.over(way)
        return lambda features: self._tilted(features[0], list(inner(self._seen(list(features)))))

    def _seen(self, features: list[Array]) -> list[Array]:
        first = len(features) - len(self.creep)
        # by the distance from x, so that a settled memory is unchanged
        lags = [features[0] + c * (m - features[0]) for c, m in zip(self.creep, features[first:], strict=True)]
        return [*features[:first], *lags]

    def _tilted(self, x: Array, logits: list[Array]) -> list[Array]:
        low, middle, high = self.reach.array(self.tilt.dtype)
        t = jnp.clip(x, low, high) - middle  # exp(tilt t) is unknown for an x that no record reached
        common, spring = jnp.exp(self.tilt[0] * t), jnp.exp(self.tilt[1] * t)
        *tokens, offset = logits
        for k in np.flatnonzero(shared_by(len(tokens) - 1)):
            both = common * spring if k == 0 else common  # k = 0 only occurs up to order 2: see `shared_by`
            tokens[k] = logit_of(positive_factor(tokens[k]) * both)
        return [*tokens, offset * (self.offset * common * spring)]

    def scaled(self, factor):
        """Return the encoder with the inner last layer multiplied by `factor`; the adaptation to the day stays."""
        return replace(self, inner=self.inner.scaled(factor))


def _fade(state: Rows, low: Array, high: Array) -> Array:
    fade = jnp.ones_like(state[0])
    for i, row in enumerate(state):
        t = jnp.clip(2 - jnp.abs(row - (low[i] + high[i]) / 2) * 4 / (high[i] - low[i]), 0.0, 1.0)
        fade = fade * t * t * (3 - 2 * t)
    return fade


def plain(encoder: AbstractEncoder) -> AbstractEncoder:
    """Return the encoder as it was trained, without adaptation to another day."""
    return encoder.inner if isinstance(encoder, AdaptedEncoder) else encoder


def ignores_position(encoder: AbstractEncoder) -> bool:
    """Return whether the logits are the same at every displacement x."""
    if isinstance(encoder, CompactEncoder):
        return float(np.ptp(np.asarray(encoder.bounds)[:, 0])) == 0.0
    return isinstance(encoder, ConstantEncoder)


def fast_memories(count: int) -> int:
    """Return the number of memories that the offset token's net sees, fastest first: all but the two slowest."""
    return max(count - 2, 0)


def shared_by(order: int) -> np.ndarray:
    """Mark the logits that must be multiplied to multiply all tokens by a common factor, shape (n + 1,).

    Up to order 2 these are all; from order 3 on the last one, which multiplies the polynomial of all sections.
    """
    return np.arange(order + 1) >= (0 if order < 3 else order)


class _Branches(eqx.Module):
    """The network of one token (paper, Fig. 3): a branch per input, fusion, feature enhancement, one output."""

    branches: eqx.nn.Linear
    fusion: eqx.nn.Linear
    enhance: list[eqx.nn.Linear]
    readout: eqx.nn.Linear
    dropout: eqx.nn.Dropout

    def __init__(self, features, width, depth, dropout, key):
        keys = jax.random.split(key, depth + 3)
        one = eqx.filter_vmap(lambda k: _linear(1, width, key=k))  # one leading axis of inputs, not a list of layers
        self.branches = one(jax.random.split(keys[0], features))
        self.fusion = _linear(features * width, width, key=keys[1])
        self.enhance = [_linear(width, width, key=k) for k in keys[2:-1]]
        self.readout = _zero(width, 1, keys[-1])
        self.dropout = eqx.nn.Dropout(dropout)

    def __call__(self, features, key):
        keys = [None] * len(self.enhance) if key is None else jax.random.split(key, len(self.enhance))
        branch = eqx.filter_vmap(lambda layer, x: jax.nn.relu(layer(x[None])))
        h = jax.nn.relu(self.fusion(branch(self.branches, features).ravel()))
        for layer, k in zip(self.enhance, keys, strict=True):
            h = self.dropout(jax.nn.relu(layer(h)), key=k, inference=k is None)
        return self.readout(h)[0]


class PaperEncoder(AbstractEncoder):
    """The paper's encoder: one network per token (Fig. 3; 128 wide, 2 layers, dropout 0.4), no offset token."""

    networks: _Branches  # stacked: leading axis = token

    def __init__(self, features: int, tokens: int, *, key: PRNGKeyArray, width=128, depth=2, dropout=0.4):
        build = eqx.filter_vmap(lambda k: _Branches(features, width, depth, dropout, k))
        # stacked, so that all tokens are one product
        self.networks = build(jax.random.split(key, tokens))

    def __call__(self, features, *, key=None):
        """Compute the logits of one instant, shape (n + 2,); the logit of the offset token is always zero."""
        # no dropout without a key, because a rollout must not draw random numbers
        keys = None if key is None else jax.random.split(key, len(self.networks.readout.weight))
        logits = eqx.filter_vmap(lambda net, k: net(features, k))(self.networks, keys)
        return jnp.concatenate([logits, jnp.zeros((1,), logits.dtype)])

    def over(self, way="instants"):
        """Return a function from features (S, m) to the n + 2 logits, both one array per quantity, of any shape.

        From 256 instants on, a CPU reads the first layers from exact tables (`relu_tables`). `way` is not used.
        """

        def one_by_one(*features):
            return vmapped(self, features)

        def tabulated(*features):
            logits = logits_by_tables(self.networks, jnp.stack([f.ravel() for f in features]))
            return [*logits.reshape(-1, *features[0].shape), jnp.zeros_like(features[0])]

        def logits(features: Rows) -> Rows:
            if features[0].size < 256:  # for fewer, the tables cost more to build than they save
                return one_by_one(*features)
            # the tables are read in blocks that suit a CPU's cache: on a GPU they take 35 times as long as the products
            return jax.lax.platform_dependent(*features, cpu=tabulated, default=one_by_one)

        return logits

    def scaled(self, factor):
        """Return the encoder with its last linear layers multiplied by `factor`."""
        last = self.networks.readout
        return eqx.tree_at(lambda e: e.networks.readout, self, jax.tree.map(lambda a: factor * a, last))


def _linear(features: int, outputs: int, *, key) -> eqx.nn.Linear:
    """Build a linear layer in float32, even if JAX's default is float64."""
    return eqx.nn.Linear(features, outputs, dtype=jnp.float32, key=key)


def _zero(features: int, outputs: int, key) -> eqx.nn.Linear:
    """Build a linear layer of zeros, without a program that draws weights of its shape."""
    return jax.tree.map(jnp.zeros_like, eqx.filter_eval_shape(_linear, features, outputs, key=key))

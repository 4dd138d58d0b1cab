"""Tokens over rows: every quantity one array over instants or records, every sum written out (eqs. 4, 5 and 13).

    h_j = tanh(b_j + sum_i W_ji f_i),   l_o = c_o + sum_j R_oj h_j,   sigma_i = sigma_i^0 g(l_i),   F = sigma_off + ...

The numbers of `encoder(features)` under vmap, to rounding. A vmapped small net is a matrix product with a matrix of 8
by 7, far below what a product routine is made for; written out, it is one kernel that never leaves the registers: 2.1
instead of 14-24 ms for 120,000 instants on two shared cores. Rows may have any shape, that of a scalar too.
"""

from collections.abc import Callable, Sequence
from functools import singledispatch

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._model.encoder import AbstractEncoder, CompactEncoder, ConstantEncoder, PaperEncoder, fast_memories, shared_by
from .._model.memory import AbstractMemory, FadingMemory, NoMemory
from .._model.model import Model
from .._model.positive import logit_of, positive_factor
from .relu_tables import affine, paper_logits

Rows = Sequence[Array]
_WRITTEN_OUT = 32  # hidden units of a net; beyond, a matrix product is faster and compiles faster
_FEW = 256  # instants for which the paper's tables cost more to build than they save


@singledispatch
def encoder_rows(encoder: AbstractEncoder, matrix: bool = False) -> Callable[[Rows], list[Array]]:
    """fn(features): logits, one row per token and one for the offset; features: S then memory, scaled.

    An encoder without a written-out form is vmapped. `matrix`: hidden layers of small nets side by side in one matrix
    product (a scan over records); what is constant is computed here, once.
    """

    def logits(features: Rows) -> list[Array]:
        flat = jnp.stack([f.reshape(-1) for f in features], -1)
        return [row.reshape(features[0].shape) for row in jax.vmap(encoder)(flat).T]

    return logits


@encoder_rows.register
def _(encoder: ConstantEncoder, matrix: bool = False):
    return lambda features: [jnp.zeros_like(features[0])] * encoder.outputs


@encoder_rows.register
def _(encoder: PaperEncoder, matrix: bool = False):
    plain = encoder_rows.dispatch(object)(encoder)

    def logits(features: Rows) -> list[Array]:
        if features[0].size < _FEW:
            return plain(features)
        found = paper_logits(encoder, jnp.stack([f.reshape(-1) for f in features]))
        return [row.reshape(features[0].shape) for row in found] + [jnp.zeros_like(features[0])]

    return logits


@encoder_rows.register
def _(encoder: CompactEncoder, matrix: bool = False):
    n, memories, e = encoder.order, encoder.bounds.shape[1] - encoder.order, encoder
    past = [0, *range(n, n + fast_memories(memories))]
    moving = list(range(n if e.frugal else n + memories))
    seen_by = [(e.spring, [0]), (e.damping, moving), (e.past, past)]
    nets = _nets([(net, columns) for net, columns in seen_by if net is not None], matrix)

    def logits(features: Rows) -> list[Array]:
        low, high = e.bounds.astype(features[0].dtype)
        seen = [jnp.clip(f, low[i], high[i]) for i, f in enumerate(features)]
        state, memory, x = seen[:n], seen[n:], seen[0]
        found = iter(nets(seen))
        powers = [x, x * x, x * x * x]
        first, last = (_sum(e.spring_poly, powers, at, o) for o, at in enumerate(next(found)))
        products = [*state, *(state[i] * state[k] for i, k in zip(*np.triu_indices(n), strict=True))]
        damping = next(found) if e.damping is not None else []
        middle = [_sum(e.damping_poly, products, at, o) for o, at in enumerate(damping)]
        (offset,) = next(found) if e.past is not None else [jnp.zeros_like(x)]
        for k, row in enumerate(memory[: len(e.fading)]):
            offset = offset + (e.fading[k, 0] + e.fading[k, 1] * x + e.fading[k, 2] * powers[1]) * row
        raw = [first, *middle, last]
        if e.coupling is None:
            return [*raw, offset]
        common = jnp.exp(_sum(e.coupling[None], powers, jnp.zeros_like(x), 0))
        for k in np.flatnonzero(shared_by(n)):
            raw[k] = logit_of(positive_factor(raw[k]) * common)
        return [*raw, offset * common]

    return logits


def _sum(weights: Array, rows: Rows, start, at: int):
    """Start + sum_k weights_{at, k} rows_k; one index into the array, since a slice of it would be a kernel."""
    for k, row in enumerate(rows):
        start = start + weights[at, k] * row
    return start


def _nets(nets: list, matrix: bool) -> Callable[[Rows], list[list[Array]]]:
    """fn(rows): outputs of several one-layer nets, each seeing its own columns of the features."""
    if matrix or nets[0][0].hidden.out_features > _WRITTEN_OUT:
        return _side_by_side(nets)

    def outputs(rows: Rows) -> list[list[Array]]:
        found = []
        for net, columns in nets:
            mine, (weight, bias) = [rows[c] for c in columns], (net.hidden.weight, net.hidden.bias)
            hidden = [jnp.tanh(_sum(weight, mine, bias[j], j)) for j in range(len(bias))]
            weight, bias = net.readout.weight, net.readout.bias
            found.append([_sum(weight, hidden, bias[o], o) for o in range(len(bias))])
        return found

    return outputs


def _side_by_side(nets: list) -> Callable[[Rows], list[list[Array]]]:
    """The same with all nets in one hidden matrix and one block-diagonal readout."""
    features = 1 + max(c for _, columns in nets for c in columns)
    hidden = jnp.concatenate(
        [
            jnp.zeros((net.hidden.out_features, features), net.hidden.weight.dtype)
            .at[:, jnp.array(c)]
            .set(net.hidden.weight)
            for net, c in nets
        ]
    )
    readout = jax.scipy.linalg.block_diag(*(net.readout.weight for net, _ in nets))
    inner, outer = (jnp.concatenate([affine(get(net))[1] for net, _ in nets]) for get in (_hidden, _readout))
    sizes = np.cumsum([net.readout.out_features for net, _ in nets])

    def outputs(rows: Rows) -> list[list[Array]]:
        column = (-1,) + (1,) * rows[0].ndim
        made = jnp.tanh(jnp.tensordot(hidden, jnp.stack(rows[:features]), 1) + inner.reshape(column))
        found = list(jnp.tensordot(readout, made, 1) + outer.reshape(column))
        return [found[a:b] for a, b in zip([0, *sizes], sizes, strict=False)]

    return outputs


def _hidden(net) -> eqx.nn.Linear:
    return net.hidden


def _readout(net) -> eqx.nn.Linear:
    return net.readout


def tokens_rows(model: Model, logits: Rows) -> tuple[list[Array], Array]:
    """Scaled tokens sigma_0 ... sigma_n and the offset token of every instant (`Model.tokens_from`)."""
    n, factor = model.order, [positive_factor(row) for row in logits[:-1]]
    if n < 3:
        return [model.coefficients[i] * factor[i] for i in range(n + 1)], logits[-1]
    state, sections = (jnp.asarray(a, factor[0].dtype) for a in (model.scales.state, model.scales.sections))
    values = [row * s for row, s in zip(factor[:n], sections, strict=True)]
    lead = model.coefficients[n] * factor[n]
    return [lead * r * c for r, c in zip(state / state[n], _product(values), strict=True)], logits[-1]


def _product(values: list) -> list:
    """Ascending coefficients of the polynomial with these sections, as `sections.product`."""
    one = jnp.ones_like(values[0])
    poly, pairs = [one], [[*values[k : k + 2], one] for k in range(0, len(values) - 1, 2)]
    for section in pairs + ([[values[-1], one]] if len(values) % 2 else []):
        wide = [jnp.zeros_like(one)] * (len(poly) + len(section) - 1)
        for i, a in enumerate(poly):
            for k, b in enumerate(section):
                wide[i + k] = wide[i + k] + a * b
        poly = wide
    return poly


def force_rows(model: Model, features: Rows, equation: Rows) -> Array:
    """The scaled force every instant needs (eq. 13) from rows x, ..., x^(n), scaled."""
    tokens, force = tokens_rows(model, encoder_rows(model.encoder)(features))
    for token, row in zip(tokens, equation, strict=True):
        force = force + token * row
    return force


@singledispatch
def memory_rates(memory: AbstractMemory) -> Callable[[Rows, Array], list[Array]]:
    """fn(memories, x): their time derivatives in 1/s, row by row; what is constant is computed here, once."""
    rate = jax.vmap(memory.rate, (1, 0), 1)

    def rates(rows: Rows, x: Array) -> list[Array]:
        found = rate(jnp.stack([row.reshape(-1) for row in rows]), x.reshape(-1))
        return [row.reshape(x.shape) for row in found]

    return rates


@memory_rates.register
def _(memory: NoMemory):
    return lambda rows, x: []


@memory_rates.register
def _(memory: FadingMemory):
    inverse = jnp.exp(-memory.log_tau)
    return lambda rows, x: [(x - row) * inverse[k] for k, row in enumerate(rows)]

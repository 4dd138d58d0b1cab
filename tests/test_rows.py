"""Rows against one instant at a time or what was written down once more: logits, tokens and memory rates."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pitp_jax.method.model.encoder import AbstractEncoder, CompactEncoder, ConstantEncoder, PaperEncoder
from pitp_jax.method.model.memory import ElapsedTime, FadingMemory, NoMemory, RingingMemory
from pitp_jax.method.model.positive import positive_factor
from pitp_jax.method.model.relu_tables import tables

RINGING = RingingMemory(jnp.array(1.5), jnp.array(-2.0), jnp.array([-1.0, 0.5]))


class Odd(AbstractEncoder):
    """An encoder nobody wrote out."""

    def __call__(self, features, *, key=None):
        return jnp.stack([features.sum(), features[0] ** 2, jnp.cos(features[-1])])

    def scaled(self, factor):
        return self


def compact(order, memories, width, offset, shake, seed, frugal=False):
    low = -np.ones((1, order + memories))
    fresh = CompactEncoder(
        order, memories, width=width, offset=offset, frugal=frugal, bounds=np.concatenate([low, -1.5 * low]),
        key=jax.random.key(seed),
    )  # fmt: skip
    return shake(fresh, 0.3, seed)


CASES = (  # order, memories, width, offset, shape
    (1, 0, 3, True, (13,)),
    (2, 5, 8, True, (13,)),
    (2, 5, 8, True, (2, 3)),
    (3, 1, 40, True, (13,)),
    (4, 2, 2, False, ()),
    (2, 2, 3, False, (1,)),
)


@pytest.mark.parametrize("frugal", [False, True])
@pytest.mark.parametrize(("order", "memories", "width", "offset", "shape"), CASES)
def test_compact_logits(shake, order, memories, width, offset, shape, frugal):
    encoder = compact(order, memories, width, offset, shake, order, frugal)
    rows = np.random.default_rng(width).normal(0, 1, (order + memories, *shape)).astype(np.float32)
    found = jax.jit(lambda r: jnp.stack(encoder.over()(list(r))))(rows)
    truth = jax.jit(jax.vmap(encoder))(rows.reshape(len(rows), -1).T).T.reshape(order + 2, *shape)
    np.testing.assert_allclose(found, truth, rtol=0, atol=3e-6 * max(1, np.abs(truth).max()))


@pytest.mark.parametrize("encoder", [ConstantEncoder(4), Odd()])
def test_other_encoders(encoder):
    rows = jnp.asarray(np.random.default_rng(0).normal(0, 1, (3, 7)), jnp.float32)
    found, truth = jnp.stack(encoder.over()(list(rows))), jax.vmap(encoder)(rows.T).T
    np.testing.assert_allclose(found, truth, rtol=1e-6)


def paper(features, tokens, width, seed):
    """Random readouts: fresh ones are zero."""
    make = eqx.filter_jit(lambda key: PaperEncoder(features, tokens, width=width, key=key))
    fresh = make(jax.random.key(seed))
    weight = fresh.networks.readout.weight
    return eqx.tree_at(
        lambda e: e.networks.readout.weight, fresh, jax.random.normal(jax.random.key(seed), weight.shape)
    )


def _jitted(encoder, rows):
    return jax.jit(lambda r: jnp.stack(encoder.over()(list(r))))(rows)


@pytest.mark.slow
@pytest.mark.parametrize("instants", [5, 2300])
def test_paper_logits(instants):
    """Few instants take the plain way, many the tables, the last block of them padded."""
    encoder = paper(3, 2, 16, 1)
    rows = jnp.asarray(np.random.default_rng(1).normal(0, 2, (3, instants)), jnp.float32)
    found, truth = _jitted(encoder, rows), jax.jit(jax.vmap(encoder))(rows.T).T
    assert np.ptp(truth[0]) > 0.1
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-5 * np.abs(truth).max())


@pytest.mark.slow
def test_tables_are_for_cpus_alone():
    """Programs for a GPU, lowered here without one, look nothing up and hold the products instead."""
    encoder = paper(2, 1, 4, 1)
    made = jax.jit(lambda r: jnp.stack(encoder.over()(list(r))))
    rows = jnp.ones((2, 300), jnp.float32)
    text = {p: jax.export.export(made, platforms=[p])(rows).mlir_module() for p in ("cpu", "cuda")}
    assert "stablehlo.gather" in text["cpu"] and "stablehlo.gather" not in text["cuda"]
    assert "stablehlo.dot_general" in text["cuda"]


@pytest.mark.slow
def test_tables_are_exact_between_at_and_beyond_the_knots():
    """In float64, with a branch that has no slope and two that share a knot."""
    with jax.enable_x64(True):
        made = jax.tree.map(lambda a: a.astype(jnp.float64) if eqx.is_inexact_array(a) else a, paper(1, 1, 6, 2))
        branch = made.networks.branches
        weight = branch.weight.at[0, 0, :3, 0].set(jnp.array([0.0, 1.0, -2.0]))
        bias = branch.bias.at[0, 0, :3].set(jnp.array([0.7, 0.5, -1.0]))
        encoder = eqx.tree_at(lambda e: (e.networks.branches.weight, e.networks.branches.bias), made, (weight, bias))
        knots, slope, intercept = (np.asarray(a)[0, 0] for a in tables(encoder.networks))
        finite = knots[np.abs(knots) < 1e20]
        x = np.concatenate([finite, np.linspace(-5, 5, 101), [-1e4, 1e4]])
        at = np.searchsorted(knots, x)
        found = slope[at] * x[:, None] + intercept[at]
        fusion = np.asarray(encoder.networks.fusion.weight)[0]
        truth = np.maximum(np.asarray(weight)[0, 0, :, 0] * x[:, None] + np.asarray(bias)[0, 0], 0) @ fusion.T
    np.testing.assert_allclose(found, truth, rtol=1e-12, atol=1e-12)


def direct(model, logits):
    """The tokens at one instant, written down once more: the nominal's sections multiplied out by `jnp.polymul`."""
    factor, n = jax.vmap(positive_factor)(logits[:-1]), model.order
    if n < 3:
        return model.coefficients * factor, logits[-1]

    def polynomial(q):
        poly = jnp.ones(1)
        for k in range(0, n - 1, 2):
            poly = jnp.polymul(poly, jnp.array([1.0, q[k + 1], q[k]]))
        return (jnp.polymul(poly, jnp.array([1.0, q[-1]])) if n % 2 else poly)[::-1]

    nominal = jnp.asarray(model.scales.sections)
    return model.coefficients * factor[n] * polynomial(factor[:n] * nominal) / polynomial(nominal), logits[-1]


@pytest.mark.parametrize("order", [2, 3, 4])
def test_tokens(linear, order):
    model = linear(order)
    logits = jnp.asarray(np.random.default_rng(order).normal(0, 1.0, (order + 2, 9)), jnp.float32)
    tokens, offset = jax.jit(lambda rows: model.tokens_from(list(rows)))(logits)
    truth, truth_offset = jax.jit(jax.vmap(lambda row: direct(model, row)))(logits.T)
    np.testing.assert_allclose(jnp.stack(tokens), truth.T, rtol=2e-5)
    np.testing.assert_array_equal(offset, truth_offset)


@pytest.mark.slow
@pytest.mark.parametrize("memory", [ElapsedTime(3.0), FadingMemory(jnp.array([-1.0, 0.5])), RINGING])
@pytest.mark.parametrize("shape", [(), (4,)])
def test_memory_rates(memory, shape, double):
    """The slope of the exact trajectory at its beginning."""
    rng, dt = np.random.default_rng(0), 1e-5
    with jax.enable_x64(True):
        memory = double(memory)
        rows, x = jnp.asarray(rng.normal(0, 1, (memory.size, *shape))), jnp.asarray(rng.normal(0, 1, shape))
        found = memory.rate()(list(rows), x)
        path = jnp.broadcast_to(x.reshape(-1), (3, x.size))
        ran = jax.vmap(lambda x, m: memory.trajectory(x, dt, m), (1, 1), 2)(path, rows.reshape(memory.size, -1))
        slope = (-3 * ran[0] + 4 * ran[1] - ran[2]) / (2 * dt)
        assert len(found) == memory.size and all(row.shape == shape for row in found)
        np.testing.assert_allclose(jnp.stack(found).reshape(memory.size, -1), slope, rtol=1e-6, atol=1e-6)
    assert NoMemory().rate()([], x) == []

"""The row-wise rollout against the plain one."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typed import untyped

from pitp_jax import rest_state
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.encoder import PaperEncoder
from pitp_jax.method.model.memory import ElapsedTime
from pitp_jax.method.simulate.batched_rollout import fast_rollout, rows_rollout, steps_at_once
from pitp_jax.method.simulate.decoder import rollout, rollout_batch

DT, SAMPLES = 1e-3, 250


def runs(model, records):
    """Voltages, and starts of which the last moves."""
    t = np.arange(SAMPLES) * DT
    volts = np.stack([500 * np.sin((5 + r) * t) ** 2 + 30 * np.sin(90 * t) for r in range(records)])
    start = np.tile(np.asarray(rest_state(model)), (records, 1))
    start[-1, 0] = 0.2
    return jnp.asarray(volts, jnp.float32), jnp.asarray(start)


def lagging(model):
    return eqx.tree_at(lambda m: m.drive, model, ElectrodeLag(jnp.asarray(-5.5, jnp.float32)))


def with_elapsed(nonlinear):
    return eqx.tree_at(lambda m: m.memory, nonlinear(2, tau=(0.1,)), ElapsedTime(2.0))


CASES = {
    "one record": (lambda nl, lin: lagging(nl(2)), 1),
    "records, filled up": (lambda nl, lin: lagging(nl(2)), 6),
    "more records": (lambda nl, lin: nl(2), 19),
    "order 1": (lambda nl, lin: nl(1, substeps=2), 3),
    "order 3, zoh": (lambda nl, lin: nl(3, hold="zoh"), 2),
    "linear, bandlimited": (lambda nl, lin: lin(2, hold="bandlimited"), 2),
    "second mass": (lambda nl, lin: nl(2, ring=(60.0, 0.1)), 2),
    "frugal": (lambda nl, lin: nl(2, frugal=True), 2),
    "elapsed time": (lambda nl, lin: with_elapsed(nl), 2),
    "many substeps": (lambda nl, lin: lagging(nl(2, substeps=6)), 2),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_equals_the_plain_rollout(nonlinear, linear, case):
    make, records = CASES[case]
    model = make(nonlinear, linear)
    volts, start = runs(model, records)
    found, truth = fast_rollout(model, volts, DT, start), rollout_batch(model, volts, DT, start)
    assert found.shape == truth.shape
    assert np.ptp(truth[..., 0]) > 0.1
    np.testing.assert_allclose(found, truth, rtol=0, atol=5e-6 * np.abs(truth).max())


@pytest.mark.slow
def test_many_substeps_are_the_same_steps(nonlinear, monkeypatch):
    model = nonlinear(2, substeps=6)
    volts, start = runs(model, 1)
    scanned = rollout(model, volts[0], DT, start[0])
    monkeypatch.setattr("pitp_jax.method.simulate.decoder.UNROLLED", 6)
    np.testing.assert_allclose(scanned, rollout(model, volts[0], DT, start[0]), rtol=0, atol=1e-5)


@pytest.mark.slow
def test_several_samples_an_iteration_are_the_same_samples(nonlinear):
    """As on a GPU; 250 is not divisible by 16."""
    model = nonlinear(2)
    volts, start = runs(model, 2)
    one, many = (jax.jit(lambda k=k: rows_rollout(model, volts, DT, start, k))() for k in (1, 16))
    assert steps_at_once() == (1 if jax.default_backend() == "cpu" else 16)
    np.testing.assert_allclose(many, one, rtol=0, atol=2e-6 * np.abs(one).max())


@pytest.mark.slow
@pytest.mark.parametrize("part", ["effects", "encoder"])
def test_what_is_not_written_out_takes_the_plain_way(linear, monkeypatch, part):
    volts, start = runs(linear(2), 1)
    other = {"effects": (jnp.ones(()),), "encoder": PaperEncoder(2, 3, key=jax.random.key(0))}[part]
    model = eqx.tree_at(lambda m: getattr(m, part), linear(2), other)
    plain = jnp.zeros((*volts.shape, start.shape[1]))
    monkeypatch.setattr("pitp_jax.method.simulate.batched_rollout.rollout_batch", lambda *_: plain)
    assert untyped(fast_rollout).__wrapped__(model, volts, DT, start) is plain

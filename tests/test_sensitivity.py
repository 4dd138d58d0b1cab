"""Normal equations of free runs against automatic and finite differences of plain rollouts, in float64."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from normal import normal_equations
from typed import of_kind

from pitp_jax.method.effects import effect
from pitp_jax.method.fit.forward_sensitivity import Runs
from pitp_jax.method.fit.parameters import parameters, trainable, with_parameters
from pitp_jax.method.model.drive import DirectDrive, ElectrodeLag
from pitp_jax.method.model.encoder import CompactEncoder
from pitp_jax.method.model.memory import FadingMemory, NoMemory
from pitp_jax.method.simulate import ports
from pitp_jax.method.simulate.decoder import rest_state, rollout

DT, SAMPLES = 2e-3, 48
CASES = [(2, 1, "foh"), (2, 1, "zoh"), (3, 2, "foh")]


@pytest.fixture(scope="module")
def model(nonlinear):
    """fn(order, substeps, hold): every trained kind of number is there, and none is at a special value."""

    def make(order=2, substeps=1, hold="foh", size=0.3):
        made = nonlinear(order, key=order, size=size, tau=(0.015, 0.06, 0.3), dt=DT, substeps=substeps, hold=hold)
        return eqx.tree_at(lambda m: m.drive, made, ElectrodeLag(jnp.log(jnp.float32(5e-3))))

    return make


def runs_of(model, samples=SAMPLES):
    """One record from rest, one that starts moving; targets off the runs, weights of zero among the others."""
    rng = np.random.default_rng(4)
    moving = jnp.concatenate([jnp.asarray([0.4, -0.3, 0.2])[: model.order], jnp.full(model.memory.size, 0.3)])
    held = ports.initial(model, moving[0], jnp.zeros(()), 0.0)
    start = jnp.stack([rest_state(model), jnp.concatenate([moving, held]).astype(model.coefficients.dtype)])
    weight = rng.uniform(0.5, 2, (2, samples))
    weight[1, 5:9] = 0
    return Runs(
        start,
        jnp.asarray(rng.uniform(0, 1800, (2, samples)), start.dtype),
        jnp.asarray(rng.normal(0.3, 0.4, (2, samples)), start.dtype),
        jnp.asarray(weight, start.dtype),
    )


def root_residuals(model, runs, every=1):
    """Sqrt(every w) e at every `every`-th sample, from the plain decoder."""
    run = jax.vmap(lambda u, s: ports.readings(model, rollout(model, u, DT, s)))(runs.voltage, runs.start)
    last = runs.target.shape[1] // every * every
    error = jnp.sqrt(every * runs.weight) * (run - runs.target)
    return error[:, :last:every].ravel()


def against_the_plain_rollout(m, runs, vector):
    """Hold C, J'We and J'WJ against forward differentiation through the decoder's own scan; its J."""
    found = normal_equations(m, runs, DT, 1, vector)
    residuals = jax.jit(lambda v: root_residuals(with_parameters(m, v), runs))
    r = np.asarray(residuals(jnp.asarray(vector)))
    j = np.asarray(jax.jit(jax.jacfwd(residuals))(jnp.asarray(vector)))
    assert found.cost == pytest.approx(r @ r, rel=1e-12)
    np.testing.assert_allclose(found.gradient, j.T @ r, rtol=0, atol=1e-10 * np.abs(j.T @ r).max())
    np.testing.assert_allclose(found.hessian, j.T @ j, rtol=0, atol=1e-10 * np.abs(j.T @ j).max())
    return j


@pytest.mark.slow
@pytest.mark.parametrize(("order", "substeps", "hold"), CASES)
def test_normal_equations_are_those_of_the_plain_rollout(model, double, order, substeps, hold):
    """Every trained kind of number, at every order, with and without substeps."""
    with jax.enable_x64(True):
        m = double(model(order, substeps, hold))
        runs = runs_of(m)
        vector, counts = parameters(m)
        assert counts[1:].tolist() == [3, 1, 0] and counts.sum() == len(vector)
        j = against_the_plain_rollout(m, runs, vector)
    assert (np.abs(j[:, -4:]).max(0) > 1e-4).all()  # memories and the drive do move the run
    assert (np.abs(j).max(0) > 0).mean() > 0.9


@pytest.mark.slow
def test_effects_are_trained_along(model, double):
    """A delay, a drag and a sensor's lag: their columns too, in logarithms, against the plain rollout's."""
    with jax.enable_x64(True):
        parts = effect("delay", time=3.1e-3), effect("drag", c=0.4), effect("sensor_lag", tau=7e-3)
        m = double(replace(model(2, 2), effects=parts))
        runs = runs_of(m)
        vector, counts = parameters(m)
        assert counts[1:].tolist() == [3, 1, 3]
        np.testing.assert_allclose(vector[-3:], np.log([3.1e-3, 0.4, 7e-3]), rtol=1e-6)
        j = against_the_plain_rollout(m, runs, vector)
    assert (np.abs(j[:, -3:]).max(0) > 1e-4).all()


@pytest.mark.slow
@pytest.mark.parametrize(("order", "substeps"), [(2, 2), (3, 1)])
def test_the_gradient_is_that_of_the_cost(model, double, order, substeps):
    """Central differences of C alone, so that a wrong C with a matching J would show; along every fifth number."""
    with jax.enable_x64(True):
        m = double(model(order, substeps))
        runs = runs_of(m)
        vector, _ = parameters(m)
        found = normal_equations(m, runs, DT, 1, vector)
        some = [*range(0, len(vector), 5), *range(len(vector) - 4, len(vector))]
        step = 1e-5 * np.eye(len(vector))[some]
        cost = jax.jit(jax.vmap(lambda v: jnp.sum(root_residuals(with_parameters(m, v), runs) ** 2)))
        up, down = (np.asarray(cost(jnp.asarray(vector + sign * step))) for sign in (1, -1))
    slope = (up - down) / 2e-5
    np.testing.assert_allclose(2 * found.gradient[some], slope, rtol=1e-5, atol=1e-6 * np.abs(slope).max())


@pytest.mark.slow
def test_thinned_errors(model, double):
    """Every seventh sample counts seven times; the incomplete last block is left out."""
    with jax.enable_x64(True):
        m = double(model())
        runs = runs_of(m)
        found = normal_equations(m, runs, DT, 7, parameters(m)[0])
        r = np.asarray(root_residuals(m, runs, 7))
        assert found.cost == pytest.approx(r @ r, rel=1e-12)


@pytest.mark.slow
def test_float32_is_enough_for_a_step(model, double):
    """As training runs: cost, gradient and H of 400 samples within 1e-3 of float64."""
    single = model(size=0.1)
    found = normal_equations(single, runs_of(single, 400), DT, 1, parameters(single)[0])
    with jax.enable_x64(True):
        m = double(single)
        runs = jax.tree.map(lambda a: a.astype(jnp.float64), runs_of(single, 400))
        truth = normal_equations(m, runs, DT, 1, parameters(m)[0])
    assert found.cost == pytest.approx(truth.cost, rel=1e-3)
    np.testing.assert_allclose(found.gradient, truth.gradient, rtol=0, atol=1e-3 * np.abs(truth.gradient).max())
    scale = np.sqrt(np.outer(np.diag(truth.hessian), np.diag(truth.hessian))) + 1e-12
    np.testing.assert_allclose(found.hessian / scale, truth.hessian / scale, rtol=0, atol=2e-3)


@pytest.mark.slow
def test_parameters_go_round(model):
    """Out and in again: nothing but the trained numbers moves, the encoder's bounds among what stays."""
    m = model(3)
    vector, counts = parameters(m)
    same = with_parameters(m, vector)
    assert jax.tree.structure(same) == jax.tree.structure(m)
    for a, b in zip(jax.tree.leaves(same), jax.tree.leaves(m), strict=True):
        np.testing.assert_array_equal(a, b)
    moved = with_parameters(m, vector + 1)
    encoder, its = (of_kind(CompactEncoder, v.encoder) for v in (m, moved))
    np.testing.assert_array_equal(moved.coefficients, m.coefficients)
    np.testing.assert_array_equal(its.bounds, encoder.bounds)
    np.testing.assert_allclose(its.fading, encoder.fading + 1, rtol=1e-6)
    for kind, part in ((FadingMemory, "memory"), (ElectrodeLag, "drive")):
        lag, its_lag = (of_kind(kind, getattr(v, part)).log_tau for v in (m, moved))
        np.testing.assert_allclose(its_lag, lag + 1, rtol=1e-6)
    assert counts.tolist() == [len(vector) - 4, 3, 1, 0]


@pytest.mark.slow
def test_models_with_fewer_parts(model):
    """No memory, no drive, no encoder: the numbers that are there, down to none."""
    bare = eqx.tree_at(lambda m: m.drive, model(), DirectDrive())
    assert parameters(bare)[1].tolist()[1:] == [3, 0, 0]
    found = normal_equations(bare, runs_of(bare), DT, 1, parameters(bare)[0])
    assert found.hessian.shape == (len(found.gradient),) * 2 and np.isfinite(found.hessian).all()
    assert sum(jax.tree.leaves(trainable(replace(bare, memory=NoMemory())))) > 5


def test_trainable_is_told_per_leaf(model):
    spec = trainable(model())
    assert spec.coefficients is False and not any(jax.tree.leaves(spec.encoder.bounds))
    assert spec.encoder.fading is True and spec.memory.log_tau is True and spec.drive.log_tau is True

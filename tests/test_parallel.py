"""Newton over the whole trajectory against the plain loop and the sequential rollout."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pitp_jax._model.drive import ElectrodeLag
from pitp_jax._simulate import parallel_in_time
from pitp_jax._simulate.decoder import rest_state, rollout
from pitp_jax._simulate.parallel_in_time import affine_scan, parallel_rollout, rollout_by_size, suits

DT = 1e-3


def voltage(size, count=600):
    t = np.arange(count) * DT
    return size * np.sin(2 * np.pi * 1.3 * t) ** 2 * (1 + 0.3 * np.sin(40 * t))


@settings(max_examples=8, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_scan_of_affine_maps_equals_the_loop(seed):
    rng, n = np.random.default_rng(seed), 3
    matrix, offset, start = rng.standard_normal((37, n, n)) / n, rng.standard_normal((37, n)), rng.standard_normal(n)
    states = [start]
    for a, b in zip(matrix, offset, strict=True):
        states.append(a @ states[-1] + b)
    with jax.enable_x64(True):
        found = jax.jit(affine_scan)(jnp.asarray(matrix), jnp.asarray(offset), jnp.asarray(start))
    np.testing.assert_allclose(found, np.stack(states), rtol=0, atol=1e-12 * np.abs(states).max())


@pytest.mark.slow
def test_equals_the_rollout(nonlinear):
    model = nonlinear(2, size=0.3)
    u, start = jnp.asarray(voltage(500.0), jnp.float32), rest_state(model)
    found, truth = parallel_rollout(model, u, DT, start), rollout(model, u, DT, start)
    assert bool(found.converged)
    assert 2 <= int(found.iterations) <= 6
    np.testing.assert_allclose(found.states, truth, rtol=0, atol=1e-4 * np.abs(truth).max())


@pytest.mark.slow
def test_equals_the_rollout_in_double_with_a_lag_and_a_moving_start(nonlinear, double):
    with jax.enable_x64(True):
        lag = ElectrodeLag(jnp.asarray(np.log(5e-3)))
        model = eqx.tree_at(lambda m: m.drive, double(nonlinear(3, size=0.3)), lag)
        start = rest_state(model).at[0].set(0.3)
        u = jnp.asarray(voltage(500.0))
        found, truth = parallel_rollout(model, u, DT, start), rollout(model, u, DT, start)
    assert bool(found.converged)
    np.testing.assert_allclose(found.states, truth, rtol=0, atol=1e-10 * np.abs(truth).max())


@pytest.mark.slow
def test_a_linear_model_needs_no_iteration_but_the_last(linear):
    model = linear(2)
    u = jnp.asarray(voltage(900.0), jnp.float32)
    assert int(parallel_rollout(model, u, DT, rest_state(model)).iterations) == 1


def test_damping_finds_what_newton_alone_runs_away_from(nonlinear):
    """A spring that hardens by half: more iterations than Newton's few, the same states."""
    model = nonlinear(2)
    u, start = jnp.asarray(voltage(850.0), jnp.float32), rest_state(model)
    found, truth = parallel_rollout(model, u, DT, start), rollout(model, u, DT, start)
    assert bool(found.converged)
    assert int(found.iterations) > 10
    np.testing.assert_allclose(found.states, truth, rtol=0, atol=1e-4 * np.abs(truth).max())


def test_what_does_not_converge_is_rolled_out(nonlinear, monkeypatch):
    """A residual that no iterate can meet: the sequential rollout answers."""
    model = nonlinear(2)
    u, start = jnp.asarray(voltage(500.0), jnp.float32)[None], rest_state(model)[None]
    lost = parallel_in_time.Parallel(jnp.full((600, 4), jnp.nan), jnp.array(60), jnp.array(False))
    monkeypatch.setattr(parallel_in_time, "suits", lambda *_: True)
    monkeypatch.setattr(parallel_in_time, "parallel_rollout", lambda *_: lost)
    found = rollout_by_size(model, u, DT, start)
    truth = rollout(model, u[0], DT, start[0])
    np.testing.assert_allclose(found[0], truth, rtol=0, atol=1e-5 * np.abs(truth).max())


def test_chosen_by_size_and_backend(nonlinear, monkeypatch):
    assert suits(1, 120_000, "gpu") and not suits(1024, 10_000, "gpu") and not suits(1, 500, "gpu")
    assert not suits(1, 10**8, "cpu")
    model = nonlinear(2)
    u, start = jnp.asarray(np.stack([voltage(400.0), voltage(500.0)]), jnp.float32), jnp.tile(rest_state(model), (2, 1))
    one_way = rollout_by_size(model, u, DT, start)
    monkeypatch.setattr(parallel_in_time, "suits", lambda *_: True)
    np.testing.assert_allclose(rollout_by_size(model, u, DT, start), one_way, rtol=0, atol=1e-4 * np.abs(one_way).max())

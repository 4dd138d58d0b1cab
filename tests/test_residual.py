"""The loss against closed forms, and tokens that cannot change sign."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pitp_jax import Model
from pitp_jax.method.model.equation import equation_force
from pitp_jax.method.model.positive import logit_of, positive_factor
from pitp_jax.method.train.equation_error import EquationData, huber, loss

KEY = jax.random.key(1)
BOX = (jnp.float32(0.8), jnp.float32(1.2))


@eqx.filter_jit
def data_of(model, count=200, key=KEY):
    """Random instants, and the force the model itself needs there."""
    n, keys = model.order, jax.random.split(key, 2)
    features = jax.random.normal(keys[0], (count, n + model.memory.size))
    highest = jax.random.normal(keys[1], (count, 1))
    equation = jnp.concatenate([features[:, :n], highest], -1)
    force = jax.vmap(lambda f, x: equation_force(model, model.encoder(f), x)[0])(features, equation)
    return EquationData(features, equation, force, jnp.ones(count))


@pytest.mark.parametrize("order", [1, 2, 3])
def test_exact_data_of_the_nominal_costs_nothing(linear, order):
    model = linear(order)
    total, (_, constraint) = eqx.filter_jit(loss)(model, data_of(model), BOX, width=0.05, penalty=(1.0, 1.0))
    assert float(constraint) == 0.0
    assert float(total) < 1e-10
    numbers = data_of(model)
    truth = np.asarray(numbers.equation, np.float64) @ np.asarray(model.coefficients, np.float64)
    np.testing.assert_allclose(numbers.force, truth, rtol=0, atol=1e-5)


def test_a_wrong_force_costs_its_huber(linear):
    model = linear(2)
    data = data_of(model)
    shifted = EquationData(
        data.features, data.equation, data.force + jnp.where(data.force > 0, 0.3, -0.02), data.weight
    )
    share = float((data.force > 0).mean())
    truth = share * (0.3 - 0.05) + (1 - share) * 0.02**2 / (2 * 0.1)
    assert float(loss(model, shifted, BOX, width=0.1, penalty=(0.0, 0.0))[0]) == pytest.approx(truth, rel=1e-4)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_box_penalty(linear, monkeypatch, sign):
    """Factors 1.5, 0.7 and 1: (2 * 0.3 + 3 * 0.1) / 3, for negative coefficients too."""
    model = eqx.tree_at(lambda m: m.coefficients, linear(2), sign * linear(2).coefficients)
    factors = jnp.array([1.5, 0.7, 1.0])
    moved = list(model.coefficients * factors)
    monkeypatch.setattr(Model, "tokens_from", lambda self, logits: (moved, jnp.float32(0.0)))
    _, (_, constraint) = loss(model, data_of(model), BOX, width=1.0, penalty=(2.0, 3.0))
    assert float(constraint) == pytest.approx((2 * 0.3 + 3 * 0.1) / 3, rel=1e-5)


@pytest.mark.parametrize(("residual", "truth"), [(0.0, 0.0), (0.1, 0.025), (-0.1, 0.025), (0.2, 0.1), (-3.0, 2.9)])
def test_huber_width_one_fifth(residual, truth):
    """R^2 / 0.4 inside 0.2, |r| - 0.1 outside."""
    assert float(huber(jnp.float32(residual), 0.2)) == pytest.approx(truth, abs=1e-6)


def test_huber_joins_smoothly():
    slope = jax.grad(lambda r: huber(r, 0.2))
    for edge in (-0.2, 0.2):
        assert float(slope(edge * (1 - 1e-4))) == pytest.approx(float(slope(edge * (1 + 1e-4))), abs=1e-3)
        assert float(slope(edge)) == pytest.approx(np.sign(edge), abs=1e-6)


@pytest.fixture(scope="module")
def wild(nonlinear):
    model = nonlinear(2, key=0, size=3.0)
    return model, eqx.filter_jit(jax.vmap(lambda f: model.tokens(f)[0]))


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.sampled_from([1.0, 10.0, 100.0]))
def test_tokens_keep_their_sign(wild, seed, reach):
    """Tokens of a wild encoder anywhere in feature space are positive and finite, so every step is solvable."""
    model, read = wild
    features = reach * jax.random.normal(jax.random.key(seed), (64, 4))
    tokens = read(features)
    assert bool((tokens * jnp.sign(model.coefficients) > 0).all())
    assert bool(jnp.isfinite(1 / tokens).all())


def test_positive_factor_is_smooth():
    """G(0) = 1 with slope 1, value and slope continuous at -1/2, positive and increasing everywhere."""
    slope = jax.grad(positive_factor)
    assert float(positive_factor(jnp.float32(0.0))) == 1.0
    assert float(slope(0.0)) == 1.0
    with jax.enable_x64(True):
        below, above = -0.5 - 1e-9, -0.5 + 1e-9
        assert float(positive_factor(jnp.float64(below))) == pytest.approx(0.5, abs=1e-8)
        assert float(positive_factor(jnp.float64(above))) == pytest.approx(0.5, abs=1e-8)
        assert float(slope(jnp.float64(below))) == pytest.approx(1.0, abs=1e-7)
        assert float(slope(jnp.float64(above))) == pytest.approx(1.0, abs=1e-7)
    grid = positive_factor(jnp.linspace(-1e4, 1e4, 10_001))
    assert float(grid.min()) > 0
    assert bool((jnp.diff(grid) > 0).all())
    assert bool(jnp.isfinite(jax.vmap(slope)(jnp.linspace(-3, 3, 601))).all())


def test_every_positive_factor_has_its_logit():
    factors = jnp.asarray([1e-3, 0.1, 0.4999, 0.5, 0.5001, 1.0, 36.0])
    np.testing.assert_allclose(positive_factor(logit_of(factors)), factors, rtol=1e-6)
    assert float(logit_of(jnp.float32(1.0))) == 0.0

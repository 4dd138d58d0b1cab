"""Sections: the nominal's factors and back, stable whatever positive numbers they are multiplied by."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pitp_jax.method.model.sections import product, sections_of

ORDERS = (3, 4, 5, 6)


def stable(rng, order, pairs):
    """Coefficients a_0 ... a_n of random stable roots, `pairs` of them complex, of the order of 50 rad/s."""
    w, damping = 50 * np.exp(rng.uniform(-1, 1, pairs)), rng.uniform(0.02, 0.95, pairs)
    roots = np.concatenate([
        w * (-damping + 1j * np.sqrt(1 - damping**2)),
        w * (-damping - 1j * np.sqrt(1 - damping**2)),
        -50 * np.exp(rng.uniform(-2, 2, order - 2 * pairs)),
    ])  # fmt: skip
    return np.exp(rng.uniform(10, 20)) * np.real(np.poly(roots))[::-1]


@pytest.mark.parametrize("order", ORDERS)
def test_sections_multiply_to_the_polynomial(order):
    rng = np.random.default_rng(order)
    with jax.enable_x64(True):
        for pairs in [p for p in range(order // 2 + 1) for _ in range(5)]:
            a = stable(rng, order, pairs)
            sections = sections_of(a)
            assert len(sections) == order and min(sections) > 0
            np.testing.assert_allclose(a[-1] * np.array(product(list(sections))), a, rtol=1e-9)


def test_one_known_product():
    """(s^2 + 2 s + 5) (s^2 + 3 s + 2) (s + 7): the slowest pair first, real roots paired from the slowest."""
    a = np.polymul(np.polymul([1, 2, 5], [1, 3, 2]), [1, 7])[::-1]
    np.testing.assert_allclose(sections_of(a), [2, 3, 5, 2, 7], rtol=1e-9)
    np.testing.assert_allclose(product([2.0, 3.0, 5.0, 2.0, 7.0]), a, rtol=1e-6)


@pytest.mark.parametrize("order", [3, 4, 5])
def test_a_root_of_multiplicity_n_is_split_and_joined(order):
    """np.roots scatters it by eps^(1/n) into the complex plane; the product still is the polynomial."""
    a = np.poly(np.full(order, -20.0))[::-1]
    with jax.enable_x64(True):
        np.testing.assert_allclose(product(sections_of(a)), a, rtol=1e-9)


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(order=st.sampled_from(ORDERS), seed=st.integers(0, 10**6), spread=st.floats(0.0, 4.0))
def test_any_positive_factors_are_stable(order, seed, spread):
    """Factors up to exp(4) = 55."""
    rng = np.random.default_rng(seed)
    sections = np.asarray(sections_of(stable(rng, order, int(rng.integers(order // 2 + 1)))))
    with jax.enable_x64(True):
        poly = np.asarray(product(list(sections * np.exp(spread * rng.uniform(-1, 1, order)))))
    assert np.roots(poly[::-1]).real.max() < 0


@pytest.mark.parametrize("order", ORDERS)
def test_factors_on_the_tokens_would_not_be(order):
    """Why there are sections: the tokens of stable polynomials, each times a factor between 1/e and e."""
    rng, lost = np.random.default_rng(1), 0
    for _ in range(200):
        a = stable(rng, order, order // 2)
        lost += np.roots((a * np.exp(rng.uniform(-1, 1, order + 1)))[::-1]).real.max() > 0
    assert lost > 10


@pytest.mark.parametrize("order", [1, 2, *ORDERS])
def test_zero_logits_are_the_coefficients(linear, double, order):
    """To the rounding of either precision; exactly where there are no sections."""
    model = linear(order)
    read = eqx.filter_jit(lambda m, at: m.tokens(at))
    tokens, offset = read(model, jnp.zeros(order))
    np.testing.assert_allclose(tokens, model.coefficients, rtol=3e-6 if order > 2 else 0)
    assert float(offset) == 0
    with jax.enable_x64(True):
        tokens, _ = read(double(model), jnp.zeros(order))
        np.testing.assert_allclose(tokens, double(model).coefficients, rtol=1e-11)


@pytest.mark.parametrize("order", [2, *ORDERS])
def test_changed_coefficients_are_the_tokens(linear, order):
    """Each of them, also where tokens are made of sections: else a refit changes nothing but the gain."""
    factors = np.linspace(0.9, 1.2, order + 1)
    model = linear(order)
    tokens, _ = eqx.filter_jit(lambda m, at: m.tokens(at))(model.changed(factors), jnp.zeros(order))
    np.testing.assert_allclose(tokens, np.asarray(model.coefficients) * factors, rtol=3e-6)


@pytest.mark.parametrize("order", [3, 4, *(pytest.param(n, marks=pytest.mark.slow) for n in (5, 6))])
def test_the_tokens_of_any_encoder_are_stable(nonlinear, order):
    """A wild encoder (logits of several units, both branches of the positive factor) anywhere in feature space."""
    model = nonlinear(order, size=2.0)
    features = jax.random.normal(jax.random.key(order), (100, order + 2))
    tokens = np.asarray(eqx.filter_jit(jax.vmap(lambda f: model.tokens(f)[0]))(features), np.float64)
    physical = tokens / np.asarray(model.scales.state)
    ratio = tokens / np.asarray(model.coefficients)
    assert ratio.min() < 0.5 and ratio.max() > 2  # they do vary
    assert max(np.roots(row[::-1]).real.max() for row in physical) < 0


def test_low_orders_have_no_sections(linear):
    assert len(linear(1).scales.sections) == len(linear(2).scales.sections) == 0
    assert len(linear(3).scales.sections) == 3

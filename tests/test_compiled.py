"""`simulate.free_runs`, the door of all free runs without a gradient, beside loops in NumPy and closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from pitp_jax.method.simulate.free_runs import BLOCK, CHUNK, free_runs

pytestmark = pytest.mark.usefixtures("code_of_users")

RNG = np.random.default_rng(3)


def softening(p, s, u):
    """A lag whose speed falls with its state, with two outputs."""
    after = s + jnp.stack([p[0] * (u - s[0]) / (1 + s[1] ** 2), p[1] * (s[0] - s[1])])
    return after, jnp.stack([s[0], s[1] * u])


def pulled(p, s, u):
    """A step whose input is an array: two numbers for every time step."""
    return s + p * (u[0] - s) + u[1], s[0]


def test_runs_equal_a_loop_in_numpy():
    """More runs than a block and more steps than a call; every run has its parameters, start and input."""
    runs, n = BLOCK + 3, CHUNK + 7
    p, s, u = RNG.uniform(0.01, 0.3, (runs, 2)), RNG.normal(size=(runs, 2)), RNG.normal(size=(3, n))
    column = RNG.integers(0, 3, runs)
    y = free_runs(softening, p, s, u, column)
    assert y.shape == (runs, n, 2) and y.dtype == np.float64
    (a, b), truth = s.T.copy(), np.empty_like(y)
    for t in range(n):
        now = u[column, t]
        truth[:, t] = np.stack([a, b * now], 1)
        a, b = a + p[:, 0] * (now - a) / (1 + b**2), b + p[:, 1] * (a - b)
    np.testing.assert_allclose(y, truth, rtol=0, atol=1e-13)


def test_a_linear_step_equals_its_exponential():
    """s_{t+1} = E s_t from a start alone: s_t = exp(A h t) s_0."""
    a, h, n = np.array([[0.0, 1.0], [-40.0, -0.8]]), 2e-3, 400
    start = RNG.normal(size=(4, 2))

    def step(p, s, u):
        return p.reshape(2, 2) @ s, s

    y = free_runs(step, np.tile(expm(a * h).ravel(), (4, 1)), start, np.zeros((1, n)), np.zeros(4, int))
    truth = np.stack([start @ expm(a * h * t).T for t in range(n)], 1)
    np.testing.assert_allclose(y, truth, rtol=0, atol=1e-11)


def test_an_input_may_be_several_numbers():
    u = RNG.normal(size=(2, 50, 2))
    y = free_runs(pulled, np.full((1, 1), 0.1), np.zeros((1, 1)), u, np.array([1]))
    s, truth = 0.0, []
    for first, second in u[1]:
        truth.append(s)
        s += 0.1 * (first - s) + second
    np.testing.assert_allclose(y[0, :, 0], truth, rtol=0, atol=1e-14)


def test_a_diverging_run_leaves_the_others_alone():
    def step(p, s, u):
        return s + p * (u + s * s), s

    p, u = np.array([[0.01], [0.9], [0.002]]), np.ones((1, 60))
    y = free_runs(step, p, np.zeros((3, 1)), u, np.zeros(3, int))
    assert not np.isfinite(y[1]).all() and np.isfinite(y[[0, 2]]).all()
    np.testing.assert_array_equal(y[[0, 2]], free_runs(step, p[[0, 2]], np.zeros((2, 1)), u, np.zeros(2, int)))

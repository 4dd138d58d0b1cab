"""Levenberg-Marquardt with geodesic acceleration against scipy, closed forms and the plain method."""

from itertools import islice

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from pitp_jax.method.fit import minimise
from pitp_jax.method.fit.minimise import accelerated

TIME = np.linspace(0, 3, 200)
TRUTH = np.array([1.3, -0.9, 1.8, 0.7])


def wave(p):
    """Amplitude, log of a decay rate, log of a frequency and an offset."""
    return p[0] * np.exp(-np.exp(p[1]) * TIME) * np.cos(np.exp(p[2]) * TIME) + p[3]


MEASURED = wave(TRUTH) + 0.05 * np.random.default_rng(3).standard_normal(len(TIME))


def decay(p):
    return wave(p) - MEASURED


def valley(p):
    """Rosenbrock's, as narrow as 1:100."""
    return np.array([100 * (p[1] - p[0] ** 2), 1 - p[0]])


def slopes_of(errors):
    """Central differences, one block."""

    def slopes(p):
        return [np.stack([(errors(p + d) - errors(p - d)) / 2e-6 for d in 1e-6 * np.eye(len(p))], -1)]

    return slopes


def walk(errors, start, count=100):
    """All that is yielded, `count` steps at most."""
    return list(islice(accelerated(lambda p: [errors(p)], slopes_of(errors), np.asarray(start, float)), count + 1))


@pytest.mark.parametrize("start", [[1.0, 0.0, 1.7, 0.0], [3.0, -2.0, 1.9, 2.0], [0.2, -0.5, 1.75, -1.0]])
def test_the_minimum_is_scipys(start):
    truth = least_squares(decay, start, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    params, cost, done = walk(decay, start)[-1]
    assert done and cost == pytest.approx(2 * truth.cost, rel=1e-9)
    np.testing.assert_allclose(params, truth.x, atol=1e-5)


def test_every_step_leads_down_and_costs_what_it_says():
    taken = walk(decay, [3.0, -2.0, 1.9, 2.0])
    costs = [cost for _, cost, _ in taken]
    assert (np.diff(costs[:-1]) < 0).all() and len(costs) > 3
    assert [done for *_, done in taken] == [False] * (len(taken) - 1) + [True]
    for params, cost, _ in taken:
        assert cost == pytest.approx(decay(params) @ decay(params), rel=1e-12)


def test_a_bent_valley_takes_fewer_jacobians(monkeypatch):
    """Than the same walk straight on, and than Nielsen's rule."""
    start = np.array([-1.2, 1.0])

    def normal(p):
        r, (j,) = valley(p), slopes_of(valley)(p)
        return minimise.Normal(float(r @ r), j.T @ r, j.T @ j)

    def jacobians():
        return next(k for k, (_, cost, _) in enumerate(walk(valley, start)) if cost < 1e-10)

    plain = next(k for k, (_, n, _) in enumerate(minimise.steps(normal, start, np.full(2, np.inf))) if n.cost < 1e-10)
    bent = jacobians()
    monkeypatch.setattr(minimise, "_BENT", 0.0)  # every turn is too sharp
    straight = jacobians()
    assert bent < 0.7 * straight and bent < 0.7 * plain


def test_a_linear_problem_has_no_bend():
    """Where r_vv = 0 the step is Levenberg's: the damped normal equations, in closed form, at the damping chosen."""
    rng = np.random.default_rng(1)
    matrix, side = rng.normal(size=(30, 4)), rng.normal(size=30)
    taken = walk(lambda p: matrix @ p - side, np.zeros(4), 3)
    truth = np.linalg.lstsq(matrix, side, rcond=None)[0]
    hessian = matrix.T @ matrix
    reached = [
        np.linalg.solve(
            hessian + minimise._FIRST_DAMPING * minimise._DAMPING_FACTOR**k * np.diag(np.diag(hessian)),
            matrix.T @ side,
        )
        for k in range(-30, 2)
    ]
    assert min(np.abs(taken[1][0] - r).max() for r in reached) < 1e-9
    np.testing.assert_allclose(taken[-1][0], truth, atol=1e-6)


def test_blocks_of_any_shape_add_up():
    """A matrix of float32 on the device and a row on the host are the same problem as one long row."""

    def parts(p):
        r = decay(p)
        return [np.asarray(jnp.asarray(r[:120].reshape(10, 12), jnp.float32)), r[120:]]

    def slopes(p):
        (j,) = slopes_of(decay)(p)
        return [jnp.asarray(j[:120].reshape(10, 12, 4), jnp.float32), j[120:]]

    found = [params for params, _, _ in islice(accelerated(parts, slopes, np.array([1.0, 0.0, 1.7, 0.0])), 8)]
    whole = [params for params, _, _ in walk(decay, [1.0, 0.0, 1.7, 0.0], 7)]
    np.testing.assert_allclose(found[1], whole[1], rtol=1e-3)
    np.testing.assert_allclose(found[-1], whole[-1], atol=1e-4)


def test_a_lost_start_is_told_once():
    taken = walk(lambda p: np.array([np.nan]), [1.0])
    assert len(taken) == 1 and np.isnan(taken[0][1])


def test_slopes_that_are_lost_end_it():
    found = list(accelerated(lambda p: [p - 1.0], lambda p: [np.full((1, 1), np.nan)], np.zeros(1)))
    assert [done for *_, done in found] == [False, True] and found[-1][1] == 1.0

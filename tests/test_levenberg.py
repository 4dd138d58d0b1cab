"""Levenberg-Marquardt against scipy on small problems: the same minimum, bounds kept, no step up."""

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from pitp_jax.method.fit.minimise import Descent, Normal, minimise, steps

TIME = np.linspace(0, 3, 200)
TRUTH = np.array([1.3, np.log(0.4), np.log(6.0), 0.7])
FREE = np.full(4, np.inf)


def decay(p):
    """Amplitude, log of a decay rate, log of a frequency and an offset."""
    return p[0] * np.exp(-np.exp(p[1]) * TIME) * np.cos(np.exp(p[2]) * TIME) + p[3]


DATA = decay(TRUTH) + 0.05 * np.random.default_rng(3).standard_normal(len(TIME))


def residual(p):
    return decay(p) - DATA


def jacobian(residual, p):
    return np.stack([(residual(p + h) - residual(p - h)) / 2e-6 for h in 1e-6 * np.eye(len(p))], -1)


def normal(residual):
    def at(p):
        r, j = residual(p), jacobian(residual, p)
        return Normal(float(r @ r), j.T @ r, j.T @ j)

    return at


@pytest.mark.parametrize("start", [[1.0, 0.0, 1.7, 0.0], [3.0, -2.0, 1.9, 2.0], [0.2, -0.5, 1.75, -1.0]])
def test_the_minimum_is_scipys(start):
    truth = least_squares(residual, start, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    found, converged = minimise(normal(residual), np.array(start), FREE)
    assert converged
    np.testing.assert_allclose(found, truth.x, rtol=0, atol=1e-5)
    assert np.sum(residual(found) ** 2) == pytest.approx(2 * truth.cost, rel=1e-9)


@pytest.mark.parametrize("bounded", [[1], [1, 2]])
def test_bounds_are_met_and_kept(bounded):
    """The free minimum lies above the bounds; scipy's trust region finds the same point on them."""
    upper = FREE.copy()
    upper[bounded] = TRUTH[bounded] - 0.05
    start = np.array([1.0, -1.5, 1.7, 0.0])
    seen = []

    def watched(p):
        seen.append(p)
        return normal(residual)(p)

    found, converged = minimise(watched, start, upper)
    truth = least_squares(residual, start, bounds=(-np.inf, upper), xtol=1e-13, ftol=1e-13, gtol=1e-13)
    assert converged
    assert (np.stack(seen) <= upper + 1e-12).all()
    np.testing.assert_allclose(found[bounded], upper[bounded], atol=1e-12)
    np.testing.assert_allclose(found, truth.x, rtol=0, atol=1e-4)


@pytest.mark.parametrize(("most", "converged"), [(2, False), (99, True)])
def test_the_answer_is_pythons_own_truth_value(most, converged):
    """A cost in NumPy's number makes comparisons in NumPy's kind, which the type of the result does not allow."""
    at, start = normal(residual), np.array([1.0, 0.0, 1.7, 0.0])
    found = minimise(lambda p: at(p)._replace(cost=np.float64(at(p).cost)), start, FREE, most=most)
    assert found[1] is converged


def test_a_start_above_a_bound_is_brought_back():
    upper = np.array([np.inf, -0.5, np.inf, np.inf])
    first, _, _ = next(steps(normal(residual), np.array([1.0, 3.0, 1.7, 0.0]), upper))
    assert first[1] == -0.5


def test_no_step_goes_up():
    """Rosenbrock's valley from its usual start: every cost below the last, down to zero, then told so."""

    def valley(p):
        return np.array([10 * (p[1] - p[0] ** 2), 1 - p[0]])

    walked = list(steps(normal(valley), np.array([-1.2, 1.0]), np.full(2, np.inf)))
    costs = [here.cost for _, here, _ in walked]
    assert (np.diff(costs)[:-1] < 0).all() and costs[-1] <= costs[-2]  # the last is told again, as converged
    assert [done for *_, done in walked].count(True) == 1 and walked[-1][2]
    np.testing.assert_allclose(walked[-1][0], [1, 1], atol=1e-6)
    assert len(walked) < 40


def test_the_start_is_told_first():
    p = np.array([1.0, 0.0, 1.7, 0.0])
    first, here, done = next(steps(normal(residual), p, FREE))
    np.testing.assert_array_equal(first, p)
    assert here.cost == pytest.approx(np.sum(residual(p) ** 2)) and not done


def test_a_linear_problem_takes_a_few_steps():
    """Each damped step leaves less than 1e-3 of the distance at first; columns of 1 and 1e-8 count alike."""
    rng = np.random.default_rng(1)
    matrix = rng.standard_normal((50, 3)) * np.array([1.0, 1e-8, 1e4])
    wanted = np.array([2.0, 3e8, 1e-4])
    walked = list(steps(normal_of(matrix, matrix @ wanted + rng.standard_normal(50)), np.zeros(3), np.full(3, np.inf)))
    assert walked[-1][2] and len(walked) < 8


def normal_of(matrix, data):
    def at(p):
        r = matrix @ p - data
        return Normal(float(r @ r), matrix.T @ r, matrix.T @ matrix)

    return at


def test_logarithms_move_by_two_at_most():
    """Parameters with a bound are logarithms: a long step of one is cut, and none without a bound is."""
    matrix, data = np.eye(2), np.array([-50.0, -50.0])
    for upper, longest in ((np.array([0.0, np.inf]), [2.0, 50.0]), (np.full(2, np.inf), [50.0, 50.0])):
        path = np.stack([p for p, *_ in steps(normal_of(matrix, data), np.zeros(2), upper)])
        np.testing.assert_allclose(np.abs(np.diff(path, axis=0)).max(0), longest, rtol=1e-2)
        np.testing.assert_allclose(path[-1], data, rtol=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_a_step_within_a_box_is_scipys(seed):
    """The damping is rows sqrt(lambda D) of zeros; what it predicts is the decrease of the cost without them."""
    rng, damping = np.random.default_rng(seed), 0.1
    matrix, data = rng.standard_normal((30, 3)) * [1.0, 5.0, 0.2], rng.standard_normal(30)
    free, _ = Descent(damping).step(normal_of(matrix, data)(np.zeros(3)), np.full(3, -np.inf), np.full(3, np.inf))
    ends = [-np.inf, free[1] - 1, -0.4 * abs(free[2])], [0.5 * abs(free[0]), np.inf, np.inf]
    step, expected = Descent(damping).step(normal_of(matrix, data)(np.zeros(3)), np.array(ends[0]), np.array(ends[1]))
    damped = np.concatenate([matrix, np.diag(np.sqrt(damping * np.sum(matrix**2, 0)))])
    truth = lsq_linear(damped, np.append(data, np.zeros(3)), ends, method="bvls", tol=1e-14).x
    np.testing.assert_allclose(step, truth, atol=1e-9)
    assert expected == pytest.approx(data @ data - np.sum((matrix @ step - data) ** 2))


def test_a_number_with_hardly_any_slope_keeps_still():
    """Its slope is rounding: with a share of the largest diagonal it moves by the damping's, not by its own unit."""
    here = Normal(1.0, np.array([-1.0, -1e-9]), np.diag([1.0, 1e-20]))
    steps = [Descent(1e-2).step(here, np.full(2, -np.inf), np.full(2, np.inf), least)[0] for least in (0.0, 1e-9)]
    assert steps[0][1] > 1e9 and steps[1][1] == pytest.approx(1e-9 / (1e-20 + 1e-2 * 1e-9), rel=1e-6)


def test_the_damping_follows_what_was_predicted():
    """Nielsen's: a tenth where the quadratic was right, the same at half of it, 2, 4, 8 times after steps up."""
    start = Descent(1.0)
    assert start.after(1.0, 1.0) == (True, Descent(0.1)) and start.after(0.5, 1.0) == (True, start)
    for factor in (2.0, 8.0, 64.0):
        accepted, start = start.after(-np.inf, 1.0)
        assert not accepted and start.damping == factor
    assert not Descent().after(np.nan, 1.0)[0] and not Descent().after(1.0, 0.0)[0]


def test_two_parameters_that_cannot_be_told_apart():
    """H is singular: the step is the smallest one, and the sum is found."""
    matrix = np.ones((20, 2))
    found, converged = minimise(normal_of(matrix, np.full(20, 3.0)), np.zeros(2), np.full(2, np.inf))
    assert converged
    np.testing.assert_allclose(found, [1.5, 1.5], atol=1e-6)


def test_a_start_that_is_not_finite_is_where_it_ends():
    walked = list(steps(lambda p: Normal(np.nan, np.zeros(2), np.eye(2)), np.zeros(2), np.full(2, np.inf)))
    assert len(walked) == 1 and not walked[0][2]
    assert not minimise(lambda p: Normal(np.inf, np.zeros(2), np.eye(2)), np.zeros(2), np.full(2, np.inf))[1]


def test_a_step_out_of_the_domain_is_taken_back():
    """log(p) = 1 from p = 20: the first full step ends at -20, where nothing is finite."""
    tried = []

    def logarithm(p):
        tried.append(float(p[0]))
        with np.errstate(invalid="ignore"):
            r, j = np.log(p) - 1, 1 / p[:, None]
        return Normal(float(r @ r), j.T @ r, j.T @ j)

    found, converged = minimise(logarithm, np.array([20.0]), np.full(1, np.inf))
    assert min(tried) < 0
    assert converged and found[0] == pytest.approx(np.e, rel=1e-5)

"""Where an identification starts: each guess alone, on the response of a known system."""

import numpy as np
import pytest
from scipy.signal import lsim

from pitp_jax._identify.beginnings import find_beginnings
from pitp_jax._identify.initial_guess import equation_error_roots, linear_start, peak_roots
from pitp_jax._identify.output_error import build_problem, residual
from pitp_jax._record.record import Record

DT, SAMPLES = 2e-3, 1500
TIME = np.arange(SAMPLES) * DT
SWEEP = 1000 * (1 - np.cos(2 * np.pi * (0.2 * TIME + 2 * TIME**2)))


def record(a, start=0, offset=0.0):
    """Without noise; from `start` on, where it moves."""
    x = lsim(([1.0], a[::-1]), SWEEP**2, TIME)[1] + offset
    return Record("r", TIME[start:], SWEEP[start:], x[start:])


def problem_of(*records):
    return build_problem(records, "square", find_beginnings(records, "square")[0])


def sorted_roots(a):
    return np.sort_complex(np.roots(a[::-1]))


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_equation_errors_roots_are_the_systems(coefficients, order):
    a = coefficients(order)
    problem = problem_of(record(a))
    roots = equation_error_roots([record(a)], order, problem)
    assert roots is not None
    found = np.sort_complex(roots) * problem.omega
    np.testing.assert_allclose(found, sorted_roots(a), rtol=0.05)


def test_too_few_samples_give_no_roots(coefficients):
    a = coefficients(2)
    problem = problem_of(record(a))
    blind = record(a)
    blind.displacement[10:] = np.nan
    assert equation_error_roots([blind], 2, problem) is None


@pytest.mark.parametrize("order", [1, 2, 4])
def test_the_peak_is_the_resonance(coefficients, order):
    problem = problem_of(record(coefficients(2)))
    found = np.asarray(peak_roots(problem, order), complex)
    w = 2 * np.pi * 5.0 / problem.omega
    assert len(found) == order and (np.real(found) < 0).all()
    assert np.sort(np.abs(found))[0] == pytest.approx(w, rel=0.1)
    others = np.sort(np.abs(found))[2:] / np.sort(np.abs(found))[0]
    np.testing.assert_allclose(others, [4.0, 8.0][: len(others)], rtol=1e-4)


def test_given_its_poles_the_gain_is_the_systems(coefficients):
    a = coefficients(2)
    problem = problem_of(record(a, offset=1e-3))
    params = linear_start(sorted_roots(a) / problem.omega, 2, problem)
    assert params is not None
    assert params[2] == pytest.approx(problem.voltage_scale**2 / a[0] / problem.output_scale, rel=1e-3)
    assert np.abs(residual(params, problem, order=2, hold="foh")).max() < 2e-3


def test_where_it_starts_in_motion_gain_zero_and_state_are_the_best_there_are(coefficients):
    """What is left is orthogonal to what any of them would add."""
    a = coefficients(2)
    problem = problem_of(record(a, 640, offset=1e-3))
    params = linear_start(sorted_roots(a) / problem.omega, 2, problem)
    assert params is not None

    def left(p):
        return np.asarray(residual(p, problem, order=2, hold="foh"), np.float64).reshape(-1)

    assert problem.free_zeros == 1 and len(params) == problem.parameters(2)
    for more in np.eye(len(params))[2:]:
        column = left(params + more) - left(params)
        cosine = column @ left(params) / np.linalg.norm(column) / np.linalg.norm(left(params))
        assert np.linalg.norm(column) > 1.0 and abs(cosine) < 1e-4


def test_no_roots_no_start(coefficients):
    problem = problem_of(record(coefficients(2)))
    assert linear_start(None, 2, problem) is None and linear_start(np.array([-1.0]), 2, problem) is None

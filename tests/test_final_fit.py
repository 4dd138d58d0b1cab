"""The refined fit is the minimum of the output error."""

import numpy as np
import pytest
from scipy.signal import lsim

from pitp_jax._identify.beginnings import find_beginnings
from pitp_jax._identify.final_fit import refine
from pitp_jax._identify.output_error import build_problem, normal_equations
from pitp_jax._record.record import Record

DT, SAMPLES = 2e-3, 1500
TIME = np.arange(SAMPLES) * DT
SWEEP = 1000 * (1 - np.cos(2 * np.pi * (0.2 * TIME + 2 * TIME**2)))
HOW = {"order": 2, "hold": "foh"}


def problem(a, seed, start=0):
    x = lsim(([1.0], a[::-1]), SWEEP**2, TIME)[1]
    x = x + 0.01 * x.std() * np.random.default_rng(seed).standard_normal(SAMPLES)
    records = [Record("r", TIME[start:], SWEEP[start:], x[start:])]
    return build_problem(records, "square", find_beginnings(records, "square")[0])


def truth(a, problem):
    """Parameters of the planted system: logarithms of its poles, gain, and a start of zero where there is one."""
    omega, params = np.sqrt(a[0] / a[2]) / problem.omega, np.zeros(problem.parameters(2))
    params[:2] = np.log(a[1] / a[2] / problem.omega), 2 * np.log(omega)
    params[2] = problem.voltage_scale**2 / a[0] / problem.output_scale
    return params


@pytest.mark.parametrize("start", [0, 640])  # at rest; moving: offset and start are fitted too
def test_it_ends_where_the_gradient_is_zero(coefficients, start):
    """Away from the minimum by 3 % of every parameter the slope of the error is large, at the end it has gone."""
    given = problem(coefficients(2), 1, start)
    off = truth(coefficients(2), given) * 1.03
    found = refine(off, given, **HOW)
    before, after = (normal_equations(p, given, **HOW) for p in (off, found))
    assert after.cost < before.cost
    scale = np.sqrt(np.diag(after.hessian) * after.cost)
    assert (np.abs(after.gradient) < 1e-5 * scale).all()
    assert (np.abs(before.gradient) > 1e-2 * scale).any()

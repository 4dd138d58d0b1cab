"""The last word on a fit: the minimum of the output error from nearby, by a program that holds no record of its own."""

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.signal import lsim
from typed import untyped

from pitp_jax._identify.final_fit import _solve, polish
from pitp_jax._identify.output_error import build_problem, normal_equations, residual
from pitp_jax._record.record import Record

DT, SAMPLES = 2e-3, 1500
TIME = np.arange(SAMPLES) * DT
SWEEP = 1000 * (1 - np.cos(2 * np.pi * (0.2 * TIME + 2 * TIME**2)))
HOW = {"order": 2, "hold": "foh"}


def problem(a, seed, start=0):
    x = lsim(([1.0], a[::-1]), SWEEP**2, TIME)[1]
    x = x + 0.01 * x.std() * np.random.default_rng(seed).standard_normal(SAMPLES)
    return build_problem([Record("r", TIME[start:], SWEEP[start:], x[start:])], "square")


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
    found = polish(off, given, **HOW)
    before, after = (normal_equations(p, given, **HOW) for p in (off, found))
    assert after.cost < before.cost
    scale = np.sqrt(np.diag(after.hessian) * after.cost)
    assert (np.abs(after.gradient) < 1e-5 * scale).all()
    assert (np.abs(before.gradient) > 1e-2 * scale).any()


def test_a_second_problem_of_the_same_size_needs_no_program_of_its_own(coefficients):
    """A second system of the same size is solved without compiling again, and is another one."""
    soft, stiff = coefficients(2), coefficients(2, stiffness=1.4e9, hz=4.0)
    first, second = problem(soft, 2), problem(stiff, 3)
    one = polish(truth(soft, first) * 1.01, first, **HOW)
    programs = untyped(_solve)._cache_size()
    two = polish(truth(stiff, second) * 1.01, second, **HOW)
    assert untyped(_solve)._cache_size() == programs
    for a, given, p in ((soft, first, one), (stiff, second, two)):
        np.testing.assert_allclose(p, truth(a, given), rtol=0, atol=0.01)
        left = np.sqrt(np.mean(residual(p, given, **HOW) ** 2)) * given.output_scale
        assert left == pytest.approx(0.01 * given.output_scale, rel=0.5)


ONE_CORE = """
import os
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import numpy as np
from scipy.signal import lsim
import pitp_jax as pitp
time = np.arange(30_000) * 4e-3
voltage = 1000 * (1 - np.cos(2 * np.pi * (0.1 * time + 0.05 * time**2)))
x = lsim(([1.0], [1.0, 3.0, 1e3]), voltage**2, time)[1]
print(pitp.identify([pitp.Record("sweep", time, voltage, x)], order=2).model.natural_frequency)
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores cannot be taken from a process here")
def test_one_core_is_enough():
    """Signals of 240 kB: given to a callback, JAX would copy them on the one thread that waits for the callback."""
    done = subprocess.run([sys.executable, "-c", ONE_CORE], capture_output=True, text=True, timeout=120, check=True)
    assert float(done.stdout) == pytest.approx(np.sqrt(1e3), rel=1e-3)

"""Errors and slopes of free runs, summed as a least-squares step needs them."""

from types import SimpleNamespace

import numpy as np

from pitp_jax.method.fit.forward_sensitivity import run_errors, run_slopes
from pitp_jax.method.fit.parameters import with_parameters


def normal_equations(model, runs, dt, every, vector):
    """C, J'We and J'WJ at `vector` from the errors and slopes of all runs."""
    here = with_parameters(model, vector)
    e = np.asarray(run_errors(here, runs, dt, every), np.float64).ravel()
    j = np.asarray(run_slopes(here, runs, dt, every), np.float64).reshape(e.size, -1)
    return SimpleNamespace(cost=e @ e, gradient=j.T @ e, hessian=j.T @ j)

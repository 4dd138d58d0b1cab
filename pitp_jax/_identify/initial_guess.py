"""Where the output-error fit of one order starts.

equation error:  least squares of F = sum a_i x^(i) + c_r on filtered derivatives (a constant c_r per record), roots
                 reflected to be stable
peak:            a resonance where output over force is largest in the spectrum, further poles faster
linear:          given the poles, gain, zeros and initial states by linear least squares on the simulated response
"""

from collections.abc import Sequence

import numpy as np

from .._record.preprocess import preprocess
from .._record.record import Record
from .linear_ode import logs_from_roots
from .output_error import OutputError, normal_equations


def equation_error_roots(records: Sequence[Record], order: int, problem: OutputError):
    """Roots of the polynomial that fits F = sum a_i x^(i) + c_r on filtered derivatives, in units of omega."""
    cut = min(problem.omega / np.pi, 0.4 / problem.dt)
    rows, rhs = [], []
    for r, b in zip(records, problem.beginnings, strict=True):
        s = preprocess(
            r,
            order,
            cut,
            r.voltage ** (2 if problem.square else 1),
            displacement=b.direction * (r.displacement - b.zero),
        )
        keep = np.flatnonzero(s.valid)
        keep = keep[:: max(1, len(keep) * len(records) // 200_000)]
        if len(keep):
            states = s.states[keep] / problem.omega ** np.arange(order + 1)
            rows.append(states - states.mean(0))
            rhs.append(s.force[keep] - s.force[keep].mean())
    if not rows:
        return None
    rows = np.concatenate(rows)
    if len(rows) < 4 * (order + 2):
        return None
    scale = np.abs(rows).max(0) + 1e-300
    fit = np.linalg.lstsq(rows / scale, np.concatenate(rhs), rcond=None)[0] / scale
    return np.roots(fit[::-1]) if np.isfinite(fit).all() and abs(fit[-1]) > 0 else None


def peak_roots(problem: OutputError, order: int):
    """A resonance, damping 10 %, where output over force is largest in the spectrum; further poles faster."""
    force = problem.drive ** (2 if problem.square else 1)
    f = np.abs(np.fft.rfft(force - force.mean(1, keepdims=True))).sum(0)
    y = np.abs(np.fft.rfft(problem.output)).sum(0)
    width = max(len(f) // 400, 1)
    f, y = (np.convolve(v, np.ones(width) / width, "same") for v in (f, y))
    grid = 2 * np.pi * np.arange(len(f)) / (force.shape[1] * problem.dt) / problem.omega
    band = (grid > 0.02) & (f > 0.03 * f.max())
    peak = float(grid[np.argmax(np.where(band, y / np.maximum(f, 1e-300), 0))]) if band.any() else 0.5
    pair = peak * np.array([-0.1 + 0.995j, -0.1 - 0.995j])
    return np.array([-peak]) if order == 1 else np.append(pair, -peak * 4.0 * np.arange(1, order - 1))


def linear_start(roots, order: int, problem: OutputError, delay: float = 1.0):
    """Given the poles, gain, zeros and initial states by linear least squares; `delay` in samples, where one is fitted.

    All of them enter linearly, so one Gauss-Newton step from anywhere is exact.
    """
    if roots is None or len(roots) != order:
        return None
    params = np.zeros(problem.parameters(order))
    params[:order], params[order] = logs_from_roots(roots), 1.0
    linear = np.arange(order, len(params) - problem.delayed)
    if problem.delayed:
        params[-1] = np.log(delay)
    here = normal_equations(params, problem, order=order, hold="foh")
    if not (np.isfinite(here.cost) and np.isfinite(here.hessian).all()):
        return None
    root = np.sqrt(np.maximum(np.diag(here.hessian)[linear], 1e-300))
    step = np.linalg.lstsq(here.hessian[np.ix_(linear, linear)] / np.outer(root, root), here.gradient[linear] / root)[0]
    params[linear] -= step / root
    return params

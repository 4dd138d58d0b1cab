"""Where the output-error fit of one order starts.

equation error:  least squares of F = sum a_i x^(i) + c on filtered derivatives, roots reflected to be stable
peak:            a resonance where output over force is largest in the spectrum, further poles faster
gain:            given the poles, gain and free offset by linear least squares on the simulated response
"""

from collections.abc import Sequence

import numpy as np

from .._record.preprocess import preprocess
from .._record.record import Record
from .linear_ode import logs_from_roots
from .output_error import OutputError, residual


def equation_error_roots(records: Sequence[Record], order: int, problem: OutputError):
    """Roots of the polynomial that fits F = sum a_i x^(i) + c on filtered derivatives, in units of omega."""
    cut = min(problem.omega / np.pi, 0.4 / problem.dt)
    rows, rhs = [], []
    for r in records:
        s = preprocess(
            r,
            order,
            cut,
            r.voltage ** (2 if problem.square else 1),
            displacement=r.displacement - problem.offset,
        )
        keep = np.flatnonzero(s.valid)
        keep = keep[:: max(1, len(keep) * len(records) // 200_000)]
        rows.append(s.states[keep] / problem.omega ** np.arange(order + 1))
        rhs.append(s.force[keep])
    rows = np.concatenate(rows)
    if len(rows) < 4 * (order + 2):
        return None
    scale = np.abs(rows).max(0) + 1e-300
    fit = np.linalg.lstsq(np.c_[rows / scale, np.ones(len(rows))], np.concatenate(rhs), rcond=None)[0][:-1] / scale
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


def linear_start(roots, order: int, problem: OutputError):
    """Given the poles, the gain and a free offset by linear least squares; initial states zero."""
    if roots is None or len(roots) != order:
        return None
    params = np.zeros(problem.parameters(order))
    params[:order], params[order] = logs_from_roots(roots), 1.0
    y = (problem.weight * problem.output).reshape(-1)
    unit = residual(params, problem, order=order, hold="foh").reshape(-1) + y
    if not np.isfinite(unit).all():
        return None
    columns = [unit] + ([problem.weight.reshape(-1)] if problem.free_offset else [])
    normal = np.array([[a @ b for b in columns] for a in columns])
    params[order : order + len(columns)] = np.linalg.lstsq(normal, [a @ y for a in columns], rcond=None)[0]
    return params

"""Test whether an unstable pole explains records that no stable model does: a plant held by a control loop.

    P(d/dt) x = F,    x(t) = sum_i r_i m_i(t) + c_i n_i(t),    m_i' = p_i m_i + F
    n_i = e^{p_i t}  where Re p_i < 0,    e^{p_i (t - T)}  where Re p_i > 0      (`bounded_response`)

A simulation forward in time diverges within a few 1 / Re p, but the recorded motion did not. The recorded motion is the
one solution that is bounded at both ends of the record; an unstable mode is computed backwards from the end. Poles by
least squares from a grid; inside, linearly, every record's gain, offset and free responses.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import least_squares

from ..numerics.coloured_noise import project
from .linear_ode import bounded_response
from .output_error import Problem

_GRID = 4
_GROWS = 3.0  # e-folds over the record, at least; less is drift or a missing damping
_FRACTION = 0.5  # of the stable model's residual; free end values alone reduce it by less


def unstable_pole(stable: float, problem: Problem) -> tuple[complex, float] | None:
    """Return the unstable pole (rad/s) of a model that halves the residual of the best stable model; None without one.

    The residual of that model comes with it.

    `stable`: residual of the stable model, as a fraction of the output's rms.
    """
    best = None
    for order in (1, 2, 3):
        for pair in (False, True)[:order]:  # one pole cannot be a pair
            start = min(_starts(order, pair, problem), key=lambda p: float(np.sum(_residual(p, pair, problem) ** 2)))
            fit = least_squares(_residual, start, args=(pair, problem), x_scale=0.5, max_nfev=20)
            pole, rms = _poles(fit.x, pair)[0], float(np.sqrt(2 * fit.cost))
            # a pole above the input's band means an output ahead of its input; one that hardly grows is drift
            seen = pole.real * problem.seconds > _GROWS and abs(pole) < problem.omega
            if seen and rms <= _FRACTION * stable:
                best, stable = (complex(pole), rms), rms  # a higher order must halve it again
    return best


def _starts(order: int, pair: bool, problem: Problem) -> Iterator[np.ndarray]:
    """Yield initial parameters: logarithms of the unstable pole (or of a pair's parts), then of the stable ones."""
    grid = np.log(np.geomspace(2 * np.pi / problem.seconds, problem.omega, _GRID))
    others = [np.sort(grid)[k : k + order - 1 - pair] for k in range(_GRID - (order - 1 - pair) + 1)]
    for size in grid:
        for rest in others:
            yield np.concatenate([[size - 1.5, size] if pair else [size], rest + 0.1 * np.arange(len(rest))])


def _poles(params: Sequence[float] | np.ndarray, pair: bool) -> np.ndarray:
    """Return the poles (rad/s) of the parameters, the unstable pole or pair first."""
    sizes = np.exp(params)
    turn = sizes[1] * np.array([1j, -1j]) if pair else np.zeros(1, complex)
    return np.append(sizes[0] + turn, -sizes[1 + pair :])


def _residual(params, pair: bool, problem: Problem) -> np.ndarray:
    """Fit gains, offsets and free responses; return the residual of all records over sqrt(number of samples)."""
    parts = []
    for force, output, weight in zip(problem.forces, problem.output, problem.weight, strict=True):
        run, free = bounded_response(_poles(params, pair) * problem.dt, force - force.mean())
        rows = weight * np.vstack([run, np.ones_like(run), free.T])
        parts.append(project(weight * output, rows.T)[1])
    return np.concatenate(parts) / np.sqrt(problem.samples)

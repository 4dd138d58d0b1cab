"""Refine the identified parameters by Gauss-Newton on the output error, each step by a QR of the whole Jacobian.

    min_d |J d + r|,    [J r] = Q R,    d = -R_J^-1 R_r         (Golub & Van Loan, 5.3)

The search over orders, starts and holds runs on normal equations, which square the condition number; a QR does not. It
is accumulated record by record, so the Jacobian is never held whole.
"""

import numpy as np
from jaxtyping import Float

from .output_error import OutputError, terms

_MOST, _SETTLED, _SHORTEST = 12, 1e-10, 0.01


def refine(
    params: Float[np.ndarray, " parameters"], problem: OutputError, *, order: int, hold: str
) -> Float[np.ndarray, " parameters"]:
    """Parameters of least output error from a nearby start."""
    best, cost, step, share = params, np.inf, np.zeros(len(params)), 1.0
    for _ in range(_MOST):
        triangle = _triangle(params, problem, order, hold)
        here = float(triangle[:, -1] @ triangle[:, -1])
        if not here < cost:  # a step that was too long, or rounding
            share /= 4
            if share < _SHORTEST:
                return best
            params = best + share * step
            continue
        settled = here > (1 - _SETTLED) * cost
        best, cost, share = params, here, 1.0
        size = np.maximum(np.linalg.norm(triangle[:, :-1], axis=0), 1e-300)
        step = -np.linalg.lstsq(triangle[:, :-1] / size, triangle[:, -1], rcond=1e-12)[0] / size
        if settled or not np.isfinite(step).all():
            return best
        params = best + step
    return best


def _triangle(params, problem: OutputError, order: int, hold: str) -> np.ndarray:
    """R of [J r], (parameters + 1) square."""
    found = np.zeros((0, len(params) + 1))
    with np.errstate(all="ignore"):
        for left, jacobian, columns in terms(params, problem, order=order, hold=hold):
            rows = np.zeros((len(left), len(params) + 1))
            rows[:, columns], rows[:, -1] = jacobian, left
            if not np.isfinite(rows).all():
                return np.full((len(params) + 1,) * 2, np.nan)
            found = np.asarray(np.linalg.qr(np.vstack([found, rows]), mode="r"))
    return found

"""Minimise a sum of squares by Levenberg-Marquardt on normal equations: a few parameters, very many residuals.

    (H + lambda diag H) d = -g,    H = J'J,  g = J'r,    gain ratio rho = (C(p) - C(p + d)) / (d'(lambda diag H d - g))

lambda follows rho as Nielsen (1999) has it. H squares the condition number; the diagonal scaling and float64 leave
enough for the tens of parameters of a linear model. Nothing is compiled: an identification meets each shape once.
"""

from collections.abc import Callable, Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np

_MAX_STEPS = 60
_TOLERANCE = 1e-11  # relative decrease of the cost still to be had; in 1e5 samples 0.001 of a standard error
_SLOW, _PATIENCE = 1e-6, 4  # that many steps in a row, each lowering the cost by less: a flat valley, walked far enough
_LONGEST = 2.0  # largest change of a logarithm in one step: a factor e^2, beyond which the quadratic is a guess
_LARGEST_DAMPING = 1e12


class Normal(NamedTuple):
    """Sum of squares C, half its gradient g, and H."""

    cost: float
    gradient: np.ndarray
    hessian: np.ndarray

    @classmethod
    def of(cls, cost, gradient, hessian) -> "Normal":
        """Convert from arrays of any kind to float64."""
        return cls(float(cost), np.asarray(gradient, np.float64), np.asarray(hessian, np.float64))


def minimise(normal: Callable[[np.ndarray], Normal], params: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, bool]:
    """Find the parameters of least cost from `params` on, none above `upper`; and whether the tolerance was met.

    Those with a finite `upper` are taken for logarithms, in which a long step is never to be trusted.
    """
    slow, before, fitted, converged = 0, np.inf, params, False
    for fitted, here, met in islice(steps(normal, params, upper), _MAX_STEPS):
        slow = slow + 1 if before - here.cost < _SLOW * before else 0
        before, converged = here.cost, met
        if slow == _PATIENCE:
            return fitted, True
    return fitted, converged


def steps(
    normal: Callable[[np.ndarray], Normal], params: np.ndarray, upper: np.ndarray
) -> Iterator[tuple[np.ndarray, Normal, bool]]:
    """Yield parameters, their `Normal` and whether the tolerance is met: at the start and after every step down.

    Ends where it is met, where the start is not finite, or where no step leads down (met, if little was left to win).
    """
    params = np.minimum(params, upper)
    here, damping, growth = normal(params), 1e-3, 2.0
    yield params, here, False
    while np.isfinite(here.cost) and np.isfinite(here.hessian).all():
        step = _solve(here, damping, upper - params)
        # shortened as a whole: the direction stays one of descent
        step *= min(1.0, _LONGEST / max(float(np.abs(step[np.isfinite(upper)]).max(initial=0.0)), 1e-300))
        # the fall of C that its quadratic promises, without the damping, which is no part of C
        expected = float(-step @ (2 * here.gradient + here.hessian @ step))
        # under heavy damping every step is short: that alone is not convergence
        if expected <= _TOLERANCE * here.cost and damping < 1.0:
            yield params, here, True
            return
        there = normal(params + step)
        ratio = (here.cost - there.cost) / expected if expected > 0 and np.isfinite(there.cost) else -1.0
        if ratio > 0:  # any fall is taken; by how much the quadratic was trusted, the damping says (Nielsen's rule)
            params, here, growth = params + step, there, 2.0
            damping *= max(1 / 10, 1 - (2 * ratio - 1) ** 3)
            yield params, here, False
        else:
            damping, growth = damping * growth, 2 * growth
            if damping > _LARGEST_DAMPING:  # no way down: what is still expected is rounding
                yield params, here, expected <= _SLOW * here.cost
                return


def _solve(here: Normal, damping: float, room: np.ndarray) -> np.ndarray:
    """Solve for the damped step that moves no parameter up by more than its `room`; the others make up for those."""
    # at its bound already, and the cost falls beyond it
    step, fixed = np.zeros(len(room)), (room <= 0) & (here.gradient < 0)
    while not fixed.all():
        free = ~fixed
        root = np.sqrt(np.diag(here.hessian)[free] * (1 + damping) + 1e-300)
        # unit diagonal: parameters of any units, and lambda stands in the root alone
        matrix = here.hessian[np.ix_(free, free)] / np.outer(root, root)
        np.fill_diagonal(matrix, 1.0)
        slope = here.gradient[free] + here.hessian[np.ix_(free, fixed)] @ step[fixed]  # the bounded ones have moved
        # least squares, not Cholesky: parameters that the data cannot tell apart make it singular as lambda falls
        step[free] = -np.linalg.lstsq(matrix, slope / root, rcond=1e-15)[0] / root
        over = free & (step > room)
        if not over.any():
            break
        step[over], fixed = room[over], fixed | over
    return step

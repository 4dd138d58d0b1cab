"""Minimise a sum of squares C(p) = |r(p)|^2 by damped Gauss-Newton steps, with two ways to choose the damping.

    (H + lambda D) d = -g,    low_i <= d_i <= high_i        H = J'J,  g = J'r,  D = diag H

`steps`        r and J come together: lambda follows how well the quadratic model predicted C (Nielsen, 1999); fits side
               by side, whose rejected steps keep their J, ask a `Descent` each (`method.diagnose.fit`)
`accelerated`  J costs at least ten times as much as r: the best lambda at every J, and a curved step

    (H + lambda D) a = -J'r_vv,   r_vv = (r(p + h d) - 2 r(p) + r(p - h d)) / h^2,   p <- p + d + a / 2

Transtrum and Sethna (2012): a narrow valley is curved, and a straight step leaves it at once
(docs/decisions/free_runs.md). Priors are rows of r. H squares the condition number of J. Float64, the scaling by D and
the damping leave enough digits for tens to hundreds of parameters, with millions of residuals that need not be stored
at once.

Optimistix is not used: it has no bounds, needs J itself (1e6 rows instead of sums of P^2 numbers), and compiles its
loop, while an identification meets each shape once. `optimistix.LevenbergMarquardt` fits small, already compiled
problems (`method.identify.frequency_fit`).
"""

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import islice
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Blocks = Sequence[Float[np.ndarray | Array, "..."]]  # residuals, or their slopes with the parameters last

_MAX_STEPS = 60  # of a fit; then the best parameters are returned as not converged
_TOLERANCE = 1e-11  # relative decrease of the cost still expected; in 1e5 samples 0.001 of a standard error
_SLOW, _PATIENCE = 1e-6, 4  # as many steps in a row that each lower the cost by less: a flat valley
_LONGEST = 2.0  # largest change of a logarithm in one step: a factor e^2, beyond which the quadratic is unreliable
# lambda at the start; between trials; and from which on a step is below rounding
_FIRST_DAMPING, _DAMPING_FACTOR, _LARGEST_DAMPING = 1e-3, 4.0, 1e12
_LOST_DIGITS = 1e-15  # of the largest eigenvalue: a direction below it is rounding
_PROBE = 0.3  # h: large enough to see the curvature above float32 rounding, small enough to stay on the same parabola
_BENT = 0.75  # |a| over |d| (in D), beyond which the quadratic is unreliable


class Normal(NamedTuple):
    """The sum of squares C, half its gradient g, and the matrix H = J'J, at some parameters."""

    cost: float
    gradient: np.ndarray
    hessian: np.ndarray


class Damped:
    """The damped matrix H + lambda D, factored once for every damping lambda.

    `least`: fraction of the largest value of D that is added to all, so that numbers with hardly any slope keep still.
    """

    def __init__(self, hessian: np.ndarray, least: float = 0.0):
        # the tiny number prevents a division by zero for a parameter that no residual depends on
        self.root = np.sqrt(np.diag(hessian) + max(least * np.diag(hessian).max(), 1e-300))
        values, self._vectors = np.linalg.eigh(hessian / np.outer(self.root, self.root))
        self._values = np.maximum(values, 0)  # rounding makes the smallest of a singular H negative

    def step(self, side: np.ndarray, damping: float) -> np.ndarray:
        """Solve (H + lambda D) d = -side for the optimiser step d, with lambda = `damping`."""
        values = self._values + damping
        # with small lambda, parameters that the data do not separate make it singular: then the smallest step
        along = np.where(values > _LOST_DIGITS * values.max(), self._vectors.T @ (side / self.root) / values, 0.0)
        return -(self._vectors @ along) / self.root


class Descent(NamedTuple):
    """The damping of a fit's next step, and the factor by which it grows if that step is rejected."""

    damping: float = _FIRST_DAMPING
    growth: float = 2.0

    def step(self, here: Normal, low: np.ndarray, high: np.ndarray, least: float = 0.0) -> tuple[np.ndarray, float]:
        """Return the damped step within a box, and the decrease of C that its quadratic predicts.

        Numbers that reach their side of the box stay there, and the others compensate. `least`: as in `Damped`.
        """
        # at its bound already, while the cost decreases beyond it
        step, fixed = np.zeros(len(low)), np.where(here.gradient < 0, high, -low) <= 0
        while not fixed.all():
            free = ~fixed
            slope = here.gradient[free] + here.hessian[np.ix_(free, fixed)] @ step[fixed]  # the bounded ones have moved
            step[free] = Damped(here.hessian[np.ix_(free, free)], least).step(slope, self.damping)
            inside = np.clip(step, low, high)
            over = free & (step != inside)
            if not over.any():
                break
            step[over], fixed = inside[over], fixed | over
        # without the damping, which is not part of C
        return step, float(-step @ (2 * here.gradient + here.hessian @ step))

    def after(self, decrease: float, expected: float) -> tuple[bool, "Descent"]:
        """Return whether a step is accepted, which any decrease is, and the descent after it (Nielsen's rule)."""
        if not (decrease > 0 and expected > 0):
            return False, Descent(self.damping * self.growth, 2 * self.growth)
        return True, Descent(self.damping * max(1 / 10, 1 - (2 * decrease / expected - 1) ** 3))


def minimise(
    normal: Callable[[np.ndarray], Normal],
    params: np.ndarray,
    upper: np.ndarray,
    most: int = _MAX_STEPS,
    least: float = 0.0,
) -> tuple[np.ndarray, bool]:
    """Find the parameters of least cost, none above `upper`; return them, and whether the tolerance was met.

    It takes at most `most` steps and ends after one that lowers the cost by less than the fraction `least`. Parameters
    with a finite `upper` count as logarithms, whose steps are bounded.
    """
    slow, before, best = 0, np.inf, params
    for best, here, met in islice(steps(normal, params, upper), most):
        slow = slow + 1 if before - here.cost < _SLOW * before else 0
        if met or slow == _PATIENCE or before - here.cost < least * before:
            return best, True
        before = here.cost
    return best, False


def steps(
    normal: Callable[[np.ndarray], Normal], params: np.ndarray, upper: np.ndarray
) -> Iterator[tuple[np.ndarray, Normal, bool]]:
    """Yield (parameters, `Normal`, whether the tolerance is met), at the start and after every accepted step.

    It ends when it is met, if the start is not finite, or if no step lowers the cost (met, if little could be gained).
    """
    params, longest, descent = np.minimum(params, upper), np.where(np.isfinite(upper), _LONGEST, np.inf), Descent()
    here = normal(params)
    yield params, here, False
    while np.isfinite(here.cost) and np.isfinite(here.hessian).all():
        step, expected = descent.step(here, -longest, np.minimum(longest, upper - params))
        # with strong damping every step is short, which alone is not convergence
        if expected <= _TOLERANCE * here.cost and descent.damping < 1.0:
            yield params, here, True
            return
        there = normal(params + step)
        accepted, descent = descent.after(here.cost - there.cost, expected)
        if accepted:
            params, here = params + step, there
            yield params, here, False
        elif descent.damping > _LARGEST_DAMPING:  # no decrease possible: the remaining prediction is rounding
            yield params, here, expected <= _SLOW * here.cost
            return


class _Trial(NamedTuple):
    cost: float
    params: np.ndarray
    errors: Blocks


def accelerated(
    errors: Callable[[np.ndarray], Blocks], slopes: Callable[[np.ndarray], Blocks], params: np.ndarray
) -> Iterator[tuple[np.ndarray, float, bool]]:
    """Yield (parameters, sum of squares, whether no step lowers it), at the start and after every accepted step.

    Args:
        errors: blocks of residuals r at given parameters.
        slopes: of the same blocks dr/dp, with one axis more, the last.
        params: initial values.
    """
    here, damping = errors(params), _FIRST_DAMPING
    cost = _cost(here)
    yield params, cost, False
    while np.isfinite(cost):
        best, damping = _search(_trials(errors, slopes(params), params, here), damping, cost)
        if best.cost >= cost:
            yield params, cost, True
            return
        cost, params, here = best
        yield params, cost, False


def _search(trial: Callable[[float], _Trial], damping: float, cost: float) -> tuple[_Trial, float]:
    """Search for the damping of lowest cost on a geometric grid, starting at the last damping."""
    trial = cache(trial)  # the search back meets the same grid points again
    best = trial(damping)
    for factor in (1 / _DAMPING_FACTOR, _DAMPING_FACTOR):
        after = trial(damping * factor)
        # less damping is tried only while it helps; more also until a step lowers the cost, as a short step must
        while after.cost < best.cost or (best.cost >= cost and factor > 1 and damping < _LARGEST_DAMPING):
            best, damping = after, damping * factor
            after = trial(damping * factor)
    return best, damping


def _trials(errors, jacobian: Blocks, params, here: Blocks) -> Callable[[float], _Trial]:
    """Return a function that computes the optimiser step from `params`, and its cost, for a damping."""
    hessian = np.sum([_gram(j) for j in jacobian], axis=0)
    if not np.isfinite(hessian).all():  # an unstable run overflowed, so no step from here is reliable
        return lambda damping: _Trial(np.inf, params, here)
    matrix, gradient = Damped(hessian), _pull(jacobian, here)

    def trial(damping: float) -> _Trial:
        step = matrix.step(gradient, damping)
        ahead, behind = errors(params + _PROBE * step), errors(params - _PROBE * step)
        bend = [(a - 2 * r + b) / _PROBE**2 for a, r, b in zip(ahead, here, behind, strict=True)]
        if all(np.isfinite(b).all() for b in bend):  # otherwise a probe diverged, and the straight step is used alone
            turn = matrix.step(_pull(jacobian, bend), damping)
            if np.linalg.norm(matrix.root * turn) <= _BENT * np.linalg.norm(matrix.root * step):
                step = step + turn / 2
        there = errors(params + step)
        cost = _cost(there)
        # nan compares false with everything; an infinite cost loses every comparison
        return _Trial(cost if np.isfinite(cost) else np.inf, params + step, there)

    return trial


def _cost(blocks: Blocks) -> float:
    # in float64, because the last steps differ by less than float32 can add over 1e5 samples
    return float(sum(np.sum(np.square(b, dtype=np.float64)) for b in blocks))


def _pull(jacobian: Blocks, blocks: Blocks) -> np.ndarray:
    """Compute the gradient J'r, summed over blocks of residuals."""
    products = [_xp(j).tensordot(b, j, np.ndim(b)) for j, b in zip(jacobian, blocks, strict=True)]
    return np.sum([np.asarray(p, np.float64) for p in products], axis=0)


def _gram(slopes) -> np.ndarray:
    rows = slopes.reshape(-1, slopes.shape[-1])
    return np.asarray(_xp(slopes).tensordot(rows, rows, (0, 0)), np.float64)


def _xp(array):
    """Return the module of an array (numpy or jax.numpy), so that it stays on its device in its precision."""
    return np if isinstance(array, np.ndarray) else jnp

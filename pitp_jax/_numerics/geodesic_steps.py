"""Levenberg-Marquardt with geodesic acceleration: a dear Jacobian, cheap residuals.

    (H + lambda D) v = -J'r,    (H + lambda D) a = -J'r_vv,    p <- p + v + a/2          H = J'J, D = diag H
    r_vv = (r(p + h v) - 2 r(p) + r(p - h v)) / h^2

Transtrum and Sethna (2012). A narrow valley bends, and a straight step leaves it at once: r_vv says how. J costs a
whole pass, r a tenth of it or less, so the damping is searched for at every J (docs/decisions/free_runs.md). H squares
the condition number of J; float64, the scaling by D and the damping leave enough digits for a step downhill.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Blocks = Sequence[Float[np.ndarray | Array, "..."]]  # residuals, or their slopes with the parameters last

_FIRST_DAMPING, _DAMPING_FACTOR, _LARGEST_DAMPING = 1e-3, 4.0, 1e10
_PROBE = 0.3  # h: far enough to see the bend above float32 rounding, near enough to stay on the same parabola
_BENT = 0.75  # |a| over |v| (in D), beyond which a quadratic says nothing


class _Trial(NamedTuple):
    cost: float
    params: np.ndarray
    errors: Blocks


def steps(
    errors: Callable[[np.ndarray], Blocks], slopes: Callable[[np.ndarray], Blocks], params: np.ndarray
) -> Iterator[tuple[np.ndarray, float, bool]]:
    """Yield parameters, sum of squares there, and whether no step leads down: at the start and after every step down.

    Args:
        errors: blocks of residuals r at given parameters.
        slopes: of the same blocks dr/dp, with one axis more, the last.
        params: where to start.
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
    """Search the damping downhill on a geometric grid from the last one, and upwards until a step leads down at all."""
    trial = cache(trial)  # turning round meets the grid points of the way out again
    best = trial(damping)
    for factor in (1 / _DAMPING_FACTOR, _DAMPING_FACTOR):
        after = trial(damping * factor)
        # less damping is tried only as long as it pays; more also while nothing leads down, as a short step must
        while after.cost < best.cost or (best.cost >= cost and factor > 1 and damping < _LARGEST_DAMPING):
            best, damping = after, damping * factor
            after = trial(damping * factor)
    return best, damping


def _trials(errors, jacobian: Blocks, params, here: Blocks) -> Callable[[float], _Trial]:
    """Build fn(damping): the step from `params`, and the cost behind it."""
    hessian = np.sum([_gram(j) for j in jacobian], axis=0)
    if not np.isfinite(hessian).all():  # an unstable run overflowed: no step from here can be trusted
        return lambda damping: _Trial(np.inf, params, here)
    # root = D^(1/2); the tiny number keeps a parameter that no residual feels from dividing by zero
    gradient, root = _pull(jacobian, here), np.sqrt(np.diag(hessian) + 1e-300)
    # D^(-1/2) H D^(-1/2) = Q W Q' once, and H + lambda D is solved for any lambda by dividing by W + lambda
    values, vectors = np.linalg.eigh(hessian / np.outer(root, root))

    def trial(damping: float) -> _Trial:
        def solve(side):
            # rounding makes the smallest eigenvalues of a singular H negative
            return -(vectors @ (vectors.T @ (side / root) / (np.maximum(values, 0) + damping))) / root

        step = solve(gradient)
        ahead, behind = errors(params + _PROBE * step), errors(params - _PROBE * step)
        bend = [(a - 2 * r + b) / _PROBE**2 for a, r, b in zip(ahead, here, behind, strict=True)]
        if all(np.isfinite(b).all() for b in bend):  # else a probe ran away, and the straight step decides alone
            turn = solve(_pull(jacobian, bend))
            if np.linalg.norm(root * turn) <= _BENT * np.linalg.norm(root * step):
                step = step + turn / 2
        there = errors(params + step)
        cost = _cost(there)
        # nan compares false with everything; an infinite cost loses every comparison
        return _Trial(cost if np.isfinite(cost) else np.inf, params + step, there)

    return trial


def _cost(blocks: Blocks) -> float:
    # in float64: steps of the end differ by less than float32 can add over 1e5 samples
    return float(sum(np.sum(np.square(b, dtype=np.float64)) for b in blocks))


def _pull(jacobian: Blocks, blocks: Blocks) -> np.ndarray:
    """Multiply residuals by J' (J'r), summed over the blocks."""
    products = [_xp(j).tensordot(b, j, np.ndim(b)) for j, b in zip(jacobian, blocks, strict=True)]
    return np.sum([np.asarray(p, np.float64) for p in products], axis=0)


def _gram(slopes) -> np.ndarray:
    rows = slopes.reshape(-1, slopes.shape[-1])
    return np.asarray(_xp(slopes).tensordot(rows, rows, (0, 0)), np.float64)


def _xp(array):
    """Name the array's own module: a block stays where it is, in its own precision."""
    return np if isinstance(array, np.ndarray) else jnp

"""Levenberg-Marquardt with geodesic acceleration: a dear Jacobian, cheap residuals.

    (H + lambda D) v = -J'r,    (H + lambda D) a = -J'r_vv,    p <- p + v + a/2          H = J'J, D = diag H
    r_vv = (r(p + h v) - 2 r(p) + r(p - h v)) / h^2

Transtrum and Sethna (2012). A narrow valley bends, and a straight step leaves it at once: r_vv says how. J costs a
whole pass, r a tenth of it or less, so the damping is searched for at every J. Free runs of a roll: 11 Jacobians to
where Nielsen's rule takes 45. Going on further finds what the prior leaves open: the Silverbox' arrow, beyond the
trained amplitude, 0.32 mV instead of 0.27, and a Peano-HASEL's 7 Hz 19 % instead of 13.5 until `Settings.few`.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Blocks = Sequence[Float[np.ndarray | Array, "..."]]  # residuals, or their slopes with the parameters last

_START, _FACTOR, _MOST = 1e-3, 4.0, 1e10
_REACH = 0.3  # h; one-sided with J v and 0.2 it went as far per second on a cone, less far on the roll
_BENT = 0.75  # |a| over |v| (in D), beyond which a quadratic says nothing


class _Trial(NamedTuple):
    cost: float
    params: np.ndarray
    errors: Blocks


def steps(
    errors: Callable[[np.ndarray], Blocks], slopes: Callable[[np.ndarray], Blocks], params: np.ndarray
) -> Iterator[tuple[np.ndarray, float, bool]]:
    """Parameters, sum of squares there, and whether no step leads down; at the start and after every step down.

    Args:
        errors: blocks of residuals r at given parameters.
        slopes: of the same blocks dr/dp, with one axis more, the last.
        params: where to start.
    """
    here, damping = errors(params), _START
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
    """Downhill from the last damping over a geometric grid, and further up until a step leads down at all."""
    trial = cache(trial)
    best = trial(damping)
    for factor in (1 / _FACTOR, _FACTOR):
        after = trial(damping * factor)
        while after.cost < best.cost or (best.cost >= cost and factor > 1 and damping < _MOST):
            best, damping = after, damping * factor
            after = trial(damping * factor)
    return best, damping


def _trials(errors, jacobian: Blocks, params, here: Blocks) -> Callable[[float], _Trial]:
    """fn(damping): the step from `params`, and the cost behind it."""
    hessian = np.sum([_gram(j) for j in jacobian], axis=0)
    if not np.isfinite(hessian).all():
        return lambda damping: _Trial(np.inf, params, here)
    gradient, root = _pull(jacobian, here), np.sqrt(np.diag(hessian) + 1e-300)
    values, vectors = np.linalg.eigh(hessian / np.outer(root, root))  # once for every damping

    def trial(damping: float) -> _Trial:
        def solve(side):
            return -(vectors @ (vectors.T @ (side / root) / (np.maximum(values, 0) + damping))) / root

        step = solve(gradient)
        ahead, behind = errors(params + _REACH * step), errors(params - _REACH * step)
        bend = [(a - 2 * r + b) / _REACH**2 for a, r, b in zip(ahead, here, behind, strict=True)]
        if all(np.isfinite(b).all() for b in bend):
            turn = solve(_pull(jacobian, bend))
            if np.linalg.norm(root * turn) <= _BENT * np.linalg.norm(root * step):
                step = step + turn / 2
        there = errors(params + step)
        cost = _cost(there)
        return _Trial(cost if np.isfinite(cost) else np.inf, params + step, there)

    return trial


def _cost(blocks: Blocks) -> float:
    return float(sum(np.sum(np.square(b, dtype=np.float64)) for b in blocks))


def _pull(jacobian: Blocks, blocks: Blocks) -> np.ndarray:
    """J' of residuals."""
    found = [_xp(j).tensordot(b, j, np.ndim(b)) for j, b in zip(jacobian, blocks, strict=True)]
    return np.sum([np.asarray(f, np.float64) for f in found], axis=0)


def _gram(slopes) -> np.ndarray:
    rows = slopes.reshape(-1, slopes.shape[-1])
    return np.asarray(_xp(slopes).tensordot(rows, rows, (0, 0)), np.float64)


def _xp(array):
    """A block stays where it is, in its own precision."""
    return np if isinstance(array, np.ndarray) else jnp

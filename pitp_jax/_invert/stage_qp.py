"""Solve a quadratic programme along a horizon by a primal-dual interior point method with Riccati recursions.

    minimise    sum_k  z_k' Q_k z_k / 2 + q_k' z_k + rho (w_k + b_k)^2 / 2
    subject to  z_{k+1} = A_k z_k + e w_k,  z_0 = 0                            (e: the last unit vector)
                low_k <= G_k z_k <= high_k,   sum_k |g_k z_k[-1] + h_k| <= budget

Mehrotra's predictor and corrector (Nocedal & Wright, 2006, alg. 16.4). With slacks s and multipliers m > 0 a Newton
step is the same problem without bounds, G' (m / s) G added to Q: a recursion backwards and one forwards (Rao, Wright &
Rawlings, 1998), K n^3 operations; one control, so it divides by a scalar. The absolute values are bounds -a_k <= g z +
h <= a_k with sum a_k <= budget: a_k is eliminated stage by stage, and the budget's multiplier is one more right-hand
side. It needs float64.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._model.programs import jit
from .._numerics.where import where

_ITERATIONS = 50
_GAP = 1e-6  # of duality gap and residuals, with objective and bounds of order one
_BACK = 0.99  # of the way to the nearest bound


class StageQP(NamedTuple):
    """A quadratic programme, stage by stage, of order one: objective, bounds and changes."""

    A: Float[Array, "stages n n"]
    Q: Float[Array, "stages n n"]
    q: Float[Array, "stages n"]
    b: Float[Array, " stages"]
    rho: Float[Array, ""]
    G: Float[Array, "stages rows n"]
    low: Float[Array, "stages rows"]
    high: Float[Array, "stages rows"]
    g: Float[Array, " stages"]
    h: Float[Array, " stages"]
    budget: Float[Array, ""]


class _Iterate(NamedTuple):
    """Unknowns: z, a; then per inequality its slack or its multiplier, of bounds, absolute values and budget."""

    z: Float[Array, "stages n"]
    a: Float[Array, " stages"]
    slack: tuple[Array, Array, Array]
    multiplier: tuple[Array, Array, Array]


@jit
def solve_stage_qp(problem: StageQP, start: float) -> tuple[Float[Array, "stages n"], Array, Array]:
    """Solve for all z_k; return them, the iterations and the last duality gap. Slacks are at least `start` at first."""
    still = jnp.zeros_like(problem.q)
    a = jnp.abs(problem.h) + start
    # an infeasible start: slacks are positive, and their defining equations are met during the iterations
    slack = jax.tree.map(lambda s: jnp.maximum(s, start), _distances(problem, still, a))
    count = sum(s.size for s in slack)
    # equal products of slack and multiplier, as on the central path, where the first steps are long
    first = _Iterate(still, a, slack, jax.tree.map(lambda s: 1 / (count * s), slack))

    def going(carry):
        _, step, gap, off = carry
        return (step < _ITERATIONS) & ((gap > _GAP) | (off > _GAP)) & jnp.isfinite(gap)

    def on(carry):
        now = _improve(problem, carry[0], count)
        off = jax.tree.map(lambda d, s: jnp.abs(d - s).max(), _distances(problem, now.z, now.a), now.slack)
        return now, carry[1] + 1, _gap(now.slack, now.multiplier), jnp.stack(off).max()

    last, step, gap, _ = jax.lax.while_loop(going, on, (first, jnp.asarray(0), jnp.asarray(1.0), jnp.asarray(1.0)))
    return last.z, step, gap


def _distances(problem: StageQP, z: Array, a: Array) -> tuple[Array, Array, Array]:
    """Compute the slack of every inequality: bounds (2, stages, rows), (2, stages), (1,)."""
    value, change = jnp.einsum("krn,kn->kr", problem.G, z), problem.g * z[:, -1] + problem.h
    return (
        jnp.stack([value - problem.low, problem.high - value]),
        jnp.stack([a - change, a + change]),
        (problem.budget - a.sum())[None],
    )


def _gap(slack, multiplier) -> Array:
    return jnp.stack([(s * m).sum() for s, m in zip(slack, multiplier, strict=True)]).sum()


def _improve(problem: StageQP, now: _Iterate, count: int) -> _Iterate:
    """Take one Mehrotra predictor-corrector step on the KKT system; the a_k are eliminated stage by stage.

    With S = m / s per inequality: G' S G joins Q, the two bounds on |g z + h| join as 4 S+ S- / (S+ + S-) on g z + h,
    and the budget's multiplier is a scalar, whose response (`per_price`) is one more right-hand side.
    """
    stiffness = jax.tree.map(lambda m, s: m / s, now.multiplier, now.slack)
    bounds, (upper, lower), budget = stiffness
    total, lean = upper + lower, upper - lower
    Q = problem.Q + jnp.einsum("krn,kr,krm->knm", problem.G, bounds.sum(0), problem.G)
    weight = 4 * upper * lower / total
    factors = _factor(problem, Q.at[:, -1, -1].add(weight * problem.g**2))
    none = jnp.zeros_like(problem.q)
    tilt = lean / total
    per_price = _sweep(problem, factors, none.at[:, -1].set(problem.g * tilt), 0.0)
    spent_per_price = ((problem.g * per_price[:, -1] * lean - 1) / total).sum()

    def newton(target):
        """Solve for the full step towards these products of slack and multiplier."""
        of_bounds, (up, down), price = jax.tree.map(
            lambda c, s, m: c / s + m, target, now.slack, now.multiplier
        )  # multipliers where the slack is zero
        pull = of_bounds[0] + bounds[0] * problem.low - of_bounds[1] + bounds[1] * problem.high
        q = problem.q - jnp.einsum("krn,kr->kn", problem.G, pull)
        q = q.at[:, -1].add(problem.g * (up - down - tilt * (up + down) + weight * problem.h))
        z = _sweep(problem, factors, q, 1.0)
        spent = ((up + down + lean * (problem.g * z[:, -1] + problem.h)) / total).sum()
        rate = ((price - budget * (problem.budget - spent)) / (1 - budget * spent_per_price))[0]
        z = z + rate * per_price
        a = (up + down - rate + lean * (problem.g * z[:, -1] + problem.h)) / total
        slack = _distances(problem, z, a)
        multiplier = jax.tree.map(lambda c, s, m, k, d: c / s + m - k * d, target, now.slack, now.multiplier,
                                  stiffness, slack)  # fmt: skip
        return _Iterate(z, a, slack, multiplier)

    gap = _gap(now.slack, now.multiplier) / count
    # predictor: straight to products of zero, as far as the bounds allow
    aim = newton(jax.tree.map(jnp.zeros_like, now.slack))
    length = _longest(now, aim, 1.0)
    ahead = jax.tree.map(lambda a, b: a + length * (b - a), now, aim)
    # corrector: back to the centre by the cube of the predictor's remaining gap, and with its second-order error
    centre = (_gap(ahead.slack, ahead.multiplier) / count / gap) ** 3 * gap
    second = jax.tree.map(
        lambda s, m, t, n: centre - (t - s) * (n - m), now.slack, now.multiplier, aim.slack, aim.multiplier
    )
    aim = newton(second)
    length = _longest(now, aim, _BACK)
    return jax.tree.map(lambda a, b: a + length * (b - a), now, aim)


def _longest(now: _Iterate, aim: _Iterate, part: float) -> Array:
    """Return the step length, at most 1, that covers the fraction `part` of the way to the nearest bound."""

    def to_zero(value, ahead):
        return jnp.min(where(ahead < value, value / jnp.where(ahead < value, value - ahead, 1.0), jnp.inf))

    ways = jax.tree.map(to_zero, (now.slack, now.multiplier), (aim.slack, aim.multiplier))
    return jnp.minimum(1.0, part * jnp.stack(jax.tree.leaves(ways)).min())


def _factor(problem: StageQP, Q: Array):
    """Compute gains K_k = P_e A / H, H = rho + P_ee and closed-loop matrices A - e K, backwards."""

    def back(P, stage):
        A, Q = stage
        H, column = problem.rho + P[-1, -1], P[-1]
        P = Q + A.T @ (P - jnp.outer(column, column) / H) @ A
        return (P + P.T) / 2, (column @ A / H, H)  # rounding would let P lose its symmetry over thousands of stages

    gains, H = jax.lax.scan(back, jnp.zeros_like(Q[0]), (problem.A, Q), reverse=True)[1]
    return gains, H, problem.A.at[:, -1].add(-gains)


def _sweep(problem: StageQP, factors, q: Array, size: float) -> Array:
    """Solve for all z_k of the problem without inequalities, for another q and `size` times b."""
    gains, H, closed = factors

    def back(p, stage):
        closed, gain, H, q, push = stage
        return q + p @ closed - gain * push, (p[-1] + push) / H

    start = jnp.zeros_like(q[0])
    pushes = jax.lax.scan(back, start, (closed, gains, H, q, size * problem.rho * problem.b), reverse=True)[1]

    def on(z, stage):
        closed, push = stage
        return (closed @ z).at[-1].add(-push), z

    return jax.lax.scan(on, start, (closed, pushes))[1]

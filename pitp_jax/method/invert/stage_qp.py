"""Solve a quadratic programme along a horizon as one sparse programme, with the solver PIQP.

    minimise    sum_k  z_k' Q_k z_k / 2 + q_k' z_k + rho (w_k + b_k)^2 / 2
    subject to  z_{k+1} = A_k z_k + e w_k,  z_0 = 0                            (e: the last unit vector)
                low_k <= G_k z_k <= high_k,   sum_k |g_k z_k[-1] + h_k| <= budget

Each stage has the unknowns (z, spent, w, a):  -a_k <= g z + h <= a_k,  spent_{k+1} = spent_k + a_k,  and the last sum
is at most the budget. The sparse factorisation of the banded KKT system takes K n^3 operations.
"""

from typing import NamedTuple

import numpy as np
import piqp
import scipy.sparse as sparse
from jaxtyping import Float


class StageQP(NamedTuple):
    """A quadratic programme along a horizon, stage by stage: objective, bounds and changes, all of order one."""

    A: Float[np.ndarray, "stages n n"]
    Q: Float[np.ndarray, "stages n n"]
    q: Float[np.ndarray, "stages n"]
    b: Float[np.ndarray, " stages"]
    rho: float
    G: Float[np.ndarray, "stages rows n"]
    low: Float[np.ndarray, "stages rows"]
    high: Float[np.ndarray, "stages rows"]
    g: Float[np.ndarray, " stages"]
    h: Float[np.ndarray, " stages"]
    budget: float


def solve_stage_qp(problem: StageQP) -> Float[np.ndarray, "stages n"]:
    """Solve the programme; return z_k of every stage, not finite if the solver fails."""
    solver, (stages, n) = piqp.SparseSolver(), problem.q.shape
    how = solver.settings
    # a cost much smaller than the bounds took up to 250 iterations instead of 30 without its own scale
    how.check_duality_gap = how.preconditioner_scale_cost = True
    how.eps_abs = how.eps_duality_gap_abs = 1e-5  # objective and bounds are of order one
    how.eps_rel = how.eps_duality_gap_rel = 0.0
    solver.setup(*_sparse(problem))
    solver.solve()
    return np.asarray(solver.result.x).reshape(stages, -1)[:, :n]


def _sparse(p: StageQP) -> tuple:
    """Return the sparse matrices and vectors of the programme over the unknowns of all stages."""
    stages, n = p.q.shape
    rows, m = p.G.shape[1], n + 3
    spent, w, a = n, n + 1, n + 2
    weight, cost = np.zeros((stages, m, m)), np.zeros((stages, m))
    weight[:, :n, :n], weight[:, w, w] = p.Q, p.rho
    cost[:, :n], cost[:, w] = p.q, p.rho * p.b
    onward = np.zeros((stages, n + 1, m))
    onward[:, :n, :n], onward[:, n - 1, w], onward[:, n, spent], onward[:, n, a] = p.A, 1, 1, 1
    # the first block of rows is the start, which is zero
    here = np.tile(np.eye(n + 1, m), (stages, 1, 1))
    dynamics = _diagonal(here) - sparse.vstack([sparse.csc_matrix((n + 1, stages * m)), _diagonal(onward[:-1], m)])
    inside = np.zeros((stages, rows + 2, m))
    inside[:, :rows, :n], inside[:, rows:, a] = p.G, 1
    inside[:, rows, n - 1], inside[:, rows + 1, n - 1] = -p.g, p.g
    total = sparse.csc_matrix(([1.0, 1.0], ([0, 0], [(stages - 1) * m + spent, (stages - 1) * m + a])), (1, stages * m))
    low = np.column_stack([p.low, p.h, -p.h]).ravel()
    high = np.column_stack([p.high, np.full((stages, 2), np.inf)]).ravel()
    bounds = np.append(low, -np.inf), np.append(high, p.budget)
    G = sparse.vstack([_diagonal(inside), total], "csc")
    return _diagonal(weight), cost.ravel(), dynamics.tocsc(), np.zeros(stages * (n + 1)), G, *bounds


def _diagonal(blocks: Float[np.ndarray, "stages rows columns"], more: int = 0) -> sparse.csc_matrix:
    """Place blocks along the diagonal of a sparse matrix, with `more` columns of zeros behind them."""
    stages, rows, columns = blocks.shape
    at, row, column = np.indices(blocks.shape)
    places = (at * rows + row).ravel(), (at * columns + column).ravel()
    matrix = sparse.csc_matrix((blocks.ravel(), places), (stages * rows, stages * columns + more))
    matrix.eliminate_zeros()
    return matrix

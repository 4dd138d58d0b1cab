"""The programme of a nearest motion's step beside PIQP's multistage solver, both to a duality gap of 1e-6.

`_invert.stage_qp` on 1,000 stages of nine numbers: an oscillator at 40 stages a period, lags of it, a voltage change
and its slope; three bounds a stage, and a budget of change that holds. Ours takes stages as they are; PIQP gets them as
sparse matrices, with the sum so far as one more state and a_k as one more control, and its set-up is not timed.
"""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sparse

from pitp_jax._invert.stage_qp import StageQP, solve_stage_qp

from ..clock import row, take_turns
from ..sizes import size

_STAGES, _LAGS = size((1000, 5), (40, 2))
_GAP = 1e-6  # as `solve_stage_qp`
_FAR = 1e30  # a bound that PIQP takes for none


def programme() -> StageQP:
    """Stages of one plant that drifts by half a per cent, and a miss of two periods to be made up for."""
    n, t, angle = _LAGS + 4, np.arange(_STAGES), 2 * np.pi / 40
    onward = np.zeros((n, n))
    onward[:2, :2] = 0.99 * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    keep = np.exp(-1 / (10 * 4.0 ** np.arange(_LAGS)))
    onward[2:-2, 2:-2], onward[2:-2, 0] = np.diag(keep), 1 - keep
    onward[1, -2], onward[-2:, -2:] = 0.1, [[1, 1], [0, 1]]
    drift = 1 + 0.005 * np.random.default_rng(0).standard_normal((_STAGES, 1, 1))
    A = np.where(np.arange(n)[:, None] < 2, onward * drift, onward)
    C, G = np.zeros(n), np.zeros((3, n))
    C[:3], G[0, -2], G[1, -1], G[2, -2:] = [1, 0, -0.1], 1, 10, [1, 0.5]
    miss = 0.3 * np.sin(2 * np.pi * t / 170) + 0.1 * np.sign(np.sin(2 * np.pi * t / 90))
    wide, h = np.full((_STAGES, 3), 0.6), 0.002 * np.sin(2 * np.pi * t / 300)
    parts = (A, np.tile(np.outer(C, C), (_STAGES, 1, 1)), miss[:, None] * C, 0 * t, 0.01,
             np.tile(G, (_STAGES, 1, 1)), -wide, wide, 1.0 + 0 * t, h, 2e-3 * _STAGES)  # fmt: skip
    return StageQP(*(jnp.asarray(part, jnp.float64) for part in parts))


def objective(p: StageQP, z: np.ndarray) -> float:
    """What is minimised, of z that keep the equations."""
    w = np.append(z[1:, -1] - np.einsum("kn,kn->k", p.A[:-1, -1], z[:-1]), 0.0) + np.asarray(p.b)
    return float(0.5 * np.einsum("kn,knm,km", z, p.Q, z) + np.sum(p.q * z) + 0.5 * p.rho * w @ w)


def sparse_form(p: StageQP) -> tuple:
    """P, c, A, b, G and its bounds over (z, sum so far, w, a) of every stage."""
    K, n = p.q.shape
    m = n + 3
    weight = np.zeros((K, m, m))
    weight[:, :n, :n], weight[:, n + 1, n + 1] = p.Q, p.rho
    P = sparse.block_diag(list(weight), format="csc")
    c = np.column_stack([p.q, np.zeros(K), p.rho * p.b, np.zeros(K)]).ravel()
    step = np.zeros((K - 1, n + 1, m))
    step[:, :n, :n], step[:, n - 1, n + 1], step[:, n, n], step[:, n, n + 2] = p.A[:-1], 1, 1, 1
    here = sparse.hstack([sparse.block_diag(list(step)), sparse.csc_matrix(((K - 1) * (n + 1), m))])
    after = sparse.kron(sparse.eye(K), sparse.eye(n + 1, m))  # row block 0 is the start, which is zero
    A = (after - sparse.vstack([sparse.csc_matrix((n + 1, K * m)), here])).tocsc()
    rows = p.G.shape[1]
    inside = np.zeros((K, rows + 2, m))
    inside[:, :rows, :n], inside[:, rows:, n + 2] = p.G, 1
    inside[:, rows, n - 1], inside[:, rows + 1, n - 1] = -p.g, p.g
    spent = sparse.csc_matrix(([1.0, 1.0], ([0, 0], [(K - 1) * m + n, K * m - 1])), shape=(1, K * m))
    low = np.column_stack([p.low, p.h, -p.h]).ravel()
    high = np.column_stack([p.high, np.full((K, 2), _FAR)]).ravel()
    G = sparse.vstack([sparse.block_diag(list(inside)), spent]).tocsc()
    return P, c, A, np.zeros(K * (n + 1)), G, np.append(low, -_FAR), np.append(high, p.budget)


def piqp_ways(p: StageQP) -> tuple[dict, dict, str]:
    """Its two sparse solvers, and the objective that each reaches; or none, and why."""
    try:
        import piqp
    except ImportError as missing:
        return {}, {}, f"{missing.name} is not installed"
    ways, reached = {}, {}
    for name in ("sparse_multistage", "sparse_ldlt"):
        solver, how = (s := piqp.SparseSolver()), s.settings
        how.kkt_solver, how.check_duality_gap = getattr(piqp.KKTSolver, name), True
        how.eps_abs, how.eps_rel, how.eps_duality_gap_abs, how.eps_duality_gap_rel = _GAP, 0.0, _GAP, 0.0
        solver.setup(*sparse_form(p))
        solver.solve()
        reached[f"PIQP {name}"] = objective(p, np.asarray(solver.result.x).reshape(len(p.q), -1)[:, : p.q.shape[1]])
        ways[f"PIQP {name}"] = solver.solve
    return ways, reached, ""


def measure(seconds: float) -> dict:
    """Ours, and the peer's multistage solver beside it."""
    with jax.enable_x64(True):
        p = programme()
        ways, reached, why = piqp_ways(p)
        z, iterations, gap = solve_stage_qp(p, 0.02)
        found = take_turns({"pitp_jax": lambda: solve_stage_qp(p, 0.02)} | ways, seconds)
        reached = {"pitp_jax": objective(p, np.asarray(z)), **reached}
    peer = "PIQP sparse_multistage"
    return row(found, "pitp_jax", peer if peer in ways else None, stages=_STAGES, iterations=int(iterations),
               gap=float(gap), objectives=reached, peer_skipped=why)  # fmt: skip

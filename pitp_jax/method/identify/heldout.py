"""Score a candidate on blocks left out of its fit, and only by the part of the output that the input explains.

    every record in 3 blocks;  fold f leaves out block (f + record) mod 3;  poles, delay, gain refitted on the rest
    e = y - g x - (real modes' free responses) - mean over the block,      score^2 = sum e^2 / sum (y - mean)^2

x is simulated through the whole record from rest, or from the equilibrium of u(0). It does not contain an oscillation
that no input excites, so a lightly damped mode fitted to a harmonic does not improve the score (a piezo: 2.6 % in
sample, 58 % on other records). A record that starts in motion is not scored in the first half of its block: transients
decay there, and a delay no longer needs the input before the record.
"""

from dataclasses import dataclass

import numpy as np

from ..model.origin import OutOfFold
from .output_error import OutputError, Problem, Structure, least_squares, masked

_FOLDS = 3


@dataclass(frozen=True)
class HeldOut:
    """Held-out residual of every record, from fits without each block (1 = the output's rms; 0 where not scored).

    Attributes:
        score: rms of the error over the standard deviation of the output, both about the block's mean.
        error, scored: per record, shape (T_r,).
    """

    score: float
    error: tuple[np.ndarray, ...]
    scored: tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Candidate:
    """A fitted candidate: structure, parameters, and its residuals in sample (mean square, output = 1) and held out.

    `known`: the records determine its poles (`order_fit`).
    """

    structure: Structure
    params: np.ndarray
    cost: float
    converged: bool
    heldout: HeldOut
    known: bool

    def on(self, problem: Problem) -> OutputError:
        """Return the output error of this candidate on a problem's records."""
        return OutputError(self.params, self.structure, problem)

    @property
    def score(self) -> float:
        """Return the held-out error as a fraction of the output's deviation, at least 0.1 %."""
        # no record resolves less
        return float(np.hypot(self.heldout.score, 1e-3))


def out_of_fold(heldout: HeldOut, problem: Problem) -> OutOfFold:
    """Return the rms of held-out error and output in octaves, from one period per record to the Nyquist frequency."""
    low, high = 1 / problem.seconds, 0.5 / problem.dt
    edges = low * 2.0 ** np.arange(int(np.ceil(np.log2(high / low))) + 1)
    total = np.zeros((2, len(edges) - 1))
    for error, scored, output in zip(heldout.error, heldout.scored, problem.output, strict=True):
        mean = scored @ output / max(scored.sum(), 1.0)
        hz = np.fft.rfftfreq(len(error), problem.dt)
        for row, signal in zip(total, (error, scored * (output - mean)), strict=True):
            row += np.histogram(hz, edges, weights=2 * np.abs(np.fft.rfft(signal)) ** 2 / len(signal))[0]
    rms = problem.scale * np.sqrt(total / max(sum(s.sum() for s in heldout.scored), 1.0))
    return OutOfFold(tuple(edges.tolist()), *(tuple(row.tolist()) for row in rms))


def held_out(params: np.ndarray, structure: Structure, problem: Problem) -> HeldOut:
    """Refit without each third of the blocks in turn, from `params`; return the errors on the blocks left out."""
    edges = [np.linspace(0, len(w), 3 * _FOLDS + 1).astype(int) for w in problem.weight]
    error = [np.zeros(len(w)) for w in problem.weight]
    scored = [np.zeros(len(w)) for w in problem.weight]
    missed = whole = 0.0
    for fold in range(_FOLDS):
        numbers = [np.repeat(np.arange(3 * _FOLDS) - k - fold, np.diff(e)) for k, e in enumerate(edges)]
        rest = masked(problem, [n % _FOLDS > 0 for n in numbers])
        # start from the fit of all samples; a few steps undo the influence of the third left out
        error_of_rest = OutputError(least_squares(params, structure, rest, 4, 1e-3).params, structure, rest)
        solved, (free, rings) = error_of_rest.solved, error_of_rest.free
        for k, e in enumerate(edges):
            # a real mode's free response is drift or creep and continues; a ringing mode gets no credit
            sizes = solved.own[k] * ~rings[: len(solved.own[k])]
            run = solved.gains[0] * error_of_rest.runs[k] + free[k] @ sizes
            for j in range((fold + k) % _FOLDS, 3 * _FOLDS, _FOLDS):
                block = slice(*e[j : j + 2])
                weight = problem.weight[k][block].copy()
                if block.start == 0 and len(sizes):  # the same for every candidate, whatever rings in it
                    weight[: len(weight) // 2] = 0.0
                if not weight.sum():
                    continue
                y = problem.output[k][block]
                miss, y = ((v - weight @ v / weight.sum()) * weight for v in (y - run[block], y))
                error[k][block], scored[k][block] = miss, weight
                missed, whole = missed + float(miss @ miss), whole + float(y @ y)
    score = float(np.sqrt(missed / max(whole, 1e-300)))
    return HeldOut(score if np.isfinite(score) else np.inf, tuple(error), tuple(scored))

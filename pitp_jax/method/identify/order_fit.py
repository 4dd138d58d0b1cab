"""Describe one identified order in physical units, with the covariance of its parameters.

    a_i = c_i / (c_0 |g|)
    cov p = D H^-1 (sum_b g_b g_b') H^-1 D B / (B - P) + sum_z v v' var(z),    H = J'J,    v = dp/dz = H^-1 J'w

g_b: half the gradient over four of 64 blocks of samples in a row (overlapping batch means: B = 1.5 64 / 4 degrees of
freedom; Meketon and Schmeiser, 1984). Model error and slow noise are strongly correlated, and the textbook sigma^2 H^-1
would understate the errors by an order of magnitude; separate blocks, AR(0.98) in 62 samples, by a third. If few blocks
determine a parameter, the sandwich is too small: D >= 1 widens it to the textbook's variance. J: initial states
projected out. The offset of a record at rest is not fitted; v propagates its error.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...common.shown import Shown
from ..model.model import Hold
from ..numerics.coloured_noise import project
from .heldout import Candidate
from .linear_ode import pole_slopes, polynomial, polynomial_slopes
from .output_error import FASTEST, OutputError, Problem, gram_of, inverse

_BLOCKS, _IN_A_ROW = 64, 4
_BEYOND = 1.5  # rad a sample: these samples cannot show a faster pole
_KNOWN = 3.0  # largest standard error of a logarithm; unmeasured poles have errors of hundreds


@dataclass(frozen=True, repr=False)
class OrderFit(Shown):
    """The best fit of one order: coefficients in physical units, errors, and whether the records determine it.

    Attributes:
        order: n.
        hold: the voltage between samples.
        coefficients, stderr: a_0 ... a_n in V^2 s^i / m (V s^i / m for a linear input) and their standard errors,
            robust to correlated residuals, including the error of an offset estimated at rest.
        correlation: of those errors, shape (n + 1, n + 1).
        mae, rms: mean absolute and root mean square error of the free run over observed samples, m (paper, III-D).
        heldout: rms error on held-out blocks, % of the output's standard deviation there (`heldout`).
        natural_hz, damping: of every real pole and pole pair, ascending in frequency.
        natural_stderr: of the natural frequencies, Hz.
        offset, polarity: sensor offset (m) and direction (+1 or -1).
        converged: the least squares met its tolerance.
        poles_known: converged, and the logarithm of every pole is known to +-3 (a strong nonlinearity inflates the
            errors of a good linear fit). The pole that makes it `static` may be unknown. No pole lies at the upper
            bound.
        identifiable: its poles are known, and every coefficient is larger than its standard error, except the one that
            a `static` or integrating plant does not show.
        static: order 1, with a pole too fast for the sampling rate.
        integrates: one pole is 0: a plant without a spring.
        delay, delay_stderr: of the input in s, if one was fitted.
        input_offset: constant, added to the input of a plant without a spring.
    """

    order: int
    hold: Hold
    coefficients: np.ndarray
    stderr: np.ndarray
    correlation: np.ndarray
    mae: float
    rms: float
    heldout: float
    natural_hz: np.ndarray
    damping: np.ndarray
    natural_stderr: np.ndarray
    offset: float
    polarity: float
    converged: bool
    poles_known: bool
    identifiable: bool
    static: bool
    integrates: bool
    delay: float
    delay_stderr: float
    input_offset: float

    @property
    def hidden(self) -> list[int]:
        """Return which coefficients an integrating or static plant does not show."""
        return _hidden(self.static, self.integrates)


def _hidden(static: bool, integrates: bool) -> list[int]:
    return [0] * integrates + [1] * static


def describe(candidate: Candidate, problem: Problem) -> OrderFit:
    """Return one fitted order in physical units: coefficients, standard errors, errors used for comparison."""
    error, structure = candidate.on(problem), candidate.structure
    n, poles, solved, spread = structure.moved, error.poles, error.solved, covariance(error)
    residual = np.concatenate(solved.residuals) * problem.scale
    coefficients, jacobian = _physical(error)
    main = spread[: n + 1, : n + 1]
    of_coefficients = jacobian @ main @ jacobian.T
    stderr = np.sqrt(np.clip(np.diag(of_coefficients), 0, None))
    stderr[: structure.integrates] = coefficients[0]
    determined, static = _determined(error, spread)
    known = candidate.converged and determined
    upper = np.flatnonzero(np.imag(poles) >= 0)
    upper = upper[np.argsort(np.abs(poles[upper]))]
    size, angle = np.abs(poles[upper]), np.angle(poles[upper])  # of a pole at -0: pi
    # d |p| = Re(p* dp) / |p|
    rates = np.real(np.exp(-1j * angle)[:, None] * pole_slopes(error.logs)[upper, :n])
    return OrderFit(
        order=structure.order,
        hold=structure.hold,
        coefficients=coefficients,
        stderr=stderr,
        correlation=of_coefficients / np.maximum(np.outer(stderr, stderr), 1e-300),
        mae=float(np.abs(residual).sum() / problem.samples),
        rms=float(np.sqrt((residual**2).sum() / problem.samples)),
        heldout=100 * candidate.heldout.score,
        natural_hz=size / (2 * np.pi),
        damping=-np.cos(angle),
        natural_stderr=np.sqrt(np.clip(np.diag(rates @ main[:n, :n] @ rates.T), 0, None)) / (2 * np.pi),
        offset=zero_of(problem.main, error),
        polarity=float(np.sign(solved.gains[0]) or 1.0),
        converged=candidate.converged,
        poles_known=known,
        identifiable=known
        and bool(np.delete(stderr < np.abs(coefficients), _hidden(static, structure.integrates)).all()),
        static=static,
        integrates=structure.integrates,
        delay=error.delay,
        delay_stderr=error.delay * float(np.sqrt(max(spread[-1, -1], 0.0))) if error.delay else 0.0,
        input_offset=structure.offset(error.params),
    )


def identifiable(error: OutputError, converged: bool) -> bool:
    """Return whether the records determine the poles of this fit, as `OrderFit.poles_known` defines it."""
    return converged and _determined(error, covariance(error))[0]


def _determined(error: OutputError, spread: np.ndarray) -> tuple[bool, bool]:
    """Return two answers: are the poles determined, is the plant static."""
    poles, problem = error.poles, error.problem
    errors, fastest = np.sqrt(np.clip(np.diag(spread), 0, None)), np.abs(poles).max()
    is_open = bool((errors[: np.count_nonzero(poles)] >= _KNOWN).any())
    least = 1 / problem.seconds if is_open else _BEYOND / problem.fine
    static = bool(len(poles) == 1 and fastest > least)
    return static or not is_open and bool(fastest <= 0.97 * FASTEST / problem.fine), static


def zero_of(record: int, error: OutputError) -> float:
    """Return the sensor offset of a record, in the output's unit."""
    problem = error.problem
    fitted = error.solved.gains[problem.numbers()[record][1:]]  # none or one
    return float(problem.beginnings[record].zero + problem.scale * fitted.sum())


def _physical(error: OutputError) -> tuple[np.ndarray, np.ndarray]:
    """Return the coefficients of sum a_i x^(i) = F in physical units, and their derivatives by logarithms and gain."""
    logs, structure, problem, gain = error.logs, error.structure, error.problem, float(error.solved.gains[0])
    first = int(structure.integrates)
    # programs divide by a_0: a pole of 1e-6 rad in the longest record stands for one at 0
    logs = np.maximum(logs, np.log(1e-6 / problem.seconds)) if first else logs
    poly, slopes = polynomial(logs), polynomial_slopes(logs)[:, : structure.moved]
    unit = poly[first] * abs(gain) * problem.scale
    a = poly / unit
    return a, np.column_stack([(slopes - np.outer(poly, slopes[first] / poly[first])) / unit, -a / gain])


def covariance(error: OutputError) -> Float[np.ndarray, "numbers numbers"]:
    """Return the covariance of (log pole coefficients, gain, fitted sensor offsets, log delay); see the file's head."""
    problem, count, (solved, slopes) = error.problem, len(error.params), error.jacobians()
    linear, n = 1 + problem.free_zeros, error.structure.moved
    order = [*range(linear, linear + n), *range(linear), *range(linear + n, linear + count)]
    # of every record, the places of its numbers in this order
    places = [np.argsort(order)[at] for at in problem.numbers(count)]
    slopes = [slope[:, : len(weight)] for slope, weight in zip(slopes, problem.weight, strict=True)]
    hessian, size = gram_of(slopes, places), len(order)
    scores, by_zero = np.zeros((_BLOCKS, size)), {b.group: np.zeros(size) for b in problem.beginnings}
    cost, seen = 0.0, 0.0
    series = slopes, places, solved.residuals, problem.weight, error.free[0], problem.beginnings
    for slope, at, residual, weight, own, b in zip(*series, strict=True):
        one = project(b.direction * weight, own * weight[:, None])[1]
        # dp = H^-1 J'w dz: the change caused by an error of the offset measured at rest
        by_zero[b.group][at] += slope @ one * (0.0 if b.free else b.stderr / problem.scale)
        cost += float(residual @ residual)
        block = np.minimum((seen + np.cumsum(weight) - 1) * _BLOCKS / problem.samples, _BLOCKS - 1).astype(int)
        seen += weight.sum()
        edges = np.flatnonzero(np.diff(block, prepend=-1))  # a block may span two records: sums are added up
        np.add.at(scores, (block[edges][:, None], at), np.add.reduceat(slope.T * residual[:, None], edges))
    inverted = inverse(hessian)
    count, free = _BLOCKS - _IN_A_ROW + 1, 1.5 * _BLOCKS / _IN_A_ROW
    moves = sum(scores[k : k + count] for k in range(_IN_A_ROW)) @ inverted
    # H^-1 (sum g g') H^-1 B / (B - P); samples at the ends belong to fewer blocks
    sandwich = moves.T @ moves * (_BLOCKS / count / _IN_A_ROW * free / max(free - size, 1))
    textbook = cost / max(problem.samples - size, 1) * inverted
    wider = np.sqrt(np.maximum(np.diag(textbook) / (np.diag(sandwich) + 1e-300), 1.0))
    moved = [inverted @ v for v in by_zero.values()]
    return sandwich * np.outer(wider, wider) + sum(np.outer(v, v) for v in moved)

"""Write remarks about an identification for the engineer, one sentence each.

    least certain:      d log a = v sqrt(l)             v, l: eigenvector of the largest eigenvalue of cov log a
    creep:              e = b s + w,  tau s' = F - s    e: residual; significant by BIC, w coloured

Each line ends with a recording to make or a question to answer.
"""

import numpy as np

from ..numerics.coloured_noise import block_means, criterion, project, whitener
from .heldout import Candidate
from .linear_ode import respond
from .order_fit import OrderFit
from .output_error import FASTEST, OutputError, Problem
from .unstable import unstable_pole

UNSTABLE = "The plant is unstable"
_BOUND = 0.97  # fraction of a bound: a fit beyond it counts as stopped there
_USELESS = 0.1  # fraction of the output's deviation: a larger held-out residual may mean an unstable plant
_SURE, _SEEN = 10.0, 0.01  # BIC that creep must gain; fraction of the output's deviation that it must explain


def refusal(fit: OrderFit, problem: Problem) -> str:
    """Write why the requested order cannot be identified, and what to do."""
    why = "its poles are not determined by the data" if fit.converged else "the fit diverged"
    if _at_fastest(fit, problem):
        hz = FASTEST / problem.fine / (2 * np.pi)
        why = f"a pole is at the highest frequency that this sampling can show, {hz:.3g} Hz"
    where = f"order {fit.order} cannot be identified from these recordings ({why})"
    return f"{where}; record a sweep, or use --order auto to try lower orders"


def remarks(fit: OrderFit, chosen: Candidate, problem: Problem, *, every: bool) -> list[str]:
    """Write remarks on what the records do not determine; `every`: whether all orders were tried."""
    if every and chosen.heldout.score > _USELESS and (line := unstable_line(chosen, problem)):
        return [line]
    said, slowest = [], 2 * np.pi * float(fit.natural_hz[0])
    if fit.static:
        said.append(
            f"The plant is static within the recorded band: no pole below "
            f"{1.5 / (2 * np.pi * problem.fine):.3g} Hz is visible."
        )
    if fit.integrates:
        said.append(
            f"The output integrates the input (a plant without a spring; a0 is not known), so free runs drift: an "
            f"input error of 1 unit moves the output by {1 / fit.coefficients[1]:.3g} base units per second."
        )
    elif slowest * problem.seconds < 1 and fit.order > 1:
        said.append(
            f"A pole at {slowest / (2 * np.pi):.2g} Hz is slower than these recordings. Record for {3 / slowest:.2g} s "
            "to measure it."
        )
    if not any(b.begins == "rest" or _near_zero(d) for b, d in zip(problem.beginnings, problem.drive, strict=True)):
        said.append("No recording starts near zero input, so the output there is not known and 0 is assumed.")
    if fit.delay > _BOUND * problem.seconds / 4:
        said.append(
            f"The delay is at its upper limit of {problem.seconds / 4:.3g} s, a quarter of the longest recording. "
            "Check that input and output have the same clock."
        )
    return said + _weak(fit) + _creep(chosen.on(problem))


def _near_zero(drive: np.ndarray) -> bool:
    return bool(drive.min() <= 0 <= drive.max() or np.abs(drive).min() < 0.1 * np.abs(drive).max())


def _at_fastest(fit: OrderFit, problem: Problem) -> bool:
    return bool(not fit.static and 2 * np.pi * fit.natural_hz[-1] > _BOUND * FASTEST / problem.fine)


def unstable_line(chosen: Candidate, problem: Problem) -> str | None:
    """Write that the plant is unstable and what to record instead; None if no unstable pole is found."""
    error = float(np.sqrt(chosen.cost))
    better = unstable_pole(error, problem)
    if better is None:
        return None
    pole, rms = better
    where = f"{pole.real:.3g} 1/s" if not pole.imag else f"{pole.real:.3g} +- {pole.imag:.3g}j 1/s"
    return (
        f"{UNSTABLE}: with a pole at +{where}, {100 * rms:.2g} % of the motion remains unexplained, with "
        f"the best stable model {100 * error:.2g} %, so its free runs diverge. Identify the closed loop instead, with "
        "its reference as the input and the same output."
    )


def _weak(fit: OrderFit) -> list[str]:
    """Write remarks on coefficients that the data do not show, and on the least certain combination of the others.

    It is reported from a standard error of 10 % on, with the coefficients of at least 0.3 times its largest part.
    """
    relative = fit.stderr / np.abs(fit.coefficients)
    # an unknown coefficient of the hidden kinds has a remark of its own
    without = [i for i, e in enumerate(relative) if e > 1 and i not in fit.hidden]
    names = ", ".join(f"a{i}" for i in without)
    said = [f"Not known, because without influence on these recordings: {names}."] if without else []
    rest = [i for i in range(fit.order + 1) if i not in (*without, *fit.hidden)]
    spread = (fit.correlation * np.outer(relative, relative))[np.ix_(rest, rest)]
    values, vectors = np.linalg.eigh(spread)
    if len(rest) < 2 or not np.isfinite(values).all() or values[-1] < 0.1**2:
        return said
    most = vectors[:, -1] * np.sqrt(values[-1])
    most = most * np.sign(most[np.argmax(np.abs(most))])
    parts = [
        f"a{i} {100 * abs(m):.2g} % {'larger' if m > 0 else 'smaller'}"
        for i, m in zip(rest, most, strict=True)
        if abs(m) > 0.3 * np.abs(most).max()
    ]
    what = "combination" if len(parts) > 1 else "coefficient"
    return [
        *said,
        f"Least certain {what}: {' with '.join(parts)} (one standard error) would not change the fit visibly.",
    ]


def _creep(linear_fit: OutputError) -> list[str]:
    """Write a remark on creep slower than the model's poles, and how long to hold an input to measure it."""
    problem, order = linear_fit.problem, linear_fit.structure.order
    taus = np.geomspace(0.1, 10.0, 9) * problem.seconds  # of the longest record
    error, linear, lags, drift = _slow_parts(linear_fit, taus)
    # The richest hypothesis sets the spectrum; otherwise creep would be removed as coloured noise.
    white = whitener(project(error, np.column_stack([linear, *lags, drift]))[1])

    def score(*more: np.ndarray) -> float:
        columns = np.column_stack([linear, *more])
        return criterion(project(white(error), white(columns))[1], columns.shape[1] - linear.shape[1])

    plain, line = score(), score(drift)
    scores = [score(lag) + np.log(len(error)) for lag in lags]  # tau is a parameter too
    best = int(np.argmin(scores))
    richer = project(error, np.column_stack([linear, lags[best], drift]))[1]
    moved = float(np.std(project(error, linear)[1] - richer))
    spread = float(np.sqrt(np.mean([np.var(o[w > 0]) for o, w in zip(problem.output, problem.weight, strict=True)])))
    if min(scores[best], line) > plain - _SURE or moved < _SEEN * spread:
        return []
    part, tau = f"{100 * moved / spread:.2g} % of the signal", taus[best]
    if scores[best] > line - _SURE:  # a line in time per record, independent of the input, does as well
        return [
            f"A slow drift makes up {part}: creep slower than the recordings, or the sensor. Hold a constant input for "
            f"{3 * problem.seconds:.2g} s to tell them apart."
        ]
    slow = f"about {tau:.2g} s{' or more' * (best == len(taus) - 1)}"
    return [
        f"Creep ({slow}) makes up {part}; a model of order {order} cannot describe it. Hold a constant input for "
        f"{3 * tau:.2g} s to measure it."
    ]


def _slow_parts(linear_fit: OutputError, taus: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return block means of the residual (T,), and of the fitted terms, lags and straight lines that may explain it."""
    problem = linear_fit.problem
    settled = np.array([b.begins != "rest" for b in problem.beginnings])
    how = {"step": problem.dt, "square": problem.square, "hold": "foh", "settled": settled, "heads": problem.heads}
    drive, parts = np.concatenate(problem.drive), []
    lags = np.stack([respond(np.array([-np.log(tau)]), drive, **how) for tau in taus], 1)
    series = (linear_fit.free[0], linear_fit.solved.residuals, linear_fit.runs, np.split(lags, problem.heads[1:]))
    for k, (own, error, run, slow) in enumerate(zip(*series, strict=True)):
        weight, zero = problem.weight[k], problem.zeros[k]
        columns = [error, run, slow, np.full(len(weight), zero >= 0), np.linspace(0.0, 1.0, len(weight))]
        wide = np.column_stack(columns)
        # A part that the record's own initial state can explain is not evidence of creep.
        means = block_means(project(wide, own)[1], weight, max(len(weight) // 256, 1))[0]
        zeros, drift = np.zeros((len(means), max(problem.free_zeros, 1))), np.zeros((len(means), len(problem.drive)))
        zeros[:, max(zero, 0)], drift[:, k] = means[:, -2:].T
        parts.append(np.hstack([means[:, :2], zeros, means[:, 2:-2], drift]))
    rows, n = np.concatenate(parts), 2 + max(problem.free_zeros, 1)
    return rows[:, 0], rows[:, 1:n], rows[:, n : n + len(taus)].T, rows[:, n + len(taus) :]

"""Estimate initial state, sensor offset and sensor direction of every record by maximum likelihood.

    y = d (g x(t) + free(t)) + z,    free: 0 at rest | F(0) unit step's release when held | any x(0), x'(0) in motion

Poles and gain come first from a fit without any assumption: every record has its own offset, direction and initial
state, which all enter linearly. Then the criterion of `numerics.coloured_noise` selects the simplest initial state of
each record. A record at rest takes its offset from its first samples, which contain no model error. Other records share
an offset or have their own, by the same criterion.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from ..model.input_map import forces_of
from ..numerics.coloured_noise import block_means, project, whitener
from ..signal.excitation_kind import spread_over_kinds
from ..signal.initial_state import Beginning, from_known, level_groups, noise_of, rest_level
from ..signal.preprocess import force_band
from ..signal.record import Record
from ..signal.reduced import averaged, block_size
from ..signal.start import Response, estimate_start, first_part
from .linear_ode import bounded, coast, logs_from_roots, polynomial, respond
from .linear_ode import poles as modes
from .output_error import FASTEST, OutputError, Problem, Structure, build_problem, least_squares
from .starts import guesses

_PER_PERIOD = 10  # samples per period of the band's top or of the resonance, enough to distinguish initial states
_STRUCTURE = Structure(2)


@threadpool_limits.wrap(limits=1, user_api="blas")  # as in `identification`
def find_beginnings(records: Sequence[Record], input_map: str) -> tuple[list[Beginning], np.ndarray | None, float]:
    """Return initial states, the poles of order 2 (rad/s) and the residual as a fraction of the output's deviation.

    The roots are None and the fraction 1 if no such model could be fitted.
    """
    begun = [from_known(r) for r in records]
    chosen, small = _decimated(begun, input_map)
    first = _first_poles(small)
    if first is None:
        return [Beginning("rest", 1.0, *rest_level(r)) for r in begun], None, 1.0
    cost, poles = first
    clean = _only_noise(cost, small)
    decided: list[Beginning] = []
    known = [r is b for r, b in zip(records, begun, strict=True)]
    for _ in range(4):
        # a record beside the offsets of the others that start at rest
        zeros = [{b.zero for m, b in enumerate(decided) if b.begins == "rest" and m != k} for k in range(len(begun))]
        starts = [start_beside(r, input_map, *poles, sorted(z)) for r, z in zip(begun, zeros, strict=True)]
        # a record whose first samples are missing is moving
        starts = [s if whole else replace(s, begins="moving") for s, whole in zip(starts, known, strict=True)]
        fitted = [_fitted_zero(r, input_map, *poles, s) for r, s in zip(begun, starts, strict=True)]
        before, decided = decided, _with_zeros(begun, starts, fitted, clean)
        if [(b.begins, b.direction, b.group) for b in before] == [(b.begins, b.direction, b.group) for b in decided]:
            break
        some = build_problem([begun[k] for k in chosen], input_map, [decided[k] for k in chosen])
        better = _fitted(poles[0], some)
        if better is None:
            break
        cost, poles = better
    return decided, np.roots(polynomial(poles[0])[::-1]), float(np.sqrt(cost))


def _only_noise(cost: float, records: Sequence[Record]) -> bool:
    """Return whether a model of order 2 leaves only sensor noise; its error then cannot bias a fitted sensor offset."""
    size = np.mean([np.nanmean((r.displacement - np.nanmedian(r.displacement)) ** 2) for r in records])
    # a model without error leaves at most 1.2 times the noise
    return bool(np.sqrt(cost * size) < 1.2 * np.median(noise_of(records)))


def _decimated(records: Sequence[Record], input_map: str) -> tuple[list[int], list[Record]]:
    """Select records of every kind; return indices, and these records averaged over a tenth of the fastest period."""
    forces = forces_of(records, input_map)
    dt, shortest = records[0].dt, min(r.samples for r in records)
    size = block_size(dt, force_band(forces, dt), _PER_PERIOD, shortest)
    # as many records as 100,000 samples hold
    chosen = spread_over_kinds(records, max(1, 100_000 * size * len(records) // sum(r.samples for r in records)))
    return list(chosen), [averaged(records[k], forces[k], size) for k in chosen]


def _first_poles(small: Sequence[Record]) -> tuple[float, tuple[np.ndarray, float]] | None:
    """Fit a model of order 2 with free initial states from the best three guesses; None if all fail.

    Return mean square residual and model.
    """
    unknown = [Beginning("moving", 1.0, float(np.nanmedian(r.displacement)), 0.0, k, True) for k, r in enumerate(small)]
    problem = build_problem(small, "linear", unknown)
    scored = []
    for roots in guesses(_STRUCTURE.order, problem):
        logs = bounded(logs_from_roots(roots), 0.0, FASTEST / problem.fine)
        same = _directed(logs, problem)
        scored.append((OutputError(logs, _STRUCTURE, same).cost, logs, same))
    fits = [_fitted(logs, same) for _, logs, same in sorted(scored, key=lambda s: s[0])[:3]]
    return min((fit for fit in fits if fit), key=lambda fit: fit[0], default=None)


def _fitted(start: np.ndarray, problem: Problem) -> tuple[float, tuple[np.ndarray, float]] | None:
    """Fit a second-order model; return mean square residual, log pole coefficients (rad/s), gain (m per V^2 or V)."""
    fit = least_squares(start, _STRUCTURE, problem)
    gain = float(OutputError(fit.params, _STRUCTURE, problem).solved.gains[0]) * problem.scale
    return (fit.cost, (fit.params, gain)) if np.isfinite(fit.cost) else None


def _directed(logs: np.ndarray, problem: Problem) -> Problem:
    """Reverse the sensor of those normalised records whose gain has another sign than most."""
    gains: list[float] = []
    if len(problem.drive) == 1:
        return problem
    error = OutputError(logs, _STRUCTURE, problem)
    for unit, own, output, weight in zip(error.runs, error.free[0], problem.output, problem.weight, strict=True):
        columns = weight[:, None] * np.column_stack([unit, np.ones(len(unit)), own])
        gains.append(project(weight * output, columns)[0][0] * np.std(unit))
    directions = np.where(np.sum(gains) * np.array(gains) >= 0, 1.0, -1.0).tolist()
    return replace(
        problem,
        output=tuple(d * o for d, o in zip(directions, problem.output, strict=True)),
        beginnings=tuple(replace(b, direction=d) for b, d in zip(problem.beginnings, directions, strict=True)),
    )


def _fitted_zero(
    record: Record, input_map: str, logs: np.ndarray, gain: float, start: Beginning
) -> tuple[float, float, int]:
    """Fit the sensor offset of a whole record that starts in this way, beside a linear model.

    Returns:
        the offset (output unit), its weight (1 / variance), and the number of block means.
    """
    dt, moving = record.dt, start.begins == "moving"
    how = {"step": dt, "square": input_map == "square", "hold": "foh", "settled": start.begins == "held"}
    free, _ = coast(logs, record.samples, step=dt)
    period = 2 * np.pi / np.exp(logs[1] / 2)
    size = int(np.clip(period / _PER_PERIOD / dt, 1, record.samples // 64))
    run = respond(logs, record.voltage, **how)
    rest = np.nan_to_num(record.displacement) - start.direction * gain * run
    stacked = np.column_stack([rest, np.ones(len(rest)), free])
    means, share = block_means(stacked, record.observed.astype(float), size)
    means = means * np.sqrt(share)[:, None]
    # the residual beside any initial state has the model's error in it, but no other start's
    white = whitener(project(means[:, 0], means[:, 1:])[1])(means)
    columns = white[:, 1 : 2 + moving * free.shape[1]]
    factors, residual = project(white[:, 0], columns)
    alone = project(columns[:, 0], columns[:, 1:])[1]
    return float(factors[0]), float(alone @ alone / max(residual @ residual / len(residual), 1e-300)), len(residual)


def start_beside(
    record: Record, input_map: str, logs: np.ndarray, gain: float, zeros: Sequence[float] = ()
) -> Beginning:
    """Estimate how a record starts beside a linear model of order 2; `zeros`: sensor offsets of other records."""
    omega = float(np.exp(logs[1] / 2))
    part = first_part(record, omega)
    rest, held = (
        gain * respond(logs, part.voltage, step=part.dt, square=input_map == "square", hold="foh", settled=settled)
        for settled in (False, True)
    )
    return estimate_start(part, Response(rest, held, modes(logs), omega, zeros))


def _with_zeros(
    records: Sequence[Record], starts: Sequence[Beginning], fitted: Sequence[tuple[float, float, int]], clean: bool
) -> list[Beginning]:
    """Return initial states with sensor offsets: measured in the first samples at rest (pooled), otherwise fitted.

    A fitted offset is the most common one at rest, or one fitted before, if both are equal within their errors.
    """
    decided, groups = list(starts), []
    resting = [k for k, start in enumerate(starts) if start.begins == "rest"]
    for members, zero, stderr in level_groups([records[k] for k in resting]):
        free = clean or _sharper([fitted[resting[m]] for m in members], zero, stderr)
        groups.append({"zero": zero, "stderr": stderr, "group": len(groups), "free": free})
        for m in members:
            decided[resting[m]] = replace(starts[resting[m]], **groups[-1])
    at_rest = len(groups)
    # the most certain offset first
    for k in sorted(set(range(len(starts))) - set(resting), key=lambda k: -fitted[k][1]):
        zero, weight, size = fitted[k]
        for group in (*groups[: min(at_rest, 1)], *groups[at_rest:]):
            change = weight * (zero - group["zero"]) ** 2 / (1 + weight * group["stderr"] ** 2)
            if size * np.log1p(change / size) <= np.log(size):  # BIC
                break
        else:
            group = {"zero": zero, "stderr": float(weight**-0.5), "group": len(groups), "free": True}
            groups.append(group)
        decided[k] = replace(starts[k], **group)
    return decided


def _sharper(fitted: Sequence[tuple[float, float, int]], level: float, stderr: float) -> bool:
    """Return whether whole records determine a sensor offset more precisely than their first samples, without bias.

    The fitted offset has the smaller standard error, and both agree within five combined standard errors.
    """
    weight = sum(w for _, w, _ in fitted)
    mean = sum(z * w for z, w, _ in fitted) / weight
    return bool(weight * stderr**2 > 1 and (mean - level) ** 2 < 25 * (1 / weight + stderr**2))

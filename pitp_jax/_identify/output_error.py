"""The output error of a linear ODE over a padded set of records, and the covariance of its parameters.

    r_t = w_t (gain x_t(poles, start) + offset - y_t),    p = (log pole coefficients, gain, offset, [starts])
    the offset is fitted only where no record starts at rest: a linear model's misfit would bend it by far more than
    the first samples leave open (cone100 sweep: 11 um against 1)

    cov p = D H^-1 (sum_b g_b g_b') H^-1 D B / (B - P) + v v' var(offset),    H = J'J,    v = dp/doffset = H^-1 J'w

Everything is normalised: voltage, output and frequency by their scales. g_b is the gradient over one of B = 64 blocks
of samples (block sandwich): model error is strongly correlated, and the textbook sigma^2 H^-1 would understate the
errors by an order of magnitude. Where few blocks tell of a parameter the sandwich is the smaller one: D >= 1 widens
it to the textbook's variance. v: an offset taken from rest is not fitted, but it has an error too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from .._errors import BadInput
from .._numerics.levenberg_marquardt import Normal
from .._numerics.linear_recurrence import pieces
from .._record.checks import MIN_SAMPLES
from .._record.initial_state import first_known, initial_rest, rest_level
from .._record.preprocess import force_band
from .._record.record import Record
from .linear_ode import coast, respond

_BLOCKS = 64
# A ridge per sample on the logarithms gives directions the data do not see (a pole far above the band) a minimum; it
# moves identifiable poles by less than 1e-6 of themselves.
_RIDGE = 1e-10


@dataclass(frozen=True)
class OutputError:
    """The data of one identification: padded to (records, time), normalised by the scales it carries."""

    drive: Float[np.ndarray, "records time"]
    output: Float[np.ndarray, "records time"]
    weight: Float[np.ndarray, "records time"]
    rest: tuple[bool, ...]
    square: bool
    dt: float
    omega: float
    voltage_scale: float
    output_scale: float
    offset: float
    offset_std: float  # standard error of the offset found at rest, over output_scale; 0 where the offset is fitted

    def parameters(self, order: int) -> int:
        """Number of parameters: poles, gain, an offset unless some record rests, a start per moving record."""
        return order + 1 + self.free_offset + order * self.rest.count(False)

    @property
    def free_offset(self) -> bool:
        """Whether the sensor's offset has to be fitted."""
        return not any(self.rest)


def build_problem(records: Sequence[Record], input_map: str) -> OutputError:
    """Normalise and pad the records, each from its first known state; find rest, offset and the unit of frequency."""
    if np.ptp(np.concatenate([r.voltage for r in records])) == 0:
        raise BadInput("the voltage never changes in these records: record an excitation such as a sweep")
    if np.ptp(np.concatenate([r.displacement[r.observed] for r in records])) == 0:
        raise BadInput("the displacement never changes in these records: check the sensor and its column")
    rest, offset = initial_rest(records, input_map)
    records = [_from(r, min(first_known(r), r.samples - MIN_SAMPLES)) for r in records]
    dt, size = records[0].dt, max(r.samples for r in records)
    output, drive, weight = (np.zeros((len(records), size)) for _ in range(3))
    for k, r in enumerate(records):
        drive[k, : r.samples], drive[k, r.samples :] = r.voltage, r.voltage[-1]
        weight[k, : r.samples] = r.observed
        output[k, : r.samples] = np.where(r.observed, r.displacement - offset, 0.0)
    voltage_scale, output_scale = float(np.abs(drive).max()), float(np.sqrt((output**2).sum() / weight.sum()))
    band = force_band([np.asarray(r.voltage ** (2 if input_map == "square" else 1)) for r in records], dt)
    return OutputError(
        drive / voltage_scale, output / output_scale, weight,
        rest=tuple(bool(v) for v in rest), square=input_map == "square", dt=dt,
        omega=float(2 * np.pi * min(band, 0.1 / dt)), voltage_scale=voltage_scale, output_scale=output_scale,
        offset=offset, offset_std=_offset_std(records, rest) / output_scale,
    )  # fmt: skip


def _offset_std(records: Sequence[Record], rest: np.ndarray) -> float:
    """Standard error of the offset, the weighted mean of the levels at rest; wider where these disagree.

    A level comes from the longest beginning whose misfit hides in the noise. What hides can still bend the level by
    about a standard error (measured: rms 1 to 2, as the window happens to stop), so the errors are widened by half.
    """
    levels = np.array([rest_level(r) for r, at_rest in zip(records, rest, strict=True) if at_rest])
    if not len(levels):
        return 0.0
    weights = 1 / (levels[:, 1] ** 2 + 1e-30)
    scatter = weights @ (levels[:, 0] - np.average(levels[:, 0], weights=weights)) ** 2 / max(len(levels) - 1, 1)
    return float(1.5 * np.sqrt(max(scatter, 1.0) / weights.sum()))


def _from(record: Record, first: int) -> Record:
    """The record without its first samples."""
    return replace(
        record, time=record.time[first:], voltage=record.voltage[first:], displacement=record.displacement[first:]
    )


def terms(
    params: Float[np.ndarray, " parameters"], problem: OutputError, *, order: int, hold: str
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Per record: weighted output error (time,), its Jacobian (time, columns), and the parameters of the columns."""
    shared, moving = order + 1 + problem.free_offset, 0
    logs, gain = params[:order], params[order]
    offset = params[order + 1] if problem.free_offset else 0.0
    step = problem.omega * problem.dt
    for drive, output, weight, at_rest in zip(problem.drive, problem.output, problem.weight, problem.rest, strict=True):
        unit, by_logs = respond(logs, drive, step=step, square=problem.square, hold=hold)
        modelled, slopes = gain * unit + offset, [gain * by_logs, unit[:, None]]
        slopes += [np.ones((len(drive), 1))] * problem.free_offset
        columns = np.arange(shared)
        if not at_rest:  # the free response is linear in the start: added outside the gain
            own = shared + order * moving + np.arange(order)
            free, free_by_logs, by_start = coast(logs, params[own], len(drive), step=step)
            modelled, slopes[0] = modelled + free, slopes[0] + free_by_logs
            slopes, columns, moving = [*slopes, by_start], np.append(columns, own), moving + 1
        yield weight * (modelled - output), weight[:, None] * np.concatenate(slopes, 1), columns


def residual(
    params: Float[np.ndarray, " parameters"], problem: OutputError, *, order: int, hold: str
) -> Float[np.ndarray, "records time"]:
    """Weighted output error."""
    with np.errstate(all="ignore"):
        return np.stack([left for left, *_ in terms(params, problem, order=order, hold=hold)])


def fastest_logs(order: int, problem: OutputError) -> Float[np.ndarray, " order"]:
    """Upper bounds of the logarithms: poles that decay by e^30 a sample, far above what any record can tell."""
    fastest = np.log(30.0 / (problem.omega * problem.dt))
    pairs = [np.log(2) + fastest, 2 * fastest] * (order // 2)
    return np.array(pairs + [fastest] * (order % 2))


def normal_equations(
    params: Float[np.ndarray, " parameters"], problem: OutputError, *, order: int, hold: str
) -> Normal:
    """Sum of squares, half gradient and J'J over all records, with a ridge on the logarithms."""
    ridge = _RIDGE * problem.weight.sum() * (np.arange(len(params)) < order)
    cost, gradient, hessian = float(ridge @ params**2), ridge * params, np.diag(ridge)
    with np.errstate(all="ignore"):
        for left, jacobian, columns in terms(params, problem, order=order, hold=hold):
            products = _gram(np.column_stack([jacobian, left]))
            cost += float(products[-1, -1])
            gradient[columns] += products[:-1, -1]
            hessian[np.ix_(columns, columns)] += products[:-1, :-1]
    return Normal(cost, gradient, hessian)


def _gram(rows: np.ndarray) -> np.ndarray:
    return np.sum([(p.swapaxes(1, 2) @ p).sum(0) for p in pieces(rows)], 0)


def covariance(
    params: Float[np.ndarray, " parameters"], problem: OutputError, *, order: int, hold: str
) -> Float[np.ndarray, "parameters parameters"]:
    """Covariance of the parameters (see the head of this file); huge where the data leave one open."""
    size = len(params)
    hessian, scores = np.zeros((size, size)), np.zeros((_BLOCKS, size))
    by_offset, cost = np.zeros(size), 0.0
    block = (np.cumsum(problem.weight) - problem.weight.flat[0]) * _BLOCKS // problem.weight.sum()
    block = np.minimum(block.astype(int), _BLOCKS - 1).reshape(problem.weight.shape)
    for k, (left, jacobian, columns) in enumerate(terms(params, problem, order=order, hold=hold)):
        products = _gram(np.column_stack([jacobian, problem.weight[k], left]))
        hessian[np.ix_(columns, columns)] += products[:-2, :-2]
        by_offset[columns] += products[:-2, -2]
        cost += float(products[-1, -1])
        edges = np.flatnonzero(np.diff(block[k], prepend=-1))
        scores[np.ix_(block[k, edges], columns)] += np.add.reduceat(jacobian * left[:, None], edges)
    inverse = _inverse(hessian)
    moves = scores @ inverse
    sandwich = moves.T @ moves * (_BLOCKS / max(_BLOCKS - size, 1))
    textbook = cost / max(problem.weight.sum() - size, 1) * inverse
    wider = np.sqrt(np.maximum(np.diag(textbook) / (np.diag(sandwich) + 1e-300), 1.0))
    moved = inverse @ by_offset * problem.offset_std
    return sandwich * np.outer(wider, wider) + np.outer(moved, moved)


def _inverse(hessian: np.ndarray) -> np.ndarray:
    """Inverse of J'J; a direction that rounding hides has the largest variance it may have, not a negative one."""
    diagonal = np.diag(hessian)
    root = np.sqrt(np.maximum(diagonal, 1e-30 * diagonal.max()))
    values, vectors = np.linalg.eigh(hessian / np.outer(root, root))
    return (vectors / np.maximum(values, 1e-15)) @ vectors.T / np.outer(root, root)

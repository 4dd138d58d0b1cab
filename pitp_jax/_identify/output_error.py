"""The output error of a linear ODE over a padded set of records, and the covariance of its parameters.

    r_t = w_t (gain x_t(poles) + free_t(start) + d zero - d y_t)
    x: response from rest, or from the equilibrium of u(0) where the record begins held;  free: where it begins moving
    p = (log pole coefficients, gain, [zeros], [starts], [log delay / dt])

    cov p = D H^-1 (sum_b g_b g_b') H^-1 D B / (B - P) + sum_z v v' var(z),    H = J'J,    v = dp/dz = H^-1 J'w

Zeros of records at rest are not fitted: a linear model's misfit would bend them by far more than the first samples
leave open (cone100 sweep: 11 um against 1); v carries their error. Everything is normalised: voltage, output and
frequency by their scales. g_b is the gradient over one of B = 64 blocks of samples (block sandwich): model error is
strongly correlated, and the textbook sigma^2 H^-1 would understate the errors by an order of magnitude. Where few
blocks tell of a parameter the sandwich is the smaller one: D >= 1 widens it to the textbook's variance.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .._errors import BadInput
from .._numerics.levenberg_marquardt import Normal
from .._numerics.linear_recurrence import pieces
from .._record.initial_state import Beginning, from_known
from .._record.preprocess import force_band
from .._record.record import Record
from .linear_ode import coast, respond

_BLOCKS = 64
# A ridge per sample on the logarithms gives directions the data do not see (a pole far above the band) a minimum; it
# moves identifiable poles by less than 1e-6 of themselves.
_RIDGE = 1e-10
_DELAY_STEP = 0.05  # samples, of the difference that gives the slope by a delay


@dataclass(frozen=True)
class OutputError:
    """The data of one identification: padded to (records, time), normalised by the scales it carries.

    `zeros`: which fitted zero a record has, -1 where its own was taken off beforehand.
    """

    drive: Float[np.ndarray, "records time"]
    output: Float[np.ndarray, "records time"]
    weight: Float[np.ndarray, "records time"]
    beginnings: tuple[Beginning, ...]
    zeros: tuple[int, ...]
    square: bool
    delayed: bool
    dt: float
    omega: float
    voltage_scale: float
    output_scale: float

    def parameters(self, order: int) -> int:
        """Number of parameters: poles, gain, fitted zeros, a start per moving record, a delay."""
        return order + 1 + self.free_zeros + order * self.moving + self.delayed

    @property
    def free_zeros(self) -> int:
        """How many zeros are fitted."""
        return max(self.zeros) + 1

    @property
    def moving(self) -> int:
        """How many records begin in motion."""
        return sum(b.begins == "moving" for b in self.beginnings)

    @property
    def main(self) -> int:
        """A record with the zero that most have, one at rest before others: the zero that a model keeps."""
        groups = [b.group for b in self.beginnings]
        return max(range(len(groups)), key=lambda k: (groups.count(groups[k]), not self.beginnings[k].free, -k))

    def zero(self, record: int, params: np.ndarray, order: int) -> float:
        """The sensor's zero of a record, output unit."""
        group = self.zeros[record]
        return self.beginnings[record].zero + (self.output_scale * params[order + 1 + group] if group >= 0 else 0.0)


def check_motion(records: Sequence[Record]) -> None:
    """Refuse records in which nothing changes."""
    if np.ptp(np.concatenate([r.voltage for r in records])) == 0:
        raise BadInput("the voltage never changes in these records: record an excitation such as a sweep")
    if np.ptp(np.concatenate([r.displacement[r.observed] for r in records])) == 0:
        raise BadInput("the displacement never changes in these records: check the sensor and its column")


def build_problem(
    records: Sequence[Record], input_map: str, beginnings: Sequence[Beginning], *, delayed: bool = False
) -> OutputError:
    """Normalise and pad the records, each from its first known state, less its zero and in one direction."""
    records = [from_known(r) for r in records]
    dt, size = records[0].dt, max(r.samples for r in records)
    output, drive, weight = (np.zeros((len(records), size)) for _ in range(3))
    for k, (r, b) in enumerate(zip(records, beginnings, strict=True)):
        drive[k, : r.samples], drive[k, r.samples :] = r.voltage, r.voltage[-1]
        weight[k, : r.samples] = r.observed
        output[k, : r.samples] = np.where(r.observed, b.direction * (r.displacement - b.zero), 0.0)
    voltage_scale, output_scale = float(np.abs(drive).max()), float(np.sqrt((output**2).sum() / weight.sum()))
    band = force_band([np.asarray(r.voltage ** (2 if input_map == "square" else 1)) for r in records], dt)
    free = sorted({b.group for b in beginnings if b.free})
    return OutputError(
        drive / voltage_scale, output / output_scale, weight, tuple(beginnings),
        zeros=tuple(free.index(b.group) if b.free else -1 for b in beginnings), square=input_map == "square",
        delayed=delayed, dt=dt, omega=float(2 * np.pi * min(band, 0.1 / dt)), voltage_scale=voltage_scale,
        output_scale=output_scale,
    )  # fmt: skip


def shifted(drive: Float[np.ndarray, " time"], delay: float, before: float) -> Float[np.ndarray, " time"]:
    """The drive `delay` samples earlier, linear between samples, `before` the first one."""
    return np.interp(np.arange(len(drive)) - delay, np.arange(len(drive)), drive, left=before)


def _driven(logs, drive, begins: str, problem: OutputError, hold: str) -> tuple[np.ndarray, np.ndarray]:
    """Response with unit static gain from rest or from the equilibrium of u(0), and its derivative by `logs`."""
    step = problem.omega * problem.dt
    unit, by_logs = respond(logs, drive, step=step, square=problem.square, hold=hold)
    if begins == "held":
        first = drive[0] ** (2 if problem.square else 1)
        free, free_by_logs, _ = coast(logs, first * np.eye(len(logs))[0], len(drive), step=step)
        unit, by_logs = unit + free, by_logs + free_by_logs
    return unit, by_logs


def _responses(logs, params, drive, begins: str, problem: OutputError, hold: str):
    """`_driven`, its derivative by the logarithm of the delay last where there is one."""
    if not problem.delayed:
        return _driven(logs, drive, begins, problem, hold)
    delay, before = float(np.exp(params[-1])), 0.0 if begins == "rest" else drive[0]

    def late(samples):
        return _driven(logs, shifted(drive, samples, before), begins, problem, hold)

    unit, by_logs = late(delay)
    by_delay = (late(delay + _DELAY_STEP)[0] - late(delay - _DELAY_STEP)[0]) / (2 * _DELAY_STEP)
    return unit, np.column_stack([by_logs, delay * by_delay])


def terms(
    params: Float[np.ndarray, " parameters"], problem: OutputError, *, order: int, hold: str
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Per record: weighted output error (time,), its Jacobian (time, columns), and the parameters of the columns."""
    shared, moving = order + 1 + problem.free_zeros, 0
    logs, gain = params[:order], params[order]
    inner = np.append(np.arange(order), [len(params) - 1] * problem.delayed).astype(int)
    step = problem.omega * problem.dt
    for k, (drive, output, weight, b) in enumerate(
        zip(problem.drive, problem.output, problem.weight, problem.beginnings, strict=True)
    ):
        unit, by_inner = _responses(logs, params, drive, b.begins, problem, hold)
        modelled, slopes, columns = gain * unit, [gain * by_inner, unit[:, None]], [inner, [order]]
        if problem.zeros[k] >= 0:
            place = order + 1 + problem.zeros[k]
            modelled = modelled + b.direction * params[place]
            slopes, columns = [*slopes, np.full((len(drive), 1), b.direction)], [*columns, [place]]
        if b.begins == "moving":  # the free response is linear in the start: added outside the gain
            own = shared + order * moving + np.arange(order)
            free, free_by_logs, by_start = coast(logs, params[own], len(drive), step=step)
            modelled = modelled + free
            slopes[0][:, :order] += free_by_logs
            slopes, columns, moving = [*slopes, by_start], [*columns, own], moving + 1
        yield weight * (modelled - output), weight[:, None] * np.concatenate(slopes, 1), np.concatenate(columns)


def residual(
    params: Float[np.ndarray, " parameters"], problem: OutputError, *, order: int, hold: str
) -> Float[np.ndarray, "records time"]:
    """Weighted output error."""
    with np.errstate(all="ignore"):
        return np.stack([left for left, *_ in terms(params, problem, order=order, hold=hold)])


def upper_bounds(order: int, problem: OutputError) -> Float[np.ndarray, " parameters"]:
    """Of the logarithms: poles that decay by e^30 a sample, a delay of a quarter of the record; infinite elsewhere."""
    fastest = np.log(30.0 / (problem.omega * problem.dt))
    pairs = [np.log(2) + fastest, 2 * fastest] * (order // 2)
    bounds = np.full(problem.parameters(order), np.inf)
    bounds[:order] = pairs + [fastest] * (order % 2)
    if problem.delayed:
        bounds[-1] = np.log(problem.drive.shape[1] / 4)
    return bounds


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
    by_zero, cost = {b.group: np.zeros(size) for b in problem.beginnings}, 0.0
    block = (np.cumsum(problem.weight) - problem.weight.flat[0]) * _BLOCKS // problem.weight.sum()
    block = np.minimum(block.astype(int), _BLOCKS - 1).reshape(problem.weight.shape)
    for k, (left, jacobian, columns) in enumerate(terms(params, problem, order=order, hold=hold)):
        b = problem.beginnings[k]
        products = _gram(np.column_stack([jacobian, b.direction * problem.weight[k], left]))
        hessian[np.ix_(columns, columns)] += products[:-2, :-2]
        by_zero[b.group][columns] += products[:-2, -2] * (0.0 if b.free else b.stderr / problem.output_scale)
        cost += float(products[-1, -1])
        edges = np.flatnonzero(np.diff(block[k], prepend=-1))
        scores[np.ix_(block[k, edges], columns)] += np.add.reduceat(jacobian * left[:, None], edges)
    inverse = _inverse(hessian)
    moves = scores @ inverse
    sandwich = moves.T @ moves * (_BLOCKS / max(_BLOCKS - size, 1))
    textbook = cost / max(problem.weight.sum() - size, 1) * inverse
    wider = np.sqrt(np.maximum(np.diag(textbook) / (np.diag(sandwich) + 1e-300), 1.0))
    moved = [inverse @ v for v in by_zero.values()]
    return sandwich * np.outer(wider, wider) + sum(np.outer(v, v) for v in moved)


def _inverse(hessian: np.ndarray) -> np.ndarray:
    """Inverse of J'J; a direction that rounding hides has the largest variance it may have, not a negative one."""
    diagonal = np.diag(hessian)
    root = np.sqrt(np.maximum(diagonal, 1e-30 * diagonal.max()))
    values, vectors = np.linalg.eigh(hessian / np.outer(root, root))
    return (vectors / np.maximum(values, 1e-15)) @ vectors.T / np.outer(root, root)

"""Estimate how a recording starts, with sensor offset and direction, from the free runs of any model.

    y = d (x_k(t) + A c) + z + e        k: rest | held (settled at u(0)) | moving;    A: free responses of the modes
    e ~ N(0, s^2 I + a^2 C_1 + eta^2 m m' o C_2)       C_1 = exp(-omega |t - t'|),    C_2 = exp(-(omega (t - t'))^2 / 2)
    m(t) = motion until t + 2 / omega, times min(1, omega t)^2: a model's error has neither value nor velocity at t = 0

The error of the free run over all of these samples decides where another start, offset or direction is clearly better.
Between starts whose free runs err alike, the first period decides with the errors e: later a free initial state also
explains the error of a wrong model (a lag that it does not have made a start from rest a moving one).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_banded
from scipy.linalg.lapack import dtrtrs  # pyright: ignore[reportAttributeAccessIssue]
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits

from ...common.metrics import rms
from ..numerics.coloured_noise import block_means, project
from .initial_state import Beginning, Begins, first_known, noise_std, rest_level, standing_drive
from .record import Record

_PERIODS, _LEAST, _MOST = 4.0, 64, 16_384  # periods of the dominant mode; samples: fewest, and most
_MOVED = 20.0  # noise levels that the output must leave its first reading by
_PER_PERIOD, _BLOCKS, _FEWEST = 16, 160, 12  # blocks of a period, and at most; fewest samples that decide
_ERRORS = np.array([0.01, 0.03, 0.1, 0.3, 1.0])  # eta: relative errors of a model, equally probable
_COLOURED = np.array([0.0, 0.001, 0.003, 0.01, 0.03, 0.1])  # a: slow noise of the sensor, of the span
_LAGS = (0.0, 0.3, 1.0)  # rad of the dominant mode, by which the plant may follow the model
# probability of a start in motion in proportion to others; again for the charge of stores (BIC of 100 blocks)
_MOVING = 0.1
_REVERSED = 0.01  # probability that a sensor is reversed, if the model's direction is known
_CLEARLY, _TURNED = 0.5, 0.7  # rms error of a free run that is clearly better; of one with the other direction
_SAME, _NEAR = 0.002, 4.0  # of the span, and standard errors: distance of an offset at rest from a known one
_GROWN = 5.0  # log of the largest growth of an unstable mode
_FINEST, _FAR = 1e-4, 10.0  # of the span: least noise; largest error of a model that diverges


@dataclass(frozen=True)
class Response:
    """The response of a model to the input of the first part of a recording.

    Attributes:
        rest: displacement from rest, output unit, shape (T,).
        held: displacement from the equilibrium of u(0), shape (T,); nan if there is none.
        poles: of the model's modes, rad/s.
        omega: of the dominant mode, rad/s.
        zeros: known sensor offsets, output unit.
        direction: usual sensor direction; 0 if unknown.
        moving: displacement from the state that its first samples show, shape (T,); None if unknown.
        fitted: number of unknowns of `moving`, where its whole state counts as one and the charge of stores as another.
    """

    rest: np.ndarray
    held: np.ndarray
    poles: np.ndarray
    omega: float
    zeros: Sequence[float] = ()
    direction: float = 0.0
    moving: np.ndarray | None = None
    fitted: int = 1


def first_part(record: Record, omega: float, span: float | None = None) -> Record:
    """Return the first part of a recording, from which its start is estimated.

    It ends four periods after the input has changed and the output has moved. Of a longer constant stretch before that,
    the middle is cut out, because nothing changes there.

    Args:
        record: in base units.
        omega: of the dominant mode, rad/s.
        span: range of the inputs that the model was made with, V; the recording's own if unknown.
    """
    lost = first_known(record)
    length = int(np.clip(_PERIODS * 2 * np.pi / (omega * record.dt), _LEAST, _MOST // 2))
    size = min(lost + length, record.samples)
    while True:
        part = _samples(record, np.arange(size))
        stands, moved = standing_drive(part, span)[0], _first_moved(part)
        last = max(lost, stands, min(moved, stands + _MOST // 2))
        if size == record.samples or last < size:
            break
        size = min(2 * size, record.samples)
    kept = np.arange(min(last + length, record.samples))
    if stands > 2 * length:
        kept = kept[(kept < length) | (kept >= stands - length // 2)]
    return _samples(record, kept)


def _first_moved(record: Record) -> int:
    """Return the first sample that has left the first reading; all if none has."""
    y = record.displacement
    away = np.abs(y - np.median(y[record.observed][:8])) > _MOVED * noise_std(y)
    return int(np.argmax(away)) if away.any() else record.samples


def _samples(record: Record, kept: np.ndarray) -> Record:
    time = record.time[0] + record.dt * np.arange(len(kept))
    return replace(record, time=time, voltage=record.voltage[kept], displacement=record.displacement[kept])


@dataclass(frozen=True)
class _FreeRun:
    """One hypothesis: kind of start and direction, with the offset, first reading and rms error of its free run."""

    kind: Begins
    direction: float
    zero: float
    level: float
    error: float


@threadpool_limits.wrap(limits=1, user_api="blas")  # at 160 blocks two threads take four times the CPU time of one
def estimate_start(part: Record, response: Response) -> Beginning:
    """Return the start of a recording, with sensor offset, its standard error, and sensor direction.

    Args:
        part: the `first_part` of a recording.
        response: of a model to the input of this part.
    """
    kinds = _possible(part, response)
    evidence = [
        _evidence(part, response, k) + (response.fitted * np.log(_MOVING) if k == "moving" else 0.0) for k in kinds
    ]
    probability = dict(zip(kinds, np.exp(np.array(evidence) - logsumexp(evidence)), strict=True))
    first = max(kinds, key=lambda k: probability[k])
    certainty = float(probability[first])
    best = {k: _directed([_free_run(part, response, k, d) for d in (1.0, -1.0)], response.direction) for k in kinds}
    run = best[first]
    least = min((best[k] for k in kinds if k != "moving"), key=lambda r: r.error, default=run)
    if least.error < _CLEARLY * run.error:
        run, certainty = least, 1.0
    return _with_offset(part, response, run, certainty)


def _possible(part: Record, response: Response) -> list[Begins]:
    """Return the kinds of start that the data alone allow."""
    if first_known(part) > 0:
        return ["moving"]
    stands, level = standing_drive(part)
    is_flat = stands >= _FEWEST and _first_moved(part) >= stands
    kinds: list[Begins] = ["rest"] if is_flat else ["moving", "rest"]
    if level != 0 and _settled_differs(part, response):
        kinds.append("held")
    return kinds


def _directed(runs: Sequence[_FreeRun], usual: float) -> _FreeRun:
    """Return the free run with the smaller error; that of the usual direction unless the other is clearly better."""
    best = min(runs, key=lambda r: r.error)
    if not usual or best.direction == usual:
        return best
    same = next(r for r in runs if r.direction == usual)
    return best if best.error < _TURNED * same.error else same


def _free_run(part: Record, response: Response, kind: Begins, direction: float, zero: float | None = None) -> _FreeRun:
    """Return the free run of one hypothesis, with an offset fitted to all samples or a given one."""
    seen = part.observed
    run = direction * _simulated(response, kind)
    free = _free(response.poles, part.dt * np.arange(part.samples)) if kind == "moving" else np.empty((part.samples, 0))
    one = np.ones((part.samples, int(zero is None)))
    columns = np.column_stack([free, one])
    factors, error = project(part.displacement[seen] - run[seen] - (zero or 0.0), columns[seen])
    offset = float(factors[-1]) if zero is None else zero
    level = offset + float(run[0] + free[0] @ factors[: free.shape[1]])
    return _FreeRun(kind, direction, offset, level, rms(error))


def _simulated(response: Response, kind: Begins) -> np.ndarray:
    """Return the response that a kind of start begins with; 0 if the model diverges, because it explains no motion."""
    own = {"rest": response.rest, "held": response.held, "moving": response.moving}[kind]
    runs = (run for run in (own, response.held, response.rest) if run is not None and np.isfinite(run).all())
    return next(runs, np.zeros(len(response.rest)))


def _with_offset(part: Record, response: Response, run: _FreeRun, certainty: float) -> Beginning:
    """Decide between the offset of a record's own and a known one; return the start.

    A record at rest shows its own in the first samples alone, which contain no error of the model. Otherwise a few
    periods do not separate it from the error of the model's equilibrium or from memories (creep) that were charged
    before, so a known one stays unless its free run is clearly worse.
    """
    known = [_free_run(part, response, run.kind, run.direction, z) for z in response.zeros]
    if run.kind == "moving":
        best = min(known, key=lambda r: r.error) if known else run
        return Beginning(run.kind, run.direction, best.zero, run.error, certainty=certainty, level=best.level)
    level, stderr = rest_level(part)
    own = level - run.direction * float(_simulated(response, run.kind)[0])
    if run.kind == "rest":
        known = [r for r in known if abs(r.zero - own) < _NEAR * stderr + _SAME * part.span]
    else:
        error = _free_run(part, response, run.kind, run.direction, own).error
        known = [r for r in known if error > _CLEARLY * r.error]
    zero = min(known, key=lambda r: r.error).zero if known else own
    return Beginning(run.kind, run.direction, zero, 1.5 * stderr, certainty=certainty, level=level)


def _settled_differs(part: Record, response: Response) -> bool:
    """Return whether the response settled at u(0) exists and differs from that from rest by more than the noise."""
    least = max(noise_std(part.displacement), _FINEST * part.span)
    return bool(np.isfinite(response.held).all() and np.abs(response.held - response.rest).max() > least)


def _evidence(part: Record, response: Response, kind: Begins) -> float:
    """Return the log evidence of one kind of start over the first period of motion."""
    period = 2 * np.pi / (response.omega * part.dt)
    samples = int(max(_first_moved(part) + period + 1, _FEWEST))
    y, seen, omega = part.displacement[:samples], part.observed[:samples], response.omega
    span = part.span or 1.0
    # a record may be shorter than a block of a slow mode
    size = int(max(min(period / _PER_PERIOD, len(y) / _FEWEST), len(y) / _BLOCKS, 1))
    time = part.dt * np.arange(len(y))
    free = span * _free(response.poles, time) if kind == "moving" else np.empty((len(y), 0))
    run = _simulated(response, kind)[: len(y)]
    driven = _simulated(response, "held" if kind == "moving" else kind)[: len(y)]  # by the input alone: what lags
    growth = np.minimum(1.0, omega * time) ** min(len(response.poles), 2)
    lagged = [run - driven + _lagged(driven, omega * part.dt, g) for g in _LAGS]
    columns = np.column_stack([np.where(seen, y, 0.0), time, growth, driven, free, *lagged])
    means, share = block_means(columns, seen.astype(float), size)
    means, share = means[share > 0], share[share > 0]
    output, time, growth, expected = means[:, :4].T
    modes, runs = np.split(means[:, 4:], [free.shape[1]], axis=1)
    noise = max(noise_std(part.displacement) / np.sqrt(size), _FINEST * span)
    apart = omega * np.abs(time[:, None] - time)
    # a force moves the plant within a third of a period
    ahead = np.arange(len(output)) + int(period / np.pi / size)
    far = np.maximum.accumulate(np.maximum(np.abs(output - output[0]), np.abs(expected - expected[0])))
    motion = growth * np.minimum(far[np.minimum(ahead, len(far) - 1)], _FAR * span)
    model = np.outer(motion, motion) * np.exp(-0.5 * apart**2)
    errors = [np.diag(noise**2 / share) + (a * span) ** 2 * np.exp(-apart) + eta**2 * model
              for a in _COLOURED for eta in _ERRORS]  # fmt: skip
    directions = np.repeat([1.0, -1.0], len(_LAGS))
    against = output[:, None] - directions * np.tile(runs, 2)
    prior = np.where(directions == response.direction, 1 - _REVERSED, _REVERSED if response.direction else 0.5)
    offsets = [(float(output[0]), span), *((z, max(_SAME * span, noise)) for z in response.zeros)]
    return _marginal(against, np.log(prior), offsets, modes, errors)


def _free(poles: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return the free responses of all modes, shape (T, modes)."""
    poles = poles[np.imag(poles) >= 0]
    grown, angle = np.exp(np.minimum(np.outer(time, np.real(poles)), _GROWN)), np.outer(time, np.imag(poles))
    return np.column_stack([grown * np.cos(angle), (grown * np.sin(angle))[:, np.imag(poles) > 0]])


def _lagged(run: np.ndarray, step: float, lag: float) -> np.ndarray:
    """Return a run behind a lag of order 1; step and lag in rad of the dominant mode."""
    pole = np.exp(-step / lag) if lag else 0.0
    # a bidiagonal equation; `scipy.signal` takes as long to import as a prediction
    ahead = np.outer([1, -pole], np.ones(len(run)))
    return run[0] + solve_banded((1, 0), ahead, (1 - pole) * (run - run[0]))


def _marginal(
    targets: np.ndarray, prior: np.ndarray, offsets: Sequence[tuple], columns: np.ndarray, errors: Sequence[np.ndarray]
) -> float:
    """Return the log evidence of several targets and of equally probable covariances and offsets, up to a constant.

    The prior variance of every column's factor is 1. By Woodbury's identity each covariance is factored once for all
    offsets:  (E + C C')^-1 = E^-1 - E^-1 C (I + C' E^-1 C)^-1 C' E^-1.

    Args:
        targets: shape (T, hypotheses).
        prior: logs of their probabilities, shape (hypotheses,).
        offsets: mean and standard deviation of each.
        columns: shape (T, factors).
        errors: covariances, shapes (T, T).
    """
    given = np.column_stack([targets, columns, np.ones(len(targets))])
    # one call for all covariances, and LAPACK itself for each, because SciPy's checks take as long as the arithmetic
    factors = np.linalg.cholesky(errors)
    white = np.array([dtrtrs(factor.T, given, trans=1)[0] for factor in factors])[:, None]
    white, free, one = np.split(white, [targets.shape[1], -1], axis=-1)
    z, tau = np.array(offsets).T[..., None, None]
    residual, free = white - z * one, np.concatenate([free + 0 * tau, tau * one], -1)
    inner, shared = np.eye(free.shape[-1]) + free.mT @ free, free.mT @ residual
    fits = (residual**2).sum(-2) - (shared * np.linalg.solve(inner, shared)).sum(-2)
    sizes = np.log(np.diagonal(factors, 0, 1, 2)).sum(-1)[:, None] + np.linalg.slogdet(inner)[1] / 2
    return float(np.asarray(logsumexp(prior - fits / 2 - sizes[..., None])))

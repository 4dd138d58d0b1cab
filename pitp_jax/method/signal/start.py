"""Estimate how a recording starts, with sensor offset and direction, by likelihood beside the response of any model.

    y = d (x_k(t - lag) + A c) + z + e      k: rest | held (settled at u(0)) | moving;    A: free responses of the modes
    e ~ N(0, s^2 I + a^2 C_1 + eta^2 m m' o C_2)       C_1 = exp(-omega |t - t'|),    C_2 = exp(-(omega (t - t'))^2 / 2)
    m(t) = motion until t + 2 / omega, times min(1, omega t)^2: a model's error has neither value nor velocity at t = 0
    z ~ N(z_0, tau^2): half of all recordings have a known offset, the others any;    c ~ N(0, span^2), 0 unless moving

The first period of motion decides between rest, settled and moving. Later a free initial state also explains the error
of a wrong model (a lag that it does not have made a start from rest a moving one). Offset and direction come from four
periods. The scales a and eta, the lag, c, z and d are nuisance parameters. Starts in motion are the exception.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.linalg import cho_factor, cho_solve
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits

from ..numerics.coloured_noise import block_means
from .initial_state import Beginning, Begins, first_known, noise_std, rest_level, standing_drive
from .record import Record

_PERIODS, _LEAST, _MOST = 4.0, 64, 16_384  # periods of the dominant mode; samples: fewest, and most
_MOVED = 20.0  # noise levels that the output must leave its first reading by
_PER_PERIOD, _BLOCKS, _FEWEST = 16, 160, 12  # blocks of a period, and at most; fewest samples that decide
_ERRORS = np.array([0.01, 0.03, 0.1, 0.3, 1.0])  # eta: relative errors of a model, equally probable
_COLOURED = np.array([0.0, 0.001, 0.003, 0.01, 0.03, 0.1])  # a: slow noise of the sensor, of the span
_LAGS = (0.0, 0.3, 1.0)  # rad of the dominant mode, by which the plant may follow the model
_MOVING = 0.1  # probability of a start in motion in proportion to one at rest, and to a settled one
_REVERSED = 0.01  # probability that a sensor is reversed, if the model's direction is known
_SAME = 0.002  # of the span: least error of a known offset
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
    """

    rest: np.ndarray
    held: np.ndarray
    poles: np.ndarray
    omega: float
    zeros: Sequence[float] = ()
    direction: float = 0.0


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
    if len(kept) == record.samples:
        return record
    time = record.time[0] + record.dt * np.arange(len(kept))
    return replace(record, time=time, voltage=record.voltage[kept], displacement=record.displacement[kept])


@dataclass(frozen=True)
class _Fit:
    """One sensor direction, with a known offset or its own: log evidence, offset, its error, first reading."""

    direction: float
    evidence: float
    own: bool
    zero: float
    stderr: float
    level: float


@threadpool_limits.wrap(limits=1, user_api="blas")  # at 160 blocks two threads take four times the CPU time of one
def estimate_start(part: Record, response: Response) -> Beginning:
    """Return the most probable start of a recording, with sensor offset, its standard error, and sensor direction.

    Args:
        part: the `first_part` of a recording.
        response: of a model to the input of this part.
    """
    kinds: list[Begins] = ["moving"]
    if first_known(part) == 0:
        kinds.append("rest")
        if standing_drive(part)[1] != 0 and _settled_differs(part, response):
            kinds.append("held")
    period = 2 * np.pi / (response.omega * part.dt)
    first = int(max(_first_moved(part) + period + 1, _FEWEST))
    evidence = [logsumexp([f.evidence for f in _fits(part, response, k, first, _LAGS)]) for k in kinds]
    evidence[0] += np.log(_MOVING)
    kind = kinds[int(np.argmax(evidence))]
    certainty = float(np.exp(max(evidence) - logsumexp(evidence)))
    # A long lag may be half a period, which reverses a motion. So it has no part in the direction.
    fits = _fits(part, response, kind, part.samples, _LAGS[:2])
    if response.direction and not _opposes(part, response):
        fits = [f for f in fits if f.direction == response.direction]
    # four periods of a motion do not separate an own offset from memories (creep) that were charged before
    known = [f for f in fits if not f.own] if kind == "moving" else []
    best = max(known or fits, key=lambda f: f.evidence)
    zero, stderr = best.zero, best.stderr
    if kind == "rest" and best.own:
        # the first samples alone contain no error of the model; a misfit shifts their level by 1 to 2 standard errors
        zero, stderr = rest_level(part)
        stderr *= 1.5
    return Beginning(kind, best.direction, zero, stderr, certainty=certainty, level=best.level)


def _opposes(part: Record, response: Response) -> bool:
    """Return whether the reading and the model's response in its usual direction correlate negatively."""
    seen = part.observed & np.isfinite(response.rest)
    y, run = part.displacement[seen], response.rest[seen]
    return bool(response.direction * ((y - y.mean()) @ (run - run.mean())) < 0)


def _settled_differs(part: Record, response: Response) -> bool:
    """Return whether the response settled at u(0) exists and differs from that from rest by more than the noise."""
    least = max(noise_std(part.displacement), _FINEST * float(np.ptp(part.displacement[part.observed])))
    return bool(np.isfinite(response.held).all() and np.abs(response.held - response.rest).max() > least)


def _fits(part: Record, response: Response, kind: Begins, samples: int, lags: Sequence[float]) -> list[_Fit]:
    """Return the evidence of every sensor direction and offset prior for one kind of start, from the first samples."""
    y, seen, omega = part.displacement[:samples], part.observed[:samples], response.omega
    span = float(np.ptp(part.displacement[part.observed])) or 1.0
    # a record may be shorter than a block of a slow mode
    size = int(max(min(2 * np.pi / omega / part.dt / _PER_PERIOD, len(y) / _FEWEST), len(y) / _BLOCKS, 1))
    time = part.dt * np.arange(len(y))
    free = span * _free(response.poles, time) if kind == "moving" else np.empty((len(y), 0))
    run = (response.rest if kind == "rest" or not np.isfinite(response.held).all() else response.held)[: len(y)]
    run = run if np.isfinite(run).all() else np.zeros(len(y))  # a model that diverges explains no motion
    growth = np.minimum(1.0, omega * time) ** min(len(response.poles), 2)
    columns = np.column_stack(
        [np.where(seen, y, 0.0), time, growth, free, *(_lagged(run, omega * part.dt, g) for g in lags)]
    )
    means, share = block_means(columns, seen.astype(float), size)
    means, share = means[share > 0], share[share > 0]
    output, time, growth = means[:, :3].T
    modes, runs = np.split(means[:, 3:], [free.shape[1]], axis=1)
    noise = max(noise_std(part.displacement) / np.sqrt(size), _FINEST * span)
    apart = omega * np.abs(time[:, None] - time)
    # a force moves the plant within a third of a period
    ahead = np.arange(len(output)) + int(2 / (omega * size * part.dt))
    far = np.maximum.accumulate(np.maximum(np.abs(output - output[0]), np.abs(runs[:, 0] - run[0])))
    motion = growth * np.minimum(far[np.minimum(ahead, len(far) - 1)], _FAR * span)
    model = np.outer(motion, motion) * np.exp(-0.5 * apart**2)
    errors = [np.diag(noise**2 / share) + (a * span) ** 2 * np.exp(-apart) + eta**2 * model
              for a in _COLOURED for eta in _ERRORS]  # fmt: skip
    fits, directions = [], np.array([1.0, -1.0])
    for known in (None, *response.zeros):
        z, tau = (float(output[0]), span) if known is None else (known, max(_SAME * span, noise))
        columns = np.column_stack([np.full(len(output), tau), modes])
        targets = (output - z)[:, None, None] - directions[:, None] * runs[:, None]
        for d, (evidence, c, variance) in zip(directions, _marginal(targets, columns, errors), strict=True):
            evidence += _log_prior(response, known, d)
            zero = z + tau * float(c[0]) if known is None else z
            level = z + d * float(run[0]) + float(np.append(tau, free[0]) @ c)
            fits.append(_Fit(float(d), evidence, known is None, zero, tau * float(np.sqrt(variance)), level))
    return fits


def _free(poles: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return the free responses of all modes, shape (T, modes)."""
    upper = np.imag(poles) >= 0
    decay, rate = np.real(poles[upper]), np.imag(poles[upper])
    grown, angle = np.exp(np.minimum(np.outer(time, decay), _GROWN)), np.outer(time, rate)
    return np.column_stack([grown * np.cos(angle), (grown * np.sin(angle))[:, rate > 0]])


def _lagged(run: np.ndarray, step: float, lag: float) -> np.ndarray:
    """Return a run behind a lag of order 1; step and lag in rad of the dominant mode."""
    pole = np.exp(-step / lag) if lag else 0.0
    return run[0] + np.asarray(scipy.signal.lfilter([1 - pole], [1, -pole], run - run[0]))


def _log_prior(response: Response, known: float | None, direction: float) -> float:
    log = np.log(0.5 / max(len(response.zeros), 1)) if response.zeros else 0.0
    if response.direction:
        log += np.log(1 - _REVERSED if direction == response.direction else _REVERSED)
    return float(log)


def _marginal(targets: np.ndarray, columns: np.ndarray, errors: Sequence[np.ndarray]) -> list[tuple]:
    """Return log evidence, columns' factors and the first one's variance, for every direction.

    Covariances and lags are equally probable; factors and variance are those of the best ones. The prior variance of
    every factor is 1.

    Args:
        targets: shape (T, directions, lags).
        columns: shape (T, factors).
        errors: covariances, shapes (T, T).
    """
    flat, scores, factors, variances = targets.reshape(len(targets), -1), [], [], []
    for error in errors:
        factor = cho_factor(error + columns @ columns.T, lower=True)
        solved = cho_solve(factor, np.column_stack([flat, columns[:, 0]]))
        scores.append(-0.5 * (flat * solved[:, :-1]).sum(0) - np.log(np.diag(factor[0])).sum())
        factors.append(columns.T @ solved[:, :-1])
        variances.append(max(1 - float(columns[:, 0] @ solved[:, -1]), 0.0))
    found = []
    for d, score in enumerate(np.reshape(scores, (len(errors), *targets.shape[1:])).swapaxes(0, 1)):
        k, lag = np.unravel_index(np.argmax(score), score.shape)
        c = factors[k][:, d * targets.shape[2] + lag]
        found.append((float(logsumexp(score)) - np.log(score.size), c, variances[k]))
    return found

"""How every record begins, and the zero and the direction of its sensor, by likelihood on the whole record.

    y = d (g x(t) + free(t)) + z,    free: 0 at rest | F(0) unit step's release when held | any x(0), x'(0) in motion

Poles and gain come first from a fit that knows nothing: every record with a zero, a direction and an initial state of
its own, all of which enter linearly. Then each record takes the simplest beginning by the criterion of
`_numerics.coloured_noise`. A record at rest has its zero from its first samples, which hold no error of the model;
others share one, or have one of their own, by the same criterion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from .._model.input_map import INPUT_MAPS
from .._numerics.coloured_noise import block_means, criterion, project, whitener
from .._record.excitation_kind import spread_over_kinds
from .._record.initial_state import (
    INITIAL_SAMPLES,
    Beginning,
    Begins,
    from_known,
    is_still,
    level_groups,
    noise_std,
    rest_level,
    settled_samples,
    standing_drive,
)
from .._record.preprocess import force_band
from .._record.record import Record
from .._record.reduced import averaged, block_size
from .frequency_fit import linear_start
from .frequency_response import frequency_response
from .linear_ode import coast, logs_from_roots, no_faster, polynomial, respond
from .output_error import FASTEST, Problem, Structure, alone, build_problem, driven, least_squares, own_columns, solve
from .starts import cost_of, guesses

_PER_PERIOD = 10  # samples of a period, of the band or of the resonance, that tell beginnings apart
_MOST = 100_000  # samples from which the poles are found
_STARTS = 3  # of the guesses, each with the directions that it tells, that are followed
_STRUCTURE, _ROUNDS = Structure(2), 4
_DIFFER = 0.1  # of the largest force: between first drives whose settled levels differ
_JUMP = 0.05  # of the drive's range, between two samples
_CLEAN = 1.2  # times the noise that a model without an error leaves at most
_FINEST = 1e-5  # of the output's deviation: no record resolves less, whatever rounding leaves of one without noise


@threadpool_limits.wrap(limits=1, user_api="blas")  # as in `identification`
def find_beginnings(records: Sequence[Record], input_map: str) -> tuple[list[Beginning], np.ndarray | None, float]:
    """How every record begins, the roots of order 2 found on the way (rad/s), and the fraction of the output it leaves.

    The roots are None and the fraction 1 where no such model could be fitted.
    """
    begun = [from_known(r) for r in records]
    chosen, small = _decimated(begun, input_map)
    first = _first_poles(small)
    if first is None:
        return [_at_rest(r) for r in begun], None, 1.0
    cost, poles = first
    clean = _only_noise(cost, small)
    decided: list[Beginning] = []
    for _ in range(_ROUNDS):
        rows = [_columns(r, input_map, *poles) for r in begun]
        known = [r is b for r, b in zip(records, begun, strict=True)]
        kinds = [_kind(row, r, whole, poles[0]) for row, r, whole in zip(rows, begun, known, strict=True)]
        kinds = _settled_together(begun, rows, kinds, known, poles[0])
        before, decided = decided, _with_zeros(begun, rows, kinds, clean)
        if [(b.begins, b.direction, b.group) for b in before] == [(b.begins, b.direction, b.group) for b in decided]:
            break
        some = build_problem([begun[k] for k in chosen], input_map, [decided[k] for k in chosen])
        better = _fitted(poles[0], some)
        if better is None:
            break
        cost, poles = better
    return decided, np.roots(polynomial(poles[0])[::-1]), float(np.sqrt(cost))


def _only_noise(cost: float, records: Sequence[Record]) -> bool:
    """Whether a model of order 2 leaves no more than the sensor's noise: then it has no error that bends a zero."""
    size = np.mean([np.nanmean((r.displacement - np.nanmedian(r.displacement)) ** 2) for r in records])
    return bool(np.sqrt(cost * size) < _CLEAN * np.median([noise_std(r.displacement) for r in records]))


def _at_rest(record: Record) -> Beginning:
    return Beginning("rest", 1.0, *rest_level(record))


@dataclass(frozen=True)
class _Columns:
    """One record, whitened in blocks: output, response from rest, what holding adds, free responses, a constant."""

    output: np.ndarray
    driven: np.ndarray
    held: np.ndarray
    free: np.ndarray
    one: np.ndarray
    size: float  # standard deviation of the output

    def residual(self, begins: Begins, direction: float) -> tuple[np.ndarray, float]:
        """What this explanation leaves, and its zero."""
        base = self.output - direction * (self.driven + (self.held if begins == "held" else 0.0))
        columns = [self.one, self.free] if begins == "moving" else [self.one]
        factors, rest = project(base, np.column_stack(columns))
        return rest, float(factors[0])

    def zero(self, begins: Begins, direction: float) -> tuple[float, float, int]:
        """The zero fitted, its weight 1 / variance, and how many samples tell of it."""
        residual, zero = self.residual(begins, direction)
        alone = project(self.one, self.free)[1] if begins == "moving" else self.one
        return zero, float(alone @ alone / max(residual @ residual / len(residual), 1e-300)), len(residual)

    def moves(self) -> bool:
        """Whether a first state explains half of what rest leaves: one cut at a turning point has no speed either."""
        rest, moving = (min(np.linalg.norm(self.residual(b, d)[0]) for d in (1.0, -1.0)) for b in ("rest", "moving"))
        return bool(moving < 0.5 * rest)

    def score(self, begins: Begins, direction: float) -> float:
        """How badly this explains the record, with its numbers paid for (BIC)."""
        extra = self.free.shape[1] if begins == "moving" else 0
        return criterion(self.residual(begins, direction)[0], extra, floor=_FINEST * self.size)


def _decimated(records: Sequence[Record], input_map: str) -> tuple[list[int], list[Record]]:
    """Some records in means over blocks of a tenth of the band's period, and which they are."""
    forces = [INPUT_MAPS[input_map]().force(r.voltage) for r in records]
    dt, shortest = records[0].dt, min(r.samples for r in records)
    size = block_size(dt, force_band(forces, dt), _PER_PERIOD, shortest)
    chosen = spread_over_kinds(records, max(1, _MOST * size * len(records) // sum(r.samples for r in records)))
    return list(chosen), [averaged(records[k], forces[k], size) for k in chosen]


def _first_poles(small: Sequence[Record]) -> tuple[float, tuple[np.ndarray, float]] | None:
    """What `_fitted` returns, nothing known of how records begin."""
    unknown = [Beginning("moving", 1.0, float(np.nanmedian(r.displacement)), 0.0, k, True) for k, r in enumerate(small)]
    problem = build_problem(small, "linear", unknown)
    by_response = _from_response(problem)
    # the response alone led an order three behind a delay to a wrong place, and its records were called at rest
    starts = [logs_from_roots(some) for some in guesses(_STRUCTURE.order, problem) if len(some) == _STRUCTURE.order]
    starts += [] if by_response is None else [by_response]
    scored = []
    for start in starts:
        logs = no_faster(start, FASTEST / problem.fine)
        same = _directed(logs, problem)
        scored.append((cost_of(logs, _STRUCTURE, same), logs, same))
    fits = []
    for _, logs, same in sorted(scored, key=lambda s: s[0])[:_STARTS]:
        fit = _fitted(logs, same)
        fits += [] if fit is None else [fit]
    return min(fits, key=lambda f: f[0]) if fits else None


def _from_response(problem: Problem) -> np.ndarray | None:
    """Where the frequency response of the record leads whose lines tell most; None where no record has enough.

    One record's, since the directions of the others are not known yet.
    """
    each = [frequency_response(alone(problem, k)) for k in range(len(problem.drive))]
    best = max(each, key=lambda response: int(response.coherent.sum()))
    return linear_start(best, problem.dt, _STRUCTURE.order) if best.rich else None


def _fitted(start: np.ndarray, problem: Problem) -> tuple[float, tuple[np.ndarray, float]] | None:
    """Least output error from here: its cost, logarithms (rad/s) and gain (m per V^2 or V)."""
    logs, cost, _ = least_squares(start, _STRUCTURE, problem)
    gain = float(solve(logs, _STRUCTURE, problem).gains[0]) * problem.scale
    return (cost, (logs, gain)) if np.isfinite(cost) else None


def _directed(logs: np.ndarray, problem: Problem) -> Problem:
    """The problem in directions from each record's own gain, relative to most."""
    gains: list[float] = []
    if len(problem.drive) == 1:
        return problem
    for k, (output, weight) in enumerate(zip(problem.output, problem.weight, strict=True)):
        unit = driven(logs, _STRUCTURE, problem, k)
        free, _ = own_columns(logs, _STRUCTURE, problem, k)
        columns = weight[:, None] * np.column_stack([unit, np.ones(len(unit)), free])
        gains.append(project(weight * output, columns)[0][0] * np.std(unit))
    most = 1.0 if np.sum(gains) >= 0 else -1.0
    directions = [1.0 if most * g >= 0 else -1.0 for g in gains]
    return replace(
        problem,
        output=tuple(d * o for d, o in zip(directions, problem.output, strict=True)),
        beginnings=tuple(replace(b, direction=d) for b, d in zip(problem.beginnings, directions, strict=True)),
    )


def _columns(record: Record, input_map: str, logs: np.ndarray, gain: float) -> _Columns:
    """Whitened by the spectrum of what the richest explanation leaves, in blocks of a tenth of the resonance."""
    square, dt = input_map == "square", record.dt
    unit, settled = (
        respond(logs, record.voltage, step=dt, square=square, hold="foh", settled=s) for s in (False, True)
    )
    held, (free, _) = settled - unit, coast(logs, record.samples, step=dt)
    period = 2 * np.pi / np.exp(logs[1] / 2)
    size = int(np.clip(period / _PER_PERIOD / dt, 1, record.samples // 64))
    y = np.where(record.observed, record.displacement, 0.0)
    stacked = np.column_stack([y, gain * unit, gain * held, free, np.ones(len(y))])
    means, share = block_means(stacked, record.observed.astype(float), size)
    means = means * np.sqrt(share)[:, None]
    y, driven, one = means[:, 0], means[:, 1], means[:, -1:]
    columns = np.column_stack([one, means[:, 3:-1]])
    residuals = [project(y - d * driven, columns)[1] for d in (1.0, -1.0)]
    white = whitener(min(residuals, key=lambda e: float(e @ e)))(means)
    return _Columns(white[:, 0], white[:, 1], white[:, 2], white[:, 3:-1], white[:, -1], float(y.std()))


def _kind(row: _Columns, record: Record, whole: bool, logs: np.ndarray) -> tuple[Begins, float]:
    """The simplest beginning and the direction, zero fitted; "moving" where the first samples are missing.

    A flat reading under a flat drive is rest or held by the data, whatever the model leaves of the motion after it.
    """
    kinds: tuple[Begins, ...] = ("rest", "held", "moving") if whole else ("moving",)
    (standing, level), omega = standing_drive(record), _omega(logs)
    passing = whole and standing * record.dt * omega < np.pi / 2  # the drive does not stand where the record begins
    if whole and settled_samples(record, omega):
        kinds = ("held",) if level else ("rest",)
    elif passing and level and _smooth(record.voltage) and not is_still(record, omega):
        kinds = ("moving",)  # at rest under a drive or settled at it, only a jump gives a speed at once
    elif passing and not level and is_still(record, omega) and not row.moves():
        kinds = ("rest",)  # of motions cut anywhere hardly one has no speed just where its drive passes 0 V
    elif not level:
        kinds = tuple(k for k in kinds if k != "held")  # held at 0 V is rest
    return min(((b, d) for d in (1.0, -1.0) for b in kinds), key=lambda k: row.score(*k))


def _smooth(drive: np.ndarray) -> bool:
    """Whether the drive does not jump in the first samples, from which a first velocity is known."""
    return bool(np.abs(np.diff(drive[:INITIAL_SAMPLES])).max() < _JUMP * np.ptp(drive))


def _settled_together(
    records: Sequence[Record],
    rows: Sequence[_Columns],
    kinds: Sequence[tuple[Begins, float]],
    known: Sequence[bool],
    logs: np.ndarray,
) -> list[tuple[Begins, float]]:
    """The kinds, with no record in motion that only the model's misfit sets in motion.

    Records that stand still at one level, of which one is at rest or whose first drives differ, did not all turn there
    by chance: each is at rest or held, whatever the model leaves of the motion after it.
    """
    decided, omega = list(kinds), _omega(logs)
    still = [
        k
        for k, (r, (begins, _)) in enumerate(zip(records, kinds, strict=True))
        if begins == "rest" or (begins == "moving" and known[k] and is_still(r, omega))
    ]
    first = np.array([r.voltage[0] for r in records]) / max(np.abs(r.voltage).max() for r in records)
    for group, *_ in level_groups([records[k] for k in still]):
        members = [still[m] for m in group]
        if np.ptp(first[members] ** 2) > _DIFFER or any(kinds[k][0] == "rest" for k in members):
            for k in (k for k in members if kinds[k][0] == "moving"):
                kind: tuple[Begins, ...] = ("rest", "held") if standing_drive(records[k])[1] else ("rest",)
                decided[k] = min(((b, d) for d in (1.0, -1.0) for b in kind), key=lambda c, k=k: rows[k].score(*c))
    return decided


def _omega(logs: np.ndarray) -> float:
    """Natural frequency of order 2, rad/s."""
    return float(np.exp(logs[1] / 2))


def _with_zeros(
    records: Sequence[Record], rows: Sequence[_Columns], kinds: Sequence[tuple[Begins, float]], clean: bool
) -> list[Beginning]:
    """Zeros at rest from the first samples, pooled where they agree; of the others that one, one for all, or own."""
    decided: dict[int, Beginning] = {}
    resting = [k for k, (begins, _) in enumerate(kinds) if begins == "rest"]
    groups = level_groups([records[k] for k in resting])
    fitted = {k: rows[k].zero(*kinds[k]) for k in range(len(records))}
    for group, (members, zero, stderr) in enumerate(groups):
        free = clean or _sharper([fitted[resting[m]] for m in members], zero, stderr)
        decided |= {resting[m]: Beginning("rest", kinds[resting[m]][1], zero, stderr, group, free) for m in members}
    own = {k: zero for k, zero in fitted.items() if k not in decided}
    if groups:
        (first, *_), zero, stderr = groups[0]
        free = decided[resting[first]].free
        near = [k for k, (there, w, size) in own.items() if _agree(zero - there, w / (1 + w * stderr**2), size)]
        decided |= {k: Beginning(*kinds[k], zero, stderr, 0, free) for k in near}
        own = {k: v for k, v in own.items() if k not in near}
    pool, mean = dict(own), 0.0
    while pool:
        mean = sum(z * w for z, w, _ in pool.values()) / sum(w for _, w, _ in pool.values())
        worst = max(pool, key=lambda k: pool[k][1] * (pool[k][0] - mean) ** 2)
        if _agree(pool[worst][0] - mean, *pool[worst][1:]):
            break
        pool.pop(worst)
    group = len(groups)
    together = sum(w for _, w, _ in pool.values())
    decided |= {k: Beginning(*kinds[k], mean, _stderr(together), group, True) for k in pool}
    apart = [k for k in own if k not in pool]
    decided |= {
        k: Beginning(*kinds[k], own[k][0], _stderr(own[k][1]), group + 1 + j, True) for j, k in enumerate(apart)
    }
    return [decided[k] for k in range(len(records))]


def _stderr(weight: float) -> float:
    return float(1 / np.sqrt(max(weight, 1e-300)))


def _sharper(fitted: Sequence[tuple[float, float, int]], level: float, stderr: float) -> bool:
    """The whole records tell a zero better than their first samples, and no error of the model bends it.

    The fitted one has the smaller standard error, and both agree within five of theirs together (a level is bent by
    what hides in its noise).
    """
    weight = sum(w for _, w, _ in fitted)
    mean = sum(z * w for z, w, _ in fitted) / weight
    return bool(weight * stderr**2 > 1 and (mean - level) ** 2 < 25 * (1 / weight + stderr**2))


def _agree(difference: float, weight: float, size: int) -> bool:
    """A zero of its own is not worth its parameter: T log(1 + w dz^2 / T) <= log T."""
    return bool(size * np.log1p(weight * difference**2 / size) <= np.log(size))

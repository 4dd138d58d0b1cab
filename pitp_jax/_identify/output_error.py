"""The output error of a linear ODE over a set of records, by variable projection.

    r_t = w_t (y_t - g x_t(poles, delay) - zero - sum_j c_j n_jt)     x: unit static gain;  n_j: a record's own columns
    minimise over log pole coefficients and log delay;  inside, linearly:  gain g, zeros (one a group), c (one a record)

    held:         x from the equilibrium of u(0)            moving:   n = free responses of every mode

The inner problem is solved exactly (Golub & Pereyra, 1973), so a start is poles and a delay alone. A weak ridge holds
what a record does not tell of its initial state. Zeros of records at rest are taken off beforehand where their first
samples tell them better than a model's misfit would bend them. Everything is normalised by the output's rms.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float

from .._errors import BadInput
from .._model.model import Hold
from .._numerics.levenberg_marquardt import Normal, minimise
from .._record.initial_state import Beginning, from_known
from .._record.preprocess import force_band
from .._record.record import Record
from .linear_ode import coast, poles, respond

_RIDGE = 1e-3  # per sample, on an initial state in units of the output's rms
_STEP = 1e-6  # of a logarithm, for its slope by a difference
_LATER = 0.02  # samples, the same for the delay: its shift is linear between samples
_SLOWEST = 0.01  # rad a record: a slower pole integrates, as far as the records show
FASTEST = 3.0  # rad a sample: a faster pole is none that these samples show


@dataclass(frozen=True)
class Structure:
    """What distinguishes one candidate from another."""

    order: int
    hold: Hold = "foh"
    delayed: bool = False

    @property
    def complexity(self) -> int:
        """Number of parameters that a held-out score has to pay for."""
        return self.order + self.delayed


@dataclass(frozen=True)
class Problem:
    """The records of one identification, normalised.

    Attributes:
        drive, output, weight: per record, shape (T_r,); output over `scale`, 0 where not measured.
        beginnings: per record; `zeros`: which fitted zero it has, -1 where its own was taken off.
        square, dt, scale: input map, sampling interval (s), the output's rms.
        omega: rad/s, top of the drive's band.
        fine: sampling interval that the drive was held over; shorter than `dt` where samples were averaged.
    """

    drive: tuple[np.ndarray, ...]
    output: tuple[np.ndarray, ...]
    weight: tuple[np.ndarray, ...]
    beginnings: tuple[Beginning, ...]
    zeros: tuple[int, ...]
    square: bool
    dt: float
    scale: float
    omega: float
    fine: float

    @property
    def samples(self) -> float:
        """How many samples count."""
        return float(sum(w.sum() for w in self.weight))

    @property
    def free_zeros(self) -> int:
        """How many zeros are fitted."""
        return max(self.zeros) + 1

    @property
    def main(self) -> int:
        """A record with the zero that most have, one at rest before others: the zero that a model keeps."""
        groups = [b.group for b in self.beginnings]
        return max(range(len(groups)), key=lambda k: (groups.count(groups[k]), not self.beginnings[k].free, -k))

    @property
    def seconds(self) -> float:
        """How long the longest record is."""
        return max(len(d) for d in self.drive) * self.dt

    def upper(self, structure: Structure) -> Float[np.ndarray, " parameters"]:
        """Of the logarithms: no pole above the band that is sampled, no delay beyond a quarter of a record."""
        fastest, n = np.log(FASTEST / self.dt), structure.order
        bounds = [np.log(2) + fastest, 2 * fastest] * (n // 2) + [fastest] * (n % 2)
        return np.array(bounds + [np.log(self.seconds / 4)] * structure.delayed)


@dataclass(frozen=True)
class Solved:
    """Linear parameters at some poles, and what is left.

    Attributes:
        gains: g, then the fitted zeros; own: per record its c.
        left: weighted residual of every record; penalty: of the ridge.
    """

    gains: Float[np.ndarray, " gains"]
    own: tuple[np.ndarray, ...]
    left: tuple[np.ndarray, ...]
    penalty: Float[np.ndarray, " rows"]

    @property
    def rows(self) -> Float[np.ndarray, " rows"]:
        """All of it in one vector."""
        return np.concatenate([*self.left, self.penalty])


def check_motion(records: Sequence[Record]) -> None:
    """Refuse records in which nothing changes."""
    if np.ptp(np.concatenate([r.voltage for r in records])) == 0:
        raise BadInput("the voltage never changes in these records: record an excitation such as a sweep")
    if np.ptp(np.concatenate([r.displacement[r.observed] for r in records])) == 0:
        raise BadInput("the displacement never changes in these records: check the sensor and its column")


def build_problem(records: Sequence[Record], input_map: str, beginnings: Sequence[Beginning]) -> Problem:
    """Normalise the records, each from its first known state, less its zero and in one direction."""
    records = [from_known(r) for r in records]
    moved = [np.where(r.observed, b.direction * (r.displacement - b.zero), 0.0)
             for r, b in zip(records, beginnings, strict=True)]  # fmt: skip
    weight = tuple(r.observed.astype(float) for r in records)
    scale = float(np.sqrt(sum((m**2).sum() for m in moved) / max(sum(w.sum() for w in weight), 1.0))) or 1.0
    square, dt = input_map == "square", records[0].dt
    band = force_band([r.voltage**2 if square else r.voltage for r in records], dt)
    free = sorted({b.group for b in beginnings if b.free})
    return Problem(
        tuple(r.voltage for r in records), tuple(m / scale for m in moved), weight, tuple(beginnings),
        zeros=tuple(free.index(b.group) if b.free else -1 for b in beginnings), square=square, dt=dt, scale=scale,
        omega=float(2 * np.pi * min(band, 0.1 / dt)), fine=dt,
    )  # fmt: skip


def shifted(drive: Float[np.ndarray, " time"], samples: float, before: float) -> Float[np.ndarray, " time"]:
    """The drive so many samples later, linear between samples, `before` its first one."""
    return np.interp(np.arange(len(drive)) - samples, np.arange(len(drive)), drive, left=before)


def poles_of(params: np.ndarray, structure: Structure) -> Complex[np.ndarray, " poles"]:
    """The fitted poles, rad/s."""
    return poles(params[: structure.order])


def driven(params: np.ndarray, structure: Structure, problem: Problem, k: int) -> Float[np.ndarray, " time"]:
    """Response of record k to its drive, unit static gain."""
    begins = problem.beginnings[k].begins
    drive, square, hold = problem.drive[k], problem.square, structure.hold
    late = float(np.exp(params[-1])) / problem.dt if structure.delayed else 0.0
    if hold == "zoh" and problem.fine < problem.dt:  # of a held drive the means are half a fine sample early
        late, hold = late + problem.fine / problem.dt / 2, "foh"
    if late:
        drive = shifted(drive, late, 0.0 if begins == "rest" else drive[0])
    logs = params[: structure.order]
    return respond(logs, drive, step=problem.dt, square=square, hold=hold, settled=begins != "rest")


def own_columns(params: np.ndarray, structure: Structure, problem: Problem, k: int) -> tuple[np.ndarray, np.ndarray]:
    """What record k has beside its response to the drive, (T, columns), and which columns oscillate."""
    samples = len(problem.drive[k])
    if problem.beginnings[k].begins != "moving":
        return np.zeros((samples, 0)), np.zeros(0, bool)
    return coast(params[: structure.order], samples, step=problem.dt)


def solve(params: np.ndarray, structure: Structure, problem: Problem, gains: np.ndarray | None = None) -> Solved:
    """Gain, zeros and initial states of least squares at these poles; `gains`: those two, where they are given."""
    columns, parts = [], []
    for k, (output, weight) in enumerate(zip(problem.output, problem.weight, strict=True)):
        common = np.zeros((len(output), 1 + problem.free_zeros))
        common[:, 0] = driven(params, structure, problem, k)
        if problem.zeros[k] >= 0:
            common[:, 1 + problem.zeros[k]] = problem.beginnings[k].direction
        own, _ = own_columns(params, structure, problem, k)
        rows = np.column_stack([own, common, output]) * weight[:, None]
        gram, n = rows.T @ rows, own.shape[1]
        ridge = np.full(n, _RIDGE**2 * weight.sum())
        own_inverse = inverse(gram[:n, :n] + np.diag(ridge))
        parts.append(gram[n:, n:] - gram[n:, :n] @ own_inverse @ gram[:n, n:])
        columns.append((rows, own_inverse @ gram[:n, n:], np.sqrt(ridge)))
    whole = np.sum(parts, 0)
    gains = np.asarray(inverse(whole[:-1, :-1]) @ whole[:-1, -1]) if gains is None else gains
    own, left, penalty = [], [], []
    for rows, projected, ridge in columns:
        n = len(ridge)
        c = projected[:, -1] - projected[:, :-1] @ gains
        own.append(c)
        left.append(rows[:, -1] - rows[:, n:-1] @ gains - rows[:, :n] @ c)
        penalty.append(-ridge * c)
    return Solved(gains, tuple(own), tuple(left), np.concatenate(penalty))


def inverse(gram: np.ndarray) -> np.ndarray:
    """Inverse of J'J; a direction that rounding hides has the largest variance it may have, not a negative one."""
    if not len(gram) or not np.isfinite(gram).all():
        return np.full_like(gram, np.nan)
    diagonal = np.diag(gram)
    root = np.sqrt(np.maximum(diagonal, 1e-30 * max(diagonal.max(), 1e-300)))
    values, vectors = np.linalg.eigh(gram / np.outer(root, root))
    return (vectors / np.maximum(values, 1e-14)) @ vectors.T / np.outer(root, root)


def steps(params: np.ndarray, structure: Structure, problem: Problem) -> Float[np.ndarray, " parameters"]:
    """By how much every parameter is moved to see its slope."""
    moves = np.full(len(params), _STEP)
    if structure.delayed:
        moves[-1] = min(_LATER * problem.dt / max(float(np.exp(params[-1])), 1e-300), 0.5)
    return moves


def normal_equations(params: np.ndarray, structure: Structure, problem: Problem) -> Normal:
    """Sum of squares, half gradient and J'J of the projected residual."""
    with np.errstate(all="ignore"):
        here = solve(params, structure, problem).rows
        if not np.isfinite(here).all():
            return Normal.of(np.inf, np.zeros(len(params)), np.zeros((len(params),) * 2))
        jacobian = np.empty((len(here), len(params)))
        for j, move in enumerate(steps(params, structure, problem)):
            moved = params + move * np.eye(len(params))[j]
            jacobian[:, j] = (solve(moved, structure, problem).rows - here) / move
    return Normal.of(here @ here, jacobian.T @ here, jacobian.T @ jacobian)


def least_squares(
    params: np.ndarray, structure: Structure, problem: Problem, most: int = 60, least: float = 1e-9
) -> tuple[np.ndarray, float, bool]:
    """Parameters of least output error from a start, their mean square (of the output's), and whether it converged."""
    upper = problem.upper(structure)
    params, converged = minimise(lambda p: normal_equations(p, structure, problem), params, upper, most, least)
    params = _not_slower(params, structure, _SLOWEST / problem.seconds)
    rows = solve(params, structure, problem).rows
    cost = float(rows @ rows) / problem.samples
    return params, cost if np.isfinite(cost) else np.inf, converged


def _not_slower(params: np.ndarray, structure: Structure, slowest: float) -> np.ndarray:
    """No pole of a plant that integrates goes on to zero, where nothing is left of it in sample."""
    params = params.copy()
    for k in range(0, structure.order - 1, 2):
        params[k + 1] = max(params[k + 1], params[k] + np.log(slowest))
    if structure.order % 2:
        params[structure.order - 1] = max(params[structure.order - 1], np.log(slowest))
    return params


def masked(problem: Problem, keep: Sequence[np.ndarray]) -> Problem:
    """The problem with some samples left out of every sum."""
    return replace(problem, weight=tuple(w * k for w, k in zip(problem.weight, keep, strict=True)))

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
from .._numerics.minimise import Normal, minimise
from .._record.initial_state import Beginning, from_known
from .._record.preprocess import force_band
from .._record.record import Record
from .linear_ode import coast, no_faster, pole_slopes, poles, powers, respond, respond_with_slopes

_RIDGE = 1e-3  # per sample, on an initial state in units of the output's rms
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
        fastest, n = np.log(FASTEST / self.fine), structure.order  # means over blocks hide no pole that is a lag
        bounds = [np.log(2) + fastest, 2 * fastest] * (n // 2) + [fastest] * (n % 2)
        return np.array(bounds + [np.log(self.seconds / 4)] * structure.delayed)


@dataclass(frozen=True)
class Solved:
    """Linear parameters at some poles, and what is left.

    Attributes:
        gains: g, then the fitted zeros; own: per record its c.
        residuals: weighted, of every record; penalty: of its ridge.
    """

    gains: Float[np.ndarray, " gains"]
    own: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]
    penalty: tuple[np.ndarray, ...]

    @property
    def rows(self) -> Float[np.ndarray, " rows"]:
        """All of it in one vector, record by record."""
        return np.concatenate([part for both in zip(self.residuals, self.penalty, strict=True) for part in both])


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


def poles_of(params: np.ndarray, structure: Structure) -> Complex[np.ndarray, " poles"]:
    """The fitted poles, rad/s."""
    return poles(params[: structure.order])


def driven(params: np.ndarray, structure: Structure, problem: Problem, k: int) -> Float[np.ndarray, " time"]:
    """Response of record k to its drive, unit static gain."""
    return respond(params[: structure.order], problem.drive[k], **_how(params, structure, problem, k))


def driven_slopes(params: np.ndarray, structure: Structure, problem: Problem, k: int) -> tuple[np.ndarray, np.ndarray]:
    """The same, and its derivatives by the parameters, (parameters, T)."""
    how = _how(params, structure, problem, k)
    run, slopes, rate = respond_with_slopes(params[: structure.order], problem.drive[k], **how)
    return run, np.vstack([slopes, -np.exp(params[-1]) * rate]) if structure.delayed else slopes


def _how(params: np.ndarray, structure: Structure, problem: Problem, k: int) -> dict:
    """How the drive of record k acts on the plant."""
    late, hold = float(np.exp(params[-1])) / problem.dt if structure.delayed else 0.0, structure.hold
    if problem.fine < problem.dt:  # means are smooth; of a held drive they are half a fine sample early
        late, hold = late + (problem.fine / problem.dt / 2 if hold == "zoh" else 0.0), "cubic"
    settled = problem.beginnings[k].begins != "rest"
    return {"step": problem.dt, "square": problem.square, "hold": hold, "settled": settled, "late": late}


def own_columns(params: np.ndarray, structure: Structure, problem: Problem, k: int) -> tuple[np.ndarray, np.ndarray]:
    """What record k has beside its response to the drive, (T, columns), and which columns oscillate."""
    samples = len(problem.drive[k])
    if problem.beginnings[k].begins != "moving":
        return np.zeros((samples, 0)), np.zeros(0, bool)
    return coast(params[: structure.order], samples, step=problem.dt)


def _own_slopes(params: np.ndarray, structure: Structure, problem: Problem, k: int, own: np.ndarray) -> np.ndarray:
    """Derivatives of what record k has of its own, at the sizes `own`, by the parameters, (parameters, T)."""
    time = np.arange(len(problem.drive[k])) * problem.dt
    slopes = np.zeros((len(params), len(time)))
    at, moves = 0, pole_slopes(params[: structure.order])
    for pole, move in zip(poles_of(params, structure), moves, strict=True):
        if pole.imag < 0:
            continue
        # a Re e^pt + b Im e^pt = Re((a - jb) e^pt), and d/dp of that is t times as large
        size = own[at] - 1j * own[at + 1] if pole.imag else own[at]
        at += 2 if pole.imag else 1
        slopes[: structure.order] += np.real(move[:, None] * (size * time * powers(pole * problem.dt, len(time))))
    return slopes


def solve(
    params: np.ndarray, structure: Structure, problem: Problem, runs: Sequence[np.ndarray] | None = None
) -> Solved:
    """Gain, zeros and initial states of least squares at these poles; `runs`: the responses, where they are known."""
    parts, whole = [], 0.0
    for k, output in enumerate(problem.output):
        run = driven(params, structure, problem, k) if runs is None else runs[k]
        rows, n, ridge = _linear(params, structure, problem, k, run, output)
        gram = rows @ rows.T
        # of the record's own c: c = (N'N + R)^-1 N'(y - G g), so that only g is common (Schur complement)
        own = inverse(gram[:n, :n] + np.diag(ridge)) @ gram[:n, n:]
        whole = whole + gram[n:, n:] - gram[n:, :n] @ own
        parts.append((rows, own, np.sqrt(ridge)))
    whole = np.asarray(whole)
    gains = inverse(whole[:-1, :-1]) @ whole[:-1, -1]  # the last row and column are y's
    sizes = [own[:, -1] - own[:, :-1] @ gains for _, own, _ in parts]
    residuals = [
        rows[-1] - np.concatenate([c, gains]) @ rows[:-1] for (rows, _, _), c in zip(parts, sizes, strict=True)
    ]
    penalty = [-ridge * c for (_, _, ridge), c in zip(parts, sizes, strict=True)]
    return Solved(gains, tuple(sizes), tuple(residuals), tuple(penalty))


def _linear(
    params: np.ndarray, structure: Structure, problem: Problem, k: int, *series: np.ndarray
) -> tuple[np.ndarray, int, np.ndarray]:
    """Weighted rows of record k (its own, response, zeros, other series), how many are its own, their ridge."""
    own, weight = own_columns(params, structure, problem, k)[0].T, problem.weight[k]
    zeros = np.zeros((problem.free_zeros, len(weight)))
    if problem.zeros[k] >= 0:
        zeros[problem.zeros[k]] = problem.beginnings[k].direction
    rows = np.vstack([own, series[0], zeros, *series[1:]])
    return rows * weight, len(own), np.full(len(own), _RIDGE**2 * weight.sum())


def jacobians(
    params: np.ndarray, structure: Structure, problem: Problem
) -> tuple[Solved, list[Float[np.ndarray, "numbers samples"]]]:
    """What is solved here, and per record the weighted slopes of its run by (gain, zeros, parameters).

    A record's own columns are projected out of them; at the end stand those of the ridge.
    """
    runs = [driven_slopes(params, structure, problem, k) for k in range(len(problem.drive))]
    solved, projected = solve(params, structure, problem, [run for run, _ in runs]), []
    for k, (run, slopes) in enumerate(runs):
        slopes = solved.gains[0] * slopes  # d(g x) / dp at constant g: g's own slope is x itself
        if len(solved.own[k]):
            slopes = slopes + _own_slopes(params, structure, problem, k, solved.own[k])
        rows, n, ridge = _linear(params, structure, problem, k, run, slopes)
        own, rest = rows[:n], rows[n:]
        # P = I - N (N'N + R)^-1 N', applied to the rows and to the ridge's, which stand below them
        factors = (rest @ own.T) @ inverse(own @ own.T + np.diag(ridge))
        projected.append(np.hstack([rest - factors @ own, -np.sqrt(ridge) * factors]) if n else rest)
    return solved, projected


def inverse(gram: np.ndarray) -> np.ndarray:
    """Inverse of J'J; a direction that rounding hides has the largest variance it may have, not a negative one."""
    if not len(gram) or not np.isfinite(gram).all():
        return np.full_like(gram, np.nan)
    diagonal = np.diag(gram)
    # scaled to a unit diagonal first: units of the parameters are no reason to drop a direction
    root = np.sqrt(np.maximum(diagonal, 1e-30 * max(diagonal.max(), 1e-300)))
    values, vectors = np.linalg.eigh(gram / np.outer(root, root))
    return (vectors / np.maximum(values, 1e-14)) @ vectors.T / np.outer(root, root)


def normal_equations(params: np.ndarray, structure: Structure, problem: Problem) -> Normal:
    """Sum of squares, half gradient and J'J of the projected residual (Kaufman, 1975)."""
    with np.errstate(all="ignore"):
        solved, slopes = jacobians(params, structure, problem)
        here, n = solved.rows, len(params)
        if not (np.isfinite(here).all() and all(np.isfinite(j).all() for j in slopes)):
            return Normal.of(np.inf, np.zeros(n), np.zeros((n, n)))
        whole = np.hstack(slopes)
        linear, moved = whole[:-n], whole[-n:]
        # Kaufman: of the projector's derivative only the part that stays when the residual is small
        moved = moved - (moved @ linear.T) @ inverse(linear @ linear.T) @ linear
        return Normal.of(here @ here, -moved @ here, moved @ moved.T)


def least_squares(
    params: np.ndarray, structure: Structure, problem: Problem, most: int = 60, least: float = 1e-9
) -> tuple[np.ndarray, float, bool]:
    """Parameters of least output error from a start, their mean square (of the output's), and whether it converged."""
    upper = problem.upper(structure)
    params = np.append(no_faster(params[: structure.order], 0.99 * FASTEST / problem.fine), params[structure.order :])
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


def alone(problem: Problem, k: int) -> Problem:
    """The problem of record k by itself, in the same units."""
    return replace(
        problem,
        drive=problem.drive[k : k + 1],
        output=problem.output[k : k + 1],
        weight=problem.weight[k : k + 1],
        beginnings=problem.beginnings[k : k + 1],
        zeros=(min(problem.zeros[k], 0),),
    )

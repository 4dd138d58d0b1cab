"""Compute and minimise the output error of a linear ODE on several records, by variable projection.

    r_t = w_t (y_t - g x_t(poles, delay) - offset - sum_j c_j n_jt)     x: unit static gain;  n_j: its own columns
    minimise over log pole coefficients and log delay;  inside, linearly:  gain g, offsets (one a group), c (per record)

    held:         x from the equilibrium of u(0)            moving:   n = free responses of every mode

The inner problem is solved exactly (Golub & Pereyra, 1973), so a start consists of poles and a delay only. A weak ridge
determines the initial state where the record does not. Offsets of records at rest are subtracted beforehand if their
first samples give them more accurately than the model's error would allow. Everything is normalised by the output's
rms.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float

from ...common.errors import BadInput
from ..fit.minimise import Normal, minimise
from ..model.model import Hold
from ..signal.initial_state import Beginning, from_known
from ..signal.preprocess import force_band
from ..signal.record import Record
from .linear_ode import bounded, coast, pole_slopes, poles, powers, respond, respond_with_slopes

_RIDGE = 1e-3  # per sample, on an initial state in units of the output's rms
_SLOWEST = 0.01  # rad a record: the records cannot distinguish a slower pole from an integrator
FASTEST = 3.0  # rad a sample: these samples cannot show a faster pole


@dataclass(frozen=True)
class Structure:
    """A candidate's structure: the order, the hold of the input between samples, and whether it has a delay.

    `integrates`: one pole is 0 (a plant without a spring). Such a plant integrates a constant offset of its input, so
    that is fitted too; a spring would turn it into an offset of the sensor.
    """

    order: int
    hold: Hold = "foh"
    delayed: bool = False
    integrates: bool = False

    @property
    def moved(self) -> int:
        """Return the number of poles that are fitted."""
        return self.order - self.integrates

    @property
    def complexity(self) -> int:
        """Return the number of fitted poles and delays, which the held-out error must justify."""
        return self.moved + self.delayed

    def logs(self, params: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " order"]:
        """Return the logarithms of the pole coefficients, -inf for a pole at 0."""
        return np.append(params[: self.moved], [-np.inf] * self.integrates)

    def offset(self, params: Float[np.ndarray, " parameters"]) -> float:
        """Return the constant offset of the input, V."""
        return float(params[self.moved]) if self.integrates else 0.0


@dataclass(frozen=True)
class Problem:
    """The records of one identification, divided by the rms of their outputs.

    Attributes:
        drive, output, weight: per record, shape (T_r,); output over `scale`, 0 where not measured.
        beginnings: per record; `zeros`: index of its fitted offset, -1 if its own was subtracted.
        square, dt, scale: input map, sampling interval (s), the output's rms.
        omega: rad/s, top of the input's band.
        fine: sampling interval over which the input was held; shorter than `dt` if samples were averaged.
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
    def forces(self) -> list[np.ndarray]:
        """Return the force of every record, V^2 or V, shapes (T_r,)."""
        return [drive**2 if self.square else drive for drive in self.drive]

    @property
    def samples(self) -> float:
        """Return the number of measured samples of all records that count."""
        return float(sum(w.sum() for w in self.weight))

    @property
    def free_zeros(self) -> int:
        """Return the number of sensor offsets that are fitted."""
        return max(self.zeros) + 1

    @property
    def main(self) -> int:
        """Return the index of a record with the most common sensor offset (rest first), which the model keeps."""
        groups = [b.group for b in self.beginnings]
        return max(range(len(groups)), key=lambda k: (groups.count(groups[k]), not self.beginnings[k].free, -k))

    @property
    def seconds(self) -> float:
        """Return the duration of the longest record, s."""
        return max(len(d) for d in self.drive) * self.dt

    def upper(self, structure: Structure) -> Float[np.ndarray, " parameters"]:
        """Return upper bounds of the log parameters: poles within the sampled band, delay up to a quarter record."""
        fastest, n = np.log(FASTEST / self.fine), structure.moved  # block means can hide no pole that acts as a lag
        bounds = [np.log(2) + fastest, 2 * fastest] * (n // 2) + [fastest] * (n % 2) + [np.inf] * structure.integrates
        return np.array(bounds + [np.log(self.seconds / 4)] * structure.delayed)


@dataclass(frozen=True)
class Solved:
    """Solution at given poles: gain, sensor offsets and initial states, with the residual.

    Attributes:
        gains: g, then the fitted offsets; own: per record its c.
        residuals: weighted, of every record; penalty: of its ridge.
    """

    gains: Float[np.ndarray, " gains"]
    own: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]
    penalty: tuple[np.ndarray, ...]

    @property
    def rows(self) -> Float[np.ndarray, " rows"]:
        """Return residuals and ridge penalties in one vector, record by record."""
        return np.concatenate([part for both in zip(self.residuals, self.penalty, strict=True) for part in both])


def check_motion(records: Sequence[Record]) -> None:
    """Refuse records whose input never changes or whose output never changes."""
    if np.ptp(np.concatenate([r.voltage for r in records])) == 0:
        raise BadInput("the input never changes in these recordings; record an excitation such as a sweep")
    if np.ptp(np.concatenate([r.displacement[r.observed] for r in records])) == 0:
        raise BadInput("the output never changes in these recordings; check the sensor and its column")


def build_problem(records: Sequence[Record], input_map: str, beginnings: Sequence[Beginning]) -> Problem:
    """Return records without their sensor offset, with one sensor direction, divided by the rms of all outputs."""
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
    """Return the fitted poles, rad/s."""
    return poles(structure.logs(params))


def driven(params: np.ndarray, structure: Structure, problem: Problem, k: int) -> Float[np.ndarray, " time"]:
    """Simulate the response of record k to the input, with unit static gain, shape (T,)."""
    drive = problem.drive[k] + structure.offset(params)
    return respond(structure.logs(params), drive, **_how(params, structure, problem, k))


def driven_slopes(params: np.ndarray, structure: Structure, problem: Problem, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Simulate the response of record k, shape (T,), and its derivatives by the parameters, (parameters, T)."""
    how, logs, drive = _how(params, structure, problem, k), structure.logs(params), problem.drive[k]
    run, slopes, rate = respond_with_slopes(logs, drive + structure.offset(params), **how)
    rows = [slopes[: structure.moved]]
    rows += [respond(logs, np.ones_like(drive), **how)] if structure.integrates else []
    return run, np.vstack([*rows, -np.exp(params[-1]) * rate] if structure.delayed else rows)


def _how(params: np.ndarray, structure: Structure, problem: Problem, k: int) -> dict:
    """Return the arguments of `respond` for record k: sampling interval, input map, hold, initial state, delay."""
    late, hold = float(np.exp(params[-1])) / problem.dt if structure.delayed else 0.0, structure.hold
    if problem.fine < problem.dt:  # block means are smooth; of a held input they are half a fine sample early
        late, hold = late + (problem.fine / problem.dt / 2 if hold == "zoh" else 0.0), "cubic"
    settled = problem.beginnings[k].begins != "rest" and not structure.integrates  # without a spring nothing settles
    return {"step": problem.dt, "square": problem.square, "hold": hold, "settled": settled, "late": late}


def own_columns(params: np.ndarray, structure: Structure, problem: Problem, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the free responses of record k, shape (T, columns), and which oscillate; none unless it starts moving."""
    samples = len(problem.drive[k])
    if problem.beginnings[k].begins != "moving":
        return np.zeros((samples, 0)), np.zeros(0, bool)
    return coast(structure.logs(params), samples, step=problem.dt)


def _own_slopes(params: np.ndarray, structure: Structure, problem: Problem, k: int, own: np.ndarray) -> np.ndarray:
    """Return derivatives of record k's free response (amplitudes `own`) by the parameters, shape (parameters, T)."""
    time = np.arange(len(problem.drive[k])) * problem.dt
    slopes = np.zeros((len(params), len(time)))
    at, moves = 0, pole_slopes(structure.logs(params))[:, : structure.moved]
    for pole, move in zip(poles_of(params, structure), moves, strict=True):
        if pole.imag < 0:
            continue
        # a Re e^pt + b Im e^pt = Re((a - jb) e^pt), whose derivative by p is t times as large
        size = own[at] - 1j * own[at + 1] if pole.imag else own[at]
        at += 2 if pole.imag else 1
        slopes[: structure.moved] += np.real(move[:, None] * (size * time * powers(pole * problem.dt, len(time))))
    return slopes


def solve(
    params: np.ndarray, structure: Structure, problem: Problem, runs: Sequence[np.ndarray] | None = None
) -> Solved:
    """Solve for gain, sensor offsets and initial states at given poles, by linear least squares.

    `runs`: the responses to the inputs, if they are known already.
    """
    parts, whole = [], 0.0
    for k, output in enumerate(problem.output):
        run = driven(params, structure, problem, k) if runs is None else runs[k]
        rows, n, ridge = _linear(params, structure, problem, k, run, output)
        gram = rows @ rows.T
        # eliminate the record's own c: c = (N'N + R)^-1 N'(y - G g), so that only g is common (Schur complement)
        own = inverse(gram[:n, :n] + np.diag(ridge)) @ gram[:n, n:]
        whole = whole + gram[n:, n:] - gram[n:, :n] @ own
        parts.append((rows, own, np.sqrt(ridge)))
    whole = np.asarray(whole)
    gains = inverse(whole[:-1, :-1]) @ whole[:-1, -1]  # the last row and column belong to y
    sizes = [own[:, -1] - own[:, :-1] @ gains for _, own, _ in parts]
    residuals = [
        rows[-1] - np.concatenate([c, gains]) @ rows[:-1] for (rows, _, _), c in zip(parts, sizes, strict=True)
    ]
    penalty = [-ridge * c for (_, _, ridge), c in zip(parts, sizes, strict=True)]
    return Solved(gains, tuple(sizes), tuple(residuals), tuple(penalty))


def _linear(
    params: np.ndarray, structure: Structure, problem: Problem, k: int, *series: np.ndarray
) -> tuple[np.ndarray, int, np.ndarray]:
    """Return weighted regressors of record k (free responses first), and number and ridge of the free responses."""
    own, weight = own_columns(params, structure, problem, k)[0].T, problem.weight[k]
    zeros = np.zeros((problem.free_zeros, len(weight)))
    if problem.zeros[k] >= 0:
        zeros[problem.zeros[k]] = problem.beginnings[k].direction
    rows = np.vstack([own, series[0], zeros, *series[1:]])
    return rows * weight, len(own), np.full(len(own), _RIDGE**2 * weight.sum())


def jacobians(
    params: np.ndarray, structure: Structure, problem: Problem
) -> tuple[Solved, list[Float[np.ndarray, "numbers samples"]]]:
    """Solve at given poles; return the solution and each record's weighted derivatives by (gain, offsets, parameters).

    A record's own columns are projected out; the ridge's derivatives come last.
    """
    runs = [driven_slopes(params, structure, problem, k) for k in range(len(problem.drive))]
    solved, projected = solve(params, structure, problem, [run for run, _ in runs]), []
    for k, (run, slopes) in enumerate(runs):
        slopes = solved.gains[0] * slopes  # d(g x) / dp at constant g: g's own slope is x itself
        if len(solved.own[k]):
            slopes = slopes + _own_slopes(params, structure, problem, k, solved.own[k])
        rows, n, ridge = _linear(params, structure, problem, k, run, slopes)
        own, rest = rows[:n], rows[n:]
        # P = I - N (N'N + R)^-1 N', applied to the rows and to the ridge's rows below them
        factors = (rest @ own.T) @ inverse(own @ own.T + np.diag(ridge))
        projected.append(np.hstack([rest - factors @ own, -np.sqrt(ridge) * factors]) if n else rest)
    return solved, projected


def inverse(gram: np.ndarray) -> np.ndarray:
    """Invert a matrix J'J safely; a direction hidden by rounding gets a large but finite variance."""
    if not len(gram) or not np.isfinite(gram).all():
        return np.full_like(gram, np.nan)
    diagonal = np.diag(gram)
    # Scaled to a unit diagonal first, so that the units of the parameters do not decide which direction is dropped.
    root = np.sqrt(np.maximum(diagonal, 1e-30 * max(diagonal.max(), 1e-300)))
    values, vectors = np.linalg.eigh(gram / np.outer(root, root))
    return (vectors / np.maximum(values, 1e-14)) @ vectors.T / np.outer(root, root)


def normal_equations(params: np.ndarray, structure: Structure, problem: Problem) -> Normal:
    """Return the sum of squares, half its gradient and J'J of the output error, as in Kaufman (1975)."""
    with np.errstate(all="ignore"):
        solved, slopes = jacobians(params, structure, problem)
        here, n = solved.rows, len(params)
        if not (np.isfinite(here).all() and all(np.isfinite(j).all() for j in slopes)):
            return Normal.of(np.inf, np.zeros(n), np.zeros((n, n)))
        whole = np.hstack(slopes)
        linear, moved = whole[:-n], whole[-n:]
        # Kaufman: only the part of the projector's derivative that remains when the residual is small
        moved = moved - (moved @ linear.T) @ inverse(linear @ linear.T) @ linear
        return Normal.of(here @ here, -moved @ here, moved @ moved.T)


def least_squares(
    params: np.ndarray, structure: Structure, problem: Problem, most: int = 60, least: float = 1e-9
) -> tuple[np.ndarray, float, bool]:
    """Fit the output error from initial parameters; return parameters, mean square residual, and convergence."""
    upper = problem.upper(structure)
    n = structure.moved
    params = np.append(bounded(params[:n], 0.0, 0.99 * FASTEST / problem.fine), params[n:])
    params, converged = minimise(lambda p: normal_equations(p, structure, problem), params, upper, most, least)
    # an integrating pole would otherwise drift to zero
    params = np.append(bounded(params[:n], _SLOWEST / problem.seconds, np.inf), params[n:])
    rows = solve(params, structure, problem).rows
    cost = float(rows @ rows) / problem.samples
    return params, cost if np.isfinite(cost) else np.inf, converged


def masked(problem: Problem, keep: Sequence[np.ndarray]) -> Problem:
    """Return the normalised records with only the samples marked in `keep` counted."""
    return replace(problem, weight=tuple(w * k for w, k in zip(problem.weight, keep, strict=True)))

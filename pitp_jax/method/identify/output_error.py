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
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from ...common.errors import refuse_if
from ..fit.minimise import Normal, minimise
from ..model.model import Hold
from ..numerics.coloured_noise import project
from ..signal.initial_state import Beginning, from_known
from ..signal.preprocess import force_band
from ..signal.record import Record
from .linear_ode import bounded, coast, pole_slopes, poles, respond, respond_with_slopes

_RIDGE = 1e-3  # per sample, on an initial state in units of the output's rms
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
    def heads(self) -> Int[np.ndarray, " records"]:
        """Return the index of every record's first sample in a series of all records, one after another."""
        return np.cumsum([0, *map(len, self.drive[:-1])])

    def numbers(self, parameters: int = 0) -> list[np.ndarray]:
        """Return per record which numbers act on it, among g, all fitted offsets, and some parameters."""
        last = 1 + self.free_zeros
        return [np.array([0, *[1 + zero] * (zero >= 0), *range(last, last + parameters)]) for zero in self.zeros]

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
        errors: of every record the weighted residual, then the penalty of its ridge.
    """

    gains: Float[np.ndarray, " gains"]
    own: tuple[np.ndarray, ...]
    errors: tuple[np.ndarray, ...]

    @property
    def residuals(self) -> list[np.ndarray]:
        """Return the weighted residuals of every record, shapes (T_r,)."""
        return [error[: len(error) - len(own)] for error, own in zip(self.errors, self.own, strict=True)]

    @property
    def rows(self) -> Float[np.ndarray, " rows"]:
        """Return residuals and ridge penalties in one vector, record by record."""
        return np.concatenate(self.errors)


def check_motion(records: Sequence[Record]) -> None:
    """Refuse records whose input never changes or whose output never changes."""
    still_input = np.ptp(np.concatenate([r.voltage for r in records])) == 0
    still_output = np.ptp(np.concatenate([r.displacement[r.observed] for r in records])) == 0
    refuse_if(
        (still_input, "the input never changes in these recordings; record an excitation such as a sweep"),
        (still_output, "the output never changes in these recordings; check the sensor and its column"),
    )


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


@dataclass(frozen=True)
class OutputError:
    """The output error of a linear ODE at given parameters, over all records of a problem."""

    params: Float[np.ndarray, " parameters"]
    structure: Structure
    problem: Problem

    @property
    def logs(self) -> Float[np.ndarray, " order"]:
        """Return the logarithms of the pole coefficients."""
        return self.structure.logs(self.params)

    @property
    def poles(self) -> Complex[np.ndarray, " poles"]:
        """Return the poles, rad/s."""
        return poles(self.logs)

    @property
    def delay(self) -> float:
        """Return the delay, s."""
        return float(np.exp(self.params[-1])) if self.structure.delayed else 0.0

    @cached_property
    def runs(self) -> list[Float[np.ndarray, " time"]]:
        """Return the response of every record to its input, with unit static gain, shapes (T_r,)."""
        return np.split(respond(self.logs, self._drive, **self._how), self.problem.heads[1:])

    def _runs_with_slopes(self) -> list[Float[np.ndarray, "rows time"]]:
        """Simulate the response of every record; in the rows below it stand its derivatives by the parameters."""
        run, slopes, rate = respond_with_slopes(self.logs, self._drive, **self._how)
        rows = [run, *slopes[: self.structure.moved]]
        if self.structure.integrates:
            rows.append(respond(self.logs, np.ones_like(run), **self._how))
        if self.structure.delayed:
            rows.append(-self.delay * rate)
        return np.split(np.stack(rows), self.problem.heads[1:], axis=-1)

    @property
    def _drive(self) -> Float[np.ndarray, " samples"]:
        return np.concatenate(self.problem.drive) + self.structure.offset(self.params)

    @property
    def _how(self) -> dict:
        """Return how the input acts: sampling interval, input map, hold, initial states, delay (`respond`)."""
        p, late, hold = self.problem, self.delay / self.problem.dt, self.structure.hold
        if p.fine < p.dt:  # block means are smooth; of a held input they are half a fine sample early
            late, hold = late + (hold == "zoh") * p.fine / p.dt / 2, "cubic"
        # without a spring nothing settles
        settled = np.array([b.begins != "rest" and not self.structure.integrates for b in p.beginnings])
        return {"step": p.dt, "square": p.square, "hold": hold, "settled": settled, "late": late, "heads": p.heads}

    @cached_property
    def free(self) -> tuple[list[Float[np.ndarray, "time columns"]], np.ndarray]:
        """Return every record's own columns, its free responses, and which of them oscillate.

        A record has none unless it starts moving.
        """
        moving = [len(drive) * (b.begins == "moving")
                  for drive, b in zip(self.problem.drive, self.problem.beginnings, strict=True)]  # fmt: skip
        columns, rings = coast(self.logs, max(moving), step=self.problem.dt)
        none = np.zeros((max(map(len, self.problem.drive)), 0))
        parts = [columns[:samples] if samples else none[: len(drive)]
                 for samples, drive in zip(moving, self.problem.drive, strict=True)]  # fmt: skip
        return parts, rings

    def _own_slopes(self, columns: np.ndarray, sizes: np.ndarray) -> Float[np.ndarray, "parameters time"]:
        """Return the derivatives of a free response (own columns and their sizes) by the parameters."""
        time, slopes = np.arange(len(columns)) * self.problem.dt, np.zeros((len(self.params), len(columns)))
        at, moves = 0, pole_slopes(self.logs)[:, : self.structure.moved]
        for pole, move in zip(self.poles, moves, strict=True):
            if pole.imag < 0:
                continue
            # a Re e^pt + b Im e^pt = Re((a - jb) e^pt), whose derivative by p is t times as large
            turn = np.array([1, 1j] if pole.imag else [1])
            mode, size = (v[..., at : at + len(turn)] for v in (columns, sizes))
            at += len(turn)
            slopes[: self.structure.moved] += np.real(move[:, None] * (size @ turn.conj() * time * (mode @ turn)))
        return slopes

    @cached_property
    def solved(self) -> Solved:
        """Return gain, sensor offsets and initial states, by linear least squares."""
        return self._solved(self.runs)

    def _solved(self, runs: Sequence[np.ndarray]) -> Solved:
        rows = [self._linear(k, run, output)
                for k, (run, output) in enumerate(zip(runs, self.problem.output, strict=True))]  # fmt: skip
        places, parts = [np.append(at, -1) for at in self.problem.numbers()], []  # the last one is y
        whole = np.zeros((2 + self.problem.free_zeros, 2 + self.problem.free_zeros))
        for row, at in zip(rows, places, strict=True):
            gram, n = row @ row.T, len(row) - len(at)
            # eliminate the record's own c = (N'N)^-1 N'(y - G g), so that only g is common (Schur complement)
            own = inverse(gram[:n, :n]) @ gram[:n, n:]
            whole[at[:, None], at] += gram[n:, n:] - gram[n:, :n] @ own
            parts.append(own)
        gains = inverse(whole[:-1, :-1]) @ whole[:-1, -1]
        sizes = [own @ np.append(-gains[at[:-1]], 1.0) for own, at in zip(parts, places, strict=True)]
        errors = [
            row[-1] - np.append(c, gains[at[:-1]]) @ row[:-1] for row, c, at in zip(rows, sizes, places, strict=True)
        ]
        return Solved(gains, tuple(sizes), tuple(errors))

    def _linear(self, k: int, run: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Return the weighted rows of record k: free responses, response, its fitted offset if any, and the others.

        They end with as many samples as it has free responses: the ridge, as measurements of 0.
        """
        p, own = self.problem, self.free[0][k]
        weight, n = p.weight[k], own.shape[1]
        rows = np.vstack([own.T, run, np.full((int(p.zeros[k] >= 0), len(weight)), p.beginnings[k].direction), others])
        rows *= weight
        return np.hstack([rows, np.eye(len(rows), n) * (_RIDGE * np.sqrt(weight.sum()))]) if n else rows

    def jacobians(self) -> tuple[Solved, list[Float[np.ndarray, "numbers rows"]]]:
        """Return the solution and each record's weighted derivatives by its `Problem.numbers`.

        A record's own columns are projected out; the ridge's derivatives come last.
        """
        runs, projected = self._runs_with_slopes(), []
        solved = self._solved([run[0] for run in runs])
        for k, (run, sizes) in enumerate(zip(runs, solved.own, strict=True)):
            slopes, n = solved.gains[0] * run[1:], len(sizes)  # d(g x) / dp at constant g: g's own slope is x itself
            if n:
                slopes = slopes + self._own_slopes(self.free[0][k], sizes)
            rows = self._linear(k, run[0], slopes)
            # P = I - N (N'N)^-1 N', where N holds the ridge's rows too
            projected.append(project(rows[n:].T, rows[:n].T)[1].T if n else rows)
        return solved, projected

    @property
    def cost(self) -> float:
        """Return the sum of squares of the residual; infinite if the response diverges."""
        with np.errstate(all="ignore"):
            cost = float(self.solved.rows @ self.solved.rows)
        return cost if np.isfinite(cost) else np.inf

    def normal_equations(self) -> Normal:
        """Return the sum of squares, half its gradient and J'J, as in Kaufman (1975)."""
        with np.errstate(all="ignore"):
            solved, slopes = self.jacobians()
            here, n = solved.rows, len(self.params)
            if not (np.isfinite(here).all() and all(np.isfinite(j).all() for j in slopes)):
                return Normal(np.inf, np.zeros(n), np.zeros((n, n)))
            linear, gram = 1 + self.problem.free_zeros, gram_of(slopes, self.problem.numbers(n))
            # Kaufman: only the part of the projector's derivative that remains when the residual is small
            factors = gram[linear:, :linear] @ inverse(gram[:linear, :linear])
            places = self.problem.numbers()
            moved = np.hstack([j[-n:] - factors[:, at] @ j[:-n] for j, at in zip(slopes, places, strict=True)])
            return Normal(float(here @ here), -moved @ here, moved @ moved.T)


def gram_of(rows: Sequence[np.ndarray], numbers: Sequence[np.ndarray]) -> np.ndarray:
    """Return J'J over all numbers from every record's derivatives by its own numbers."""
    size = 1 + max(map(max, numbers))
    gram = np.zeros((size, size))
    for row, at in zip(rows, numbers, strict=True):
        gram[at[:, None], at] += row @ row.T
    return gram


def inverse(gram: np.ndarray) -> np.ndarray:
    """Invert a matrix J'J safely; a direction hidden by rounding gets a large but finite variance."""
    if not len(gram) or not np.isfinite(gram).all():
        return np.full_like(gram, np.nan)
    diagonal = np.diag(gram)
    # Scaled to a unit diagonal first, so that the units of the parameters do not decide which direction is dropped.
    root = np.sqrt(np.maximum(diagonal, 1e-30 * max(diagonal.max(), 1e-300)))
    values, vectors = np.linalg.eigh(gram / np.outer(root, root))
    return (vectors / np.maximum(values, 1e-14)) @ vectors.T / np.outer(root, root)


class Fit(NamedTuple):
    """A fit of one structure: its parameters, mean square residual (output = 1), and whether it converged."""

    structure: Structure
    params: np.ndarray
    cost: float
    converged: bool


def least_squares(
    params: np.ndarray, structure: Structure, problem: Problem, most: int = 60, least: float = 1e-9
) -> Fit:
    """Fit the output error from initial parameters."""
    upper = problem.upper(structure)
    n = structure.moved
    params = np.append(bounded(params[:n], 0.0, 0.99 * FASTEST / problem.fine), params[n:])
    params, converged = minimise(
        lambda p: OutputError(p, structure, problem).normal_equations(), params, upper, most, least
    )
    # a pole below 0.01 rad a record cannot be told from an integrator, and would drift to zero
    params = np.append(bounded(params[:n], 0.01 / problem.seconds, np.inf), params[n:])
    return Fit(structure, params, OutputError(params, structure, problem).cost / problem.samples, converged)


def masked(problem: Problem, keep: Sequence[np.ndarray]) -> Problem:
    """Return the normalised records with only the samples marked in `keep` counted."""
    return replace(problem, weight=tuple(w * k for w, k in zip(problem.weight, keep, strict=True)))

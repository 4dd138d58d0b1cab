"""Fit hypotheses (sets of effects) to whole recordings by Levenberg-Marquardt in float64, in one batch.

    minimise  L = sum_r n_r log(MSE_r + eps_r),    MSE_r = mean over counted samples of (y - y_measured - C_r c_r)^2

Each record has its own variance, so no record dominates (log score). C_r holds the record's offset and, if it does not
start at rest, the linear plant's free responses; c_r is eliminated linearly, and the initial state follows. A step
solves (H + lambda diag H) d = -g with H = sum w_r J_r' J_r, w_r = 1 / (MSE_r + eps_r). Derivatives are finite
differences in float64: one run per parameter, no further program. A step whose run diverges is rejected.
"""

import cmath
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from ..fit.minimise import Descent, Normal
from ..numerics.coloured_noise import project
from .budget import Budget
from .data import Case
from .library import CORE, INDEX, LEAST, LOGARITHM, MOST

_EPS = 1e-5  # of a record's range: a smaller error is not evidence
_STEP = 1e-4  # change of a logarithm, or of a parameter relative to its size, for its slope
_LONGEST = 1.5  # largest change of a logarithm in one step, or of a parameter relative to its value and start
_FIRST = Descent(1e-2)  # stronger damping than near an optimum
_STILL = 1e-9  # of the largest diagonal of H: a parameter with hardly any slope is held still by the damping
_REFUSED = 8  # rejected steps until the damping is at its maximum
_SLOW = 2e-3  # relative decrease of the error below which two steps end a fit
PREVIEW = -1  # the fold of first steps: some records only
_SAMPLES_AT_ONCE = 2**23  # simulated samples in memory at once: 64 MiB


@dataclass
class Fit:
    """A hypothesis during its fit: its parameters and the state of the optimiser.

    Attributes:
        names: effects of the search, in the order added.
        free: slots that are fitted.
        slots: all of them, shape (slots,).
        unit: size of every free parameter at its start.
        starts: (x, v) at the first samples, shape (records, 2).
        fold: the fold left out of the fit; None: none.
        residuals: per record y - y_measured without its own offset and initial state, nan where samples do not count;
            None: not run.
        cost: L over the samples of the fit.
        expected: its decrease predicted by the last step.
        taken: steps that lowered it.
    """

    names: tuple[str, ...]
    free: tuple[str, ...]
    slots: np.ndarray
    starts: np.ndarray
    unit: np.ndarray = field(default_factory=lambda: np.zeros(0))
    fold: int | None = None
    residuals: list[Any] = field(default_factory=list)
    jacobian: list[np.ndarray] | None = None
    cost: float = np.inf
    descent: Descent = _FIRST
    expected: float = 0.0
    slow: int = 0
    taken: int = 0
    done: bool = False

    def __post_init__(self):
        """Set the units of the free parameters to their initial sizes, if no units are given."""
        if not len(self.unit):
            self.unit = np.maximum(np.abs(self.slots[self.places]), 1e-12)

    @property
    def places(self) -> list[int]:
        """Return the indices of the free parameters among the slots."""
        return [INDEX[k] for k in self.free]

    def again(self, **changes) -> "Fit":
        """Copy the fit with the optimiser reset, so that the copy can be continued."""
        fresh = {"slots": self.slots.copy(), "starts": self.starts.copy()}
        fresh |= {"descent": _FIRST, "slow": 0, "taken": 0, "done": False}
        return replace(self, **(fresh | changes))

    def anew(self, **changes) -> "Fit":
        """Copy the fit for other free parameters; its cost and derivatives are not yet computed."""
        return self.again(**({"unit": np.zeros(0), "jacobian": None, "cost": np.inf} | changes))

    def value(self, name: str) -> float:
        """Return the value of the parameter of this name."""
        return float(self.slots[INDEX[name]])


def coordinates(fit: Fit) -> np.ndarray:
    """Return the free parameters as the optimiser uses them: positive ones as logarithms."""
    values = fit.slots[fit.places]
    return np.where(LOGARITHM[fit.places], np.log(np.maximum(values, 1e-300)), values)


def _sizes(fit: Fit, share: float) -> np.ndarray:
    """Return the sizes of the optimiser coordinates: 1 for logarithms, otherwise at least a `share` of the start."""
    return np.where(LOGARITHM[fit.places], 1.0, np.maximum(np.abs(coordinates(fit)), share * fit.unit))


def at(fit: Fit, z: np.ndarray, bounds: Mapping[str, tuple[float, float]] = MappingProxyType({})) -> np.ndarray:
    """Return all parameters for other optimiser coordinates `z` (`coordinates`), each within its `bounds`."""
    slots, places = fit.slots.copy(), fit.places
    values = np.where(LOGARITHM[places], np.exp(np.clip(z, -70, 70)), z)
    slots[places] = np.clip(values, LEAST[places], MOST[places])
    for name in bounds.keys() & set(fit.free):
        slots[INDEX[name]] = np.clip(slots[INDEX[name]], *bounds[name])
    return slots


def basis(case: Case, slots: np.ndarray, record: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a record's offset and free responses, (T, columns), and the initial (x, v) of each, (columns, 2)."""
    size = len(case.series[record].output)
    if case.series[record].begins == "rest":
        return np.ones((size, 1)), np.zeros((1, 2))
    a0, a1, a2 = (float(slots[INDEX[k]]) for k in CORE)
    time = np.arange(size) * case.dt
    # the sensor's offset, then the plant's free responses
    columns, begins = [np.ones(size)], [(0.0, 0.0)]
    # order one: a single real pole
    poles: list[complex] = [complex(-a0 / a1)]
    if a2 > 0:
        root = cmath.sqrt(a1 * a1 - 4 * a0 * a2)
        poles = [(-a1 + root) / (2 * a2), (-a1 - root) / (2 * a2)]
    for pole in map(complex, poles if not poles[0].imag else poles[:1]):
        if abs(pole) * time[-1] < 1e-3 and a2 > 0:  # no spring: the offset represents x(0)
            continue
        size, angle = np.exp(np.clip(pole.real * time, -700, 50)), pole.imag * time
        columns.append(size * np.cos(angle))
        begins.append((1.0, pole.real))
        if pole.imag:
            columns.append(size * np.sin(angle))
            begins.append((0.0, pole.imag))
    return np.stack(columns, 1), np.array(begins)


class Fitter:
    """Fit hypotheses to the records of one case; its budget counts the simulated steps."""

    def __init__(self, case: Case, budget: Budget | None = None):
        self.case = case
        self.budget = budget or Budget()
        self.bounds: dict[str, tuple[float, float]] = {}  # of slots, by what these records show
        self._masks = {fold: case.masks(fold) for fold in (None, *range(len(case.folds)))} | {PREVIEW: case.screened()}
        self.floors = [(_EPS * s.span) ** 2 + 0.01 * s.noise**2 for s in case.series]

    def _simulate(self, groups: Sequence[list[tuple[np.ndarray, int, np.ndarray]]]) -> Iterator[list[np.ndarray]]:
        """Simulate groups of (parameters, record, initial state), few at a time, and yield each group of outputs."""
        first, drives = 0, self.case.simulator.drives
        while first < len(groups):
            last, samples = first, 0
            while last < len(groups) and (last == first or samples < _SAMPLES_AT_ONCE):
                samples += sum(len(drives[k].voltage) for _, k, _ in groups[last])
                last += 1
            jobs = [job for group in groups[first:last] for job in group]
            self.budget.count(samples * self.case.simulator.substeps)
            runs: list[np.ndarray] = []
            if jobs:
                slots, records, starts = zip(*jobs, strict=True)
                runs = self.case.simulator.run(np.stack(slots), list(records), np.stack(starts))
            for group in groups[first:last]:
                yield runs[: len(group)]
                runs = runs[len(group) :]
            first = last

    def _seen(self, fold: int | None) -> list[int]:
        return [k for k, m in enumerate(self._masks[fold]) if m.any()]

    def _residual(self, slots, starts, record: int, run):
        """Return the residual without offset and free responses, and the corrected initial state (x, v).

        A record's offset and initial state are fitted to the whole record, whichever samples a fit may use. Without the
        block at its beginning, a slow plant's decay was extrapolated backwards to twice the range.
        """
        s = self.case.series[record]
        if not np.isfinite(run).all():
            return None, starts[record]
        columns, begins = basis(self.case, slots, record)
        c, residual = project(run - np.nan_to_num(s.output), columns, s.counts)
        return np.where(s.counts, residual, np.nan), starts[record] - begins.T @ c

    def evaluate(self, fits: Sequence[Fit], slots: Sequence[np.ndarray], everything: bool = False):
        """Return (cost, residuals, initial states) of every fit at other parameters; `everything`: on all records."""
        places = [range(len(self.case.series)) if everything else self._seen(f.fold) for f in fits]
        jobs = [[(p, k, f.starts[k]) for k in some] for f, p, some in zip(fits, slots, places, strict=True)]
        results = []
        for fit, p, some, runs in zip(fits, slots, places, self._simulate(jobs), strict=True):
            residuals: list = [None] * len(self.case.series)
            starts = fit.starts.copy()
            for k, run in zip(some, runs, strict=True):
                residuals[k], starts[k] = self._residual(p, fit.starts, k, run)
            results.append((self._cost(residuals, fit.fold), residuals, starts))
        return results

    def _cost(self, residuals, fold) -> float:
        total = 0.0
        for k in self._seen(fold):
            if residuals[k] is None:
                return np.inf
            seen = self._masks[fold][k] > 0
            # a record's own variance, so that one with large motion does not decide alone
            total += seen.sum() * np.log(np.mean(residuals[k][seen] ** 2) + self.floors[k])
        return float(total)

    def differentiate(self, fits: Sequence[Fit]):
        """Compute the derivatives of the residuals with respect to the free parameters, record by record."""
        jobs, owners = [], []
        for fit in fits:
            z = coordinates(fit)
            # relative to a parameter and its start, so that one near zero still gets a visible step
            step = _STEP * _sizes(fit, 0.1)
            moved = [at(fit, z + move, self.bounds) for move in np.diag(step)]
            for n, k in enumerate(fit.free):
                if moved[n][INDEX[k]] == fit.slots[INDEX[k]]:  # at its upper bound: downwards
                    step[n] = -step[n]
                    moved[n] = at(fit, z + np.eye(len(z))[n] * step[n], self.bounds)
            fit.jacobian = [np.zeros((0, 0))] * len(self.case.series)
            for k in self._seen(fit.fold):
                # the unmoved run in the same block, because rounding of another program would not cancel
                jobs.append([(p, k, fit.starts[k]) for p in (*moved, fit.slots)])
                owners.append((fit, k, step))
        for (fit, k, step), runs in zip(owners, self._simulate(jobs), strict=True):
            block = np.stack(runs, 1)
            slopes = np.nan_to_num((block[:, :-1] - block[:, -1:]) / step, posinf=0.0, neginf=0.0)
            fit.jacobian[k] = project(slopes, basis(self.case, fit.slots, k)[0], self.case.series[k].counts)[1]

    def normal(self, fit: Fit) -> tuple[np.ndarray, np.ndarray]:
        """Return the normal matrix H and the gradient g of one optimiser step."""
        h, g = np.zeros((len(fit.free),) * 2), np.zeros(len(fit.free))
        assert fit.jacobian is not None
        for k in self._seen(fit.fold):
            seen = self._masks[fit.fold][k] > 0
            j, r = fit.jacobian[k][seen], fit.residuals[k][seen]
            # the derivative of n log MSE with respect to MSE
            weight = 1 / (np.mean(r**2) + self.floors[k])
            h, g = h + weight * j.T @ j, g + weight * j.T @ r
        return h, g

    def fit(self, fits: Sequence[Fit], iterations: int) -> list[Fit]:
        """Advance every fit by several optimiser steps; converged fits do not change.

        Rejected steps do not count as iterations: a fold's fit without an accepted step would still use its test
        samples.
        """
        fresh = [f for f in fits if not np.isfinite(f.cost)]
        for _ in range(2):  # the second time with the initial states found by the first
            for f, (cost, residuals, starts) in zip(fresh, self.evaluate(fresh, [f.slots for f in fresh]), strict=True):
                if cost < f.cost:
                    f.cost, f.residuals, f.starts = cost, residuals, starts
            fresh = [f for f in fresh if np.isfinite(f.cost) and any(s.begins != "rest" for s in self.case.series)]
        for f in fits:
            f.done = f.done or not np.isfinite(f.cost) or not f.free
        for _ in range(iterations + _REFUSED):
            active = [f for f in fits if not f.done and f.taken < iterations]
            if not active or self.budget.spent:
                break
            self.differentiate([f for f in active if f.jacobian is None])
            trials = [at(f, coordinates(f) + self._move(f), self.bounds) for f in active]
            for f, p, found in zip(active, trials, self.evaluate(active, trials), strict=True):
                self._judge(f, p, *found)
        return list(fits)

    def foreseen(self, fits: Sequence[Fit], fronts: Sequence[Fit]) -> list[float]:
        """Predict the cost of each fit after one Gauss-Newton step, with the derivatives of the fits in `fronts`.

        A start costs one run plus one for each new parameter; separate steps cost five times as much.
        """
        self.differentiate([f for f in {id(f): f for f in fronts}.values() if f.jacobian is None and f.free])
        probes = []
        for fit, front in zip(fits, fronts, strict=True):
            free = tuple(k for k in fit.free if k not in front.free)
            probes.append(fit.anew(free=free, fold=PREVIEW, residuals=[]))
        self.fit(probes, 0)
        there = [p for p in probes if np.isfinite(p.cost)]
        self.differentiate(there)
        return [self._stepped(p, f) if np.isfinite(p.cost) else np.inf for p, f in zip(probes, fronts, strict=True)]

    def _stepped(self, probe: Fit, front: Fit) -> float:
        assert probe.jacobian is not None
        seen, both = self._seen(PREVIEW), list(probe.jacobian)
        if front.free and front.jacobian is not None:
            for k in seen:
                both[k] = np.concatenate([front.jacobian[k], both[k]], 1)
        whole = replace(probe, free=(*front.free, *probe.free), unit=np.zeros(0), jacobian=both)
        move = self._move(whole)
        after = list(whole.residuals)
        for k in seen:
            after[k] = np.where(np.isfinite(after[k]), after[k] + both[k] @ move, np.nan)
        return min(probe.cost, self._cost(after, PREVIEW))

    def _move(self, fit: Fit) -> np.ndarray:
        """Return the optimiser step of the free parameters within their bounds; note the decrease of L it predicts."""
        h, g = self.normal(fit)
        z, most = coordinates(fit), _LONGEST * _sizes(fit, 1.0)
        low, high = (coordinates(replace(fit, slots=at(fit, z + end, self.bounds))) - z for end in (-most, most))
        move, fit.expected = fit.descent.step(Normal(fit.cost, g, h), low, high, _STILL)
        return move

    def _judge(self, fit: Fit, slots, cost, residuals, starts):
        gain, counted = fit.cost - cost, sum(np.count_nonzero(m) for m in self._masks[fit.fold])
        accepted, fit.descent = fit.descent.after(gain, fit.expected)
        if accepted:
            fit.slow, fit.taken = fit.slow + 1 if gain < _SLOW * counted else 0, fit.taken + 1
            fit.slots, fit.cost, fit.residuals, fit.starts, fit.jacobian = slots, cost, residuals, starts, None
        # or its steps are too short to lower the cost
        fit.done = fit.slow >= 2 or fit.descent.damping > 1e4

    def refitted_without(self, fits: Sequence[Fit], iterations: int) -> tuple[list[list[np.ndarray]], list[np.ndarray]]:
        """Refit every fit without each fold (cross-validation), starting from the fit to all records.

        Returns:
            out-of-fold residuals of every fit, by record; its slots without each fold, shape (folds, slots).
        """
        self.differentiate([f for f in fits if f.jacobian is None and f.free])
        tasks = []
        for f in fits:
            for fold in range(len(self.case.folds)):
                one = f.again(fold=fold, descent=Descent())
                # near its own optimum already: steps until they gain nothing
                one.cost = self._cost(one.residuals, fold)
                tasks.append(one)
        self.fit(tasks, iterations)
        done = self.evaluate(tasks, [t.slots for t in tasks], everything=True)
        per_fit, place = [], 0
        for _ in fits:
            rows = [np.full(len(s.output), np.nan) for s in self.case.series]
            for fold in range(len(self.case.folds)):
                _, residuals, _ = done[place]
                place += 1
                for k, tested in enumerate(self.case.tested(fold)):
                    if tested.any():
                        far = 10 * self.case.series[k].span  # a diverged run is not a model there
                        rows[k][tested] = far if residuals[k] is None else np.clip(residuals[k][tested], -far, far)
            per_fit.append(rows)
        slots = np.array([t.slots for t in tasks]).reshape(len(fits), len(self.case.folds), -1)
        return per_fit, list(slots)

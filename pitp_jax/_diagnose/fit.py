"""Fit: candidates on whole rollouts by Levenberg-Marquardt, all of them side by side.

    minimise  sum over fitted records of  mean_t (100 (y(t; p) - y_measured(t)) / range)^2

Positive numbers are fitted by their logarithm, within their bounds. In a refit the nominal's coefficients come along
(by theirs), and the sensor's zero, which an identification without the effect has read wrong: 4 um of it moved a
voltage offset by 17 of its standard errors. Slopes are forward differences: limits, plays and friction have them almost
everywhere, and a difference of 0.3 % stands far above the rounding of a float32 rollout. A run that diverges is a
rejected step.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .._effects.spec import EffectSpec, Parameter, Start
from .batched_rollouts import Lane, Lanes
from .budget import Budget

_STEP = 3e-3
_ZERO = 0.2  # farthest that a sensor's zero may be off, scaled
_MOST, _ENOUGH = 16, 2e-3  # iterations, and the relative decrease below which two of them end the fit
_PROMISE = 2e-4  # and the one promised by the linearised model below which none is made
_PATIENCE, _BEHIND = 3, 2.0  # from that step on given up: what at its pace ends above so many times the least cost


@dataclass(frozen=True)
class Candidate:
    """A set of forms with their numbers.

    Attributes:
        forms: the effects.
        values: their parameters, form by form.
        starts: their bounds.
        factors: on the nominal's coefficients, shape (n + 1,).
        refit: whether those are fitted too, and the zero.
        train: mean squared error on fitted records, (1 %)^2.
        covariance: of the fitted coordinates (logarithms where positive): effects, factors, zero; block sandwich.
        zero: reading of the resting sensor beside the nominal's, scaled.
    """

    forms: tuple[EffectSpec, ...]
    values: tuple[tuple[float, ...], ...]
    starts: tuple[Start, ...]
    factors: np.ndarray
    refit: bool
    train: float = np.inf
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    zero: float = 0.0

    @property
    def parameters(self) -> list[Parameter]:
        """All parameters in a row."""
        return [p for f in self.forms for p in f.parameters]

    @property
    def names(self) -> tuple[str, ...]:
        """Effects it adds; a refit without any is a parameter change."""
        return tuple(f.name for f in self.forms) or (("parameter_change",) if self.refit else ())

    @property
    def size(self) -> int:
        """Numbers that are fitted."""
        return len(_free(self)) + (len(self.factors) + 1 if self.refit else 0)


def _free(c: Candidate) -> list[int]:
    low = [v for s in c.starts for v in s.low]
    high = [v for s in c.starts for v in s.high]
    return [k for k, (a, b) in enumerate(zip(low, high, strict=True)) if b > a]


def _logarithms(c: Candidate) -> np.ndarray:
    """Which coordinates are logarithms."""
    nominal = [True] * len(c.factors) + [False] if c.refit else []
    return np.array([c.parameters[k].positive for k in _free(c)] + nominal, bool)


def _coordinates(c: Candidate) -> np.ndarray:
    flat = np.array([v for values in c.values for v in values])
    z = [np.log(max(flat[k], 1e-30)) if c.parameters[k].positive else flat[k] for k in _free(c)]
    return np.concatenate([z, np.log(c.factors), [c.zero]]) if c.refit else np.array(z)


def _bounds(c: Candidate) -> tuple[np.ndarray, np.ndarray]:
    ends = []
    for side, bounds in enumerate(([v for s in c.starts for v in s.low], [v for s in c.starts for v in s.high])):
        z = [np.log(bounds[k]) if c.parameters[k].positive else bounds[k] for k in _free(c)]
        nominal = np.append(np.full(len(c.factors), 1.5), _ZERO) * (-1, 1)[side]
        ends.append(np.concatenate([z, nominal]) if c.refit else np.array(z))
    return ends[0], ends[1]


def _at(c: Candidate, z: np.ndarray) -> Candidate:
    flat = np.array([v for values in c.values for v in values], float)
    free = _free(c)
    for i, k in enumerate(free):
        flat[k] = np.exp(z[i]) if c.parameters[k].positive else z[i]
    values, first = [], 0
    for f in c.forms:
        values.append(tuple(flat[first : first + len(f.parameters)]))
        first += len(f.parameters)
    if not c.refit:
        return replace(c, values=tuple(values))
    return replace(c, values=tuple(values), factors=np.exp(z[len(free) : -1]), zero=float(z[-1]))


def lane_of(c: Candidate, series: int) -> Lane:
    """The lane of a candidate on a record."""
    return Lane(c.forms, c.values, c.factors, series)


def residuals(lanes: Lanes, candidates: Sequence[Candidate], series: Sequence[int]) -> list[list[np.ndarray]]:
    """Per candidate and record y - y_measured in % of range, zero where the output does not count."""
    jobs = [lane_of(c, k) for c in candidates for k in series]
    runs, found = lanes.run(jobs), []
    for i in range(len(candidates)):
        row = []
        for j, k in enumerate(series):
            s = lanes.case.series[k]
            y = runs[i * len(series) + j].astype(np.float64)
            row.append((y + candidates[i].zero - (s.run - s.error)) * (s.weight > 0) * 100 / s.span)
        found.append(row)
    return found


def stacked(lanes: Lanes, rows: list[np.ndarray], series: Sequence[int]) -> np.ndarray:
    """One vector whose square is the pooled mean squared error."""
    parts = []
    for r, k in zip(rows, series, strict=True):
        s = lanes.case.series[k]
        parts.append(r * np.sqrt(s.weight) * s.span / 100 / np.sqrt(len(series)))
    return np.concatenate(parts)


def mean_square(lanes: Lanes, rows: list[np.ndarray], series: Sequence[int]) -> float:
    """Mean over records of e_rms_percent^2; infinite where a run diverged."""
    value = float(np.sum(stacked(lanes, rows, series) ** 2))
    return value if np.isfinite(value) else np.inf


def fit(
    lanes: Lanes,
    candidates: Sequence[Candidate],
    *,
    most: int = _MOST,
    beat: float = np.inf,
    budget: Budget | None = None,
    progress: Callable[[int, float], None] = lambda step, best: None,
) -> list[Candidate]:
    """Every candidate at its least squares on the fitted records; `beat` is the cost of one fitted before."""
    budget, longest = budget or Budget(), 0.0
    series = [k for k, s in enumerate(lanes.case.series) if s.fitted]
    level = stacked(lanes, [(s.weight > 0) * 100 / s.span for s in lanes.case.fitted], series)  # slope of the zero
    states = [_State(_clip(c)) for c in candidates]
    for state, rows in zip(states, residuals(lanes, [s.candidate for s in states], series), strict=True):
        state.residual = stacked(lanes, rows, series)
        state.cost = mean_square(lanes, rows, series)
        state.done = state.done or not np.isfinite(state.cost)
    for iteration in range(most):
        active, before = [s for s in states if not s.done], budget.left
        if not active or not budget.allows("the last steps of a fit", 2 * longest):  # one more, and judging
            break
        moved = [(s, k) for s in active for k in range(s.candidate.size - s.candidate.refit)]
        nearby = [nudged(s.candidate, k) for s, k in moved]
        slopes = residuals(lanes, [c for c, _ in nearby], series)
        for s in active:
            columns = [
                (stacked(lanes, rows, series) - s.residual) / step
                for (owner, _), (_, step), rows in zip(moved, nearby, slopes, strict=True)
                if owner is s
            ]
            columns += [level] if s.candidate.refit else []
            s.jacobian = np.nan_to_num(np.stack(columns, 1), posinf=0.0, neginf=0.0)
        tries = [s.proposal() for s in active]
        for s, tried, rows in zip(active, tries, residuals(lanes, tries, series), strict=True):
            s.judge(tried, stacked(lanes, rows, series), mean_square(lanes, rows, series))
        best = min(s.cost for s in states)
        for s in active:
            late = s.after(most - 1 - iteration) > _BEHIND * min(best, beat)
            s.done = s.done or (iteration >= _PATIENCE and late)
        progress(iteration + 1, best)
        longest = max(longest, before - budget.left) if np.isfinite(before) else 0.0
    return [s.finished() for s in states]


def _clip(c: Candidate) -> Candidate:
    low, high = _bounds(c)
    return _at(c, np.clip(_coordinates(c), low, high))


def nudged(c: Candidate, k: int) -> tuple[Candidate, float]:
    """The candidate with one coordinate moved, towards the inside of its bounds."""
    z = _coordinates(c)
    low, high = _bounds(c)
    linear = not _logarithms(c)[k]
    step = max(2e-2 * abs(z[k]), 1e-4 * (high[k] - low[k])) if linear else _STEP
    step = -step if z[k] + step > high[k] else step
    z[k] += step
    return _at(c, z), step


class _State:
    """One candidate on its way down."""

    def __init__(self, candidate: Candidate):
        self.candidate, self.damping, self.slow = candidate, 1e-2, 0
        self.done, self.cost, self.gains = candidate.size == 0, np.inf, (1.0, 1.0)
        self.residual, self.jacobian = np.zeros(0), np.zeros((0, candidate.size))

    def proposal(self) -> Candidate:
        """The damped Gauss-Newton step, inside the bounds."""
        z, (low, high) = _coordinates(self.candidate), _bounds(self.candidate)
        h, g = self.jacobian.T @ self.jacobian, self.jacobian.T @ self.residual
        free = ~(((z <= low) & (g > 0)) | ((z >= high) & (g < 0)))
        if not free.any():
            self.done = True
            return self.candidate
        h, g = h[np.ix_(free, free)], g[free]
        d = np.sqrt(np.diag(h) + 1e-12 * max(np.diag(h).max(), 1e-30))
        move = np.zeros(len(z))
        move[free] = -np.linalg.lstsq(h / np.outer(d, d) + self.damping * np.eye(len(g)), g / d, rcond=None)[0] / d
        promised = -(2 * g + h @ move[free]) @ move[free] / max(self.cost, 1e-300)
        if promised < _PROMISE:
            self.done = True
            return self.candidate
        most = np.where(_logarithms(self.candidate), 1.0, (high - low) / 4)  # once 1 V at a time, for a voltage offset
        return _at(self.candidate, np.clip(z + np.clip(move, -most, most), low, high))

    def judge(self, tried: Candidate, residual: np.ndarray, cost: float):
        """Accept what lowers the error."""
        gain = max(1 - cost / max(self.cost, 1e-300), 0.0)
        self.gains = (self.gains[1], gain)
        if cost < self.cost:
            self.slow = self.slow + 1 if gain < _ENOUGH else 0
            self.candidate, self.residual, self.cost, self.damping = tried, residual, cost, self.damping / 10
        else:
            self.damping *= 10
        self.done = self.done or self.slow >= 2 or self.damping > 1e3

    def after(self, steps: int) -> float:
        """The cost after further steps at the better of the last two's pace."""
        return self.cost * (1 - max(self.gains)) ** steps

    def finished(self) -> Candidate:
        """The candidate with its error and the covariance of its coordinates."""
        if not self.jacobian.size:
            return replace(self.candidate, train=self.cost)
        h = self.jacobian.T @ self.jacobian
        inverse = np.linalg.pinv(h, rcond=1e-12)
        scores = [b.T @ r for b, r in zip(_blocks(self.jacobian), _blocks(self.residual), strict=True)]
        meat = np.einsum("bi,bj->ij", np.stack(scores), np.stack(scores))
        return replace(self.candidate, train=self.cost, covariance=inverse @ meat @ inverse)


def _blocks(rows: np.ndarray) -> list[np.ndarray]:
    """A hundred stretches of time: what is left is correlated within them, not across."""
    return np.array_split(rows, 100)

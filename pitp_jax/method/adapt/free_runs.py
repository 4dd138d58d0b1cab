"""Fit simulations of a model to recordings, for many sets of its changed parameters at once.

    e = 100 (d (y - offset) - x(t; z)) / range  at the samples that count,   J = de/dz by forward differences

One call of `free_runs` holds every record under z and under z with each parameter changed a little. A record that
starts settled starts from the equilibrium of its own factors; one that starts in motion has its initial state among the
parameters.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ...common.errors import BadInput
from ..fit.factors import Factors, moved
from ..fit.minimise import Normal, minimise
from ..model.model import Model
from ..model.programs import double_on_cpu, in_double, jit
from ..numerics.coloured_noise import project
from ..signal.initial_state import Beginning, aligned, noise_of
from ..signal.record import Record
from ..simulate.beginnings import settled_states
from ..simulate.model_runs import Models, model_runs, padded
from ..simulate.prediction import FAR

_STEP = 1e-5  # of forward differences in float64
_MOST_STEPS, _ENOUGH = 10, 1e-3  # of a fit, and the relative decrease below which it ends
_RESONANCES = np.linspace(-0.4, 0.4, 17)  # logarithms of the inertias at which a fit may start
_BLOCKS = 8  # of a recording: every other one is held out
_LOOSE = 0.3  # prior of a first state's shift, in scales of the state
_INDEPENDENT = 100.0  # values a recording counts as, relative to the priors
_ZERO = 0.2  # prior of an offset that the first samples do not show, in ranges


class Session(NamedTuple):
    """Recordings prepared for the fit, padded to one length.

    Attributes:
        voltage: V, shape (records, T).
        target: scaled displacement, offset and direction removed; 0 where it does not count.
        weight: 100 / (scaled range) where a sample counts, otherwise 0.
        half: 1 in every other eighth of every record, so both halves contain all speeds and amplitudes.
        start: scaled initial states.
        begins: how each record starts.
        loose: standard deviation of each offset, in % of range.
        noise: white sensor noise of each, in % of range.
        dt: s.
    """

    voltage: np.ndarray
    target: np.ndarray
    weight: np.ndarray
    half: np.ndarray
    start: np.ndarray
    begins: tuple[str, ...]
    loose: np.ndarray
    noise: np.ndarray
    dt: float


def session(
    model: Model, records: Sequence[Record], starts, spent: Sequence[int], begun: Sequence[Beginning]
) -> Session:
    """Prepare recordings for the fit, with their initial states as `begin` returns them."""
    voltage, noise = padded([r.voltage for r in records]), noise_of(records)
    target, weight, half = (np.zeros(voltage.shape) for _ in range(3))
    loose = np.zeros(len(records))
    for k, (r, b) in enumerate(zip(records, begun, strict=True)):
        x = model.output.to_model(aligned(r, b, model.output).displacement) / model.scales.state[0]
        seen = np.isfinite(x)
        seen[: spent[k]] = False
        span = np.ptp(x[np.isfinite(x)])
        target[k, : r.samples], weight[k, : r.samples] = np.where(seen, x, 0.0), 100 / span * seen
        half[k, : r.samples] = np.arange(r.samples) * _BLOCKS // r.samples % 2 == 0
        units = 100 / (span * float(model.scales.state[0]))
        loose[k] = min(b.stderr * units, 100 * _ZERO) if b.begins == "rest" else 100 * _ZERO
        noise[k] *= units
    begins = tuple(b.begins for b in begun)
    return Session(voltage, target, weight, half, np.asarray(starts), begins, loose, noise, records[0].dt)


_moved = jit(moved)  # in every fit many times


class Fit(NamedTuple):
    """The result of a least-squares fit.

    Attributes:
        z: the fitted parameters.
        residual: e in % of range, shape (records, T), zero where it does not count.
        jacobian: derivatives by the parameters, with the nuisance parameters projected out, shape (records T, numbers).
    """

    z: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray


class Problem:
    """A least-squares fit of simulations to recordings, over some of a model's changed parameters."""

    def __init__(self, model: Model, factors: Factors, seen: Session, level: float):
        self.model, self.factors, self.seen, self.level = model, factors, seen, level
        self.moving = [k for k, b in enumerate(seen.begins) if b == "moving"]
        self.shifts = len(self.moving) * seen.start.shape[1]

    def readings(self, z: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """Simulate rows of (parameters z, shift of initial states); return scaled readings, (rows, records, T)."""
        s, records, rows = self.seen, len(self.seen.voltage), len(z)
        with double_on_cpu():
            model = in_double(self.model)
            models = Models.of([_moved(model, self.factors, jnp.asarray(one), s.dt) for one in z])
        many, start = models.of_runs(np.repeat(np.arange(rows), records)), np.tile(s.start, (rows, 1, 1))
        if self.moving:
            start[:, self.moving] += shift.reshape(rows, len(self.moving), -1)
        start, voltage = start.reshape(rows * records, -1), np.tile(s.voltage, (rows, 1))
        held = np.flatnonzero(np.tile([b == "held" for b in s.begins], rows))
        if len(held):
            # a softer actuator is held further out: from the old equilibrium its run would start with a transient
            settled = settled_states(many.of_runs(held), voltage[held, 0], s.dt, np.zeros(len(held)))
            start[held] = np.where(np.isfinite(settled), settled, start[held])
        return model_runs(many, voltage, s.dt, start)[1].reshape(rows, records, -1)

    def at(self, z: np.ndarray, weight: np.ndarray) -> Fit:
        """Fit only offsets and initial states, with the parameters z fixed."""
        return self.fit(np.zeros((len(z), 0)), weight, np.zeros(0), fixed=z)

    def guess(self) -> np.ndarray:
        """Return the initial guess of the fit: the best of several inertias, each with its best gain.

        A resonance shifted by more than its width reverses the phase, and the cost has no descending path past that.
        """
        s, names = self.seen, self.factors.names
        axis, gain = self.factors.direction(names[min(2, self.factors.tokens - 1)]), self.factors.direction("gain")
        z, want = _RESONANCES[:, None] * axis, s.weight * s.target
        # a diverged run gets a large error, so that it is never chosen
        y = np.nan_to_num(self.readings(z, np.zeros((len(z), self.shifts))), nan=FAR)
        runs = s.weight * np.clip(y, -FAR, FAR)
        # not below a half, because a run with a wrong resonance fits best with almost no gain
        ratios = np.clip((runs * want).sum((1, 2)) / np.maximum((runs**2).sum((1, 2)), 1e-300), 0.5, 2.0)
        best = int(np.argmin(((ratios[:, None, None] * runs - want) ** 2).sum((1, 2))))
        return z[best] + np.log(ratios[best]) * gain

    def fit(
        self, free: np.ndarray, weight: np.ndarray, prior: np.ndarray, *,
        first: np.ndarray | float = 0.0, fixed: np.ndarray | float = 0.0,
    ) -> Fit:  # fmt: skip
        """Fit the parameters z = fixed + free q by least squares, together with offsets and initial states.

        Args:
            free: directions that may change, shape (numbers, q).
            weight: of the samples, shape (records, T): 0 or 1.
            prior: standard deviations of q.
            first: q to start from.
            fixed: where q is 0.
        """
        s, count, records, shifts = self.seen, free.shape[1], len(self.seen.voltage), self.shifts
        scale, target = (s.weight * weight).reshape(-1), s.target.reshape(-1)
        # residuals are far from independent: a recording counts as 100 values of the model's own level
        unit = np.sqrt(_INDEPENDENT / max((scale > 0).sum(), 1)) / self.level
        spread = np.concatenate([prior, np.full(shifts, _LOOSE), np.maximum(s.loose, 1e-6)])
        owner = np.repeat(np.arange(records), s.voltage.shape[1])
        zeros = ((owner[:, None] == np.arange(records)) & (scale > 0)[:, None]).astype(float)
        times = np.array([free[self.factors.tokens :, k].any() for k in range(count)], bool)
        low, tried = self.factors.lowest(), []

        def normal(p) -> Normal:
            base, shift = np.maximum(fixed + free @ p[:count], low), p[count : count + shifts]
            nudges = np.eye(count + shifts) * _STEP
            z = np.concatenate([base[None], base + nudges[:, :count] @ free.T])
            y = self.readings(z, np.concatenate([shift[None], shift + nudges[:, count:]])).reshape(len(z), -1)
            if not np.isfinite(y).all() or np.abs(y).max() > FAR:
                return Normal(np.inf, np.zeros(len(p)), np.eye(len(p)))
            e = scale * (y[0] - target) + zeros @ p[count + shifts :]
            jacobian = np.concatenate([(scale * (y[1:] - y[0])).T / _STEP, zeros], 1)  # an offset adds itself, exactly
            cost = unit**2 * e @ e + np.sum((p / spread) ** 2)
            tried.append((cost, base, e, jacobian))
            gradient = unit**2 * jacobian.T @ e + p / spread**2
            return Normal(cost, gradient, unit**2 * jacobian.T @ jacobian + np.diag(spread**-2.0))

        start = np.concatenate([np.zeros(count) + first, np.zeros(shifts + records)])
        upper = np.full(len(start), np.inf)
        upper[:count][~times] = np.log(10.0)  # also marks the logarithms, whose steps `minimise` keeps short
        minimise(normal, start, upper, _MOST_STEPS, _ENOUGH)
        if not tried:
            raise BadInput("the model diverges on this recording; check units and columns with `pitp predict`")
        _, z, e, jacobian = min(tried, key=lambda t: t[0])
        # a part that offsets and first states could explain carries no information on the parameters
        return Fit(z, e.reshape(records, -1), project(jacobian[:, :count], jacobian[:, count:])[1])

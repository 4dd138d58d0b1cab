"""Simulate the output for many parameter vectors: catalogue effects around an exact linear core.

    a_0 x + a_1 x' + a_2 x'' = F c(x) - f(x, x', z),   F = map(V) / force scale,   y = sensor(x)

The linear part is exact for a force that runs linearly over a step, (x, v)+ = E (x, v) + b F_0 + d (F_1 - F_0), for any
order up to two, damped or not, with a spring or without (a_0 = 0). Smooth forces act at the middle of the step,
linearly implicit along their own tangent: f = f(x_m, v_m) / (1 + f' b_x / 2 + f'_v b_x / h). Friction and slack act
last, on the motion after all other forces. An integrator with numerical damping (0.04 at 20 samples a period) changed 5
of 18 outcomes.

The step is written for one parameter vector and one record; `simulate.free_runs` compiles it and runs it for all.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..effects.effect import Effect, Instant
from ..model.model import Model
from ..simulate.free_runs import free_runs
from .library import AHEAD, DELAY, EARLY, INDEX, MONITOR, PLACES, ROWS
from .trained_runs import trained_runs

FAR = 1e4  # scaled displacement from which a run has diverged


@dataclass(frozen=True)
class Film:
    """The drive term (V^2 or V) of a record before thinning, to average it around any time.

    Attributes:
        impulse: its integral up to every sample, V^2 s or V s, shape (samples,).
        dt, first: s, between samples; of the first one after the first thinned one.
        window: s, over which it is averaged.
        edges: the force before and after the record.
    """

    impulse: np.ndarray
    dt: float
    first: float
    window: float
    edges: tuple[float, float]

    def force(self, time: np.ndarray) -> np.ndarray:
        """Return the drive term (V^2 or V) averaged around times (s after the first thinned sample), shape (T,)."""
        low, high = (self._until(time + half) for half in (-self.window / 2, self.window / 2))
        return (high - low) / self.window

    def _until(self, time: np.ndarray) -> np.ndarray:
        place, last = (time - self.first) / self.dt, len(self.impulse) - 1
        inside = np.interp(place, np.arange(last + 1), self.impulse)
        early, late = np.minimum(place, 0.0), np.maximum(place - last, 0.0)
        return inside + self.dt * (self.edges[0] * early + self.edges[1] * late)


@dataclass(frozen=True)
class Drive:
    """Simulation input of one record: voltage at every sample (V), sampling interval (s), and initial state.

    Attributes:
        voltage: shape (T,).
        dt: s.
        start: scaled (x, v) at the first sample, from the data.
        age: of the session, s.
        before: V before the first sample; None: the same as at the first sample.
        jump: s, when the voltage changes from there to its first sample: 0, or half a sample earlier if it is held.
        film: the input before thinning; None: it was not thinned.
        reached: largest scaled |x| of the session before this record.
    """

    voltage: np.ndarray
    dt: float
    start: tuple[float, float]
    age: float = 0.0
    before: float | None = None
    jump: float = 0.0
    film: Film | None = None
    reached: float = 0.0


@dataclass(frozen=True)
class Simulator:
    """A simulator of many parameter vectors, each with the input of one record.

    Attributes:
        drives: one per record.
        square: whether F = V^2 (else V).
        force_scale: of F.
        rates: 1/s, of the scales of x' and x, and of x'' and x'.
        substeps: steps a sample.
        others: the nominal's parts that no slot holds, such as an encoder; None: its core is linear.
        nominal: slots of the nominal, shape (slots,).
    """

    drives: tuple[Drive, ...]
    square: bool
    force_scale: float
    rates: tuple[float, float]
    substeps: int
    others: Model | None = None
    nominal: np.ndarray | None = None

    def run(self, slots: np.ndarray, records: Sequence[int], starts: np.ndarray) -> list[np.ndarray]:
        """Simulate parameter vectors, each with a record from (x, v); return scaled outputs (T,), nan if diverged."""
        places = np.asarray(records, int)
        steps = np.array([len(d.voltage) for d in self.drives])[places] * self.substeps
        outputs: list = [None] * len(places)
        for count in np.unique(steps):
            some = np.flatnonzero(steps == count)
            rows = self._equally_long(slots[some], places[some], starts[some], int(count))
            for k, row in zip(some, rows, strict=True):
                outputs[k] = row
        return outputs

    def _equally_long(self, slots, records, starts, steps: int) -> np.ndarray:
        """Simulate runs of one number of steps; return their scaled outputs, shape (runs, samples)."""
        drives = [self.drives[r] for r in records]
        finer = 1 if self.others is None else 2  # a model's step reads its input in the middle as well
        inputs, column = replace(self, substeps=finer * self.substeps)._inputs(slots, records, finer * steps)
        first, h = inputs[column, 0], np.array([d.dt for d in drives]) / self.substeps
        before = [u if d.before is None else d.before for u, d in zip(first, drives, strict=True)]
        session = [(d.age, d.reached) for d in drives]
        begins = np.column_stack([starts, before, session])
        if self.others is not None:
            runs = trained_runs(self.others, self.nominal, slots, begins, inputs, column, float(h[0]))
            runs = runs[:, :: self.substeps]
            return np.where(np.abs(runs) < FAR, runs, np.nan)
        common = np.tile([1 / self.force_scale, *self.rates], (len(records), 1))
        parameters = np.concatenate([common, np.stack(_plant(slots[:, :3], h), 1), slots], 1)
        begin, step = _programs(self.square)
        start = free_runs(begin, parameters, begins, inputs[:, :1], column)[:, 0]
        start[:, -1] = first
        return free_runs(step, parameters, start, inputs[:, 1:], column)[:, :: self.substeps, 0]

    def _inputs(self, slots: np.ndarray, records: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Return delayed voltages at the ends of the steps, (columns, steps + 1), and the column of each simulation.

        V|V| is linear in between.
        """
        # one delayed input for all simulations with the same record, delay and lag of the input column
        rows = np.stack([records, _delay(slots), slots[:, INDEX[MONITOR]]], 1)
        groups, which = np.unique(rows, axis=0, return_inverse=True)
        place, columns = np.arange(steps + 1) / self.substeps, []
        for record, delay, lag in groups:
            drive = _without_lag(self.drives[int(record)], lag)
            if drive.film is not None:
                force = drive.film.force(place * drive.dt - delay)
                columns.append(root(force) if self.square else force)
                continue
            force = drive.voltage * np.abs(drive.voltage) if self.square else drive.voltage
            column = np.interp(place - delay / drive.dt, np.arange(len(force)), force)
            column = root(column) if self.square else column
            columns.append(column if drive.before is None else self._jumped(column, drive, delay))
        return np.stack(columns), which.ravel()

    def _jumped(self, column: np.ndarray, drive: Drive, delay: float) -> np.ndarray:
        """Return a delayed voltage, with the voltage before the record ahead of its first sample.

        Every step's end has the mean over half a step on either side (over one, at the first), so that the area under
        the force does not depend on the position of the jump within a step.
        """
        steps = max((delay + drive.jump) / drive.dt * self.substeps, 0.0)
        place = np.arange(len(column)) - steps
        # part of the step after the jump
        share = np.clip(place + 0.5, 0.0, 1.0)
        share[0] = np.clip(1 - 2 * steps, 0.0, 1.0)
        before = float(drive.before or 0.0)
        return before + (column - before) * (np.sqrt(share) if self.square and not before else share)


def _without_lag(drive: Drive, lag: float) -> Drive:
    """Return the input u + tau u' whose low pass with the time constant tau = `lag` (s) is the recorded one."""
    if not lag:
        return drive
    # a thinned record has its input before the first sample in its film's first mean
    before = drive.before if drive.film is None else None
    voltage = drive.voltage + lag * np.gradient(drive.voltage, drive.dt)
    return replace(drive, voltage=voltage, film=None, before=before)


def _delay(slots: np.ndarray) -> np.ndarray:
    """Return the delay of the input (s), shape (simulations,); negative if the output column is ahead of it."""
    return slots[:, INDEX[DELAY]] - slots[:, INDEX[EARLY]] - slots[:, INDEX[AHEAD]]


def root(force: np.ndarray) -> np.ndarray:
    """Compute the voltage V from V|V|."""
    return np.sign(force) * np.sqrt(np.abs(force))


def step_response(a0, a1, a2, h) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the exact step (x, v)+ = E (x, v) + b F_0 + d (F_1 - F_0) of a_0 x + a_1 x' + a_2 x'' = F.

    The exponential of [[A, B, 0], [0, 0, 1], [0, 0, 0]] by scaling and squaring; a_2 = 0: order 1, v is not used.
    """
    second = a2 > 0
    m = np.zeros((len(h), 4, 4))
    m[:, 0, 1] = np.where(second, h, 0.0)
    low = np.where(second, np.where(second, a2, 1.0), np.maximum(a1, 1e-300))
    row = np.where(second, 1, 0)
    lanes = np.arange(len(h))
    # order one writes the first row, order two the second
    m[lanes, row, 0] = -a0 / low * h
    m[:, 1, 1] = np.where(second, -a1 / low * h, 0.0)
    m[lanes, row, 2] = h / low
    m[:, 2, 3] = 1.0
    # scaled to a norm below an eighth, for which ten terms are exact within rounding
    norm = np.abs(m).sum(2).max(1)
    squarings = int(np.clip(np.ceil(np.log2(np.maximum(norm.max(), 1e-300))) + 3, 0, 60))
    m = m / 2.0**squarings
    total, term = np.eye(4) + m, m
    for k in range(2, 11):
        term = term @ m / k
        total = total + term
    for _ in range(squarings):
        total = total @ total
    return total[:, :2, :2], total[:, :2, 2], total[:, :2, 3]


class Plant(NamedTuple):
    """The linear core: coefficients a_0, a_1, a_2, the matrices E, b, d of its exact step, and the step (s)."""

    a0: Any
    a1: Any
    a2: Any
    e11: Any
    e12: Any
    e21: Any
    e22: Any
    bx: Any
    bv: Any
    dx: Any
    dv: Any
    h: Any


def _plant(core: np.ndarray, h: np.ndarray) -> Plant:
    a0, a1, a2 = core.T
    e, b, d = step_response(a0, a1, a2, h)
    return Plant(a0, a1, a2, *e.reshape(-1, 4).T, *b.T, *d.T, h=h)


@dataclass(frozen=True)
class Middle(Instant):
    """The middle of a simulated step of the linear core, with the velocity and the acceleration of that step.

    Attributes:
        highest, free, reply: of the step, as those of an `Instant`.
    """

    highest: Any = 0.0
    free: Any = 0.0
    reply: Any = 1.0

    @property
    def order(self) -> int:
        """Return 2, the order of the linear core, which may nevertheless lack a mass."""
        return 2

    @property
    def v(self):
        """Return the scaled velocity x'."""
        return self.state[1]


@lru_cache(2)
def _programs(square: bool) -> tuple[Callable, Callable]:
    """Return the beginning of a run and its step, both as `free_runs` takes a step.

    Parameters: 1 / force scale, the two rates, the plant, the slots. State of the step: x, v, x' of the last step, the
    memories, the voltage before the step.
    """
    plant_ends = 3 + len(Plant._fields)
    ends = np.cumsum([3, *(r.kernel.size for r in ROWS)]).tolist()

    def effects_of(p) -> list[Effect]:
        return [r(*p[plant_ends + PLACES[r].start : plant_ends + PLACES[r].stop]) for r in ROWS]

    def begin(parameters, start, _):
        """Settle all memories at the previous voltage; the outputs are the state of the step."""
        (x, v, volts, age, reached), parts, y = list(start), [], start[0]
        for e in effects_of(list(parameters)):
            z = e.start(volts if e.port == "IN" else y if e.port == "OUT" else x, age)
            parts.append(e.resumed(z, reached))
            y = e.apply(y, parts[-1]) if e.port == "OUT" else y
        return start, jnp.concatenate([jnp.stack([x, v, v]), *parts, volts[None]])

    def step(parameters, state, after):
        p = list(parameters)
        plant, effects, before = Plant(*p[3:plant_ends]), effects_of(p), state[-1]
        once = [e.once(plant.h) for e in effects]
        inner = (*state[:3], [state[a:b] for a, b in pairwise(ends)])
        y = jnp.where(jnp.abs(state[0]) >= FAR, jnp.nan, _reading(effects, inner))
        x, v, speed, parts = _step(square, p[0], p[1:3], effects, once, plant, inner, before, after)
        return jnp.concatenate([jnp.stack([x, v, speed]), *parts, after[None]]), y

    return begin, step


def _reading(effects: list[Effect], state):
    y = state[0]
    for e, z in zip(effects, state[3], strict=True):
        y = e.apply(y, z) if e.port == "OUT" else y
    return y + sum(e.spec.crosses(e.p, z) for e, z in zip(effects, state[3], strict=True) if e.spec.crosses)


def _step(square, unit, rates, effects: list[Effect], once, plant: Plant, state, before, after):
    (x, v, speed, old), p, h = state, plant, plant.h
    new, ends, second = list(old), (before, after), p.a2 > 0
    for k, effect in enumerate(effects):
        if effect.port == "IN" and not effect.delays:
            new[k] = effect.advance(old[k], *ends, h, once[k])
            ends = effect.apply(ends[0], old[k]), effect.apply(ends[1], new[k])
    push = [(w * w if square else w) * unit for w in ends]
    for effect in effects:
        if effect.port == "SQ":
            # the position half way through the step, as at the end of the last one
            push = [effect.apply(f, x + h / 2 * speed) for f in push]
    # the linear plant's own step, exact for a linear force
    x1 = p.e11 * x + p.e12 * v + p.bx * push[0] + p.dx * (push[1] - push[0])
    v1 = p.e21 * x + p.e22 * v + p.bv * push[0] + p.dv * (push[1] - push[0])

    def middle(x1, v1) -> Middle:
        """Return the middle of the step; at order 1 x' follows from the force of the step."""
        reply, free = jnp.where(second, p.bv, p.bx / h) / rates[0], jnp.where(second, v1, (x1 - x) / h) / rates[0]
        inertia, highest = h * rates[1] / reply, (v1 - v) / (h * rates[0] * rates[1])
        place, tokens = ((x + x1) / 2, (x1 - x) / h / rates[0]), (p.a0, p.a1, inertia)
        force, own = (push[0] + push[1]) / 2, (p.a0, p.a1, p.a2)
        return Middle(place, own, rates, force, h, tokens, 0.0, highest=highest, free=free, reply=reply)

    now = middle(x1, v1)

    def forces(place, speed):
        here = replace(now, state=(place, speed / rates[0]))
        acting = [k for k, e in enumerate(effects) if e.forces and not e.resolved]
        return sum(effects[k].act(old[k], here, once[k]).offset for k in acting)

    # the other forces at the middle of that step, and their response to displacement
    f, slope = jax.jvp(forces, ((x + x1) / 2, (x1 - x) / h), (p.bx / 2, p.bx / h))
    f = f / (1 + jnp.maximum(slope, -0.5))
    x1, v1 = x1 - p.bx * f, v1 - p.bv * f
    for k, effect in enumerate(effects):
        if effect.resolved:
            f = effect.act(old[k], middle(x1, v1), once[k]).offset
            x1, v1 = x1 - p.bx * f, v1 - p.bv * f
    lost = ~(jnp.abs(x1) < FAR)  # nan compares false: it counts as diverged too
    x1, v1 = jnp.where(lost, FAR, x1), jnp.where(lost, 0.0, v1)
    y = x, x1
    for k, effect in enumerate(effects):
        if effect.port not in ("IN", "SQ"):
            new[k] = effect.advance(old[k], *(y if effect.port == "OUT" else (x, x1)), h, once[k])
            if effect.port == "OUT":
                y = effect.apply(y[0], old[k]), effect.apply(y[1], new[k])
    return x1, v1, (x1 - x) / h, new

"""Simulate the output for many parameter vectors: the steps of the model that is handed back, with every row.

    sum_i sigma_i(S, m) x^(i) + f_rows(x, x', z) = F coupling(x),   F = map(V) / force scale,   y = sensor rows(x)

sigma_i are the slots a_0, a_1, a_2 of a linear core; those of another nominal are its tokens times a_i / a_i of the
nominal. The step is `simulate.decoder.substep`, so a fit and the model that is made from it have the same errors: a
second integrator left 0.70 % beside a planted dry friction, and took a hysteresis for it, where this one leaves 0.53 %.

It is written for one parameter vector and one record; `simulate.free_runs` compiles it and runs it for all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import jax.numpy as jnp
import numpy as np

from ..model.model import Model, linear_model
from ..numerics.intersample import between
from ..simulate import ports
from ..simulate.decoder import settled_state, substep
from ..simulate.free_runs import free_runs
from ..simulate.model_runs import Structure, taken_apart
from .library import (
    AHEAD,
    DELAY,
    EARLY,
    INDEX,
    MONITOR,
    PLACES,
    ROWS,
    coefficients_of,
    rates_of,
    within_coefficients,
)

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
        model: the nominal.
        others: its parts that no slot holds, such as an encoder; None: its core is linear.
        nominal: its slots, shape (slots,).
        substeps: steps a sample.
    """

    drives: tuple[Drive, ...]
    model: Model
    others: Model | None
    nominal: np.ndarray
    substeps: int

    @property
    def square(self) -> bool:
        """Return whether F = V^2 (else V)."""
        return self.model.input_map.name == "square"

    @property
    def force_scale(self) -> float:
        """Return the scale of F, V^2 or V."""
        return float(self.model.scales.force)

    def signed_force(self, voltage: np.ndarray) -> np.ndarray:
        """Compute V|V|, or V, of any shape."""
        return np.copysign(self.model.input_map.force(voltage), voltage)

    def run(self, slots: np.ndarray, records: Sequence[int], starts: np.ndarray) -> list[np.ndarray]:
        """Simulate parameter vectors, each with a record from (x, v); return scaled outputs (T,), nan if diverged."""
        places = np.asarray(records, int)
        steps = np.array([len(d.voltage) for d in self.drives])[places] * self.substeps
        # a core without a mass is a model of its own
        orders = np.where(slots[:, 2] > 0, 2, 1) if self.others is None else np.full(len(slots), self.others.order)
        outputs: list = [None] * len(places)
        for count, order in sorted(set(zip(steps.tolist(), orders.tolist(), strict=True))):
            some = np.flatnonzero((steps == count) & (orders == order))
            rows = self._alike(slots[some], places[some], starts[some], count, order)
            for k, row in zip(some, rows, strict=True):
                outputs[k] = row
        return outputs

    def _alike(self, slots, records, starts, steps: int, order: int) -> np.ndarray:
        """Simulate runs of one order and number of steps; return their scaled outputs, shape (runs, samples)."""
        drives = [self.drives[r] for r in records]
        # a step reads its input in the middle as well
        inputs, column = replace(self, substeps=2 * self.substeps)._inputs(slots, records, 2 * steps)
        stages = np.stack([inputs[:, :-2:2], inputs[:, 1::2], inputs[:, 2::2]], -1)
        before = [u if d.before is None else d.before for u, d in zip(inputs[column, 0], drives, strict=True)]
        begins = np.column_stack([starts, before, [(d.age, d.reached) for d in drives]])
        structure, numbers = self._plain[order]
        begin, step = (_Step(structure, len(numbers), drives[0].dt / self.substeps, first) for first in (True, False))
        parameters = self._parameters(slots, order)
        state = free_runs(begin, parameters, begins, inputs[:, :1], column)[:, 0]
        outputs = free_runs(step, parameters, state, stages, column)[:, :: self.substeps, 0]
        return np.where(np.abs(outputs) < FAR, outputs, np.nan)

    @cached_property
    def _plain(self) -> dict[int, tuple[Structure, np.ndarray]]:
        """Return the model without rows as structure and numbers, by its order."""
        cores = [core_of(self.model, order) for order in (1, 2)] if self.others is None else [self.others]
        return {core.order: taken_apart(core) for core in cores}

    def _parameters(self, slots: np.ndarray, order: int) -> np.ndarray:
        """Return the model's numbers (coefficients first) and the rows' slots of every run, shape (runs, numbers)."""
        rows, plain = slots.copy(), self._plain[order][1]
        if self.others is None:
            coefficients = slots[:, : order + 1] * np.cumprod([1.0, *rates_of(self.model)])[: order + 1]
        else:
            own = coefficients_of(self.nominal, order)
            rows[:, within_coefficients(self.nominal, order)] = 0.0
            moved = np.array([coefficients_of(s, order) for s in slots]) / np.where(own, own, 1.0)
            coefficients = plain[: order + 1] * np.where(own, moved, 1.0)
        others = np.tile(plain[order + 1 :], (len(slots), 1))
        return np.concatenate([coefficients, others, rows], 1)

    def _inputs(self, slots: np.ndarray, records: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Return delayed voltages at the ends of the steps, (columns, steps + 1), and the column of each simulation.

        V|V| is linear in between; a band-limited input, which is not linear between samples, is interpolated first.
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
            each = 4 * self.substeps if self.model.hold == "bandlimited" else 1  # values of a sample
            fine = between(drive.voltage, self.model.hold, np.arange(each) / each, np)
            force = self.signed_force(fine.reshape(-1))
            column = np.interp(each * (place - delay / drive.dt), np.arange(len(force)), force)
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


def core_of(model: Model, order: int) -> Model:
    """Return a linear model of order 1 or 2 in the nominal's scales, whose coefficients are still to be set."""
    scale = float(model.scales.state[0]) * np.cumprod([1.0, *rates_of(model)])[: order + 1]
    return linear_model(
        np.ones(order + 1), domain=model.domain, input_map=model.input_map, substeps=1, state_scale=scale,
        force_scale=float(model.scales.force),
    )  # fmt: skip


@dataclass(frozen=True)
class _Step:
    """The beginning of a run or its step of h (s), as `free_runs` takes them; parameters: of the model, then slots."""

    structure: Structure
    size: int
    h: float
    begins: bool

    def __call__(self, parameters, state, volts):
        model = self.structure.filled(parameters[: self.size])
        slots = list(parameters[self.size :])
        model = replace(model, effects=(*model.effects, *(r(*slots[PLACES[r]]) for r in ROWS)))
        if not self.begins:
            return substep(model, state, volts, self.h), ports.reading(model, state)
        x, v, before, age, reached = state
        motion = jnp.zeros(model.order).at[0].set(x)
        motion = motion.at[1].set(v / model.scales.rates[0]) if model.order > 1 else motion
        return state, ports.resumed(model, settled_state(model, motion, x, before, age), reached)

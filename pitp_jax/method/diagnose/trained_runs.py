"""Run a nominal that is more than a linear core, such as a trained one, with every row of the search.

    sum_i sigma_i(S, m) x^(i) + f_rows = F,   y = rows of the sensor(x)        (`simulate.decoder.substep`)

These are the steps of the model that is handed back, at the rate of the thinned records. The slots of the linear core
multiply the tokens: sigma_i(S, m) a_i / a_i of the nominal.
"""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from ..model.model import Model
from ..simulate import ports
from ..simulate.decoder import settled_state, substep
from ..simulate.free_runs import free_runs
from ..simulate.model_runs import Structure, taken_apart
from .library import PLACES, ROWS, coefficients_of, within_coefficients


@dataclass(frozen=True)
class _Runs:
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


def trained_runs(model: Model, nominal: np.ndarray, slots: np.ndarray, start: np.ndarray, columns, column, h: float):
    """Simulate parameter vectors with a model; return its scaled readings at the beginning of every step.

    Args:
        model: the nominal's parts that no slot holds.
        nominal: its own parameter vector, shape (slots,).
        slots: of every run, shape (runs, slots).
        start: x, v, V before the first sample, age (s) and largest |x| of the session, shape (runs, 5).
        columns: V at the ends and the middle of every step, shape (columns, 2 steps + 1); column: that of every run.
        h: length of a step, s.
    """
    structure, numbers = taken_apart(model)
    inside = within_coefficients(nominal, model.order)
    rows, own = slots.copy(), coefficients_of(nominal, model.order)
    rows[:, inside] = 0.0
    moved = np.array([coefficients_of(s, model.order) for s in slots]) / np.where(own, own, 1.0)
    numbers = np.tile(numbers, (len(slots), 1))
    numbers[:, : len(own)] *= np.where(own, moved, 1.0)  # a model's coefficients are the first of its numbers
    parameters = np.concatenate([numbers, rows], 1)
    begin, step = (_Runs(structure, numbers.shape[1], h, begins) for begins in (True, False))
    state = free_runs(begin, parameters, start, columns[:, :1], column)[:, 0]
    stages = np.stack([columns[:, :-2:2], columns[:, 1::2], columns[:, 2::2]], -1)
    return free_runs(step, parameters, state, stages, column)[..., 0]

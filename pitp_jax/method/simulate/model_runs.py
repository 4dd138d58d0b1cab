"""Simulate records with a model by `free_runs`, from NumPy to NumPy in float64.

    film = drive(u)  ->  stage voltages of every sample  ->  free_runs(step of the model)  ->  states, readings

All numbers of a model are parameters of the run, so that models of one structure share one compiled step and may differ
from run to run. It is the
step of `decoder.rollout`, which is the way to trace, differentiate or shard a simulation.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..model.constants import as_arguments
from ..model.drive import DirectDrive
from ..model.model import Model
from ..model.own_encoder import own_module
from ..numerics.intersample import between
from . import ports
from .decoder import stage_fractions, step
from .free_runs import free_runs


@dataclass(frozen=True)
class Structure:
    """A model without its numbers: models of one structure are equal.

    Attributes:
        tree: of its parts, with all static fields.
        leaves: shapes in the places of its numbers, and the values that are not numbers.
    """

    tree: Any
    leaves: tuple

    def filled(self, numbers: Float[np.ndarray | Array, " p"]) -> Model:
        """Return the model with these numbers."""
        leaves, first = [], 0
        for leaf in self.leaves:
            if isinstance(leaf, jax.ShapeDtypeStruct):
                last = first + leaf.size
                leaf, first = numbers[first:last].reshape(leaf.shape), last
            leaves.append(leaf)
        return jax.tree.unflatten(self.tree, leaves)


@dataclass(frozen=True)
class ModelStep:
    """A function of a model as `free_runs` takes it: fn(model, state, input, dt) -> (state, outputs)."""

    function: Callable
    structure: Structure
    dt: float

    def __call__(self, parameters, state, now):
        """Apply the function to the model with these numbers."""
        return self.function(self.structure.filled(parameters), state, now, self.dt)


def taken_apart(model: Model) -> tuple[Structure, Float[np.ndarray, " p"]]:
    """Return the structure and the numbers of a model."""
    leaves, tree = jax.tree.flatten(as_arguments(model))
    numbers = [np.asarray(a, np.float64) for a in leaves if eqx.is_inexact_array(a)]
    shapes = iter([jax.ShapeDtypeStruct(a.shape, a.dtype) for a in numbers])
    leaves = tuple(next(shapes) if eqx.is_inexact_array(a) else a for a in leaves)
    return Structure(tree, leaves), np.concatenate([a.ravel() for a in numbers])


@dataclass(frozen=True)
class Models:
    """The model of every run, or one for all runs: a structure that they share, and their numbers.

    Attributes:
        structure: of each.
        numbers: shape (runs or 1, p).
    """

    structure: Structure
    numbers: Float[np.ndarray, "models p"]

    @classmethod
    def of(cls, models: Sequence[Model]) -> "Models":
        """Take models of one structure apart."""
        structures, numbers = zip(*map(taken_apart, models), strict=True)
        return cls(structures[0], np.stack(numbers))

    def of_runs(self, runs: Int[np.ndarray, " chosen"]) -> "Models":
        """Return the models of these runs; one for all runs stays one."""
        return self if len(self.numbers) == 1 else Models(self.structure, self.numbers[runs])

    def __getitem__(self, run: int) -> Model:
        """Return the model of a run."""
        return self.structure.filled(self.numbers[run % len(self.numbers)])


def models_of(model: Model | Models) -> Models:
    """Return a model as that of all runs; `Models` as they are."""
    return model if isinstance(model, Models) else Models.of([model])


def runs_of(
    function: Callable, model: Model | Models, start: Float[np.ndarray, "runs state"], inputs, dt: float = 0.0
) -> Float[np.ndarray, "runs time outputs"]:
    """Compute `free_runs` of a function of a model; a single input serves all runs.

    Args:
        function: as `ModelStep` takes it, of a module, so that it compiles once.
        model: the same for all runs, or the models of the runs.
        start: initial states.
        inputs: shape (runs or 1, time) or (runs or 1, time, k).
        dt: sampling interval, s.
    """
    models = models_of(model)
    parameters = np.broadcast_to(models.numbers, (len(start), models.numbers.shape[1]))
    return free_runs(
        ModelStep(function, models.structure, float(dt)), parameters, start, inputs, np.arange(len(start)) % len(inputs)
    )


def sample(model: Model, state, stages, dt):
    """Advance a model along its stage voltages; the outputs are the state before, and the sensor's reading."""
    return step(model, state, stages, dt), jnp.append(state, ports.reading(model, state))


def model_runs(
    model: Model | Models,
    voltage: Float[np.ndarray, "records time"],
    dt: float,
    start: Float[np.ndarray, "records state"],
) -> tuple[Float[np.ndarray, "records time state"], Float[np.ndarray, "records time"]]:
    """Compute the scaled states and the sensor's scaled readings of all records, from rest or from other states."""
    models, start = models_of(model), np.asarray(start, np.float64)
    first, film = models[0], film_of(models, np.asarray(voltage, np.float64), dt, start)
    stages = between(film, first.hold, stage_fractions(first), np)
    outputs = runs_of(sample, models, start, stages, dt)
    return outputs[..., :-1], outputs[..., -1]


def padded(voltages: Sequence[np.ndarray]) -> np.ndarray:
    """Stack voltages of several lengths, shape (records, longest); the shorter ones hold their last value."""
    size = max(map(len, voltages))
    return np.stack([np.pad(u, (0, size - len(u)), mode="edge") for u in voltages])


def evaluate(function: Callable, model: Model | Models, *numbers) -> Float[np.ndarray, "rows outputs"]:
    """Compute `function(model, row, ...)` for rows of numbers, as one step of `runs_of`; columns are broadcast."""
    return runs_of(function, model, np.column_stack(np.broadcast_arrays(*numbers)), np.zeros((1, 1)))[:, 0]


def way_of(model: Model) -> str:
    """Return in words which way free runs of a model take."""
    if os.environ.get("PITP_COMPILED", "1") == "0" or find_spec("llvmlite") is None:
        return "by the JAX scan"
    own = own_module(model.encoder)
    if own is None:
        return "compiled"
    return f"compiled, if every operation of {type(own).__name__} has a scalar form; otherwise by the JAX scan"


def film_of(model: Model | Models, voltage, dt: float, start) -> Float[np.ndarray, "records time"]:
    """Compute the film's voltages (V): behind delays and the electrodes' lag."""
    models, places = models_of(model), np.arange(-1, voltage.shape[1])
    first = models[0]
    # before the record, a rest was at 0 V; any other start is assumed at the first voltage
    before = np.where(start[:, : first.order].any(1), voltage[:, 0], 0.0)
    for k, effect in enumerate(first.effects):
        if effect.delays:
            late = [places[1:] - float(models[run].effects[k].time) / dt for run in range(len(models.numbers))]
            volts = np.column_stack([before, voltage])
            voltage = np.stack([np.interp(late[run % len(late)], places, v) for run, v in enumerate(volts)])
    if isinstance(first.drive, DirectDrive):
        return voltage
    ahead = np.append(voltage[:, 1:], voltage[:, -1:], axis=1)
    return runs_of(_film_after, models, np.column_stack([before, voltage[:, 0]]), ahead, dt)[..., 0]


def _film_after(model, state, volts, dt):
    """Advance the film's voltage and u by one sample; the output is the film's voltage before."""
    return jnp.stack([model.drive.after(*state, volts, dt), volts]), state[0]

"""Simulate records with a model by `free_runs`, from NumPy to NumPy in float64.

    film = drive(u)  ->  stage voltages of every sample  ->  free_runs(step of the model)  ->  states, readings

All numbers of a model are parameters of the run, so that models of one structure share one compiled step. It is the
step of `decoder.rollout`, which is the way to trace, differentiate or shard a simulation.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

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

    def filled(self, numbers: Float[Array, " p"]) -> Model:
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


def runs_of(
    function: Callable, model: Model, start: Float[np.ndarray, "runs state"], inputs, dt: float = 0.0
) -> Float[np.ndarray, "runs time outputs"]:
    """Compute `free_runs` of a function of a model; a single input serves all runs.

    Args:
        function: as `ModelStep` takes it, of a module, so that it compiles once.
        model: the same for all runs.
        start: initial states.
        inputs: shape (runs or 1, time) or (runs or 1, time, k).
        dt: sampling interval, s.
    """
    structure, numbers = taken_apart(model)
    parameters = np.broadcast_to(numbers, (len(start), len(numbers)))
    return free_runs(
        ModelStep(function, structure, float(dt)), parameters, start, inputs, np.arange(len(start)) % len(inputs)
    )


def sample(model: Model, state, stages, dt):
    """Advance a model along its stage voltages; the outputs are the state before, and the sensor's reading."""
    return step(model, state, stages, dt), jnp.append(state, ports.reading(model, state))


def model_runs(
    model: Model, voltage: Float[np.ndarray, "records time"], dt: float, start: Float[np.ndarray, "records state"]
) -> tuple[Float[np.ndarray, "records time state"], Float[np.ndarray, "records time"]]:
    """Compute the scaled states and the sensor's scaled readings of all records, from rest or from other states."""
    start = np.asarray(start, np.float64)
    film = film_of(model, np.asarray(voltage, np.float64), dt, start)
    stages = np.stack([between(v, model.hold, stage_fractions(model), np) for v in film])
    outputs = runs_of(sample, model, start, stages, dt)
    return outputs[..., :-1], outputs[..., -1]


def evaluate(function: Callable, model: Model, *numbers) -> Float[np.ndarray, "rows outputs"]:
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


def film_of(model: Model, voltage, dt: float, start) -> Float[np.ndarray, "records time"]:
    """Compute the film's voltages (V): behind delays and the electrodes' lag."""
    # before the record, a rest was at 0 V; any other start is assumed at the first voltage
    before = np.where(start[:, : model.order].any(1), voltage[:, 0], 0.0)
    places = np.arange(-1, voltage.shape[1])
    for effect in model.effects:
        if effect.delays:
            late = places[1:] - float(effect.time) / dt
            voltage = np.stack([np.interp(late, places, np.append(b, v)) for b, v in zip(before, voltage, strict=True)])
    if isinstance(model.drive, DirectDrive):
        return voltage
    ahead = np.append(voltage[:, 1:], voltage[:, -1:], axis=1)
    return runs_of(_film_after, model, np.column_stack([before, voltage[:, 0]]), ahead, dt)[..., 0]


def _film_after(model, state, volts, dt):
    """Advance the film's voltage and u by one sample; the output is the film's voltage before."""
    return jnp.stack([model.drive.after(*state, volts, dt), volts]), state[0]

"""Simulate records with a model by `free_runs`, from NumPy to NumPy in float64.

    film = drive(u)  ->  stage voltages of every sample  ->  free_runs(step of the model)  ->  states, readings

All numbers of a model are parameters of the run, so that models of one structure share one compiled step. It is the
step of `decoder.rollout`, which is the way to trace, differentiate or shard a simulation.
"""

import os
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
from ..model.programs import in_double, jit
from ..numerics.intersample import between
from . import ports
from .decoder import at_rest, stage_fractions, step
from .free_runs import free_runs


@dataclass(frozen=True)
class Structure:
    """A model without its numbers: models of one structure are equal.

    Attributes:
        tree: of its parts, with all static fields.
        shapes: of the arrays of numbers; None in the place of another value.
        others: the values that are not numbers, by their place.
    """

    tree: Any
    shapes: tuple
    others: tuple

    def filled(self, numbers: Float[Array, " p"]) -> Model:
        """Return the model with these numbers."""
        leaves, first, others = [], 0, iter(self.others)
        for shape in self.shapes:
            if shape is None:
                leaves.append(next(others))
                continue
            last = first + int(np.prod(shape))
            leaves.append(numbers[first:last].reshape(shape))
            first = last
        return jax.tree.unflatten(self.tree, leaves)


@dataclass(frozen=True)
class ModelStep:
    """One sample (dt, s) of a model as `free_runs` takes it."""

    structure: Structure
    dt: float

    def __call__(self, parameters, state, stages):
        """Advance the state along the stage voltages; the outputs are the state before, and the sensor's reading."""
        model = self.structure.filled(parameters)
        return step(model, state, stages, self.dt), jnp.append(state, ports.reading(model, state))


def taken_apart(model: Model) -> tuple[Structure, Float[np.ndarray, " p"]]:
    """Return the structure and the numbers of a model."""
    leaves, tree = jax.tree.flatten(as_arguments(model))
    numbers = [eqx.is_inexact_array(a) for a in leaves]
    shapes = tuple(np.shape(a) if is_number else None for a, is_number in zip(leaves, numbers, strict=True))
    others = tuple(a for a, is_number in zip(leaves, numbers, strict=True) if not is_number)
    flat = [np.asarray(a, np.float64).ravel() for a, is_number in zip(leaves, numbers, strict=True) if is_number]
    return Structure(tree, shapes, others), np.concatenate(flat)


def model_runs(
    model: Model, voltage: Float[np.ndarray, "records time"], dt: float, start: Float[np.ndarray, "records state"]
) -> tuple[Float[np.ndarray, "records time state"], Float[np.ndarray, "records time"]]:
    """Compute the scaled states and the sensor's scaled readings of all records, from rest or from other states."""
    structure, numbers = taken_apart(model)
    start = np.asarray(start, np.float64)
    film = film_of(model, np.asarray(voltage, np.float64), dt, start)
    stages = np.stack([between(v, model.hold, stage_fractions(model), np) for v in film])
    parameters = np.broadcast_to(numbers, (len(film), len(numbers)))
    outputs = free_runs(ModelStep(structure, float(dt)), parameters, start, stages, np.arange(len(film)))
    return outputs[..., :-1], outputs[..., -1]


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
    if isinstance(model.drive, DirectDrive) and not any(e.delays for e in model.effects):
        return voltage
    with jax.enable_x64(True), jax.default_device(jax.local_devices(backend="cpu")[0]):
        return np.asarray(_films(in_double(model), voltage, float(dt), start))


@jit
def _films(model: Model, voltage, dt, start):
    def one(u, s):
        rest = at_rest(model, s)
        return model.drive.film(ports.delayed(model, u, dt, rest), dt, rest)

    return jax.vmap(one)(voltage, start)

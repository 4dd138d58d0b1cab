"""Convert records to training data on the device: scaled states, memories and forces.

X_i = x^(i) / scale_i,   m = memory(x),   F / F_max          (docs/readings.md: eqs. 3, 6, 8, 9)
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...common.errors import BadInput
from ..model.model import Model, Scales
from ..signal.initial_state import Beginning
from ..signal.preprocess import StateRecord, cutoff, force_band, preprocess
from ..signal.record import Record
from ..simulate.prediction import begin
from .equation_error import EquationData


@dataclass(frozen=True)
class Dataset:
    """The training data of several records, in the scaled units of the model.

    Attributes:
        model: the nominal in the new scales, with the memory (tokens still constant).
        equation: valid samples of all records, flat.
        features: per record the scaled state and memory at every sample, shape (T, n + K).
        valid: per record, True where the filtered state is valid, shape (T,).
        region: lowest and highest value of every feature over valid samples.
        begun: per record, how it begins by the nominal.
    """

    model: Model
    equation: EquationData
    features: tuple[np.ndarray, ...]
    valid: tuple[np.ndarray, ...]
    region: Float[np.ndarray, "features 2"]
    begun: list[Beginning]


def build_dataset(
    nominal: Model,
    records: Sequence[Record],
    *,
    scaling: str,
    difference: str,
    memory: Callable[[Sequence[StateRecord]], eqx.Module],
) -> Dataset:
    """Filter, differentiate and scale the records; `memory` builds the memory from the filtered motion.

    Raises:
        BadInput: no usable sample left after filtering.
    """
    dt = records[0].dt
    forces = [nominal.input_map.force(r.voltage) for r in records]
    # one cutoff for all records; otherwise one equation would be fitted to differently smoothed motions
    f_max = force_band(forces, dt)
    cut = cutoff(f_max, dt)
    states = [
        preprocess(
            r,
            nominal.order,
            cut,
            f,
            displacement=nominal.output.to_model(r.displacement),
            difference=difference,
        )
        for r, f in zip(records, forces, strict=True)
    ]
    if not any(s.valid.any() for s in states):
        raise BadInput(
            "no sample of these recordings remains after filtering, because they are too short or have too "
            "many gaps; record longer ones"
        )
    model = _rescaled(nominal, states, forces, f_max, scaling)
    model = eqx.tree_at(lambda m: m.memory, model, memory(states))
    scale = model.scales.state
    features, equation = [], []
    begun = begin(nominal, records)[2]
    for s, b in zip(states, begun, strict=True):
        x = s.states / scale
        # the past of a record that starts moving is unknown: assume it was held at its first position
        start = model.memory.initial(jnp.asarray(0.0 if b.begins == "rest" else x[0, 0], jnp.float32))
        past = model.memory.trajectory(jnp.asarray(x[:, 0], jnp.float32), dt, start)
        features.append(np.concatenate([x[:, :-1], np.asarray(past)], -1).astype(np.float32))
        equation.append((features[-1][s.valid], x[s.valid], s.force[s.valid] / model.scales.force))
    flat = [jnp.asarray(np.concatenate(part), jnp.float32) for part in zip(*equation, strict=True)]
    # with the memories before any free run: `training._region` computes it again afterwards
    everything = np.concatenate([f[s.valid] for f, s in zip(features, states, strict=True)])
    weight = jnp.asarray(spread_weights(everything[:, : nominal.order]), jnp.float32)
    data = EquationData(*flat, weight=weight)
    return Dataset(model, data, tuple(features), tuple(s.valid for s in states), region_of(everything), begun)


def region_of(*rows: np.ndarray) -> Float[np.ndarray, "features 2"]:
    """Return the lowest and highest value of every feature over all samples, shape (features, 2)."""
    return np.stack([np.min([r.min(0) for r in rows], 0), np.max([r.max(0) for r in rows], 0)], -1).astype(float)


def spread_weights(state, cells: int = 16, most: float = 20.0, valid=None, xp=np):
    """Return sample weights that even out how often states are visited: mean 1, at most `most` times the least.

    A record of steps stands still for 99 % of its samples, and only the others show its motion. Each sample gets 1 /
    sqrt(samples in its cell), on a grid of the first three states at most. Samples with false `valid` have weight 0.
    `xp` is the array's module: numpy or jax.numpy.
    """
    s = state[:, :3]  # cells of more dimensions would hold one sample each
    valid = xp.ones(len(s), bool) if valid is None else valid
    low, high = (f(xp.where(valid[:, None], s, end), 0) for f, end in ((xp.min, xp.inf), (xp.max, -xp.inf)))
    index = xp.clip((s - low) / xp.maximum(high - low, 1e-12) * cells, 0, cells - 1).astype(int)
    flat = (index * cells ** np.arange(s.shape[1])).sum(1)
    options = {} if xp is np else {"length": cells ** s.shape[1]}
    weight = 1.0 / xp.sqrt(xp.maximum(xp.bincount(flat, 1.0 * valid, **options)[flat], 1.0))
    least = xp.where(valid, weight, xp.inf).min()
    weight = xp.where(valid, xp.minimum(weight, most * least), 0.0)  # a single sample in a cell may be an outlier
    return weight / weight.mean()


def _rescaled(nominal: Model, states: Sequence[StateRecord], forces, f_max: float, scaling: str) -> Model:
    """Return the nominal model with scaled units taken from the training data.

    "rms": each derivative over its training rms. "paper": eq. 3, x^(i) over x_rms d^(i - k/2...) with d = 2 pi f_max,
    centred on k = floor(n/2) with a factor sqrt(d) per derivative.
    """
    n = nominal.order
    rms = np.sqrt(np.mean(np.concatenate([s.states[s.valid] for s in states]) ** 2, axis=0))
    if scaling == "paper":
        rms = rms[n // 2] * (2 * np.pi * f_max) ** ((np.arange(n + 1) - n // 2) / 2)
    force = max(float(np.abs(f).max()) for f in forces)  # scaled forces lie within one
    coefficients = jnp.asarray(nominal.physical_coefficients * rms / force, jnp.float32)
    return replace(nominal, coefficients=coefficients, scales=Scales(rms, force, nominal.scales.sections))

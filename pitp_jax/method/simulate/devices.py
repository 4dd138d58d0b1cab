"""Distribute records over devices: every device runs its own records with the same code.

    out_r = f(model, record_r)        without communication between devices

The model is copied to every device. One device is a mesh of one, several processes (`jax.distributed`) a mesh over all
their devices, to which each brings its own records. The result is the same on every mesh, to rounding. See
benchmarks/CLUSTER.md.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from ...common.errors import BadInput, refuse_traced
from ..model.fitted import Fitted, model_of
from ..model.model import Model
from ..model.programs import jit
from .batched_rollout import fast_rollout

_AXIS = "records"


def records_mesh(devices: Sequence | None = None) -> Mesh:
    """Build a mesh with one axis for records; by default it has all devices of all processes.

    Args:
        devices: in order; None takes all devices of all processes.

    Returns:
        a mesh with one axis, the records.

    Examples:
        >>> pitp.records_mesh(jax.devices()[:1]).size
        1
    """
    return Mesh(np.asarray(jax.devices() if devices is None else devices), (_AXIS,))


def spread(batch, mesh: Mesh):
    """Distribute this process's records over its devices, padded with copies of the last record.

    Every process passes the same number of records.
    """
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(batch)]
    count, devices = len(leaves[0]), len(mesh.local_devices)
    if count == 0 or any(len(leaf) != count for leaf in leaves):
        raise BadInput(
            f"arrays of {sorted({len(leaf) for leaf in leaves})} records cannot be stacked; give one number of records"
        )
    # the leading axis is divided among the devices, all others stay whole
    placed = NamedSharding(mesh, PartitionSpec(_AXIS))

    def place(leaf):
        # every shard must have one size; copies, because a model may fail on a record of zeros
        rows = np.concatenate([leaf, np.repeat(leaf[-1:], -count % devices, axis=0)])
        return jax.make_array_from_process_local_data(placed, rows)

    return jax.tree.map(place, jax.tree.map(np.asarray, batch))


def local_rows(array: Array, count: int) -> np.ndarray:
    """Return the first `count` records of this process as one array."""
    # the order of shards is not guaranteed
    shards = sorted(array.addressable_shards, key=lambda shard: shard.index[0].start or 0)
    return np.concatenate([np.asarray(shard.data) for shard in shards])[:count]


@jit
def over_records(function: Callable, mesh: Mesh, model: Model, batch: tuple, **how):
    """Run function(model, *batch, **how) on all devices in parallel, each with its own records."""
    # `shard_map` takes only arrays; static values are in `how`
    arrays, static = eqx.partition(model, eqx.is_array)

    def local(arrays, batch):
        return function(eqx.combine(arrays, static), *batch, **how)

    mine, all_of_it = PartitionSpec(_AXIS), PartitionSpec()
    run: Any = jax.shard_map(local, mesh=mesh, in_specs=(all_of_it, mine), out_specs=mine, check_vma=False)
    return run(arrays, batch)


def _rollout(model, voltage, start, dt: float):
    return fast_rollout(model, voltage, dt, start)


def sharded_rollout(
    model: Model | Fitted,
    voltage: Float[np.ndarray, "records time"],
    dt: float,
    start: Float[np.ndarray, "records state"],
    mesh: Mesh,
) -> Float[np.ndarray, "records time state"]:
    """Simulate this process's records under their voltages (V) on all devices; return scaled states.

    Args:
        model: the same in every process.
        voltage: this process's, V, shape (records, T).
        dt: sampling interval, s.
        start: scaled initial states, shape (records, n + K): order n, and K numbers of memories and effects.
        mesh: of `records_mesh`.

    Returns:
        scaled states, shape (records, T, n + K); the displacement in m is the first times `model.scales.state[0]`.

    Raises:
        BadInput: no record, or arrays of different numbers of records.

    Examples:
        >>> mesh, start = pitp.records_mesh(jax.devices()[:1]), pitp.rest_state(model)[None]
        >>> pitp.sharded_rollout(model, np.zeros((1, 64)), 1e-3, np.asarray(start), mesh).shape
        (1, 64, 2)
    """
    refuse_traced("sharded_rollout", "free_run", model, voltage, start)
    model = model_of(model)
    dtype = model.coefficients.dtype
    batch = spread((np.asarray(voltage, dtype), np.asarray(start, dtype)), mesh)
    return local_rows(over_records(_rollout, mesh, model, batch, dt=float(dt)), len(voltage))

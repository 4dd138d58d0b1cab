"""Run by test_shard.py in processes of their own: sharded answers beside plain ones, errors as JSON on stdout."""

import json
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pitp_jax.method.fit.forward_sensitivity import Runs, run_slopes
from pitp_jax.method.fit.free_run_problem import FreeRuns
from pitp_jax.method.fit.parameters import parameters
from pitp_jax.method.invert.equation import invert_path
from pitp_jax.method.invert.inverse import sharded_inverse
from pitp_jax.method.model.domain import Domain
from pitp_jax.method.model.encoder import CompactEncoder
from pitp_jax.method.model.input_map import SquareInput
from pitp_jax.method.model.memory import FadingMemory
from pitp_jax.method.model.model import Output, linear_model
from pitp_jax.method.numerics.spline_derivative import derivatives
from pitp_jax.method.simulate.decoder import rest_state, rollout_batch
from pitp_jax.method.simulate.devices import (
    local_rows,
    over_records,
    records_mesh,
    sharded_rollout,
    spread,
)

DT, SAMPLES, RECORDS = 1e-3, 200, 11


def make_model():
    scale = 1e-3 * 31.4 ** np.arange(3)
    model = linear_model(
        np.array([1e9, 6e6, 1e6]), input_map=SquareInput(), state_scale=scale, force_scale=1e6, output=Output(),
        hold="foh", substeps=1, domain=Domain(DT),
    )  # fmt: skip
    rng = np.random.default_rng(0)
    fresh = eqx.filter_jit(lambda key: CompactEncoder(2, 2, width=2, key=key))(jax.random.key(0))
    weights, fixed = eqx.partition(fresh, eqx.is_inexact_array)
    moved = jax.tree.map(lambda a: a + jnp.asarray(0.05 * rng.standard_normal(a.shape), jnp.float32), weights)
    encoder = eqx.combine(moved, fixed)
    memory = FadingMemory(jnp.log(jnp.asarray([0.02, 0.3], jnp.float32)))
    return eqx.tree_at(lambda m: (m.encoder, m.memory), model, (encoder, memory))


def error(found, truth):
    """Largest miss over the largest value; nan counts as infinite."""
    miss = np.abs(np.asarray(found, np.float64) - np.asarray(truth)).max() / np.abs(truth).max()
    return float(miss) if np.isfinite(miss) else float("inf")


def errors(me: int, processes: int) -> dict:
    """Errors of everything sharded on the records of process `me`, against plain calls on all records."""
    mesh, model = records_mesh(), make_model()
    t = np.arange(SAMPLES) * DT
    volts = np.stack([300 * np.sin((1 + r) * 4 * t) ** 2 for r in range(RECORDS * processes)]).astype(np.float32)
    mine = slice(RECORDS * me, RECORDS * (me + 1))
    start = np.tile(np.asarray(rest_state(model)), (len(volts), 1))
    truth = np.asarray(rollout_batch(model, jnp.asarray(volts), DT, jnp.asarray(start)))
    found = {"rollout": error(sharded_rollout(model, volts[mine], DT, start[mine], mesh), truth[mine])}
    paths = np.stack([3e-4 * (1 - np.cos((2 + r) * t)) ** 2 for r in range(RECORDS)])
    plain = [
        invert_path(model, jnp.asarray(derivatives(x, DT, 2) / np.asarray(model.scales.state), jnp.float32), DT)[1]
        for x in paths
    ]
    found["inverse"] = error(sharded_inverse(model, paths, DT, mesh) ** 2, np.square(plain, dtype=np.float64))
    target, weight = truth[..., 0] + 0.01, np.full_like(volts, 1 / volts.size)
    vector = parameters(model)[0]

    def runs(rows):
        return Runs(*(jnp.asarray(a[rows]) for a in (start, volts, target, weight)))

    batch = spread(runs(mine).filled(len(mesh.local_devices)), mesh)
    slopes = local_rows(over_records(lambda m, r: run_slopes(m, r, DT, 4), mesh, model, (batch,)), RECORDS)
    found["slopes"] = error(slopes, run_slopes(model, runs(slice(None)), DT, 4)[mine])
    if processes > 1:
        return found
    prior, batch = (np.full(len(vector), 1e-3), 0 * vector), (runs(slice(None)),)
    meshed, alone = (FreeRuns(model, batch, DT, 4, prior=prior, mesh=m) for m in (mesh, None))
    for name in ("errors", "slopes"):
        blocks = (getattr(meshed, name)(vector)[0][:RECORDS], getattr(alone, name)(vector)[:-1])
        found[f"free runs, {name}"] = error(blocks[0], np.concatenate(blocks[1])[:RECORDS])
    return found


def main():
    address, processes, me = (sys.argv[1], int(sys.argv[2]), int(sys.argv[3])) if len(sys.argv) > 1 else ("", 1, 0)
    if processes > 1:
        jax.distributed.initialize(address, processes, me)
    found = errors(me, processes)
    print(json.dumps({"devices": jax.device_count(), "local": jax.local_device_count(), "errors": found}))


if __name__ == "__main__":
    main()

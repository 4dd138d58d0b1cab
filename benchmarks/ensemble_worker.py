"""Run by the row `ensemble` as process ME of COUNT on one core each: an ensemble's fit, as JSON."""

import json
import os
import sys
import time


def main(address: str, count: int, me: int) -> dict:
    """Wall and CPU seconds of the second of two fits, the first compiles; and the numbers of all members."""
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[me % len(cores)]})  # before XLA counts them
    import jax

    if count > 1:
        jax.distributed.initialize(address, count, me)
    import jax.numpy as jnp
    import numpy as np

    import pitp_jax as pitp

    from .sizes import size
    from .subjects import DT, default, nominal, voltages

    members, records, samples, epochs, steps = size((4, 8, 2000, 20, 6), (2, 2, 300, 1, 0))
    plant, volts = default(), voltages(records, samples)
    rest = jnp.tile(pitp.rest_state(plant), (records, 1))
    states = np.asarray(
        pitp.sharded_rollout(plant, volts, DT, np.asarray(rest), pitp.records_mesh(jax.local_devices()))
    )
    t = np.arange(samples) * DT
    made = [pitp.Record(f"r{k}", t, u.astype(float), 1e-3 * x[:, 0].astype(float)) for k, (u, x) in
            enumerate(zip(volts, states, strict=True))]  # fmt: skip
    settings = pitp.Settings(epochs=epochs, stages=1, refine_steps=steps)
    seconds, cpu, found = 0.0, 0.0, None
    for _ in range(2):
        began, used = time.perf_counter(), time.process_time()
        found = pitp.train_ensemble(nominal(), made, members=members, settings=settings, key=jax.random.key(0))
        seconds, cpu = time.perf_counter() - began, time.process_time() - used
    assert found is not None
    leaves = [np.asarray(a, np.float64).ravel() for m in found.models for a in jax.tree.leaves(m)]
    return {"seconds": seconds, "cpu": cpu, "numbers": np.concatenate(leaves)[::7].tolist()}


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))))

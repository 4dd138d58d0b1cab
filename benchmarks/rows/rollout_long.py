"""One free run of 120,000 steps, default preset: as chosen by size, sequential, parallel in time, plain, diffrax.

The peer is the fastest general solver at the decoder's own error (`ode`), steps of several samples among them.

The choice must never be slower than the sequential way; the parallel way is there to show where it stands.
"""

import jax
import jax.numpy as jnp
import numpy as np

from pitp_jax._simulate.batched_rollout import fast_rollout
from pitp_jax._simulate.decoder import rest_state, rollout_batch
from pitp_jax._simulate.parallel_in_time import parallel_rollout, rollout_by_size, suits

from ..clock import row, take_turns
from ..ode import EQUAL, diffrax_ways, error, films, reference, rollout_floor
from ..subjects import DT, SAMPLES, default, voltages


def measure(seconds: float) -> dict:
    """All ways, and how far the parallel one is from the sequential one."""
    model, volts = default(), jnp.asarray(voltages(1, SAMPLES))
    start = rest_state(model)[None]
    film = films(model, volts, DT)
    measured = reference(model, film, start, DT)
    ours = error(fast_rollout(model, volts, DT, start), measured)
    solvers, errors = diffrax_ways(model, film, start, measured, DT)
    ways = {
        "pitp_jax": lambda: rollout_by_size(model, volts, DT, start),
        "sequential": lambda: fast_rollout(model, volts, DT, start),
        "sequential, plain": lambda: rollout_batch(model, volts, DT, start),
        "parallel in time": lambda: parallel_rollout(model, volts[0], DT, start[0]).states,
    }
    found = take_turns(ways | solvers, seconds)
    equal = [name for name in solvers if errors[name] <= max(ours, EQUAL)]
    peer = min(equal, key=lambda name: found[name]["median_ms"], default=None)
    parallel, truth = parallel_rollout(model, volts[0], DT, start[0]), np.asarray(ways["sequential"]())[0]
    apart = float(np.abs(np.asarray(parallel.states) - truth).max() / np.abs(truth).max())
    chosen = "parallel in time" if suits(1, SAMPLES, jax.default_backend()) else "sequential"
    return row(found, "pitp_jax", peer, chosen=chosen, steps=SAMPLES, error=ours, errors=errors,
               iterations=int(parallel.iterations), converged=bool(parallel.converged), apart=apart,
               **rollout_floor(model, 1, SAMPLES))  # fmt: skip

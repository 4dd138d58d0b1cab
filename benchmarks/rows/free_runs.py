"""Free runs without a gradient (`simulate.free_runs`): 32 records of 10,000 steps, trained models of order 2 and 3.

In float64 by machine code on all cores, beside the public JAX path of the same model in float32 (row `rollout_batch`).
"""

import numpy as np

from pitp_jax import rest_state
from pitp_jax.method.simulate.batched_rollout import fast_rollout
from pitp_jax.method.simulate.model_runs import model_runs

from ..clock import row, take_turns
from ..sizes import size
from ..subjects import DT, default, voltages

RECORDS, STEPS = size((32, 10_000), (2, 100))


def measure(seconds: float) -> dict:
    """Order 2 and 3 with five memories; the ratio is to the JAX path of order 2."""
    volts, ways = voltages(RECORDS, STEPS), {}
    for order in (2, 3):
        model = default(order)
        start = np.tile(np.asarray(rest_state(model)), (RECORDS, 1))
        ways[f"order {order}"] = lambda m=model, s=start: model_runs(m, volts, DT, s)
        ways[f"order {order}, JAX"] = lambda m=model, s=start: fast_rollout(m, volts, DT, s)
    return row(take_turns(ways, seconds), "order 2", "order 2, JAX", {}, records=RECORDS, steps=STEPS)

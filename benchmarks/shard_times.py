"""Run by the row `devices` with a number of host devices: sharded inversion and rollout, as JSON."""

import json
import sys

import jax
import numpy as np

from pitp_jax import records_mesh, rest_state, sharded_inverse, sharded_rollout

from .clock import take_turns
from .sizes import size
from .subjects import DT, default, target, voltages

RECORDS, STEPS, PATHS, SAMPLES = size((256, 1000, 32, 20_000), (8, 50, 8, 200))


def main(seconds: float) -> dict:
    """Medians per operation, and a checksum of each answer."""
    mesh, model = records_mesh(), default()
    paths = np.stack([target(SAMPLES) * (0.5 + 0.01 * k) for k in range(PATHS)])
    volts, start = voltages(RECORDS, STEPS), np.tile(np.asarray(rest_state(model)), (RECORDS, 1))
    ways = {
        "inverse, 32 x 20,000": lambda: sharded_inverse(model, paths, DT, mesh),
        "rollout, 256 x 1,000": lambda: sharded_rollout(model, volts, DT, start, mesh),
    }
    found = take_turns(ways, seconds)
    sums = {name: float(np.abs(np.asarray(run(), np.float64)).mean()) for name, run in ways.items()}
    return {"devices": jax.device_count(), "times": found, "sums": sums}


if __name__ == "__main__":
    print(json.dumps(main(float(sys.argv[1]))))

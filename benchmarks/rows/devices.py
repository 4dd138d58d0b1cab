"""Records sharded over 1, 2, 4 and 8 host devices: times, efficiency and equality; the row is the rollout on 2.

    efficiency = t_1 / (t_N min(N, cores))

Host devices share the cores, so no more than `cores` times one device can be won here, and one device already runs its
larger kernels on all of them.
"""

import json
import os
import subprocess
import sys

import numpy as np

from ..clock import row
from ..sizes import size

_ROLLOUT = "rollout, 256 x 1,000"
_COUNTS = size((1, 2, 4, 8), (1, 2))


def with_devices(count: int, seconds: float) -> dict:
    """The worker's answer."""
    env = dict(os.environ, XLA_FLAGS=f"--xla_force_host_platform_device_count={count}", JAX_PLATFORMS="cpu")
    command = [sys.executable, "-m", "benchmarks.shard_times", str(seconds)]
    return json.loads(subprocess.run(command, env=env, check=True, capture_output=True, text=True).stdout)


def measure(seconds: float) -> dict:
    """All counts."""
    answers = {count: with_devices(count, seconds / 2) for count in _COUNTS}
    cores, base, curve = len(os.sched_getaffinity(0)), answers[1], []
    for count, answer in answers.items():
        for name, times in answer["times"].items():
            won = base["times"][name]["median_ms"] / times["median_ms"]
            apart = abs(answer["sums"][name] / base["sums"][name] - 1)
            curve.append({"devices": count, "operation": name, "median_ms": times["median_ms"], "speedup": won,
                          "efficiency": won / min(count, cores), "apart": apart})  # fmt: skip
    assert np.max([c["apart"] for c in curve]) < 1e-4
    found = {"two devices": answers[2]["times"][_ROLLOUT], "one device": base["times"][_ROLLOUT]}
    return row(found, "two devices", "one device", cores=cores, curve=curve)

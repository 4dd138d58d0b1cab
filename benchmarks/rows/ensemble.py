"""An ensemble of four fitted by two JAX processes of one core each, beside one process of one core: the same members.

`cpu_ratio` is the same by CPU time, which other load on the cores does not move.
"""

import json
import socket
import subprocess
import sys

import numpy as np

from ..clock import row, summary


def fit(processes: int) -> tuple[float, float, np.ndarray]:
    """Wall and CPU seconds of the slowest process, and the members' numbers, which every process has."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    command = [sys.executable, "-m", "benchmarks.ensemble_worker", address, str(processes)]
    running = [subprocess.Popen([*command, str(k)], stdout=subprocess.PIPE, text=True) for k in range(processes)]
    answers = [json.loads(p.communicate()[0].splitlines()[-1]) for p in running]
    first, *others = (np.array(a["numbers"]) for a in answers)
    assert all(np.array_equal(first, other) for other in others)
    return max(a["seconds"] for a in answers), max(a["cpu"] for a in answers), first


def measure(seconds: float) -> dict:
    """One fit each."""
    (two, cpu, shared), (one, whole, alone) = fit(2), fit(1)
    known = np.isfinite(alone)  # a bound that there is none of is infinite in all of them
    assert np.array_equal(shared[~known], alone[~known], equal_nan=True)
    apart = float(np.abs(shared[known] - alone[known]).max() / np.abs(alone[known]).max())
    assert apart < 1e-6
    found = {"two processes": summary([two]), "one process": summary([one])}
    return row(found, "two processes", "one process", apart=apart, cpu_ratio=whole / cpu)

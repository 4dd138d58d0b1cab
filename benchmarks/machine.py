"""What the times were taken on: processor, versions, load, and the rates that bound every operation.

floor = max(operations / matrix rate, bytes / bandwidth)
"""

import os
import platform
import subprocess
from collections.abc import Callable
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from .clock import once

_PACKAGES = ("pitp_jax", "jax", "equinox", "diffrax", "numpy", "scipy", "torch", "torchdiffeq")


def facts() -> dict:
    """Processor, cores, devices, versions, date and commit; the load says how much of the cores was left."""
    found = {"python": platform.python_version(), "machine": platform.machine(), "processor": _processor(),
             "cores": len(os.sched_getaffinity(0)), "devices": [str(d) for d in jax.devices()],
             "load": round(os.getloadavg()[0], 1), "date": datetime.now(UTC).date().isoformat(),
             "commit": _commit()}  # fmt: skip
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found


def _commit() -> str | None:
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short=8", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True).stdout.strip() or None


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")


def rates() -> dict:
    """Float32 matrix rate in GFlop/s and copy bandwidth in GB/s, medians, as the machine is loaded now."""
    size = 1024
    matrix, product = jnp.ones((size, size), jnp.float32), jax.jit(lambda a: a @ a)
    block = np.ones(8_000_000)
    once(lambda: product(matrix))
    flops = np.median([2 * size**3 / once(lambda: product(matrix)) for _ in range(15)])
    copied = np.median([2 * block.nbytes / once(block.copy) for _ in range(9)])
    return {"gflops": float(flops / 1e9), "gb_per_s": float(copied / 1e9)}


def floor(operations: float, moved: float) -> dict:
    """`floor_ms` of so many operations and bytes at the `rates` of this machine."""
    rate = rates()
    return {"floor_ms": 1e3 * max(operations / rate["gflops"], moved / rate["gb_per_s"]) / 1e9, "rates": rate}


def operations(function: Callable, *args) -> float:
    """Floating-point operations of one call, as XLA counts them (a root or an exponential as one)."""
    cost = jax.jit(function).lower(*args).compile().cost_analysis()
    return float(cost["flops"] + cost.get("transcendentals", 0.0))

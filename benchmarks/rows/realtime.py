"""Latency of one compiled step from NumPy in to a Python float out: inverse and decoder, beside 1 kHz and 5 kHz loops.

The peer is the same inverse in eager PyTorch on one thread. Tails are the operating system's: `late` counts calls
longer than a period.
"""

import time

import numpy as np

from pitp_jax._invert.realtime import decoder_step, inverse_step
from pitp_jax._numerics.spline_derivative import derivatives

from ..clock import once, summary
from ..subjects import DT, default, target

_CALLS = 30_000
_PERIODS_US = {"1 kHz": 1000.0, "5 kHz": 200.0}


def latencies(call, calls: int) -> np.ndarray:
    """Seconds of every call after a few to warm up."""
    taken = np.empty(calls)
    for k in range(-200, calls):
        began = time.perf_counter_ns()
        call(k)
        taken[max(k, 0)] = 1e-9 * (time.perf_counter_ns() - began)
    return taken


def tail(taken: np.ndarray) -> dict:
    """P50, p99 and p99.9 in us, and the share of calls that miss each loop's period."""
    low, high, far = 1e6 * np.percentile(taken, [50, 99, 99.9])
    late = {name: float((1e6 * taken > period).mean()) for name, period in _PERIODS_US.items()}
    return {"p50_us": float(low), "p99_us": float(high), "p999_us": float(far), "late": late}


def stepping(compiled, inputs):
    """Fn(k): one step of a loop that carries on."""
    state = [compiled.carry]

    def call(k):
        state[0], found = compiled.run(state[0], inputs[k % len(inputs)])
        return float(found)

    return call


def torch_step(model, inputs):
    """Fn(k) in PyTorch, or none."""
    try:
        import torch

        from ..torch_model import Inverse
    except ImportError:
        return None
    torch.set_num_threads(1)
    network, memory = Inverse(model).eval(), torch.zeros(1, model.memory.size)
    scale = torch.tensor(model.scales.state, dtype=torch.float32)
    rows = torch.from_numpy(inputs)

    def call(k):
        with torch.inference_mode():
            wanted = rows[k % len(rows)][None] / scale
            return float(network(torch.cat([wanted[:, :-1], memory], 1), wanted))

    return call


def measure(seconds: float) -> dict:
    """The inverse is the row; decoder and peer beside it."""
    model = default()
    inputs = derivatives(target(5000), DT, 2).astype(np.float32)
    compile_s = once(lambda: inverse_step(model, DT).carry)
    taken = latencies(stepping(inverse_step(model, DT), inputs), _CALLS)
    volts = np.full((100, 1), 500.0, np.float32)
    decoder = latencies(stepping(decoder_step(model, DT), volts), _CALLS)
    peer = torch_step(model, inputs)
    beside = None if peer is None else latencies(peer, _CALLS // 10)
    median = None if beside is None else 1e3 * float(np.median(beside))
    found = summary(taken) | {"compile_s": compile_s}
    return {**found, "peer": "PyTorch eager" if peer else None, "peer_median_ms": median,
            "ratio": median and median / found["median_ms"], "inverse": tail(taken), "decoder": tail(decoder),
            "peer_tail": None if beside is None else tail(beside)}  # fmt: skip

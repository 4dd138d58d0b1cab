"""Latency of one compiled step from NumPy in to a Python float out: inverse and decoder, beside 1 kHz and 5 kHz loops.

The peer is the same inverse in PyTorch on one thread, eager or compiled, whichever is faster. Tails are the operating
system's: `late` counts calls longer than a period.
"""

import time

import numpy as np

from pitp_jax.method.invert.realtime import decoder_step, inverse_step
from pitp_jax.method.numerics.spline_derivative import derivatives

from ..clock import once, summary
from ..sizes import size
from ..subjects import DT, default, target

_CALLS = size(30_000, 200)
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


def torch_steps(model, inputs) -> dict:
    """Ways of PyTorch, each a fn(k); none where it is not installed."""
    try:
        import torch

        from ..torch_model import Inverse, tensor
    except ImportError:
        return {}
    torch.set_num_threads(1)
    network, memory = Inverse(model).eval(), tensor(np.zeros((model.memory.size, 1), np.float32))
    scale = tensor(np.asarray(model.scales.state, np.float32))[:, None]
    rows = tensor(inputs)[:, :, None]

    def step(wanted):
        scaled = wanted / scale
        return network(torch.cat([scaled[:-1], memory]), scaled)

    def stepping(run):
        def call(k):
            with torch.inference_mode():
                return float(run(rows[k % len(rows)]))

        return call

    return {"PyTorch eager": stepping(step), "PyTorch compiled": stepping(torch.compile(step, dynamic=False))}


def measure(seconds: float) -> dict:
    """The inverse is the row; decoder and peer beside it."""
    model = default()
    inputs = derivatives(target(5000), DT, 2).astype(np.float32)
    compile_s = once(lambda: inverse_step(model, DT).carry)
    taken = latencies(stepping(inverse_step(model, DT), inputs), _CALLS)
    volts = np.full((100, 1), 500.0, np.float32)
    decoder = latencies(stepping(decoder_step(model, DT), volts), _CALLS)
    others = {name: latencies(call, _CALLS // 10) for name, call in torch_steps(model, inputs).items()}
    peer = min(others, key=lambda name: np.median(others[name]), default=None)
    beside = None if peer is None else others[peer]
    median = None if beside is None else 1e3 * float(np.median(beside))
    found = summary(taken) | {"compile_s": compile_s}
    return {**found, "peer": peer, "peer_median_ms": median,
            "ratio": median and median / found["median_ms"], "inverse": tail(taken), "decoder": tail(decoder),
            "peer_tail": None if beside is None else tail(beside)}  # fmt: skip

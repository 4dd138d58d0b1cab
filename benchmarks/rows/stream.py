"""Streaming inversion of 10^6, 10^7 and 10^8 samples made in blocks: time and peak memory per length; default preset.

Linear time and flat memory show as equal nanoseconds per sample and equal peaks; on 10^6 samples the voltages are
compared with those of the whole path at once.
"""

import time

import numpy as np

from pitp_jax import invert_stream
from pitp_jax.method.invert.equation import invert_path, scaled_equation
from pitp_jax.method.numerics.spline_derivative import fast_derivatives

from ..clock import peak_mb, summary
from ..sizes import size
from ..subjects import DT, default, target

_BLOCK, _PERIOD = size((100_000, 200_000), (1000, 2000))  # the target repeats every 200 s
_LENGTHS = size((10**6, 10**7, 10**8), (10**4,))


def blocks(samples: int):
    """The target again and again."""
    whole = target(_PERIOD)
    for first in range(0, samples, _BLOCK):
        at = first % _PERIOD
        yield whole[at : at + _BLOCK]


def run(model, samples: int) -> tuple[float, int]:
    """Seconds, and how many voltages came."""
    began = time.perf_counter()
    count = sum(len(piece.voltage) for piece in invert_stream(model, blocks(samples), DT))
    return time.perf_counter() - began, count


def measure(seconds: float) -> dict:
    """The median is of repeated streams of 10^6; the others run once."""
    model = default()
    first, _ = run(model, _LENGTHS[0])
    times = [run(model, _LENGTHS[0])[0] for _ in range(5)]
    curve = []
    for samples in _LENGTHS:
        taken, count = run(model, samples)
        assert count == samples
        told = {"samples": samples, "seconds": taken, "ns_per_sample": 1e9 * taken / samples, "peak_mb": peak_mb()}
        curve.append(told)
    path = np.concatenate(list(blocks(_LENGTHS[0])))
    whole = np.asarray(invert_path(model, scaled_equation(model, fast_derivatives(path, DT, 2)), DT)[1])
    streamed = np.concatenate([piece.voltage for piece in invert_stream(model, blocks(_LENGTHS[0]), DT)])
    apart = np.abs(whole - streamed) / np.abs(whole).max()
    return {**summary(times, first), "peer": None, "peer_median_ms": None, "ratio": None, "samples": _LENGTHS[0],
            "curve": curve, "apart": float(apart.max()), "apart_p999": float(np.percentile(apart, 99.9))}  # fmt: skip

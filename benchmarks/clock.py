"""Times of several ways to do the same, taken in turn: first call apart, medians, nothing left in flight.

    compile_s = first call - median,    ratio = median of the peer / median of ours

What shares the machine slows every way alike when they take turns, so ratios hold where times do not. Between turns the
process rests: idle threads of one library spin for milliseconds and would be charged to the next.
"""

import resource
import time
from collections.abc import Callable

import jax
import numpy as np

_REST = 0.02  # s


class Skipped(Exception):
    """This row or peer cannot run here; the text says why."""


def peak_mb() -> int:
    """Most memory that this process has held so far, MB."""
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def once(run: Callable) -> float:
    """Seconds of one call, its result ready."""
    began = time.perf_counter()
    jax.block_until_ready(run())
    return time.perf_counter() - began


def take_turns(ways: dict[str, Callable], seconds: float, least: int = 5, most: int = 200) -> dict[str, dict]:
    """Per way: `median_ms`, `p10_ms`, `p90_ms`, `compile_s`, `runs`; in turns for about `seconds` in all."""
    first = {name: once(run) for name, run in ways.items()}
    times: dict[str, list[float]] = {name: [] for name in ways}
    began = time.perf_counter()
    while len(next(iter(times.values()))) < most:
        done = len(next(iter(times.values())))
        if done >= least and time.perf_counter() - began > seconds:
            break
        for name, run in ways.items():
            time.sleep(_REST)
            times[name].append(once(run))
    return {name: summary(taken, first[name]) for name, taken in times.items()}


def summary(seconds, first: float | None = None) -> dict:
    """Median and percentiles in ms; what the first call took beyond the median, in s."""
    low, middle, high = 1e3 * np.percentile(seconds, [10, 50, 90])
    extra = 0.0 if first is None else max(first - middle / 1e3, 0.0)
    return {"median_ms": float(middle), "p10_ms": float(low), "p90_ms": float(high), "compile_s": extra,
            "runs": len(seconds)}  # fmt: skip


def row(found: dict[str, dict], ours: str, peer: str | None, scale: dict[str, float] | None = None, **more) -> dict:
    """One row: our figures, those of the peer beside it, every other way's median under `others`.

    `scale`: factors for ways that were timed on a part of the work.
    """
    scaled = {name: f["median_ms"] * (scale or {}).get(name, 1.0) for name, f in found.items()}
    mine = found[ours]
    beside = scaled.get(peer) if peer else None
    others = {name: value for name, value in scaled.items() if name not in (ours, peer)}
    ratio = None if beside is None else beside / mine["median_ms"]
    return {**mine, "peer": peer, "peer_median_ms": beside, "ratio": ratio, "others": others, **more}

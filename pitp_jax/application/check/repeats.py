"""Find inputs that were played twice, and the difference of their responses, which no model can explain.

sigma^2 = mean (y_a - y_b - mean difference)^2 / 2       where  |u_a - u_b| < 1 % of its range
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...method.signal.record import Record
from .repeatability import repeat_scatter


@dataclass(frozen=True)
class Repeat:
    """Records with the same input: names, and scatter of the outputs (base unit, and % of range)."""

    names: tuple[str, ...]
    sigma: float
    percent: float  # of their range


def find_repeats(records: Sequence[Record], directions: Mapping[str, float]) -> list[Repeat]:
    """Group records with the same input; each record is in one group at most, and only the first 400 are compared."""
    others, groups = list(records[:400]), []
    while others:
        first = others.pop(0)
        same = [r for r in others if _same(first, r)]
        others = [r for r in others if not any(r is s for s in same)]
        if same:
            groups.append(_repeat([first, *same], directions))
    return groups


def _same(a: Record, b: Record) -> bool:
    if a.samples != b.samples or abs(a.dt / b.dt - 1) > 1e-3 or not np.ptp(a.voltage) > 0:
        return False
    return bool(np.abs(a.voltage - b.voltage).max() < 0.01 * np.ptp(a.voltage))


def _repeat(records: Sequence[Record], directions: Mapping[str, float]) -> Repeat:
    names = tuple(r.name for r in records)
    y = np.stack([directions.get(r.name, 1.0) * r.displacement for r in records])
    seen = np.isfinite(y).all(0)
    if seen.sum() < 2:
        return Repeat(names, float("nan"), float("nan"))
    y = y[:, seen] - y[:, seen].mean(1, keepdims=True)
    # sample by sample over the repeats, so that the common response cancels
    sigma = float(np.sqrt(np.mean(y.var(0, ddof=1))))
    span = float(np.median(np.ptp(y, axis=1)))
    return Repeat(names, sigma, 100 * sigma / span if span > 0 else float("nan"))


def cycles(records: Sequence[Record]) -> dict[str, float]:
    """Return the scatter of the output between cycles of a periodic input, % of range, by record name."""
    scatter = {}
    for r in records:
        y = np.where(r.observed, r.displacement, 0.0)
        square, span = repeat_scatter(r, y, r.observed), r.span
        if square is not None and span > 0:
            scatter[r.name] = 100 * float(np.sqrt(square)) / span
    return scatter

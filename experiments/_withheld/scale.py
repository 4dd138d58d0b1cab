"""The strength of a form from the gap it is to make.

    gap(p) = 100 sqrt(mean over records of (rms(y - healthy) / range(y))^2),    p: the first crossing of the target

Bracketed on a geometric grid of eight strengths, then on a finer one in the bracket (one compilation, eight lanes at a
time); the gap found is within some 10 % of the target. A form that cannot reach it stays where its gap is nearest.
"""

import numpy as np

from . import plant as integrator

_LANES = 8


def cut(rows, like) -> list[np.ndarray]:
    """Rows back to the length of each record."""
    return [np.asarray(row[: len(y)]) for row, y in zip(rows, like, strict=True)]


def gap(y, base) -> float:
    """Gap in % between outputs and healthy outputs; inf where the motion ran away."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a play may let nothing through
        shares = [np.mean((a - b) ** 2) / np.ptp(a) ** 2 for a, b in zip(y, base, strict=True)]
        large = max(np.abs(a).max() for a in y) > 100 * max(np.abs(b).max() for b in base)
        value = 100 * float(np.sqrt(np.mean(shares)))
    return np.inf if large or not np.isfinite(value) else value


def search(form, c, constants, inputs, base, target: float):
    """The strength whose gap is nearest the target, at its first crossing, and the outputs there."""
    low, high = form.span
    for _ in range(2):
        ps = np.geomspace(low, high, _LANES)
        lanes = integrator.outputs((form,), ps[:, None], (c,), constants, inputs)
        gaps = np.array([gap(cut(rows, base), base) for rows in lanes])
        finite = np.where(np.isfinite(gaps), gaps, -1.0)
        above = np.flatnonzero(gaps >= target)
        first = int(above[0]) if len(above) else int(finite.argmax())
        low, high = ps[max(first - 1, 0)], ps[first] if len(above) else ps[min(first + 1, _LANES - 1)]
    best = int(np.argmin(np.abs(np.log(np.maximum(finite, 1e-9) / target))))
    if finite[best] < 0:
        raise ValueError(f"{form.name}: every strength searched ran away")
    return float(ps[best]), cut(lanes[best], base)

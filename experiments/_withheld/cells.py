"""Where the effect truly was: cells of the drive's local frequency x the motion's local size, from the missing force.

    r = x'' + 2 zeta x' + x - u^2   along the noise-free motion with the effect, which the healthy equation lacks
    true cell: rms of r in it > 10 % of that of the loudest cell,        F1 = 2 hits / (flagged + true)

A record is cut where its drive crosses its mid-range, into parts of half a natural period or more and ten at most; a
part has the frequency crossings / (2 duration) and the size max |x| (m); what precedes the first crossing and follows
the last, if shorter, has no frequency and is left out. Edges are those that the diagnosis reports;
the lowest and highest take what lies beyond.
"""

import numpy as np

from .case import Case

_LOUD = 0.1


def parts(voltage: np.ndarray, rate: float, f0: float) -> list[tuple[int, int, float]]:
    """(first, last, Hz) of the parts of one record, from its voltage."""
    half, longest = rate / f0 / 2, 10 * rate / f0
    above = voltage > (voltage.max() + voltage.min()) / 2
    crossings = np.flatnonzero(above[1:] != above[:-1]) + 1
    cuts = [int(crossings[0]) if len(crossings) and crossings[0] < longest else 0]
    for end in [*map(int, crossings), len(voltage)]:
        pieces = int(np.ceil((end - cuts[-1]) / longest))
        if pieces > 1:
            cuts += [cuts[-1] + (end - cuts[-1]) * k // pieces for k in range(1, pieces + 1)]
        elif end - cuts[-1] >= half and end < len(voltage):
            cuts.append(end)
    pairs = zip(cuts[:-1], cuts[1:], strict=True)
    return [(a, b, ((crossings > a) & (crossings <= b)).sum() / 2 * rate / (b - a)) for a, b in pairs]


def loudness(case: Case, cells: list[dict]) -> np.ndarray:
    """Rms of the missing force in every cell, shape (cells,); zero where no part of a record is.

    Args:
        case: with its missing force (`locate=True`).
        cells: `where.cells` of a diagnosis: `band_hz`, `amplitude` (m).
    """
    bands, sizes = (_open([tuple(c[axis]) for c in cells]) for axis in ("band_hz", "amplitude"))
    energy, count = np.zeros((2, len(cells)))
    for record in case.real:
        force, y = case.missing[record.name], np.abs(case.true[record.name])
        for a, b, hz in parts(record.voltage, 1 / record.dt, case.facts["f0_hz"]):
            here = [
                k
                for k, (f, s) in enumerate(zip(bands, sizes, strict=True))
                if f[0] <= hz < f[1] and s[0] <= y[a:b].max() < s[1]
            ]
            energy[here] += np.sum(force[a:b] ** 2)
            count[here] += b - a
    return np.sqrt(energy / np.maximum(count, 1))


def _open(edges):
    """Intervals, the lowest and highest reaching to 0 and to infinity."""
    low, high = min(a for a, _ in edges), max(b for _, b in edges)
    return [(0.0 if a == low else a, np.inf if b == high else b) for a, b in edges]


def f1(case: Case, cells: list[dict]) -> float | None:
    """F1 of `flagged` against the cells where the effect truly was loud; None without cells."""
    if not cells:
        return None
    rms, flagged = loudness(case, cells), np.array([bool(c["flagged"]) for c in cells])
    loud = rms > _LOUD * max(rms.max(), 1e-300)
    return float(2 * (flagged & loud).sum() / max(flagged.sum() + loud.sum(), 1))

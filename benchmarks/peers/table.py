"""Scores and the table: free-run errors of every peer with the floor taken out, beside ours.

    ratio = median floor-free e (peer) / median floor-free e (ours)

Medians over the held-out records that repeat no training cell, and apart from them over those that do.
"""

import time

import numpy as np

import pitp_jax as pitp

from . import OURS, PEERS
from .bench import floor_free

WANTED = {False: 0.5, True: 0.25}  # ours over the best peer that cannot be inverted, and over the best that can
_HEAD = (
    f"{'peer':20s} {'fit s':>6s} {'inv':>4s} | {'held-out':>8s} {'worst':>7s} {'no floor':>8s} {'/ours':>6s} |"
    f" {'repeats':>8s} {'worst':>7s} {'no floor':>8s} {'/ours':>6s}"
)


def score(predictor, bench) -> dict:
    """Per test record e_rms %, floor % and the floor-free error %."""
    rows = {}
    for record in bench.test:
        error = pitp.e_rms_percent(predictor(record), record.displacement)
        floor = bench.floor_percent(record)
        free = floor_free(error, floor, record.samples) if np.isfinite(floor) else error
        rows[record.name] = {
            "e_rms": error,
            "floor": floor,
            "free": free,
            "repeat": record.name in bench.noise,
        }
    return rows


def measure(peer, nominal, bench, seconds: float, key) -> dict:
    """One row: fit time and scores."""
    fit, began = peer.fit, time.perf_counter()
    predictor = fit(nominal, bench.train, seconds, key, **peer.options)
    return {"fit_s": time.perf_counter() - began, "invertible": peer.invertible, "records": score(predictor, bench)}


def summary(row: dict, repeat: bool) -> tuple[float, float, float] | None:
    """Median and worst e_rms %, median floor-free %, over one kind of record."""
    chosen = [r for r in row["records"].values() if r["repeat"] == repeat]
    if not chosen:
        return None
    errors = [r["e_rms"] for r in chosen]
    return float(np.median(errors)), max(errors), float(np.median([r["free"] for r in chosen]))


def line(name: str, row: dict, ours: dict | None) -> str:
    """One row as text."""
    if "skipped" in row:
        return f"{name:20s} skipped: {row['skipped']}"
    text = f"{name:20s} {row['fit_s']:6.0f} {'yes' if row['invertible'] else 'no':>4s}"
    for repeat in (False, True):
        found, own = summary(row, repeat), ours and summary(ours, repeat)
        if found is None:
            continue
        ratio = f"{found[2] / own[2]:6.1f}" if own else f"{'-':>6s}"
        text += f" | {found[0]:8.3f} {found[1]:7.2f} {found[2]:8.3f} {ratio}"
    return text


def verdicts(rows: dict) -> list[str]:
    """Ours over the best peer of either kind, beside what is wanted."""
    ours, lines = rows.get(OURS), []
    for invertible, wanted in WANTED.items():
        free = {
            name: summary(row, False)[2]
            for name, row in rows.items()
            if name != OURS and "records" in row and row["invertible"] == invertible
        }
        if not free or not ours or "records" not in ours:
            continue
        best = min(free, key=free.get)
        kind = "can" if invertible else "cannot"
        ratio = summary(ours, False)[2] / free[best]
        lines.append(f"ours over the best peer that {kind} be inverted ({best}): {ratio:.2f} (wanted: {wanted})")
    return lines


def text(case: str, rows: dict) -> str:
    """The table of one bench, in the order of the registry."""
    ours = rows.get(OURS)
    ours = ours if ours and "records" in ours else None
    counted = next((r["records"] for r in rows.values() if "records" in r), {})
    twins = sum(r["repeat"] for r in counted.values())
    lines = [
        f"\n{case}: e_rms %, {len(counted) - twins} held-out records and {twins} repeats of a training cell",
        _HEAD,
    ]
    lines += [line(p.name, rows[p.name], ours) for p in PEERS if p.name in rows]
    return "\n".join(lines + verdicts(rows))

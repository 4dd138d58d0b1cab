"""Differences planted between two simulated actuators, and what `compare` prints about them.

    python experiments/planted_differences.py [--actuators 3] [--seed 700]

Every actuator gives one sweep before and one after a change. `identify` fits a linear model to each, and `compare`
gets both models. A gain g divides all coefficients by g. Odd seeds have a hardening spring, which a linear model lacks.
"""

import argparse
from dataclasses import replace

import numpy as np
from _hardening import Plant, record, sweep
from _show import show

import pitp_jax as pitp

CHANGES: dict[str, dict[str, float]] = {
    "none": {}, "stiffness": {"stiffness": 1.08}, "damping": {"damping": 1.3}, "gain": {"gain": 0.9},
    "delay": {"delay": 9e-3}, "stiffness, damping": {"stiffness": 0.93, "damping": 0.8},
}  # fmt: skip


def drawn(seed: int) -> tuple[Plant, np.random.Generator]:
    """Draw an actuator."""
    rng = np.random.default_rng(seed)
    omega, zeta = (
        2 * np.pi * np.exp(rng.uniform(np.log(2.5), np.log(7))),
        np.exp(rng.uniform(np.log(0.05), np.log(0.3))),
    )
    return Plant(omega, zeta, hardening=0.3 if seed % 2 else 0.0), rng


def one(seed: int, change: str) -> list[tuple]:
    """Rows of one change: the three coefficients and the delay, the true factor beside the printed one."""
    plant, rng = drawn(seed)
    by = CHANGES[change]
    records = [record(p, "sweep", sweep(), rng) for p in (plant, replace(plant, **by))]
    found = pitp.compare(*(pitp.identify([r], order=2) for r in records))
    rows, printed = [], {r.what: r for r in found.rows}
    gain = by.get("gain", 1.0)
    true = {"stiffness (a0)": by.get("stiffness", 1.0), "damping (a1)": by.get("damping", 1.0), "inertia (a2)": 1.0}
    for what, factor in true.items():
        row, factor = printed[what], factor / gain
        low, high = (1 + end / row.a for end in row.ci95)
        inside = low <= factor <= high
        judged = "differs" if row.differs else "alike"
        rows.append((seed, change, what, f"{factor:.3f}", f"{row.b / row.a:.3f}", f"{low:.3f} to {high:.3f}",
                     "yes" if inside else "no", judged))  # fmt: skip
    late = [r for r in found.rows if r.what.startswith("delay")]
    if late or "delay" in by:
        found_ms = sum(1e3 * (float(r.b or 0) - float(r.a or 0)) for r in late)
        judged = "differs" if late and late[0].differs else "-"
        true_ms = f"{1e3 * by.get('delay', 0.0):.1f}"
        rows.append((seed, change, "delay (ms)", true_ms, f"{found_ms:.2f}", "-", "-", judged))
    return rows


def main(smoke: bool = False, argv=None):
    """All actuators and changes, then the sums."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--actuators", type=int, default=3)
    parser.add_argument("--seed", type=int, default=700)
    parser.add_argument("--smoke", action="store_true", help="quick and meaningless")
    options = parser.parse_args([] if smoke and argv is None else argv)
    smoke = smoke or options.smoke
    rows = []
    for seed in range(options.seed, options.seed + (1 if smoke else options.actuators)):
        for change in ["stiffness"] if smoke else CHANGES:
            rows += one(seed, change)
    header = ("seed", "change", "quantity", "true factor", "found", "interval of 95 %", "covers", "compare")
    show("planted differences", header, rows)
    judged = [r for r in rows if r[6] != "-"]
    moved = [r for r in judged if r[3] != "1.000"]
    still = [r for r in judged if r[3] == "1.000"]
    print(f"intervals cover the truth: {sum(r[6] == 'yes' for r in judged)} of {len(judged)}")
    print(f"changed coefficients called different: {sum(r[7] == 'differs' for r in moved)} of {len(moved)}; "
          f"unchanged ones called different: {sum(r[7] == 'differs' for r in still)} of {len(still)}")  # fmt: skip
    return rows


if __name__ == "__main__":
    main()

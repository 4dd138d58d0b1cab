"""The guard of a plan: which files it allows on 20 simulated actuators with a limit of stroke, and how far they move.

    x'' + 2 zeta w x' + w^2 (x + h x^3) = w^2 u^2,   limit = 0.6 to 1.2 of the largest stroke of all files

    python experiments/planned_strokes.py [--actuators 20] [--seed 0]

A first session is played in its order: a file only if the largest stroke so far is below what the plan asks for. A
linear model is identified on the files that were played, and a plan with this model and its default rest is played the
same way. A file is harmless where its true stroke, from where the file before it ended, is below the limit.
"""

import argparse

import numpy as np
from _show import show

import pitp_jax as pitp

TOP, UNIT = 3000.0, 1e-3  # V, m


def moved(u: np.ndarray, dt: float, rest: float, plant, start: tuple[float, float]):
    """Displacement (m) under a voltage, and the state after a rest at 0 V: Heun's method, four steps a sample."""
    w, zeta, hard = plant
    x, v = start
    h, out = dt / 4, np.empty(len(u))
    force = (np.append(u, np.zeros(int(rest / dt))) / TOP) ** 2

    def acceleration(x, v, f):
        return w * w * (f - x - hard * x**3) - 2 * zeta * w * v

    for k, f in enumerate(force):
        if k < len(u):
            out[k] = x
        for _ in range(4):
            a = acceleration(x, v, f)
            x1, v1 = x + h * v, v + h * a
            x, v = x + h / 2 * (v + v1), v + h / 2 * (a + acceleration(x1, v1, f))
    return UNIT * out, (x, v)


def played(found, limit: float, plant):
    """Counts of a plan's files, played in order, the records taken, and (printed, true) strokes of those."""
    dt, largest, state = 1 / found.limits.rate, 0.0, (0.0, 0.0)
    counts, records, strokes = {"allowed": 0, "harmless": 0, "harmless allowed": 0, "worst": 0.0}, [], []
    for r in found.recordings:
        x, after = moved(r.voltage, dt, r.rest, plant, state)
        reached, allowed = float(np.abs(x).max()), largest <= r.go_on
        harmless = reached <= limit
        counts["harmless"] += harmless
        counts["harmless allowed"] += harmless and allowed
        if allowed:
            state, largest = after, max(largest, reached)
            counts["allowed"] += 1
            counts["worst"] = max(counts["worst"], reached / limit)
            noise = 2e-3 * UNIT * np.random.default_rng(len(records)).standard_normal(len(x))
            records.append(pitp.Record(r.name, r.time, r.voltage, x + noise))
            strokes.append((r.stroke, reached))
    return counts, records, strokes


def one(seed: int, duration: float) -> tuple:
    """Rows of one actuator: first session, and plan with a linear model."""
    rng = np.random.default_rng(seed)
    hz, zeta = np.exp(rng.uniform(np.log(2), np.log(8))), np.exp(rng.uniform(np.log(0.03), np.log(0.3)))
    plant = 2 * np.pi * hz, zeta, rng.uniform(0, 0.5)
    rig = {"max_voltage": TOP, "band": (0.5, 10.0), "rate": 400.0, "duration": duration, "seed": seed}
    free = pitp.plan(**rig)
    most = max(np.abs(moved(r.voltage, 1 / 400, 0.0, plant, (0.0, 0.0))[0]).max() for r in free.recordings)
    limit = most * rng.uniform(0.6, 1.2)
    first, records, _ = played(pitp.plan(**rig, max_displacement=limit), limit, plant)
    model = pitp.identify(records, order=2).model
    try:
        again = pitp.plan(model, max_voltage=TOP, max_displacement=limit, duration=duration, rate=400.0, seed=seed)
        second, _, strokes = played(again, limit, plant)
    except pitp.BadInput:
        second, strokes = {"allowed": 0, "harmless": 0, "harmless allowed": 0, "worst": 0.0}, []
    near = [abs(printed / true - 1) for printed, true in strokes]
    return hz, zeta, plant[2], limit / UNIT, first, second, near


def main(smoke: bool = False, argv=None):
    """All actuators, then the table and its sums."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--actuators", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="of the first actuator")
    parser.add_argument("--smoke", action="store_true", default=smoke)
    options = parser.parse_args([] if smoke and argv is None else argv)
    count, duration = (1, 24.0) if options.smoke else (options.actuators, 40.0)
    cells = [one(options.seed + k, duration) for k in range(count)]
    rows = []
    for seed, (hz, zeta, hard, limit, first, second, near) in enumerate(cells):
        said = [f"{c['harmless allowed']} of {c['harmless']}" for c in (first, second)]
        worst = first["worst"], second["worst"]
        within = f"{sum(e <= 0.1 for e in near)} of {len(near)}"
        rows.append((str(options.seed + seed), hz, zeta, hard, limit, said[0], worst[0], said[1], worst[1], within))
    header = (
        "actuator", "Hz", "zeta", "hardening", "limit (mm)", "first: harmless allowed", "first: worst / limit",
        "model: harmless allowed", "model: worst / limit", "printed stroke within 10 %",
    )  # fmt: skip
    show("files that a plan allows", header, rows)
    for k, name in ((4, "first session"), (5, "with a linear model")):
        allowed, all_ = (sum(c[k][word] for c in cells) for word in ("harmless allowed", "harmless"))
        worst = max(c[k]["worst"] for c in cells)
        print(f"{name}: {allowed} of {all_} harmless files allowed, worst {worst:.3f} of the limit")
    near = [e for c in cells for e in c[6]]
    print(f"printed stroke within 10 %: {sum(e <= 0.1 for e in near)} of {len(near)}")
    return rows


if __name__ == "__main__":
    main()

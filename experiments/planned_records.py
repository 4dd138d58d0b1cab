"""Planned recordings beside random ones, by the held-out error of what is fitted on them.

    session   sweep -> nominal -> plan(nominal, 60 s cone, 12 s roll) -> fit;  beside sines drawn from the paper's grid
    next      fit on 3 grid sines -> plan ranks the other 27 -> fit with the best;  beside one drawn at random
    free      the same, but plan is free to make the next recording of that length
    so101     fit on 1 motion -> plan ranks 5 others -> fit with the best;  beside one drawn;  judged on 3 never offered

    python experiments/planned_records.py session next free so101 [--plants cone100 roll] [--seeds 100 101 ...]
        [--data ../shared] [--smoke]

Errors are e_rms in % of range against the noise-free output (so101: against the measurement). Seeds below 100 tuned the
planner, those from 100 on are reported. `next` and `free` use records of 5 s at 250 Hz and 15 steps on free runs, so
that twenty trials take minutes.
"""

import argparse
from pathlib import Path

import jax
import numpy as np
from _show import show

import pitp_jax as pitp
from pitp_jax.application.plan.expected_error import information, knowledge
from pitp_jax.application.plan.next_recordings import variance

BAND = {"cone": (0.5, 10.0), "roll": (5.0, 130.0)}
SECONDS = {"cone": 60.0, "roll": 12.0}
QUICK = pitp.Settings(epochs=4, stages=2, refine_steps=15)
SMOKE = pitp.Settings(epochs=1, stages=1, refine_steps=1)
RATE, LENGTH = 250.0, 5.0  # of `next` and `free`


def kind(plant: str) -> str:
    """Cone or roll."""
    return "roll" if plant == "roll" else "cone"


def measured(actuator, drives, seed: int, *, noise: bool = True) -> list[pitp.Record]:
    """Drives (name, time, voltage) recorded on a virtual actuator."""
    return [pitp.record(actuator, n, t, u, seed=seed, noise=noise) for n, t, u in drives]


def protocol(plant: str, part: str):
    """The paper's drives of a part."""
    return [(e.name, e.time, e.voltage) for e in pitp.excitation.protocol(kind(plant), part)]


def errors(model, test) -> np.ndarray:
    """Of free runs, % of range."""
    return np.array(
        [pitp.e_rms_percent(p.displacement, r.displacement, p.scored)
         for p, r in zip(pitp.predict(model, test), test, strict=True)]
    )  # fmt: skip


def fitted(nominal, records, seed: int, settings) -> pitp.Model:
    """A trained model."""
    return pitp.train(nominal, records, settings=settings, key=jax.random.key(seed)).model


def best_of(model, records, pool) -> pitp.Record:
    """The recording of a pool whose voltage lowers the expected error on all of them most."""
    known, dt = knowledge(model.model, records), pool[0].dt
    found = information(model.model, [r.voltage for r in pool], dt, known.floor)
    offered = [r.samples * dt * m for r, m in zip(pool, found, strict=True)]
    predicted = np.mean(found, axis=0)
    return pool[int(np.argmin([variance(known.precision + m, predicted) for m in offered]))]


def session(plant: str, seeds, settings) -> None:
    """Planned drive after the sweep, beside random sines of the paper's grid of equal length."""
    actuator, rows = pitp.plant(plant), []
    sweep = measured(actuator, protocol(plant, "sweep"), seeds[0])
    nominal, grid = pitp.identify(sweep).model, protocol(plant, "train")
    test, seconds = measured(actuator, protocol(plant, "test"), 0, noise=False), SECONDS[kind(plant)]
    top = max(float(u.max()) for _, _, u in grid)
    for seed in seeds:
        found = pitp.plan(nominal, sweep, band=BAND[kind(plant)], max_voltage=top, duration=seconds, seed=seed)
        planned = [(r.name, r.time, r.voltage) for r in found.recordings]
        count = round(seconds / (len(grid[0][1]) / actuator.rate_hz))
        drawn = [grid[k] for k in np.random.default_rng(seed).choice(len(grid), count, replace=False)]
        e = [errors(fitted(nominal, measured(actuator, d, seed), seed, settings), test) for d in (planned, drawn)]
        rows.append((seed, *(float(np.median(x)) for x in e), *(float(x.max()) for x in e)))
        print(plant, "seed, planned, random (medians), worst:", *(f"{v:.3g}" for v in rows[-1]), flush=True)
    table = np.array(rows)
    rows.append(("median", *np.median(table[:, 1:], axis=0)))
    show(
        f"{plant}, {seconds:g} s after the sweep, {100 * np.median(table[:, 1] / table[:, 2]):.0f} % of random's error",
        ("seed", "planned", "random", "planned, worst", "random, worst"), rows,
    )  # fmt: skip


def short(drives):
    """Grid sines of 5 s at 250 Hz."""
    step = round(1e3 / RATE)
    return [(n, t[: int(LENGTH * 1e3) : step], u[: int(LENGTH * 1e3) : step]) for n, t, u in drives]


def following(seeds, settings, *, free: bool) -> None:
    """The next recording by plan, beside a random one."""
    actuator, rows = pitp.plant("cone100"), []
    sweep = [(n, t[::4], u[::4]) for n, t, u in protocol("cone100", "sweep")]
    nominal, grid = pitp.identify(measured(actuator, sweep, 1), order=2).model, short(protocol("cone100", "train"))
    test = measured(actuator, short(protocol("cone100", "test")), 0, noise=False)
    for seed in seeds:
        rng = np.random.default_rng(seed)
        first, *others = np.split(rng.permutation(len(grid)), [3])
        records = measured(actuator, [grid[k] for k in first], seed)
        pool = measured(actuator, [grid[k] for k in others[0]], seed)
        base = fitted(nominal, records, seed, settings)
        how = {"duration": LENGTH, "band": BAND["cone"], "max_voltage": 6000.0}
        best = pitp.plan(base, records, seed=seed, **how).recordings[0] if free else best_of(base, records, pool)
        chosen = measured(actuator, [(best.name, best.time, best.voltage)], seed)
        drawn = [pool[rng.integers(len(pool))]]
        e = [np.median(errors(fitted(nominal, records + more, seed, settings), test)) for more in (chosen, drawn)]
        rows.append((seed, best.name, drawn[0].name, float(np.median(errors(base, test))), *map(float, e)))
        print(*rows[-1], flush=True)
    better = sum(r[4] < r[5] for r in rows)
    title = f"next recording, {'free' if free else 'of the grid'}: better than random in {better} of {len(rows)}"
    show(title, ("seed", "chosen", "random", "before", "chosen", "random"), rows)


def so101(data: Path, seeds, settings) -> None:
    """The next of the motions that exist, beside a random one."""
    if not (data / "data/so101").is_dir():
        print(f"so101: skipped, {data} has no data/so101")
        return
    rows = []
    for seed in seeds:
        joint = ("elbow", "pitch")[seed % 2]
        motions = list(pitp.read(data / "data/so101" / joint))
        rng = np.random.default_rng(seed)
        order = rng.permutation(len(motions))
        size = min(m.samples for m in motions)
        cut = [pitp.Record(m.name, m.time[:size], m.voltage[:size], m.displacement[:size]) for m in motions]
        test, first, pool = [motions[k] for k in order[:3]], [cut[order[3]]], [cut[k] for k in order[4:9]]
        nominal = pitp.identify(first, order=2, input_map="linear").model
        base = fitted(nominal, first, seed, settings)
        name = best_of(base, first, pool).name
        drawn = pool[rng.integers(len(pool))].name
        e = {m.name: np.median(errors(fitted(nominal, [*first, m], seed, settings), test)) for m in pool}
        rank = sorted(e, key=lambda n: float(e[n])).index(name) + 1
        mean = float(np.mean(list(e.values())))
        rows.append((seed, joint, first[0].name, name, drawn, float(e[name]), float(e[drawn]), mean, rank))
        print(*rows[-1], flush=True)
    better = sum(r[5] < r[7] for r in rows)
    title = f"so101: better than a random motion's mean in {better} of {len(rows)}"
    show(title, ("seed", "joint", "first", "chosen", "random", "chosen", "random", "mean of all", "rank of 5"), rows)


def main(smoke: bool = False, argv=None):
    """Run the parts named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", default=["next"], help="session, next, free, so101")
    parser.add_argument("--plants", nargs="+", default=["cone100", "roll"])
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(100, 110)))
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    parser.add_argument("--smoke", action="store_true")
    options = parser.parse_args([] if smoke and argv is None else argv)
    smoke, quick = smoke or options.smoke, SMOKE if smoke or options.smoke else QUICK
    seeds = options.seeds[:1] if smoke else options.seeds
    for part in options.parts:
        if part == "session":
            for plant in options.plants:
                session(plant, seeds, SMOKE if smoke else pitp.Settings())
        elif part == "so101":
            so101(options.data, seeds, quick)
        else:
            following(seeds, quick, free=part == "free")


if __name__ == "__main__":
    main()

"""A model handed back, played on a load or an amplitude that no recording had: it must not be worse than the nominal.

    clean -> identify -> nominal;   real (two loads, or small motions) -> diagnose -> model;   held out -> both errors

    python experiments/another_load.py [SET ...] [--seed 1] [--out sets.jsonl] [--smoke]

Sets: real recordings with two added masses and held out with a third, twice the larger; real recordings at half of the
amplitude and held out at the whole of it. The actuators are those of `effect_pairs.py`. Finished sets are read from
--out. Errors are in % of the range of the held-out recordings.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from _smoke import all_but
from effect_pairs import KINDS, Plant, commands, played

import pitp_jax as pitp

# by name: kind, effects of the real actuator, its added masses while recorded and held out, and amplitude recorded
SETS = {
    "two loads": ("cone", {}, (0.0, 0.4), 0.8, 1.0),
    "two loads, creep": ("cone", {"creep": (0.15, 0.7)}, (0.1, 0.5), 1.0, 1.0),
    "two loads, friction": ("roll", {"friction": 0.04}, (0.0, 0.4), 0.8, 1.0),
    "small, stiffening": ("cone", {"cubic": 0.4}, (0.0,), 0.0, 0.5),
    "small, softening": ("cone", {"quadratic": -0.2}, (0.0,), 0.0, 0.5),
    "small, friction": ("roll", {"friction": 0.03, "cubic": 0.3}, (0.0,), 0.0, 0.5),
}


def error(model, records) -> float:
    """Return the free-run error in % of range, pooled over recordings, each with its own sensor offset."""
    squares = []
    for p, r in zip(pitp.predict(model, records), records, strict=True):
        e = p.displacement - r.displacement
        squares.append(np.var(e) / np.ptp(r.displacement) ** 2 if np.isfinite(e).all() else np.inf)
    return 100 * float(np.sqrt(np.mean(squares)))


def run(name: str, seed: int, shorter: float = 1.0) -> dict:
    """Diagnose one set and judge both models on what was held out."""
    kind, effects, loads, other, size = SETS[name]
    hertz, zeta, rate, seconds, volts, stroke = KINDS[kind]
    rng = np.random.default_rng([seed, list(SETS).index(name)])
    healthy = Plant(hertz * rng.uniform(0.85, 1.15), zeta * rng.uniform(0.7, 1.4))
    u = commands(rng, hertz, rate, seconds * shorter)
    small, unseen = np.sqrt(size) * u, commands(rng, hertz, rate, seconds * shorter)[:, [0, 3, 5, 6]]

    def recorded(plant: Plant, voltage: np.ndarray, label: str) -> list[pitp.Record]:
        x = stroke * (played(plant, voltage, rate) + 5e-4 * rng.standard_normal(voltage.shape))
        t = np.arange(len(voltage)) / rate
        return [pitp.Record(f"{label}{k}", t, volts * voltage[:, k], x[:, k]) for k in range(voltage.shape[1])]

    nominal = pitp.identify(recorded(healthy, small, "clean"), order=2, input_map="square").model
    chosen = [range(k, 8, len(loads)) for k in range(len(loads))]  # the recordings of each load
    real = []
    for k, (load, mine) in enumerate(zip(loads, chosen, strict=True)):
        real += recorded(replace(healthy, **effects, mass=load), small[:, list(mine)], f"load{k}_")
    began = time.process_time()
    others = all_but("added_mass", "creep") if shorter < 1 else []
    found = pitp.diagnose(nominal, real, refit_nominal=False, exclude=others)
    spent = time.process_time() - began
    held_out = recorded(replace(healthy, **effects, mass=other), unseen, "held_out")
    before, after = error(nominal, held_out), error(found.model, held_out)
    return {
        "set": name, "seed": seed, "verdict": found.verdict, "effects": list(found.effects),
        "handed_back": list(found.handed_back), "recorded": [error(nominal, real), error(found.model, real)],
        "held_out": [before, after], "cpu_s": spent,
    }  # fmt: skip


def main() -> None:
    """Print a row a set, then how many are worse."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("sets", nargs="*", help=f"parts of their names; all: {'; '.join(SETS)}")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--smoke", action="store_true")
    options = parser.parse_args()
    kept = options.out.read_text().splitlines() if options.out and options.out.is_file() else []
    rows = {row["set"]: row for row in map(json.loads, kept) if row["seed"] == options.seed}
    wanted = [name for name in SETS if not options.sets or any(part in name for part in options.sets)]
    for name in wanted[: 1 if options.smoke else None]:
        if name not in rows:
            rows[name] = run(name, options.seed, 0.25 if options.smoke else 1.0)
            if options.out:
                with open(options.out, "a") as file:
                    file.write(json.dumps(rows[name]) + "\n")
        r = rows[name]
        print(f"{name:22} {r['verdict']:9} {'+'.join(r['handed_back']) or '-':34} recorded {r['recorded'][0]:.2f} -> "
              f"{r['recorded'][1]:.2f} %, held out {r['held_out'][0]:.2f} -> {r['held_out'][1]:.2f} %  "
              f"{r['cpu_s']:.0f} CPU s", flush=True)  # fmt: skip
    worse = sum(r["held_out"][1] > 1.02 * r["held_out"][0] for r in rows.values())
    print(f"worse than the nominal by more than 2 % of its error: {worse} of {len(rows)}")


if __name__ == "__main__":
    main()

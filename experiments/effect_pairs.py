"""Two effects at once on simulated actuators of other equations than the package's, and a spring of either curvature.

    x'' + 2 zeta w x' + w^2 (x + spring) = w^2 (coupled force - friction - branch),  inertia x (1 + d)

    python experiments/effect_pairs.py [CELL ...] [--seed 1] [--out pairs.jsonl] [--smoke]

Cells: four pairs (creep with electrode_rc, stiffening with coulomb_friction, added_mass with creep, stretch_coupling
with delay) on a cone and a roll, and k (x + c2 x^2) with c2 of either sign on both. Sizes are drawn by the seed. A
semi-implicit scheme of 40 steps a sample integrates; the nominal model is identified on the actuator without effects.
A row has, of each planted effect, how it was reported: certain, tied, likely or not at all; and what was reported that
was not planted (a likely one counts half). Finished cells are read from --out.
"""

import argparse
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from _smoke import all_but

import pitp_jax as pitp

PAIRS = {
    "creep+electrode_rc": ("creep", "lag"),
    "stiffening+coulomb_friction": ("cubic", "friction"),
    "added_mass+creep": ("mass", "creep"),
    "stretch_coupling+delay": ("stretch", "delay"),
    "softening": ("soft",),
    "stiffening": ("hard",),
}
NAMES = {
    "creep": "creep", "lag": "electrode_rc", "cubic": "stiffening", "friction": "coulomb_friction",
    "mass": "added_mass", "stretch": "stretch_coupling", "delay": "delay", "soft": "softening", "hard": "stiffening",
}  # fmt: skip
KINDS = {"cone": (7.4, 0.07, 250.0, 6.0, 2000.0, 4e-3), "roll": (140.0, 0.03, 5000.0, 0.4, 500.0, 4e-4)}
STEPS = 40  # a sample


@dataclass(frozen=True)
class Plant:
    """Frequency (Hz), damping ratio, and effects in units of the largest displacement and of the natural period."""

    hertz: float
    zeta: float
    creep: tuple[float, float] = (0.0, 1.0)
    lag: float = 0.0
    cubic: float = 0.0
    quadratic: float = 0.0
    friction: float = 0.0
    mass: float = 0.0
    stretch: float = 0.0
    delay: float = 0.0


def drawn(rng, plant: Plant, parts: tuple[str, ...]) -> Plant:
    """Return the plant with effects of random sizes."""
    w = 2 * np.pi * plant.hertz
    sizes = {
        "creep": {"creep": (rng.uniform(0.08, 0.2), rng.uniform(25, 60) / w)},
        "lag": {"lag": rng.uniform(0.15, 0.4) / w},
        "cubic": {"cubic": rng.uniform(0.2, 0.5)}, "friction": {"friction": rng.uniform(0.02, 0.05)},
        "mass": {"mass": rng.uniform(0.1, 0.3)}, "stretch": {"stretch": rng.uniform(0.15, 0.35)},
        "delay": {"delay": rng.uniform(0.2, 0.5) / w}, "soft": {"quadratic": -rng.uniform(0.12, 0.25)},
        "hard": {"quadratic": rng.uniform(0.12, 0.25)},
    }  # fmt: skip
    for part in parts:
        plant = replace(plant, **sizes[part])
    return plant


def commands(rng, hertz: float, rate: float, seconds: float) -> np.ndarray:
    """Return eight voltages in [0, 1], shape (samples, 8)."""
    t, n = np.arange(round(rate * seconds)) / rate, round(rate * seconds)
    top = 1.8 * hertz
    waves = [np.sin(2 * np.pi * (0.05 * hertz * t + (top - 0.05 * hertz) * t**2 / 2 / seconds))]
    waves += [np.sin(2 * np.pi * f * hertz * t) for f in (0.12, 0.45, 0.8, 1.3)]
    waves += [np.repeat(rng.uniform(-1, 1, 8), -(-n // 8))[:n]]
    waves += [np.interp(t, s := np.arange(0, seconds + 1 / hertz, 0.4 / hertz), rng.uniform(-1, 1, len(s)))]
    waves += [np.interp(t, [0, 0.1 * seconds, 0.5 * seconds, 0.6 * seconds, seconds], [-1, 1, 1, -0.5, -0.5])]
    sizes = np.array([0.7, 0.95, 0.8, 0.5, 0.8, 0.9, 0.9, 0.8])
    # the mean force first, so that every record begins at rest
    return (0.5 + 0.5 * sizes * np.array(waves).T) * np.clip(t * hertz, 0, 1)[:, None]


def played(plant: Plant, voltage: np.ndarray, rate: float) -> np.ndarray:
    """Return the displacement (of the static one at full voltage), shape (samples, records)."""
    w, h, tau = 2 * np.pi * plant.hertz, 1 / rate / STEPS, plant.creep[1]
    x, v, z, film = np.zeros((4, voltage.shape[1]))
    out, last = np.empty(voltage.shape), len(voltage) - 1
    for k in range(len(voltage)):
        out[k] = x
        for j in range(STEPS):
            place = max(k + (j + 0.5) / STEPS - plant.delay * rate, 0.0)
            a, part = int(place), place - int(place)
            u = voltage[min(a, last)] * (1 - part) + voltage[min(a + 1, last)] * part
            film = u if not plant.lag else film + (1 - np.exp(-h / plant.lag)) * (u - film)
            spring = x + plant.cubic * x**3 + plant.quadratic * x**2 + plant.creep[0] * (x - z)
            force = w**2 * (film**2 * (1 + plant.stretch * x) - spring) - 2 * plant.zeta * w * v
            v = v + h * force / (1 + plant.mass)
            most = h * w**2 * plant.friction / (1 + plant.mass)
            v = np.sign(v) * np.maximum(np.abs(v) - most, 0.0)
            x, z = x + h * v, z + h / tau * (x - z)
    return out


def run(kind: str, pair: str, seed: int, shorter: float = 1.0) -> dict:
    """Diagnose one cell."""
    hertz, zeta, rate, seconds, volts, stroke = KINDS[kind]
    rng = np.random.default_rng([seed, sorted(KINDS).index(kind), list(PAIRS).index(pair)])
    healthy = Plant(hertz * rng.uniform(0.85, 1.15), zeta * rng.uniform(0.7, 1.4))
    plant = drawn(rng, healthy, PAIRS[pair])
    u = commands(rng, hertz, rate, seconds * shorter)

    def recorded(one: Plant) -> list[pitp.Record]:
        x = stroke * (played(one, u, rate) + 5e-4 * rng.standard_normal(u.shape))
        t = np.arange(len(u)) / rate
        return [pitp.Record(f"r{k}", t, volts * u[:, k], x[:, k]) for k in range(u.shape[1])]

    nominal, began = pitp.identify(recorded(healthy), order=2, input_map="square").model, time.process_time()
    others = all_but(*(NAMES[p] for p in PAIRS[pair])) if shorter < 1 else []
    d = pitp.diagnose(nominal, recorded(plant), refit_nominal=False, exclude=others)
    truth, how = [NAMES[p] for p in PAIRS[pair]], {}
    for part in d.parts:
        for name in {part.effect, *part.tied} & {*truth}:
            how.setdefault(name, part.certainty if name == part.effect else "tied")
    reported = [p for p in d.parts if p.certainty in ("certain", "likely", "tied")]
    false = [p for p in reported if not {p.effect, *p.tied} & {*truth}]
    return {
        "cell": f"{kind} {pair}", "seed": seed, "verdict": d.verdict, "effects": list(d.effects), "how": how,
        "wrong": sum(0.5 if p.certainty == "likely" else 1.0 for p in false), "false": [p.effect for p in false],
        "before": d.gap.before, "after": d.gap.after, "closed": d.gap.closed_fraction,
        "cpu_s": time.process_time() - began, "parts": [(p.effect, p.form, p.certainty) for p in d.parts],
    }  # fmt: skip


def main() -> None:
    """Print a row a cell, then the sums."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    cells = [f"{kind} {pair}" for kind in KINDS for pair in PAIRS]
    parser.add_argument("cells", nargs="*", help=f"parts of their names; all: {', '.join(cells)}")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--smoke", action="store_true")
    options = parser.parse_args()
    kept = options.out.read_text().splitlines() if options.out and options.out.is_file() else []
    rows = {row["cell"]: row for row in map(json.loads, kept) if row["seed"] == options.seed}
    wanted = [c for c in cells if not options.cells or any(part in c for part in options.cells)]
    for cell in wanted[: 1 if options.smoke else None]:
        if cell not in rows:
            rows[cell] = run(*cell.split(" "), options.seed, 0.25 if options.smoke else 1.0)
            if options.out:
                with open(options.out, "a") as file:
                    file.write(json.dumps(rows[cell]) + "\n")
        r = rows[cell]
        print(f"{cell:34} {r['verdict']:9} {r['how'] or '-'}  wrong {r['wrong']:g} {r['false'] or ''}  "
              f"{r['before']:.2f} -> {r['after']:.2f} %  {r['cpu_s']:.0f} CPU s", flush=True)  # fmt: skip
    both = [r for r in rows.values() if "+" in r["cell"]]
    whole = sum(len(r["how"]) == 2 for r in both)
    print(f"both of a pair: {whole} of {len(both)}; wrong: {sum(r['wrong'] for r in rows.values()):g}")


if __name__ == "__main__":
    main()

"""Whether 95 % intervals hold the truth, and how wide they are: of identify, of a diagnosis' numbers, of adapt's.

    y = d x + zero + sigma n,    n white, AR(0.9) or AR(0.98), unit variance;    sigma 0.3 % of range
    coverage = share of draws with |estimate - truth| < 1.96 stderr;    width = median stderr over the estimates' std

    python experiments/coverage.py [--verb identify|diagnose|adapt] [--draws N] [--seed S] [--results FILE]

One actuator of order 2, begun at rest, behind a second of rest, settled at a held drive, or cut out of a motion.
`identify` has one sweep; `diagnose` four drives of the actuator with one effect, the nominal from a sweep without it;
`adapt` one sweep after stiffness, damping or inertia has changed. Numbers that were not named are counted apart. A run
resumes from FILE. Asked for: coverage of at least 0.90, width of at most 2.5.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from _show import show
from scipy.signal import chirp, cont2discrete, lfilter

import pitp_jax as pitp

RATE, SECONDS, HZ, ZETA, TOP, STROKE = 500.0, 8.0, 7.4, 0.1, 3000.0, 1e-3
NOISES = {"white": 0.0, "AR(0.9)": 0.9, "AR(0.98)": 0.98}
BEFORE = {"rest": 0, "behind a rest": 500, "held": 5000, "moving": 700}  # samples, by how the record starts
ZERO, FINE = 5e-4, 10  # m; steps a sample
W = 2 * np.pi * HZ
NUMBERS = np.array([1.0, 2 * ZETA / W, 1 / W**2])  # stiffness, damping, inertia over the stiffness
NAMES = ("stiffness", "damping", "inertia")
EFFECTS = ("added_mass", "voltage_clip", "electrode_rc")


def drive(start: str, rng: np.random.Generator, kind: str = "sweep") -> tuple[np.ndarray, int]:
    """Voltage (V) with what is played before, and how many samples of it are cut off."""
    t, lead = np.arange(int(RATE * SECONDS)) / RATE, BEFORE[start]
    begun, held = np.arange(-lead, 0) / RATE, start == "held"
    wave = {
        "sweep": chirp(t, 0.5, SECONDS, 25.0, phi=-90 if held else 0),
        "slow": (np.sin if held else np.cos)(2 * np.pi * 1.1 * t),
        "fast": (np.sin if held else np.cos)(2 * np.pi * 5.3 * t),
        "steps": np.r_[0.0 if held else 1.0, np.repeat([-0.8, 0.3, -0.2, 0.7, 0.0, -0.9, 0.5, -0.5], len(t) // 8)][:-1],
    }[kind]
    before = {"held": np.ones(lead), "moving": 1 - np.cos(2 * np.pi * (3.0 * begun + rng.random()))}
    played = 1 + 0.9 * wave if held else 1 - wave
    u = TOP / 2 * np.concatenate([before.get(start, np.zeros(lead)), played])
    return u, 0 if start == "behind a rest" else lead


def record(start: str, pole: float, rng: np.random.Generator, kind="sweep", by=(1.0, 1.0, 1.0), level=TOP, film=None):
    """One record, its zero at ZERO; `by`: factors of the numbers; a voltage acts up to `level`, as `film` has it."""
    (u, cut), numbers, fine = drive(start, rng, kind), NUMBERS * by, FINE if film else 1
    # a held voltage is exact at any rate; what a film makes of it is not held
    sampled = cont2discrete(([STROKE], numbers[::-1]), 1 / RATE / fine, method="foh" if film else "zoh")
    b, a = (np.ravel(np.asarray(p)) for p in sampled[:2])  # pyright: ignore[reportIndexIssue]
    acts = film(np.repeat(u, fine)) if film else np.minimum(u, level)
    x, u = np.asarray(lfilter(b, a, (acts / TOP) ** 2))[::fine][cut:], u[cut:]
    n = np.asarray(lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.standard_normal(len(x) + 1000)))[1000:]
    return pitp.Record(kind, np.arange(len(x)) / RATE, u, x + ZERO + 3e-3 * np.ptp(x) * n)


def identified(noise: str, start: str, rng: np.random.Generator) -> dict:
    """(error, standard error) of a_0, a_1, a_2 over their truth and of the zero in strokes."""
    found = pitp.identify([record(start, NOISES[noise], rng)], order=2, hold="zoh")
    truth = TOP**2 / STROKE * NUMBERS
    share, doubt = np.asarray(found.chosen.coefficients) / truth - 1, np.asarray(found.chosen.stderr) / truth
    begun = found.beginnings["sweep"]
    told = {name: [float(e), float(s)] for name, e, s in zip(NAMES, share, doubt, strict=True)}
    return told | {"zero": [(begun.zero - ZERO) / STROKE, begun.stderr / STROKE]}


def nominal() -> pitp.Fitted:
    """The healthy actuator's, from a sweep at rest with white noise."""
    return pitp.identify([record("rest", 0.0, np.random.default_rng(0))], order=2, hold="zoh").model


def diagnosed(noise: str, start: str, rng: np.random.Generator) -> dict:
    """The same of the one effect's number over its truth; None where it is not what was said."""
    name = EFFECTS[rng.integers(len(EFFECTS))]
    if name == "added_mass":
        truth = rng.uniform(1.15, 1.4)  # told is a_2 over the nominal's
        how = {"by": (1.0, 1.0, truth)}
    elif name == "voltage_clip":
        truth = rng.uniform(0.75, 0.9) * TOP
        how = {"level": truth}
    else:
        truth = rng.uniform(0.15, 0.5) / W
        keep = np.exp(-1 / RATE / FINE / truth)
        how = {"film": lambda u: lfilter([0, 1 - keep], [1, -keep], u)}
    records = [record(start, NOISES[noise], rng, kind, **how) for kind in ("sweep", "slow", "fast", "steps")]
    found = pitp.diagnose(nominal(), records)
    if found.effects != (name,):
        return {name: None}
    told = next(p for row in found.ranking if row.effect == name for p in row.parameters.values())
    value, error = told["value"], told["stderr"]
    if name == "voltage_clip" and value < 1:  # told as 1 / V
        value, error = 1 / value, error / value**2
    return {name: [value / truth - 1, error / truth]}


def adapted(noise: str, start: str, rng: np.random.Generator) -> dict:
    """The same of the factors of stiffness, damping or inertia."""
    moved = rng.integers(3)
    truth = np.ones(3)
    truth[moved] = rng.choice([0.75, 1.3]) if moved == 1 else rng.choice([0.85, 1.2])
    found = pitp.adapt(nominal(), record(start, NOISES[noise], rng, by=truth))
    name = NAMES[moved]
    if name not in found.changed:
        return {name: None}
    told = found.changed[name]
    return {name: [told.factor / truth[moved] - 1, (told.ci95[1] - told.ci95[0]) / 3.92 / truth[moved]]}


VERBS = {"identify": identified, "diagnose": diagnosed, "adapt": adapted}


def counted(said: list[dict]) -> list[tuple]:
    """(number, draws, not named, coverage, width) of draws."""
    rows = []
    for name in dict.fromkeys(n for s in said for n in s["told"]):
        rows_of = [s["told"][name] for s in said if name in s["told"]]
        pairs = np.array([r for r in rows_of if r]).reshape(-1, 2)
        inside = np.abs(pairs[:, 0]) < 1.96 * pairs[:, 1]
        spread = np.sqrt(np.mean(pairs[:, 0] ** 2)) if len(pairs) else np.nan
        width = float(np.median(pairs[:, 1]) / spread) if len(pairs) > 2 else None
        covered = float(np.mean(inside)) if len(pairs) else None
        rows.append((name, len(pairs), len(rows_of) - len(pairs), covered, width))
    return rows


def main(smoke: bool = False, argv=None):
    """Draw, estimate, count."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--verb", choices=tuple(VERBS), default="identify")
    parser.add_argument("--draws", type=int, default=200, help="over all noises and starts, in turn")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--results", type=Path, help="one line a draw; a run resumes from it")
    parser.add_argument("--smoke", action="store_true", default=smoke)
    options = parser.parse_args([] if smoke and argv is None else argv)
    options.draws = 12 if options.smoke else options.draws
    kept = options.results.read_text().splitlines() if options.results and options.results.exists() else []
    done, drawn = {said["key"]: said for said in map(json.loads, kept)}, []
    for k in range(options.draws):
        noise, start = list(NOISES)[k % 3], list(BEFORE)[k // 3 % 4]
        key = f"{options.verb} {noise} {start} {options.seed} {k}"
        rng = np.random.default_rng([options.seed, k])
        told = done[key]["told"] if key in done else VERBS[options.verb](noise, start, rng)
        said = {"key": key, "noise": noise, "start": start, "told": told}
        drawn.append(said)
        if options.results and key not in done:
            with options.results.open("a") as out:
                out.write(json.dumps(said) + "\n")
    cells = {"all": drawn} | {n: [s for s in drawn if s["noise"] == n] for n in NOISES}
    cells |= {b: [s for s in drawn if s["start"] == b] for b in BEFORE}
    if options.verb == "identify":
        cells |= {f"{n}, {b}": [s for s in cells[n] if s["start"] == b] for n in NOISES for b in BEFORE}
    rows = [(cell, *row) for cell, said in cells.items() for row in counted(said)]
    show(f"coverage, {options.verb}", ("cell", "number", "draws", "not named", "coverage", "width"), rows)
    return rows


if __name__ == "__main__":
    main()

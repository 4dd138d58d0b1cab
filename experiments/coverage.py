"""Whether an identification's 95 % intervals hold the truth, and how wide they are.

    y = d x + zero + sigma n,    n white, AR(0.9) or AR(0.98), unit variance;    sigma 0.3 % of range
    coverage = share of draws with |estimate - truth| < 1.96 stderr;    width = median stderr over the estimates' std

    python experiments/coverage.py [--draws N] [--results FILE]

One actuator of order 2 under a sweep, begun at rest, behind a second of rest, settled at a held drive, or cut out of a
running motion. A run resumes from FILE. Asked for: coverage of at least 0.90, width of at most 2.5.
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
ZERO = 5e-4
W = 2 * np.pi * HZ
TRUTH = TOP**2 / STROKE * np.array([1.0, 2 * ZETA / W, 1 / W**2])


def record(start: str, pole: float, rng: np.random.Generator) -> pitp.Record:
    """One sweep with its sensor's zero at ZERO; what comes before it is played and, but for a rest, cut off."""
    t, lead = np.arange(int(RATE * SECONDS)) / RATE, BEFORE[start]
    begun = np.arange(-lead, 0) / RATE
    sweep = 1 + 0.9 * chirp(t, 0.5, SECONDS, 25.0, phi=-90) if start == "held" else 1 - chirp(t, 0.5, SECONDS, 25.0)
    before = {"held": np.ones(lead), "moving": 1 - np.cos(2 * np.pi * (3.0 * begun + rng.random()))}
    u = TOP / 2 * np.concatenate([before.get(start, np.zeros(lead)), sweep])
    sampled = cont2discrete(([W**2 * STROKE], [1, 2 * ZETA * W, W**2]), 1 / RATE, method="zoh")
    b, a = (np.ravel(np.asarray(p)) for p in sampled[:2])  # pyright: ignore[reportIndexIssue]
    cut = 0 if start == "behind a rest" else lead
    x, u = np.asarray(lfilter(b, a, (u / TOP) ** 2))[cut:], u[cut:]
    n = np.asarray(lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.standard_normal(len(x) + 1000)))[1000:]
    return pitp.Record("sweep", np.arange(len(x)) / RATE, u, x + ZERO + 3e-3 * np.ptp(x) * n)


def draw(noise: str, start: str, seed: int) -> dict:
    """Estimate over truth minus one and its standard error, of a_0, a_1, a_2; of the zero in strokes."""
    made = record(start, NOISES[noise], np.random.default_rng(seed))
    found = pitp.identify([made], order=2, hold="zoh")
    share = np.asarray(found.chosen.coefficients) / TRUTH - 1
    begun = found.beginnings["sweep"]
    errors = np.append(share, (begun.zero - ZERO) / STROKE)
    doubts = np.append(np.asarray(found.chosen.stderr) / TRUTH, begun.stderr / STROKE)
    return {"errors": errors.tolist(), "stderr": doubts.tolist(), "begins": begun.begins}


def main(smoke: bool = False, argv=None):
    """Draw, identify, count."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=200, help="over all noises and starts, in turn")
    parser.add_argument("--results", type=Path, help="one line a draw; a run resumes from it")
    options = parser.parse_args([] if smoke and argv is None else argv)
    options.draws = 12 if smoke else options.draws
    kept = options.results.read_text().splitlines() if options.results and options.results.exists() else []
    done = {said["key"]: said for said in map(json.loads, kept)}
    cells: dict[tuple[str, str], list[dict]] = {}
    for seed in range(options.draws):
        noise, start = list(NOISES)[seed % 3], list(BEFORE)[seed // 3 % 4]
        key = f"{noise} {start} {seed}"
        said = done.get(key) or {"key": key} | draw(noise, start, seed)
        cells.setdefault((noise, start), []).append(said)
        if options.results and key not in done:
            with options.results.open("a") as out:
                out.write(json.dumps(said) + "\n")
    rows = []
    cells[("all", "")] = [said for one in cells.values() for said in one]
    for (noise, start), said in cells.items():
        errors, doubts = (np.array([s[what] for s in said]) for what in ("errors", "stderr"))
        inside = (np.abs(errors) < 1.96 * doubts).mean(0)
        width = np.median(doubts, 0) / np.maximum(errors.std(0), 1e-300)
        rows.append((noise, start, len(said), *(f"{c:.2f} / {w:.2f}" for c, w in zip(inside, width, strict=True))))
    show("coverage", ("noise", "start", "draws", "stiffness", "damping", "inertia", "zero"), rows)
    return rows


if __name__ == "__main__":
    main()

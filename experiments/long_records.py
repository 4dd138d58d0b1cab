"""Diagnosis of long recordings: the search on pieces beside a search over everything.

    python experiments/long_records.py [--only joint,stop,lag] [--everything]

Three plants of second order, 150,000 samples each with 16 to 25 samples a period of their mode, simulated with 20
semi-implicit steps a sample: a joint with dry friction, a stage that meets a hard stop, a film that charges late. The
nominal is identified on the plant without its effect. Printed: verdict, error of nominal and handed-back model over all
samples (% of range, free runs of `predict`), simulated steps, CPU seconds of the diagnosis and memory.
"""

import argparse
import resource
import time

import numpy as np
from _smoke import all_but

import pitp_jax as pitp
from pitp_jax.method.diagnose import budget, pieces

SAMPLES, STEPS = 150_000, 20
# name: frequency (Hz), damping ratio, sampling rate (Hz), recordings
PLANTS = {"joint": (4.0, 0.35, 100.0, 2), "stop": (6.0, 0.1, 100.0, 3), "lag": (5.0, 0.2, 100.0, 1)}


def drive(rng, samples: int, rate: float, hz: float) -> np.ndarray:
    """Return stretches of sines, sweeps, steps and noise below twice the mode, of other sizes, in [-1, 1]."""
    parts, t, done = [], np.arange(int(20 * rate)) / rate, 0
    while done < samples:
        size, kind, f = rng.uniform(0.2, 1.0), rng.integers(4), rng.uniform(0.1, 1.2) * hz
        level = rng.uniform(-0.3, 0.3) * (1 - size)
        noise = np.interp(
            t, t[:: max(int(rate / hz / 2), 1)], rng.uniform(-1, 1, len(t[:: max(int(rate / hz / 2), 1)]))
        )
        shapes = np.sin(2 * np.pi * f * t), np.sin(2 * np.pi * f * t * t / 40), np.sign(np.sin(2 * np.pi * f * t / 8))
        parts.append(level + size * (*shapes, noise)[kind])
        done += len(t)
    return np.concatenate(parts)[:samples]


def played(name: str, voltage: np.ndarray, rate: float, hz: float, zeta: float, effect: str) -> np.ndarray:
    """Return the output of x'' + 2 zeta w x' + w^2 x = w^2 u with an effect, from rest, shape (T,)."""
    w, h, x, v, film = 2 * np.pi * hz, 1 / rate / STEPS, 0.0, 0.0, 0.0
    out, last = np.empty(len(voltage)), np.append(voltage[1:], voltage[-1])
    for k in range(len(voltage)):
        out[k] = x
        for j in range(STEPS):
            u = voltage[k] + (last[k] - voltage[k]) * (j + 0.5) / STEPS
            if effect == "lag":
                film += h / 0.03 * (u - film)
                u = film
            force = w * w * (u - x) - 2 * zeta * w * v
            if effect == "stop" and x > 0.5:
                force -= 15 * w * w * (x - 0.5)
            v += h * force
            if effect == "joint":  # dry friction of a tenth of the largest force
                v = np.sign(v) * max(abs(v) - h * 0.1 * w * w, 0.0)
            x += h * v
    return out


def recordings(name: str, effect: str, samples: int, seed: int) -> list[pitp.Record]:
    """Return the recordings of a plant, with or without its effect."""
    hz, zeta, rate, count = PLANTS[name]
    rng, found = np.random.default_rng(seed), []
    for k in range(count):
        n = samples // count
        u = drive(rng, n, rate, hz)
        x = played(name, u, rate, hz, zeta, effect) + 1e-3 * rng.standard_normal(n)
        found.append(pitp.Record(f"{name} {k}", np.arange(n) / rate, u, x))
    return found


def error(model, records) -> float:
    """Return the free-run error over all samples, % of range, pooled over recordings."""
    runs = pitp.predict(model, records)
    each = [pitp.e_rms_percent(p.displacement, r.displacement) ** 2 for p, r in zip(runs, records, strict=True)]
    return float(np.sqrt(np.mean(each)))


def main() -> None:
    """Print a line for every plant."""
    options = argparse.ArgumentParser()
    options.add_argument("--only", default=",".join(PLANTS))
    options.add_argument("--everything", action="store_true", help="search all samples")
    options.add_argument("--samples", type=int, default=SAMPLES)
    options.add_argument("--smoke", action="store_true", help="quick and meaningless")
    given = options.parse_args()
    if given.smoke:
        given.only, given.samples, pieces.RUN_STEPS = "lag", 12_000, 3_000
    if given.everything:
        pieces.RUN_STEPS = budget.SEARCH_STEPS = 10**15
    for name in given.only.split(","):
        healthy = recordings(name, "", min(20_000, given.samples), 1)
        nominal = pitp.identify(healthy, order=2, input_map="linear").model
        records = recordings(name, name, given.samples, 2)
        began = time.process_time()
        found = pitp.diagnose(nominal, records, exclude=all_but("electrode_rc", "delay") if given.smoke else [])
        cpu, memory = time.process_time() - began, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        before, after = error(nominal, records), error(found.model, records)
        print(
            f"{name}: {found.verdict} {found.effects} tied {found.equivalent}, handed back {found.handed_back}; "
            f"{before:.3g} -> {after:.3g} % of range; {found.lane_steps:.3g} simulated steps, {cpu:.0f} CPU s, "
            f"{memory:.2g} GB; {'everything' if found.pieces is None else f'{len(found.pieces)} pieces'}",
            *found.notes, sep="\n    ", flush=True,
        )  # fmt: skip


if __name__ == "__main__":
    main()

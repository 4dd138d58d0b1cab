"""The same actuator on another day: what `adapt` says of one 10 s recording, on draws of changed plants.

    plant -> sweep -> nominal, (demo) trained;    changed plant -> one 10 s recording -> adapt -> held-out recordings

    python experiments/another_day.py [--demo DIR] [--bench linear,nominal,trained] [--changes NAME,...]
        [--seeds 100:110] [--smoke]

`linear`: a drawn linear plant of `_withheld` and its nominal; `nominal`, `trained`: cone100 of `pitp demo --quick --out
DIR` and its two models. Truth of a number: its ratio to the drive's force, mean over the stroke of the recording.
`own`: the error of the unadapted model on the unchanged plant under the same drives, which is what a full refit
reaches. Thresholds were tuned on seeds below 100.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from _paper import errors
from _show import show
from _withheld import plant as exact
from _withheld import protocol
from scipy.signal import lfilter

import pitp_jax as pitp

CHANGES = ("same", "softer", "load", "late", "creep", "specimen")
_SECONDS, _RATE = 10.0, 1e3
_TOKENS = ("stiffness", "damping", "inertia")


def arguments(smoke: bool, argv):
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--demo", type=Path, help="folder of `pitp demo --quick`, for nominal and trained")
    parser.add_argument("--bench", type=lambda s: s.split(","), default=["linear"])
    parser.add_argument("--changes", type=lambda s: s.split(","), default=CHANGES)
    parser.add_argument("--seeds", default="100:105", help="FIRST:END")
    parser.add_argument("--smoke", action="store_true", help="quick and meaningless")
    options = parser.parse_args(argv)
    if smoke or options.smoke:
        options.bench, options.changes, options.seeds = ["linear"], ["same", "softer"], "0:1"
    options.seeds = range(*map(int, options.seeds.split(":")))
    return options


def drives(rng: np.random.Generator, top: float) -> list[tuple[str, np.ndarray]]:
    """The one recording's drive, then held-out ones, in V; `top` scales amplitudes about half of it."""
    ex, size = pitp.excitation, rng.uniform(0.5, 0.85) * top / 2
    kind = rng.choice(["multisine", "sweep", "steps"], p=[0.4, 0.4, 0.2])
    first = {
        "multisine": lambda: ex.multisine((0.3, 11.0), _SECONDS, _RATE, size, top / 2, seed=rng, rise=0.5),
        "sweep": lambda: ex.sweep(0.3, 11.0, _SECONDS, _RATE, size, top / 2, rise=0.3),
        "steps": lambda: ex.steps(list(rng.uniform(0.2, 0.85, 10) * top), 1.0, _RATE, rise=0.03),
    }[kind]()
    held = [ex.sine(f, _SECONDS, _RATE, 0.7 * top / 2, top / 2, rise=0.3) for f in (1.5, 3.1, 6.6)]
    held.append(ex.complex_trajectory(1.0, _SECONDS, _RATE, 0.4 * top / 2, top / 2, seed=rng, rise=0.3))
    names = [kind, "sine1.5", "sine3.1", "sine6.6", "complex"]
    return [(name, wave[1]) for name, wave in zip(names, [first, *held], strict=True)]


def lagged(u: np.ndarray, tau: float) -> np.ndarray:
    """Film voltage behind an electrode's lag, u linear between samples, uncharged before."""
    if tau == 0:
        return u
    keep = np.exp(-1 / (_RATE * tau))
    rise = 1 - (1 - keep) * tau * _RATE
    push = (1 - keep) * u[:-1] + rise * np.diff(u)
    return np.concatenate([[0.0], lfilter([1.0], [1.0, -keep], push)])


def factors(change: str, rng: np.random.Generator) -> dict[str, float]:
    """What of the physics is multiplied by what."""
    return {
        "same": {}, "late": {}, "softer": {"spring": 0.92}, "load": {"mass": 1.2}, "creep": {"slow": 2.0},
        "specimen": {k: rng.uniform(0.9, 1.1) for k in ("spring", "mass", "damping", "capacitance")},
    }[change]  # fmt: skip


def linear(change: str, rng: np.random.Generator):
    """A drawn linear plant, changed: nominal, unchanged and changed recordings, truth."""
    kind = protocol.KINDS["cone"]
    p, by = protocol.draw_plant(kind, rng), factors(change, rng)
    s, i, d, g = (by.get(k, 1.0) for k in ("spring", "mass", "damping", "capacitance"))
    new = replace(p, f0=p.f0 * np.sqrt(s / i), scale=p.scale * g / s, zeta=p.zeta * d / np.sqrt(s * i))
    tau = rng.uniform(0.1, 0.5) / (2 * np.pi * p.f0) if change == "late" else 0.0
    waves = drives(rng, kind.top)
    careful = min(1.0, np.sqrt(p.zeta / 0.08))  # as `protocol` drives it
    waves = [(n, np.round(kind.top / 2 + careful * (u - kind.top / 2), 2)) for n, u in waves]
    sweep = ("sweep", pitp.excitation.sweep(0.5, 11.0, 2 * _SECONDS, _RATE, careful * 2000, kind.offset)[1])

    def measured(plant, waves, tau=0.0):
        made = []
        for name, u in waves:
            x = plant.scale * exact.healthy(lagged(u, tau) / kind.top, plant.constants["step"], plant.zeta)[0]
            y = x + 0.003 * np.ptp(x) * rng.standard_normal(len(x))
            made.append(pitp.Record(name, np.arange(len(u)) / _RATE, u, y))
        return made

    nominal = pitp.identify(measured(p, [sweep]), order=2).model
    truth = dict(zip(_TOKENS, (s / g, d / g, i / g), strict=True)) | {"electrode_tau": tau, "creep": 1.0}
    return nominal, measured(p, waves), measured(new, waves, tau), truth


def virtual(model, change: str, rng: np.random.Generator):
    """cone100, changed."""
    old, by = pitp.plant("cone100"), factors(change, rng)
    s, g, d = (by.get(k, 1.0) for k in ("spring", "capacitance", "damping"))
    branches = tuple((k * s, tau) for k, tau in old.branches)
    slow = (branches[-1][0] * by.get("slow", 1.0), branches[-1][1])
    new = replace(
        old, spring=old.spring * s, branches=(*branches[:-1], slow), mass=old.mass * by.get("mass", 1.0),
        capacitance=old.capacitance * g, membrane_damping=old.membrane_damping * d, friction=old.friction * d,
    )  # fmt: skip
    tau = rng.uniform(0.1, 0.5) / (2 * np.pi * old.resonance_hz) if change == "late" else 0.0
    waves, seed = drives(rng, 6000.0), int(rng.integers(1 << 30))

    def measured(plant, tau=0.0):
        time, u = np.arange(len(waves[0][1])) / _RATE, np.stack([u for _, u in waves])
        x = pitp.simulate(plant, time, np.stack([lagged(row, tau) for row in u]))
        noise = np.random.default_rng(seed).normal(0, plant.noise_std, x.shape)
        return [pitp.Record(n, time, v, y) for (n, v), y in zip(waves, x + noise, strict=True)]

    changed = measured(new, tau)
    stroke = np.quantile(changed[0].displacement, np.linspace(0.05, 0.95, 10)).clip(2e-4)
    return model, measured(old), changed, ratios(old, new, stroke) | {"electrode_tau": tau}


def ratios(old, new, stroke: np.ndarray) -> dict[str, float]:
    """New over old of what acts against V^2, mean over the stroke (m)."""

    def tokens(p):
        q, slope = p.geometry.stretch(p.rest_position + stroke)
        force = -p.relaxed_force(p.rest_position + stroke, 0.0) / (0.5 * p.capacitance * slope)
        inertia = p.mass / (0.5 * p.capacitance * slope)
        volts = np.interp(stroke, p.static(grid := np.linspace(0, 6000, 60)), grid)
        modes = [np.linalg.eigvals(p.linearised(v)) for v in volts]
        loss = np.array([-2 * max(m, key=np.imag).real for m in modes]) * inertia
        one = slope / (q * p.capacitance) / p.geometry.stretch(p.rest_position)[0]  # of a branch, per J of it
        fast, slow = (one * sum(k for k, tau in p.branches if (tau < _SECONDS / 2) == f) for f in (True, False))
        return np.stack([force + slow * stroke, loss, inertia, fast / (force / stroke)])

    return dict(zip((*_TOKENS, "creep"), (tokens(new) / tokens(old)).mean(1), strict=True))


def covered(changed, truth: dict[str, float]) -> list[bool]:
    """For every number named, whether its interval holds the truth."""
    found = []
    for name, c in changed.items():
        if name == "gain":
            ends = [1 / truth[t] for t in ("stiffness", "inertia")]
            found.append(all(c.ci95[0] <= e <= c.ci95[1] for e in ends))
        elif name == "electrode_tau":
            found.append(c.seconds_ci95[0] <= truth[name] <= c.seconds_ci95[1])
        else:
            found.append(c.ci95[0] <= truth[name] <= c.ci95[1])
    return found


def row(bench: str, change: str, seed: int, models) -> dict:
    """One draw."""
    rng = np.random.default_rng([seed, CHANGES.index(change), len(bench)])
    model, same, changed, truth = linear(change, rng) if bench == "linear" else virtual(models[bench], change, rng)
    began = time.perf_counter()
    found = pitp.adapt(model, changed[0])
    seconds = time.perf_counter() - began
    own, before, after = (
        float(np.median(list(errors(m, rs).values())))
        for m, rs in ((model, same[1:]), (model, changed[1:]), (found.model, changed[1:]))
    )
    numbers = ", ".join(
        f"{n} {c.factor:.3f} ({truth.get(n, np.nan):.3f})" for n, c in found.changed.items()
    )  # fmt: skip
    print(f"{bench} {change} {seed} {changed[0].name}: {found.verdict} {found.before:.2f} -> {found.after:.2f} %; "
          f"held out {before:.2f} -> {after:.2f} (own {own:.2f}) %; {numbers}; {seconds:.1f} s",
          flush=True)  # fmt: skip
    return {"verdict": found.verdict, "own": own, "before": before, "after": after, "seconds": seconds,
            "covered": covered(found.changed, truth)}  # fmt: skip


def table(rows: dict[tuple[str, str], list[dict]]) -> None:
    """Medians and counts per bench and change."""
    lines = []
    for (bench, change), found in rows.items():
        verdicts = [r["verdict"] for r in found]
        inside = [c for r in found for c in r["covered"]]
        middle = {k: float(np.median([r[k] for r in found])) for k in ("own", "before", "after", "seconds")}
        worse = sum(r["after"] > 1.05 * r["before"] for r in found)
        counts = (verdicts.count(v) for v in ("unchanged", "adapted", "retrain"))
        lines.append((f"{bench}, {change}", len(found), *counts,
                      middle["own"], middle["before"], middle["after"], worse, f"{sum(inside)}/{len(inside)}",
                      middle["seconds"]))  # fmt: skip
    header = ("draws", "n", "unchanged", "adapted", "retrain", "own %", "before %", "after %", "worse", "covered", "s")
    show("another day: medians of held-out e_rms", header, lines)


def main(smoke: bool = False, argv=None):
    """All draws, then the table."""
    options = arguments(smoke, [] if smoke and argv is None else argv)
    files = {"nominal": "nominal.pitp", "trained": "model.pitp"}
    models = {b: pitp.load(options.demo / files[b]) for b in options.bench if b in files}
    rows = {
        (bench, change): [row(bench, change, seed, models) for seed in options.seeds]
        for bench in options.bench
        for change in options.changes
        if not (bench == "linear" and change == "creep")
    }
    table(rows)
    return rows


if __name__ == "__main__":
    main()

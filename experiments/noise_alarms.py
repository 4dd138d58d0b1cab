"""Healthy actuators under noise of every colour: how often a diagnosis sees a gap where there is none.

    y = x + sigma n,    n white, AR(0.9), AR(0.98), a moving average over 20 samples, or white and read in coarse steps

    python experiments/noise_alarms.py [--kinds cone,roll] [--noises NAME,...] [--seeds FIRST] [--count N] [--floors]

Plants, drives and the sensor's noise of 0.3 % of range are those of `_withheld/`; nominals are identified on records
with the same noise. Counts come with their Clopper-Pearson intervals. Thresholds are tuned on seeds 0 to 99; figures
are of seeds that nothing was tuned on. `--floors` reads gap and floor alone, a tenth of the time.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from _show import show
from _withheld import protocol
from _withheld.case import Spec, make
from scipy.stats import beta

import pitp_jax as pitp
from pitp_jax._diagnose.case import build_case
from pitp_jax._diagnose.evaluation import floor
from pitp_jax._diagnose.noise import estimate


def interval(wrong: int, count: int) -> tuple[float, float]:
    """95 % limits of a share of which `wrong` of `count` were seen."""
    low = beta.ppf(0.025, wrong, count - wrong + 1) if wrong else 0.0
    high = beta.ppf(0.975, wrong + 1, count - wrong) if wrong < count else 1.0
    return float(low), float(high)


def looked_at(model, records) -> dict:
    """Gap and floor of all records, in floors, and the floor over what a sensor makes of it."""
    case = build_case(model, records)
    noise = estimate(case, [s.error for s in case.series])
    everything = list(range(len(case.series)))
    gap = float(np.sqrt(np.mean([np.sum(s.weight * s.error**2) for s in case.series])))
    return {"floors": gap / floor(case, noise, everything), "struck": noise.sigma / noise.sensor}


def row(kind: str, noise: str, seed: int, floors: bool) -> dict:
    """One healthy actuator; its seconds are those of the diagnosis."""
    case = make(Spec((), kind, seed, 1.0, noise))
    model = pitp.identify(case.clean, order=2, input_map="square").model
    began = time.perf_counter()
    if floors:
        return looked_at(model, case.real)
    found = pitp.diagnose(model, case.real)
    said = "+".join(found.effects) or found.verdict
    return {"said": said, "seconds": time.perf_counter() - began, "gap": vars(found.gap)}


def main(smoke: bool = False, argv=None):
    """Draw, diagnose, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kinds", type=lambda s: s.split(","), default=["cone", "roll"])
    parser.add_argument("--noises", type=lambda s: s.split(","), default=list(protocol.NOISES))
    parser.add_argument("--seeds", type=int, default=0, help="the first")
    parser.add_argument("--count", type=int, default=20, help="of every noise and actuator")
    parser.add_argument("--floors", action="store_true", help="gap and floor alone")
    parser.add_argument("--results", type=Path, help="one line a case; a run resumes from it")
    options = parser.parse_args([] if smoke and argv is None else argv)
    if smoke:
        options.kinds, options.noises, options.count, options.floors = ["short"], ["average"], 1, True
    kept = options.results.read_text().splitlines() if options.results and options.results.exists() else []
    done = {said["key"]: said for said in map(json.loads, kept)}
    rows = []
    for seed in range(options.seeds, options.seeds + options.count):
        for kind in options.kinds:
            for noise in options.noises:
                key = f"{kind} {noise} {seed}"
                said = done.get(key) or {"key": key} | row(kind, noise, seed, options.floors)
                rows.append((kind, noise, said))
                if options.results and key not in done:
                    with options.results.open("a") as out:
                        out.write(json.dumps(said) + "\n")
                print(said, flush=True)
    found = []
    for kind in options.kinds:
        for noise in options.noises:
            mine = [r for k, n, r in rows if (k, n) == (kind, noise)]
            if options.floors:
                found.append((kind, noise, len(mine), max(r["floors"] for r in mine), max(r["struck"] for r in mine)))
                continue
            wrong = [r["said"] for r in mine if r["said"] != "no_gap"]
            low, high = interval(len(wrong), len(mine))
            found.append((kind, noise, f"{len(wrong)}/{len(mine)}", f"{low:.3f} to {high:.3f}", ", ".join(wrong)))
    titles = ("actuator", "noise", "cases", "largest gap / floor", "floor / sensor's")
    show("alarms", titles if options.floors else ("actuator", "noise", "alarms", "95 %", "said"), found)
    return rows


if __name__ == "__main__":
    main()

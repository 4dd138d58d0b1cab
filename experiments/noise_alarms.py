"""Healthy actuators under noise of every colour: how often a diagnosis sees a gap where there is none.

    y = x + sigma n,    n white, AR(0.9), AR(0.98), a moving average over 20 samples, or white and read in coarse steps

    python experiments/noise_alarms.py [--kinds cone,roll] [--noises NAME,...] [--seeds FIRST] [--count N]

Plants, drives and the sensor's noise of 0.3 % of range are those of `_withheld/`; nominals are identified on records
with the same noise. Counts come with their Clopper-Pearson intervals. Figures
are of seeds that nothing was tuned on.
"""

import argparse
import json
import time
from pathlib import Path

from _show import show
from _withheld import protocol
from _withheld.case import Spec, make
from scipy.stats import beta

import pitp_jax as pitp


def interval(wrong: int, count: int) -> tuple[float, float]:
    """95 % limits of a share of which `wrong` of `count` were seen."""
    low = beta.ppf(0.025, wrong, count - wrong + 1) if wrong else 0.0
    high = beta.ppf(0.975, wrong + 1, count - wrong) if wrong < count else 1.0
    return float(low), float(high)


def row(kind: str, noise: str, seed: int) -> dict:
    """One healthy actuator; its seconds are those of the diagnosis."""
    case = make(Spec((), kind, seed, 1.0, noise))
    model = pitp.identify(case.clean, order=2, input_map="square").model
    began = time.perf_counter()
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
    parser.add_argument("--results", type=Path, help="one line a case; a run resumes from it")
    options = parser.parse_args([] if smoke and argv is None else argv)
    if smoke:
        options.kinds, options.noises, options.count = ["short"], ["average"], 1
    kept = options.results.read_text().splitlines() if options.results and options.results.exists() else []
    done = {said["key"]: said for said in map(json.loads, kept)}
    rows = []
    for seed in range(options.seeds, options.seeds + options.count):
        for kind in options.kinds:
            for noise in options.noises:
                key = f"{kind} {noise} {seed}"
                said = done.get(key) or {"key": key} | row(kind, noise, seed)
                rows.append((kind, noise, said))
                if options.results and key not in done:
                    with options.results.open("a") as out:
                        out.write(json.dumps(said) + "\n")
                print(said, flush=True)
    found = []
    for kind in options.kinds:
        for noise in options.noises:
            mine = [r for k, n, r in rows if (k, n) == (kind, noise)]
            wrong = [r["said"] for r in mine if r["said"] != "no_gap"]
            low, high = interval(len(wrong), len(mine))
            found.append((kind, noise, f"{len(wrong)}/{len(mine)}", f"{low:.3f} to {high:.3f}", ", ".join(wrong)))
    show("alarms", ("actuator", "noise", "alarms", "95 %", "said"), found)
    return rows


if __name__ == "__main__":
    main()

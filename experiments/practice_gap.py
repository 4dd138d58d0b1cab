"""Diagnosis of the practice cases in ../shared/gap, scored against their truth.

    clean (healthy) -> identify -> nominal;    real -> diagnose -> verdict beside the label

    python experiments/practice_gap.py [CASE ...] [--refit] [--data ../shared] [--smoke]

The labels are read after the last diagnosis. `--refit`: the nominal is identified on the records that carry the effect.
"""

import argparse
import json
import time
from pathlib import Path

from _show import show
from _withheld.score import right

import pitp_jax as pitp


def main(smoke: bool = False, argv=None):
    """Diagnose, then open the labels."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", help="folder names; default: all")
    parser.add_argument("--refit", action="store_true")
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    parser.add_argument("--smoke", action="store_true")
    options = parser.parse_args([] if smoke and argv is None else argv)
    root = options.data / "gap"
    if not root.is_dir():
        print(f"skipped: {root} is absent")
        return
    if smoke or options.smoke:
        return
    said, rows = {}, []
    for name in options.cases or sorted(p.name for p in root.iterdir() if p.is_dir()):
        nominal = pitp.identify(pitp.read(root / name / ("real" if options.refit else "clean"))).model
        began = time.perf_counter()
        found = pitp.diagnose(nominal, pitp.read(root / name / "real"), refit_nominal=options.refit)
        said[name] = found, time.perf_counter() - began
        print(f"{name}: {str(found).splitlines()[0]}", flush=True)
    truth = json.loads((root / "truth.json").read_text())["cases"]
    good = 0
    for name, (found, seconds) in said.items():
        effects, label = found.as_json(), truth[name]["effect"]
        ok = right(label, effects, refit=options.refit, left_out=False, ties=True)
        good += ok
        what = "+".join(found.effects) or found.verdict
        tied = ", ".join(found.equivalent) or "-"
        g = found.gap
        rows.append(
            (name, what, tied, "yes" if ok else "NO", g.before, g.after, g.noise_floor, g.closed_fraction, seconds)
        )
    header = ("case", "said", "tied", "right", "before %", "after %", "floor %", "closed", "seconds")
    show("practice cases", header, rows)
    print(f"{good} of {len(rows)} right")


if __name__ == "__main__":
    main()

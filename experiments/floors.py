"""Issue-style floors on recordings: identify, fit with the default preset, free run on held-out records.

    python experiments/floors.py cone100 roll hasel silverbox [--data ../shared] [--seeds 1] [--firmness RHO] [--smoke]

Each case prints the identified linear model beside the trained one, and the wall time of the fit. The data are not part
of this project; a case whose folder is absent is skipped with a line.
"""

import argparse
import dataclasses
import time
from pathlib import Path

import jax
import numpy as np

import pitp_jax as pitp
from pitp_jax.method.train.settings import PRESETS

CASES = {
    "cone100": ("bench/cone100", ["sweep"], ["train"], ["test"], "auto", "square"),
    "roll": ("bench/roll", ["sweep"], ["train"], ["test"], "auto", "square"),
    "hasel": ("data/hasel_peano", None, ["steps.csv.gz", "sine_03Hz.csv.gz"], ["sine_07Hz.csv.gz"], 2, "square"),
    "silverbox": (
        "data/silverbox", None, ["multisine_train.csv.gz"],
        ["multisine_test.csv.gz", "arrow_full_test.csv.gz", "arrow_no_extrapolation_test.csv.gz"], 2, "linear",
    ),
}  # fmt: skip


def figures(model, records):
    """Free-run figures per record: e_rms %, nrmse %, rmse (base unit)."""
    rows = {}
    for record, run in zip(records, pitp.predict(model, records), strict=True):
        pair = run.displacement, record.displacement, run.scored
        rows[record.name] = pitp.e_rms_percent(*pair), pitp.nrmse_percent(*pair), pitp.rmse(*pair)
    return rows


def run(case: str, data: Path, seed: int, smoke: bool, firmness: float | None = None):
    """Identify, fit and score one case; returns the rows printed."""
    folder, sweep, train, test, order, input_map = CASES[case]
    root = data / folder
    if not root.is_dir():
        print(f"{case}: skipped, {root} is absent")
        return {}
    training = pitp.read(*[root / p for p in train])
    began = time.perf_counter()
    start = pitp.identify(
        pitp.read(*[root / p for p in sweep]) if sweep else training, order=order, input_map=input_map
    )
    identified = time.perf_counter()
    settings = dataclasses.replace(PRESETS["default"], firmness=firmness)
    if smoke:
        settings = dataclasses.replace(settings, stages=1, epochs=1, refine_steps=0)
    fitted = pitp.train(start.model, training, settings=settings, key=jax.random.key(seed)).model
    done = time.perf_counter()
    held = pitp.read(*[root / p for p in test])
    before, after = figures(start.model, held), figures(fitted, held)
    seconds = f"identify {identified - began:.0f} s, fit {done - identified:.0f} s"
    print(f"\n{case} (order {fitted.order}, {fitted.hold}, seed {seed}; {seconds})")
    print(f"{'record':32s} {'e_rms %':>8s} {'linear':>8s} {'nrmse %':>8s} {'linear':>8s} {'rmse':>10s}")
    for name, (e, n, r) in after.items():
        print(f"{name:32s} {e:8.3f} {before[name][0]:8.2f} {n:8.2f} {before[name][1]:8.2f} {r:10.3g}")
    again = repeats(training, held)
    for part, names in (("held out", after.keys() - again), ("repeats", again)):
        for label, k in (("e_rms %", 0), ("nrmse %", 1)) if names else ():
            a, b = (np.array([rows[n][k] for n in names]) for rows in (after, before))
            print(f"{part} ({len(names)}), median {label:8s} {np.median(a):8.3f} (worst {a.max():.3f});  "
                  f"linear {np.median(b):8.2f} (worst {b.max():.2f})")  # fmt: skip
    return after


def repeats(training, held) -> set[str]:
    """Names of held-out records whose voltage is that of a training record."""
    return {
        r.name
        for r in held
        if any(r.samples == t.samples and np.allclose(r.voltage, t.voltage, atol=1.0) for t in training)
    }


def main(smoke: bool = False, argv=None):
    """Run the cases named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", default=list(CASES), help=", ".join(CASES))
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--firmness", type=float, help="see pitp_jax.Settings")
    parser.add_argument("--smoke", action="store_true")
    options = parser.parse_args(argv)
    for case in options.cases:
        for seed in range(options.seeds):
            run(case, options.data, seed, smoke or options.smoke, options.firmness)


if __name__ == "__main__":
    main()

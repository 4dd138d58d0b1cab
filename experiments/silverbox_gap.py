"""Diagnosis on a measured circuit: the Silverbox, an electronic Duffing oscillator (linear input).

    nominal: order 2, identified on multisine_train;  diagnosed on its two halves;  scored on the three official tests

    python experiments/silverbox_gap.py [--data ../shared] [--smoke]

The nominal was identified on a record that carries the effect, so its coefficients are fitted along. Published:
linear 6.96 / 14.4 / 6.58 mV, best 0.36 / 0.26 / 0.32 mV (multisine / arrow full / arrow without extrapolation).
"""

import argparse
from dataclasses import replace
from pathlib import Path

import pitp_jax as pitp

TESTS = ("multisine_test", "arrow_full_test", "arrow_no_extrapolation_test")


def cut(records, samples):
    """The first samples of every record."""
    return [
        replace(r, time=r.time[:samples], voltage=r.voltage[:samples], displacement=r.displacement[:samples])
        for r in records
    ]


def errors(model, records):
    """Free-run rmse in mV."""
    runs = pitp.predict(model, records)
    return [1e3 * pitp.rmse(p.displacement, r.displacement, p.scored) for p, r in zip(runs, records, strict=True)]


def main(smoke: bool = False, argv=None):
    """Identify, diagnose, and score on the official tests."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    parser.add_argument("--smoke", action="store_true")
    options = parser.parse_args(argv)
    root = options.data / "data/silverbox"
    if not root.is_dir():
        print(f"skipped: {root} is absent")
        return
    train = pitp.read(root / "multisine_train.csv.gz")
    tests = pitp.read(*[root / f"{name}.csv.gz" for name in TESTS])
    if smoke or options.smoke:
        train, tests = cut(train, 4000), cut(tests, 4000)
    nominal = pitp.identify(train, order=2, input_map="linear").model
    half = len(train[0].time) // 2
    parts = [
        replace(r, name=f"{r.name} {k + 1}", **{f: getattr(r, f)[s] for f in ("time", "voltage", "displacement")})
        for r in train
        for k, s in enumerate((slice(0, half), slice(half, None)))
    ]
    found = pitp.diagnose(nominal, parts, refit_nominal=True)
    print(found)
    for added in found.added:
        print(f"{added.effect} ({added.form}):", {k: (v["value"], v["unit"]) for k, v in added.parameters.items()})
    print(f"{'rmse, mV':32s} {'linear':>8s} {'with effect':>12s}")
    rows = zip(tests, errors(nominal, tests), errors(found.model, tests), strict=True)
    for record, before, after in rows:
        print(f"{record.name:32s} {before:8.2f} {after:12.3f}")


if __name__ == "__main__":
    main()

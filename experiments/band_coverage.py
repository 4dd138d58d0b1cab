"""The fraction of held-out samples inside an ensemble's bands of 95, 80 and 50 %.

    python experiments/band_coverage.py [cone100|roll] [--data ../shared] [--members 4] [--seed 0] [--smoke]

Trains on train/, prints every member's own error, and per held-out record the fraction of samples inside each band and
its half width over the record's range. Without recordings the quick demo of the virtual actuator is used. `--seed`
draws the nets and the order of the minibatches.
"""

import argparse
import dataclasses
from pathlib import Path

import jax
import numpy as np

import pitp_jax as pitp
from pitp_jax.application.demo.protocol import excitations, measure
from pitp_jax.method.train.settings import PRESETS

LEVELS = (0.95, 0.8, 0.5)


def records_of(case: str, data: Path):
    """Sweep, training and held-out records of a bench, or of the virtual cone."""
    root = data / "bench" / case
    if root.is_dir():
        return tuple(pitp.read(root / part) for part in ("sweep", "train", "test"))
    plant = pitp.plant(case)
    return tuple(measure(plant, excitations(case, part, True)) for part in ("sweep", "train", "test"))


def main(smoke: bool = False, argv=None):
    """Train, predict and count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", nargs="?", default="cone100")
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    parser.add_argument("--members", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--smoke", action="store_true")
    options = parser.parse_args([] if smoke else argv)
    settings = PRESETS["default"]
    if smoke or options.smoke:
        settings = dataclasses.replace(settings, stages=1, epochs=1, refine_steps=1)
    sweep, train, test = records_of(options.case, options.data)
    nominal = pitp.identify(sweep).model
    key = jax.random.key(options.seed)
    ensemble = pitp.train_ensemble(nominal, train, members=options.members, settings=settings, key=key)
    for k, member in enumerate(ensemble.models):
        own = [
            pitp.e_rms_percent(run.displacement, r.displacement, run.scored)
            for run, r in zip(pitp.predict(member, test), test, strict=True)
        ]
        print(f"member {k}: held-out e_rms, median {np.median(own):.3f} %, worst {max(own):.3f} %")
    for level in LEVELS:
        inside, width = [], []
        for record, band in zip(test, pitp.predict_band(ensemble, test, level=level), strict=True):
            keep = band.scored & record.observed
            error = np.abs(band.displacement - record.displacement)[keep]
            inside.append(100 * np.mean(error <= band.half_width[keep]))
            width.append(100 * np.mean(band.half_width[keep]) / np.ptp(record.displacement[keep]))
            print(f"{record.name:28s} {inside[-1]:6.1f} % inside, half width {width[-1]:5.2f} % of range")
        mean, widths = np.mean(inside), np.mean(width)
        print(f"all: {mean:.1f} % inside ({100 * level:g} wanted), worst {min(inside):.1f} %, width {widths:.2f} %")


if __name__ == "__main__":
    main()

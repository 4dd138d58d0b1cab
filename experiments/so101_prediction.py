"""Two joints of a SO-101 arm: a second order with a dead time, identified on two motions, predicts three others.

    q'' + a q' + b q = c u(t - d):   identify on the chirp and the multisine -> free runs on motions kept out

    python experiments/so101_prediction.py [--data ../shared] [--smoke]

u is the commanded angle and q the measured one. The arm's own zero is none of the model's, so the mean of the error is
removed. e is the rms of what is left in % of the motion's standard deviation. Source: github.com/isaac-sim2real/sage.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from _show import show

import pitp_jax as pitp

FIT = ("chirp_sweep", "multisine")
KEPT = ("prbs_excitation", "friction_gravity", "single_joint_elbow")


def percent(model, record, *, remove_mean: bool = True) -> float:
    """Error of a free run, rms in % of the record's standard deviation."""
    (run,) = pitp.predict(model, [record])
    error = (record.displacement - run.displacement)[run.scored]
    error = error - error.mean() if remove_mean else error
    return float(100 * np.sqrt(np.mean(error**2)) / record.displacement[run.scored].std())


def joint(folder: Path) -> tuple:
    """Natural frequency in Hz, dead time in ms, errors on motions kept out (mean removed, then not), seconds."""
    by_name = {r.name: r for r in pitp.read(folder)}
    began = time.perf_counter()
    found = pitp.identify([by_name[n] for n in FIT], order=2, input_map="linear", learn=("delay",))
    seconds = time.perf_counter() - began
    errors = [percent(found.model, by_name[n]) for n in KEPT]
    raw = [percent(found.model, by_name[n], remove_mean=False) for n in KEPT]
    hertz = found.model.natural_frequency / (2 * np.pi)
    return (folder.name, hertz, 1e3 * found.chosen.delay, *errors, *raw, seconds)


def main(smoke: bool = False, argv=None):
    """A row per joint that is there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    parser.add_argument("--smoke", action="store_true", help="one joint")
    options = parser.parse_args([] if smoke and argv is None else argv)
    folders = [options.data / "data/so101" / name for name in ("elbow", "pitch")]
    rows = [joint(f) for f in folders[: 1 if smoke or options.smoke else 2] if f.is_dir()]
    if not rows:
        print(f"skipped: {folders[0]} is absent")
        return rows
    kept = [n.split("_")[0] for n in KEPT]
    header = ("joint", "Hz", "dead time ms", *kept, *(f"{n}, mean kept" for n in kept), "seconds")
    show("SO-101, rms error in % of standard deviation, motions kept out", header, rows)
    return rows


if __name__ == "__main__":
    main()

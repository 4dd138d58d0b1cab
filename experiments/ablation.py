"""What each part of the default preset is worth: one thing switched off at a time, on the recordings of both benches.

    python experiments/ablation.py [cone100 roll] [--only NAME,...] [--seeds 1] [--data ../shared] [--smoke]

Prints, per variant and seed, the median and worst e_rms of held-out records, of the in-sample ones, and the fit time.
A variant that costs nothing should be removed from the code.
"""

import argparse
import dataclasses
import time
from pathlib import Path

import jax
import numpy as np
from _paper import errors
from band_coverage import records_of

import pitp_jax as pitp
from pitp_jax.method.train.settings import PRESETS

VARIANTS = {
    "default": {},
    "equation error only": {"refine_steps": 0},
    "no electrode lag": {"drive": "direct"},
    "no offset token": {"offset": False},
    "no memory": {"memory": "none"},
    "elapsed time": {"memory": "elapsed"},
    "3 memories": {"memories": 3},
    "8 memories": {"memories": 8},
    "no second mass": {"ringing": False},
    "width 4": {"width": 4},
    "width 16": {"width": 16},
    "paper scales": {"scaling": "paper"},
    "central difference": {"difference": "central"},
    "wide Huber": {"huber": 1.0},
    "one stage": {"stages": 1},
}


def main(smoke: bool = False, argv=None):
    """Fit every variant and print its row as soon as it is there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", default=["cone100", "roll"])
    parser.add_argument("--only", type=lambda v: v.split(","), default=list(VARIANTS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    parser.add_argument("--smoke", action="store_true")
    options, short = parser.parse_args([] if smoke else argv), {}
    if smoke or options.smoke:
        options.cases, options.only = ["cone100"], ["default", "no memory"]
        short = {"stages": 1, "epochs": 1, "refine_steps": 1}
    for case in options.cases:
        sweep, train, test = records_of(case, options.data)
        nominal = pitp.identify(sweep).model
        print(f"\n{case:22s} seed {'held-out':>15s} {'in-sample':>15s}  fit")
        print(f"{'':27s} {'median  worst':>15s} {'median  worst':>15s}")
        for name in options.only:
            for seed in range(options.seeds):
                settings = dataclasses.replace(PRESETS["default"], **{**VARIANTS[name], **short})
                began = time.perf_counter()
                model = pitp.train(nominal, train, settings=settings, key=jax.random.key(seed)).model
                seconds = time.perf_counter() - began
                held, own = (np.array(list(errors(model, part).values())) for part in (test, train))
                print(
                    f"{name:22s} {seed:4d} {np.median(held):7.3f} {held.max():7.3f} "
                    f"{np.median(own):7.3f} {own.max():7.3f}  {seconds:.0f} s",
                    flush=True,
                )


if __name__ == "__main__":
    main()

"""The delay that `identify --learn delay` and `fit --learn delay` find on simulated actuators with a known one.

    python experiments/learned_delay.py [--actuators 8] [--fits 2] [--seed 400] [--linear]

Every actuator (`_hardening.py`, delay 0.3 to 6 samples of 4 ms; `--linear`: without its cubic spring) gives a sweep and
four sines. `identify` states a standard error. `fit` trains on all five recordings from the model of the sweep. It also
learns a lag of the electrode, which these actuators do not have; a slow signal shows the sum of delay and lag. The
errors are medians of two sines apart, against the noise-free motion, with --learn delay and without.
"""

import argparse
from dataclasses import replace

import jax
import numpy as np
from _hardening import DT, Plant, record, sine, sweep
from _show import show

import pitp_jax as pitp
from pitp_jax.method.model.drive import ElectrodeLag

SINES = ((0.7, 1.0), (1.9, 0.9), (3.3, 0.8), (5.1, 0.7))  # Hz, of the largest voltage
KEPT = ((1.3, 0.95), (4.2, 0.75))


class Quiet:
    """A generator without noise."""

    def standard_normal(self, count: int) -> np.ndarray:
        """Return zeros."""
        return np.zeros(count)


def drawn(seed: int, *, linear: bool = False) -> tuple[Plant, np.random.Generator]:
    """Draw an actuator."""
    rng = np.random.default_rng(seed)
    omega, zeta = (
        2 * np.pi * np.exp(rng.uniform(np.log(2.5), np.log(8))),
        np.exp(rng.uniform(np.log(0.05), np.log(0.3))),
    )
    hardening, delay = rng.uniform(0.0, 0.5), DT * rng.uniform(0.3, 6.0)
    return Plant(omega, zeta, hardening=0.0 if linear else hardening, delay=delay), rng


def identified(seed: int, *, linear: bool = False) -> tuple:
    """Row of one actuator: true and identified delay in ms, in standard errors."""
    plant, rng = drawn(seed, linear=linear)
    chosen = pitp.identify([record(plant, "sweep", sweep(), rng)], learn=("delay",)).chosen
    true, own, error = (1e3 * v for v in (plant.delay, chosen.delay, chosen.delay_stderr))
    off = abs(own - true) / error if error else np.inf
    return seed, plant.omega / 2 / np.pi, plant.zeta, plant.hardening, true, chosen.order, own, error, off


def fitted(seed: int) -> tuple:
    """Row of one actuator: the trained delay and lag in ms, held-out errors in % of range."""
    plant, rng = drawn(seed)
    records = [record(plant, "sweep", sweep(), rng)]
    records += [record(plant, f"sine{hz}", sine(hz, size), rng) for hz, size in SINES]
    kept = [record(plant, f"kept{hz}", sine(hz, size), Quiet()) for hz, size in KEPT]
    row: tuple = (seed, 1e3 * plant.delay)
    for parts in (("delay",), ()):
        nominal = pitp.identify(records[:1]).model
        settings = replace(pitp.Settings(), parts=parts)
        model = pitp.train(nominal, records, settings=settings, key=jax.random.key(0)).model
        late = 1e3 * sum(float(e.time) for e in model.effects if e.delays)
        lag = 1e3 * float(np.exp(model.drive.log_tau)) if isinstance(model.drive, ElectrodeLag) else 0.0
        runs = zip(pitp.predict(model, kept), kept, strict=True)
        errors = [pitp.e_rms_percent(p.displacement, r.displacement, p.scored) for p, r in runs]
        row += (late, lag, float(np.median(errors)))
    return row


def main(smoke: bool = False, argv=None):
    """Both tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--actuators", type=int, default=8)
    parser.add_argument("--fits", type=int, default=2)
    parser.add_argument("--seed", type=int, default=400)
    parser.add_argument("--linear", action="store_true")
    parser.add_argument("--smoke", action="store_true", help="quick and meaningless")
    options = parser.parse_args([] if smoke and argv is None else argv)
    smoke = smoke or options.smoke
    seeds = range(options.seed, options.seed + (1 if smoke else options.actuators))
    rows = [identified(seed, linear=options.linear or smoke) for seed in seeds]
    header = ("seed", "Hz", "zeta", "h", "delay", "order", "identified", "stderr", "error / stderr")
    show("identify --learn delay, ms", header, rows)
    off = np.array([r[-1] for r in rows])
    print(f"within 1.96 standard errors: {(off < 1.96).sum()} of {len(off)}", flush=True)
    if smoke:
        return rows
    trained = [fitted(seed) for seed in seeds[: options.fits]]
    header = ("seed", "delay", "learned", "lag", "held out (%)", "without: delay", "lag", "held out (%)")
    show("fit --learn delay, ms", header, trained)
    return rows


if __name__ == "__main__":
    main()

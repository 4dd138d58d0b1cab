"""Does a diagnosis mend the feedforward? A rig changes after its model was trained; track before and after.

    train on the healthy virtual actuator -> the rig changes -> record a few sines -> diagnose -> play both feedforwards

    python experiments/tracking_after_diagnosis.py [--plant cone100] [--smoke]

Changes: electrodes aged (a lag of 8 ms before the square), a heavier load (+20 %), a softer membrane (-8 %). The plant
(`pitp_jax.plant`) is none of the model's forms. Printed: e_rms of the noise-free displacement in % of the target's
range, played open loop with the old model's voltage and with the diagnosed one's; the healthy rig's beside them.
"""

import argparse
from dataclasses import replace

import jax
import numpy as np
from _show import show
from _smoke import all_but
from scipy.signal import lfilter

import pitp_jax as pitp
from pitp_jax.application.demo import protocol
from pitp_jax.method.train.settings import PRESETS

LAG = 8e-3  # s
SEED = 7  # of the sensor noise on the changed rig


def lagged(voltage: np.ndarray, dt: float) -> np.ndarray:
    """V of tau V' = u - V, exactly for u linear between samples, from 0 V."""
    q = np.exp(-dt / LAG)
    rise = LAG / dt * (1 - q)
    return lfilter([1 - rise, rise - q], [1, -q], voltage)


def same(voltage: np.ndarray, dt: float) -> np.ndarray:
    """Nothing before the film."""
    return voltage


CHANGES = {
    "none": (lambda plant: plant, same),
    "electrodes 8 ms late": (lambda plant: plant, lagged),
    "load 20 % heavier": (lambda plant: replace(plant, mass=1.2 * plant.mass), same),
    "membrane 8 % softer": (lambda plant: replace(plant, spring=0.92 * plant.spring), same),
}


def recorded(plant, before, drives):
    """Records of a changed rig: the voltage that was played, the displacement that came of it."""
    found = []
    for e in drives:
        dt = e.time[1] - e.time[0]
        got = pitp.record(plant, e.name, e.time, before(e.voltage, dt), seed=SEED)
        found.append(replace(got, voltage=np.asarray(e.voltage, float)))
    return found


def tracked(plant, before, model, targets) -> list[float]:
    """e_rms of every target, open loop."""
    errors = []
    for target in targets:
        plan = pitp.feedforward(model, target)
        clock = np.arange(len(plan.time)) / plant.rate_hz
        x = pitp.simulate(plant, clock, before(plan.voltage, 1 / plant.rate_hz))[plan.target]
        errors.append(pitp.e_rms_percent(x, target.displacement))
    return errors


def main(smoke: bool = False, argv=None):
    """Train once, then change, diagnose and track."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plant", default="cone100")
    parser.add_argument("--smoke", action="store_true")
    options = parser.parse_args([] if smoke and argv is None else argv)
    smoke = smoke or options.smoke
    plant = pitp.plant(options.plant)
    drives = {part: protocol.excitations(plant.name, part, True) for part in ("sweep", "train")}
    (swept,), train = (protocol.measure(plant, drives[part]) for part in ("sweep", "train"))
    model = pitp.identify([swept]).model
    if not smoke:
        settings = replace(PRESETS["default"], **protocol.QUICK_TRAINING)
        model = pitp.train(model, train, settings=settings, key=jax.random.key(0)).model
    scale, frequencies, targets = (
        protocol.SCALES[protocol.kind(plant.name)],
        list(protocol.TRACKING_PAPER[plant.name]),
        [],
    )
    frequencies = frequencies[:1] if smoke else frequencies
    for f in frequencies:
        amplitude, mean = protocol.swing(protocol.nearest(train, plant.name, f))
        time, wanted = pitp.excitation.sine(f, scale.track_s, plant.rate_hz, amplitude, mean, rise=scale.rise_s)
        targets.append(pitp.Target(time, wanted))
    rows = []
    others = all_but("electrode_rc", "delay") if smoke else []
    for name, (change, before) in list(CHANGES.items())[: 2 if smoke else None]:
        changed = change(plant)
        said, errors = "-", tracked(changed, before, model, targets)
        rows.append((name, "trained before", said, *errors))
        if name != "none":
            found = pitp.diagnose(model, recorded(changed, before, drives["train"]), exclude=others)
            said = "+".join(found.effects) or found.verdict
            rows.append((name, "diagnosed", said, *tracked(changed, before, found.model, targets)))
    header = ("change", "model", "said", *(f"{f:g} Hz" for f in frequencies))
    show(f"tracking, {plant.name}: e_rms in % of range", header, rows)


if __name__ == "__main__":
    main()

"""Diagnosis on a measured Peano-HASEL actuator (60 g load), and what its records show without any model.

    1. nominal: order 2 on small steps;      diagnosed on the large steps and the 3 Hz sine;  scored at 7 Hz
    2. nominal: trained on steps and 3 Hz;   diagnosed on the same records;                   scored at 7 Hz
    3. nominal: order 2 on small steps;      commanded voltage as input, beside the measured one

    python experiments/hasel_gap.py [--data ../shared] [--parts 1,2,3] [--smoke]

Two measurements need no fit. Plateaus of the steps: displacement over V^2 falls as the field grows, as it would under a
saturating force (or a hardening spring: the sines tell these apart). Accelerations of the 7 Hz sine: the load is only
pulled, so it falls freely, and their distribution ends at -g on one side only.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from _show import show
from scipy.signal import savgol_filter

import pitp_jax as pitp

GRAVITY = 9.81  # m/s^2
SMALL = 36.0  # s: up to there steps to 2.5 kV


def cut(record, first: float, last: float, name: str):
    """The record from `first` to `last`, s."""
    part = slice(int(first / record.dt), int(last / record.dt))
    return replace(record, name=name, **{f: getattr(record, f)[part] for f in ("time", "voltage", "displacement")})


def nrmse(model, records) -> list[float]:
    """Free runs, error in % of the standard deviation."""
    runs = pitp.predict(model, records)
    return [pitp.nrmse_percent(p.displacement, r.displacement, p.scored) for p, r in zip(runs, records, strict=True)]


def plateaus(steps) -> list[tuple]:
    """(V, displacement in mm, mm per kV^2) at the end of every step up: the mean of its last 0.4 s."""
    high = np.abs(steps.voltage) > 300
    ends = np.flatnonzero(high[:-1] & ~high[1:])
    span, guard, rows = int(0.4 / steps.dt), int(0.05 / steps.dt), []
    for k in ends:
        window = slice(k - guard - span, k - guard)
        volts, x = np.mean(steps.voltage[window]), 1e3 * np.nanmean(steps.displacement[window])
        if np.ptp(steps.voltage[window]) < 200:
            rows.append((float(volts), float(x), float(x / (volts / 1e3) ** 2)))
    return rows


def accelerations(record) -> np.ndarray:
    """m/s^2, from a cubic over 20 ms around every sample."""
    seen = record.observed
    x = np.interp(record.time, record.time[seen], record.displacement[seen])
    return savgol_filter(x, int(0.02 / record.dt) | 1, 3, deriv=2, delta=record.dt)


def without_a_model(steps, sine) -> None:
    """The two measurements."""
    show("plateaus of the steps", ("V", "mm", "mm / kV^2"), plateaus(steps)[::2])
    a = accelerations(sine)
    edges = np.array([-np.inf, -15, -11, -8, -5, 5, 8, 11, 15, np.inf])
    counts = 100 * np.histogram(a, edges)[0] / len(a)
    names = [f"{low:g} to {high:g}" for low, high in zip(edges[:-1], edges[1:], strict=True)]
    show(f"accelerations of {sine.name}, m/s^2", ("between", "% of samples"), zip(names, counts, strict=True))
    falling = a[(a < -7) & (a > -13)]
    mode = np.histogram(falling, 24)
    at = (mode[1][np.argmax(mode[0])] + mode[1][np.argmax(mode[0]) + 1]) / 2
    print(f"most frequent acceleration of the fall: {at:.2f} m/s^2 (free fall: {-GRAVITY})")


def told(finding) -> None:
    """What was found."""
    print(finding)
    for added in finding.added:
        print(f"{added.effect} ({added.form}):", {k: (v["value"], v["unit"]) for k, v in added.parameters.items()})
    rows = [(r.effect, r.form, r.train, r.heldout) for r in finding.ranking]
    show("ranking, % of range", ("effect", "form", "fitted", "held out"), rows[:6])


def diagnosed(title: str, nominal, records, test, **how) -> None:
    """Diagnose, then score on a record that neither saw."""
    print(f"\n=== {title}")
    finding = pitp.diagnose(nominal, records, **how)
    told(finding)
    (before,), (after,) = nrmse(nominal, [test]), nrmse(finding.model, [test])
    print(f"{test.name}: nrmse {before:.1f} -> {after:.1f} % ({100 * (1 - after / before):.0f} % less)")


def witness(root: Path, steps) -> None:
    """Commanded voltage as input; then what the measured voltage says about the amplifier."""
    sine = root / "sine_07Hz.csv.gz"
    (commanded,), (measured,) = pitp.read(sine, input_column="voltage_command_V"), pitp.read(sine)
    nominal = pitp.identify([cut(steps, 0, SMALL, "small steps")], order=2).model
    diagnosed("commanded voltage as input", nominal, [commanded], measured)
    u, v = commanded.voltage, measured.voltage
    shifts = np.arange(0, 40)
    left = [np.std(v[40:] - np.roll(u, k)[40:]) for k in shifts]
    best = int(np.argmin(left))
    gain = float(u @ v / (u @ u))
    print(f"measured over commanded voltage: gain {gain:.4f}, best delay {1e3 * best * measured.dt:.1f} ms, "
          f"{100 * left[best] / np.std(v):.2f} % of its standard deviation left ({100 * left[0] / np.std(v):.2f} % "
          f"without); largest slew {np.abs(np.diff(v)).max() / measured.dt / 1e6:.2f} MV/s")  # fmt: skip


def main(smoke: bool = False, argv=None):
    """The parts asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    parser.add_argument("--parts", default="1,2,3")
    parser.add_argument("--smoke", action="store_true")
    options = parser.parse_args([] if smoke and argv is None else argv)
    root = options.data / "data/hasel_peano"
    if not root.is_dir():
        print(f"skipped: {root} is absent")
        return
    steps, slow, fast = pitp.read(*[root / f"{n}.csv.gz" for n in ("steps", "sine_03Hz", "sine_07Hz")])
    without_a_model(steps, fast)
    if smoke or options.smoke:
        return
    parts = options.parts.split(",")
    if "1" in parts:
        nominal = pitp.identify([cut(steps, 0, SMALL, "small steps")], order=2).model
        diagnosed("from small steps to large and fast", nominal, [cut(steps, SMALL, 115, "large steps"), slow], fast)
    if "2" in parts:
        linear = pitp.identify([steps, slow], order=2).model
        trained = pitp.train(linear, [steps, slow], key=jax.random.key(0)).model
        diagnosed("what training on steps and 3 Hz left", trained, [steps, slow], fast)
    if "3" in parts:
        witness(root, steps)


if __name__ == "__main__":
    main()

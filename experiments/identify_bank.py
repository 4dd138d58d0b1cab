"""Identification on simulated machines: is the true order and hold chosen, and how near is the free run to the truth's?

    python experiments/identify_bank.py --seed 1 --linear 20

Each draw: order 1 to 4, a delay or none, held or linear drive, white or coloured noise of 0.05 to 1 % of range, a sweep
from rest, settled at a bias, or cut out of a running motion. Truth: `scipy.signal.lsim` on 20 times finer samples.
Reported: draws with the true order; with the true hold, where there is no delay that could stand for half a sample; and
the median and the worst ratio of the free run's error to the noise, on a second drive without noise.
"""

import argparse

import numpy as np
from scipy.signal import chirp, lfilter, lsim

import pitp_jax as pitp
from pitp_jax._record.record import Record

RATE, SECONDS, FINE = 500.0, 20.0, 20


def drawn(rng: np.random.Generator):
    """Coefficients a_0 ... a_n, delay (s) and hold of one plant."""
    order, hz = int(rng.integers(1, 5)), float(rng.uniform(2.0, 8.0))
    poly = np.ones(1)
    for k in range(order // 2):
        w = 2 * np.pi * hz * 2.5**k
        poly = np.convolve(poly, [1.0, 2 * rng.uniform(0.05, 0.4) / w, 1 / w**2])
    if order % 2:
        poly = np.convolve(poly, [1.0, 1 / (2 * np.pi * hz * rng.uniform(0.4, 1.5))])
    delay = float(rng.choice([0.0, rng.uniform(1.0, 8.0) / RATE]))
    return poly, delay, str(rng.choice(["foh", "zoh"]))


def played(poly, delay: float, hold: str, drive: np.ndarray) -> np.ndarray:
    """The plant's output at the samples, from the equilibrium of the first one."""
    t = np.arange((len(drive) - 1) * FINE + 1) / FINE
    place = t - delay * RATE
    if hold == "zoh":
        fine = drive[np.clip(np.floor(place + 1e-9).astype(int), 0, len(drive) - 1)]
    else:
        fine = np.interp(place, np.arange(len(drive)), drive)
    x = lsim(([1.0], poly[::-1]), fine - fine[0], t / RATE, interp=hold == "foh")[1]
    return x[::FINE] + fine[0]


def record(rng: np.random.Generator, poly, delay: float, hold: str) -> Record:
    """A noisy sweep that begins at rest, settled, or in motion."""
    t = np.arange(int(RATE * SECONDS)) / RATE
    drive = chirp(t, 0.2, SECONDS, 25.0, phi=-90) + float(rng.choice([0.0, 0.7]))
    x, size = played(poly, delay, hold, drive), float(rng.choice([5e-4, 2e-3, 1e-2]))
    noise = rng.standard_normal(len(x))
    if rng.random() < 0.5:
        noise = np.asarray(lfilter([np.sqrt(1 - 0.9**2)], [1.0, -0.9], noise))
    first = int(rng.choice([0, int(1.3 * RATE)]))
    return Record("sweep", t[first:], drive[first:], (x + size * np.ptp(x) * noise)[first:])


def free_run(found, poly, delay: float, hold: str, noise: float) -> float:
    """Error on another drive, in noises of the identified record."""
    t = np.arange(int(RATE * 8)) / RATE
    drive = np.sin(2 * np.pi * 0.7 * t) * np.sin(2 * np.pi * 0.31 * t) + 0.5 * np.sin(2 * np.pi * 3.1 * t) * (t > 1)
    truth = played(poly, delay, hold, drive)
    run = pitp.predict(found.model, [Record("other", t, drive, truth)])[0]
    error = (run.displacement - truth)[run.scored]
    return float(np.std(error)) / noise


def main() -> None:
    """Draw, identify, print a line each and the summary."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--linear", type=int, default=20)
    options = parser.parse_args()
    rng, rows = np.random.default_rng(options.seed), []
    for k in range(options.linear):
        poly, delay, hold = drawn(rng)
        r = record(rng, poly, delay, hold)
        found = pitp.identify([r], input_map="linear")
        c = found.chosen
        ratio = free_run(found, poly, delay, hold, c.rms)
        rows.append((c.order == len(poly) - 1, c.hold == hold or bool(delay), ratio))
        print(f"{k}: order {len(poly) - 1} -> {c.order}, {hold} -> {c.hold}, delay {1e3 * delay:.2f} -> "
              f"{1e3 * c.delay:.2f} ms, {found.beginnings['sweep'].begins}, {ratio:.3f} noises")  # fmt: skip
    order, held, ratios = (np.array(column) for column in zip(*rows, strict=True))
    print(f"true order {order.sum()} of {len(order)}, true hold {held.sum()}; free run {np.median(ratios):.3f} noises, "
          f"at most {ratios.max():.3f}")  # fmt: skip


if __name__ == "__main__":
    main()

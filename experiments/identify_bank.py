"""Identification on simulated machines: order, hold and free run, beside the truth and SciPy's best linear model.

    python experiments/identify_bank.py --seeds 1 2 --linear 20 --nonlinear 10 [--results bank.jsonl] [--table]

A linear draw: order 1 to 4, a delay or none, held or linear drive, white or coloured noise of 0.05 to 1 % of range, a
sweep from rest, settled at a bias, or cut out of a running motion. Truth: exact filters of SciPy on 20 times finer
samples. Its hold can be told where the other hold, its poles, gain and delay fitted anew, lies at least three standard
errors away (d >= 3, the noise's colour known): of a plant behind a delay, held samples are lines half a sample later,
but for the square of their spacing.
A nonlinear draw: a plant of order 2 with creep, dry friction, backlash on its output, or a sensor that reads |x|;
`scipy.integrate.solve_ivp`. Beside it stand the all-pole models of order 1 to 4 that `scipy.optimize.least_squares`
fits to the same record, each under the hold and the delay of 0 to 8 samples that leave least: the best order of them on
the record that is scored.

Scored on another drive without noise, zero fitted. One JSON line a draw; an interrupted run resumes from --results.
Seeds below 100 are for tuning; figures are reported on others, once.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.signal import chirp, cont2discrete, lfilter, lsim, residue
from scipy.stats import binomtest

import pitp_jax as pitp

RATE, SECONDS, FINE, COLOUR = 500.0, 20.0, 20, 0.9
KINDS = ("creep", "friction", "backlash", "folded")
DELAYS = (0, 1, 2, 4, 8)  # samples, of SciPy's models
FARTHEST = 2 * np.log(2 * np.pi * RATE)  # logarithm of omega^2 at one turn a sample: no coefficient goes beyond


def plant(rng: np.random.Generator, order: int) -> np.ndarray:
    """Coefficients a_0 ... a_n with a_0 = 1: pairs of poles, and a real one where the order is odd."""
    hz, poly = float(rng.uniform(2.0, 8.0)), np.ones(1)
    for k in range(order // 2):
        w = 2 * np.pi * hz * 2.5**k
        poly = np.convolve(poly, [1.0, 2 * rng.uniform(0.05, 0.4) / w, 1 / w**2])
    if order % 2:
        poly = np.convolve(poly, [1.0, 1 / (2 * np.pi * hz * rng.uniform(0.4, 1.5))])
    return poly


def played(poly, delay: float, hold: str, drive: np.ndarray) -> np.ndarray:
    """The plant's output at the samples, from the equilibrium of the first one; delay in s."""
    t = np.arange((len(drive) - 1) * FINE + 1) / FINE
    place = t - delay * RATE
    if hold == "zoh":
        fine = drive[np.clip(np.floor(place + 1e-9).astype(int), 0, len(drive) - 1)]
    else:
        fine = np.interp(place, np.arange(len(drive)), drive)
    fine, x = fine - fine[0], np.zeros(len(fine))
    switch = 1 - (place[0] * FINE) % 1  # where in a fine step a held drive changes
    for part, pole in zip(*residue([1.0], poly[::-1])[:2], strict=True):  # exact for lines and for steps
        z = pole / (RATE * FINE)
        two = (np.expm1(z) - z) / z**2 if hold == "foh" else np.expm1(z * (1 - switch)) / z
        pushed = np.expm1(z) / z * fine[:-1] + two * np.diff(fine)
        x = x + np.real(part * lfilter([1.0], [1.0, -np.exp(z)], np.append(0.0, pushed))) / (RATE * FINE)
    return x[::FINE] + drive[0]


def white(values: np.ndarray, coloured: bool) -> np.ndarray:
    """Whitened by the colour that the noise was drawn with."""
    if not coloured:
        return values
    return np.append(values[0], (values[1:] - COLOUR * values[:-1]) / np.sqrt(1 - COLOUR**2))


def other_drive() -> np.ndarray:
    """The drive on which free runs are scored."""
    t = np.arange(int(RATE * 8)) / RATE
    return np.sin(2 * np.pi * 0.7 * t) * np.sin(2 * np.pi * 0.31 * t) + 0.5 * np.sin(2 * np.pi * 3.1 * t) * (t > 1)


def free_run(found, drive: np.ndarray, truth: np.ndarray) -> float:
    """Standard deviation of the model's error on another record."""
    run = pitp.predict(found.model, [pitp.Record("other", np.arange(len(drive)) / RATE, drive, truth)])[0]
    return float(np.std((run.displacement - truth)[run.scored]))


def distance(poly, delay: float, hold: str, drive, first: int, sigma: float, coloured: bool) -> float:
    """How many standard errors the other hold stays away whatever its numbers."""
    other = "foh" if hold == "zoh" else "zoh"
    target = white(played(poly, delay, hold, drive)[first:], coloured) / sigma

    def residual(p):
        run = played(poly * np.exp(np.append(0.0, p[:-2])), max(p[-1], 0.0) / RATE, other, drive)
        return white(p[-2] * run[first:], coloured) / sigma - target

    late = max(delay * RATE + (0.5 if hold == "zoh" else -0.5), 0.0)
    start = np.append(np.zeros(len(poly) - 1), [1.0, late])
    if not delay:  # a delay would be one number more than the truth has
        fixed = least_squares(lambda p: residual(np.append(p, 0.0)), start[:-1], max_nfev=8)
        return float(np.sqrt(2 * fixed.cost))
    return float(np.sqrt(2 * least_squares(residual, start, max_nfev=8).cost))


def linear_draw(seed: int, k: int) -> dict:
    """One linear plant, identified."""
    rng = np.random.default_rng([seed, 1, k])
    order = int(rng.integers(1, 5))
    poly = plant(rng, order)
    delay, hold = float(rng.choice([0.0, rng.uniform(1.0, 8.0) / RATE])), str(rng.choice(["foh", "zoh"]))
    t = np.arange(int(RATE * SECONDS)) / RATE
    drive = chirp(t, 0.2, SECONDS, 25.0, phi=-90) + float(rng.choice([0.0, 0.7]))
    x, coloured = played(poly, delay, hold, drive), bool(rng.random() < 0.5)
    sigma = float(rng.choice([5e-4, 2e-3, 1e-2])) * float(np.ptp(x))
    noise = rng.standard_normal(len(x))
    if coloured:
        noise = np.asarray(lfilter([np.sqrt(1 - COLOUR**2)], [1.0, -COLOUR], noise))
    first = int(rng.choice([0, int(1.3 * RATE)]))
    record = pitp.Record("sweep", t[first:], drive[first:], (x + sigma * noise)[first:])
    found = pitp.identify([record], input_map="linear")
    c, other = found.chosen, other_drive()
    error = free_run(found, other, played(poly, delay, hold, other)) / sigma
    return {
        "order": [order, c.order], "hold": [hold, c.hold], "delay_ms": [1e3 * delay, 1e3 * c.delay],
        "begins": found.beginnings["sweep"].begins, "coloured": coloured, "noise": sigma / float(np.ptp(x)),
        "hold_distance": distance(poly, delay, hold, drive, first, sigma, coloured),
        "ratio": float(np.hypot(1.0, error)),
    }  # fmt: skip


def moved(kind: str, poly: np.ndarray, size: float, drive: np.ndarray) -> np.ndarray:
    """The output of a plant with one nonlinearity (or creep) of this size, from rest at 0."""
    t = np.arange(len(drive)) / RATE
    x = played(poly, 0.0, "foh", drive)  # of friction, where there is none
    if kind == "creep":  # a lag of 2 s beside the mode
        return x + size * np.asarray(lsim(([1.0], [2.0, 1.0]), drive, t)[1])
    if kind == "backlash":
        y, out = np.empty_like(x), 0.0
        for k, value in enumerate(x):
            out = min(max(out, value - size), value + size)
            y[k] = out
        return y
    if kind == "folded":
        return np.abs(x + 1.0 - size) - (1.0 - size)

    def slope(now, state):
        force = np.interp(now, t, drive)
        return [state[1], (force - state[0] - poly[1] * state[1] - size * np.tanh(state[1] / 0.02)) / poly[2]]

    return solve_ivp(slope, (0.0, t[-1]), [0.0, 0.0], "LSODA", t, rtol=1e-6, atol=1e-8, max_step=1 / RATE).y[0]


def run_of(logs: np.ndarray, hold: str, late: int, drive: np.ndarray) -> np.ndarray:
    """An all-pole model from rest, unit static gain: pairs (a, b) of s^2 + e^a s + e^b, and one s + e^a."""
    poly = np.ones(1)
    for k in range(0, len(logs) - 1, 2):
        poly = np.polymul(poly, [1.0, np.exp(logs[k]), np.exp(logs[k + 1])])
    if len(logs) % 2:
        poly = np.polymul(poly, [1.0, np.exp(logs[-1])])
    top, bottom = tuple(cont2discrete(([poly[-1]], poly), 1 / RATE, method=hold))[:2]  # pyright: ignore
    return np.asarray(lfilter(np.ravel(top), bottom, np.append(np.zeros(late), drive)[: len(drive)]))


def peers(drive: np.ndarray, output: np.ndarray, other: np.ndarray):
    """What SciPy's model of every order, under the hold and delay that leave least, makes of another drive."""

    def residual(logs, hold, late):
        if np.abs(logs).max() > FARTHEST:
            return np.full(len(drive), 1e3)
        with np.errstate(all="ignore"):
            run = run_of(logs, hold, late, drive)
        if not np.isfinite(run).all():
            return np.full(len(drive), 1e3)
        columns = np.column_stack([run, np.ones(len(run))])
        return output - columns @ np.linalg.lstsq(columns, output, rcond=None)[0]

    for order in range(1, 5):
        grid = np.log(2 * np.pi * np.array([0.5, 2.0, 5.0, 12.0]))
        starts = [np.append([v for k in range(order // 2) for v in (w + 2 * k - 1, 2 * (w + k))], [w] * (order % 2))
                  for w in grid]  # fmt: skip
        ends = []
        for hold in ("foh", "zoh"):
            for late in DELAYS:
                best = min(starts, key=lambda s: float(np.sum(residual(s, hold, late) ** 2)))
                fit = least_squares(residual, best, args=(hold, late), x_scale=0.3, max_nfev=25)
                starts = [*starts[:4], fit.x]
                ends.append((fit.cost, fit.x, hold, late))
        _, logs, hold, late = min(ends, key=lambda e: e[0])
        run = run_of(logs, hold, late, drive)
        gain = np.linalg.lstsq(np.column_stack([run, np.ones(len(run))]), output, rcond=None)[0][0]
        yield gain * run_of(logs, hold, late, other)


def nonlinear_draw(seed: int, k: int) -> dict:
    """One plant with a nonlinearity, identified by us and by SciPy."""
    rng, kind = np.random.default_rng([seed, 2, k]), KINDS[k % len(KINDS)]
    poly = plant(rng, 2)
    low, high = {"creep": (0.1, 0.4), "friction": (0.02, 0.15), "backlash": (0.02, 0.15), "folded": (0.3, 0.8)}[kind]
    size, t = float(rng.uniform(low, high)), np.arange(int(RATE * SECONDS)) / RATE
    drive, other = chirp(t, 0.2, SECONDS, 12.0, phi=-90), other_drive()
    y, truth = moved(kind, poly, size, drive), moved(kind, poly, size, other)
    y = y + 2e-3 * np.ptp(y) * rng.standard_normal(len(y))
    found = pitp.identify([pitp.Record("sweep", t, drive, y)], input_map="linear")
    best = min(float(np.std(run - truth)) for run in peers(drive, y, other))
    c, ours = found.chosen, free_run(found, other, truth)
    return {
        "kind": kind, "size": size, "order": c.order, "hold": c.hold, "delay_ms": 1e3 * c.delay,
        "begins": found.beginnings["sweep"].begins, "ours": ours / np.std(truth), "scipy": best / np.std(truth),
        "ratio": ours / best,
    }  # fmt: skip


def interval(hits) -> str:
    """Hits, of how many, and the Wilson interval in %."""
    low, high = binomtest(sum(hits), len(hits)).proportion_ci(method="wilson")
    return f"{sum(hits)} of {len(hits)} ({100 * low:.0f} to {100 * high:.0f} %)"


def table(rows: list[dict]) -> None:
    """Print what the draws show."""
    drawn, failed = [r for r in rows if "refused" not in r], [r for r in rows if "refused" in r]
    linear, bent = ([r for r in drawn if ("kind" in r) is flag] for flag in (False, True))
    right = {key: [r[key][0] == r[key][1] for r in linear] for key in ("order", "hold")}
    clear = [hit for hit, r in zip(right["hold"], linear, strict=True) if r["hold_distance"] >= 3]
    for name, hits in (("order", right["order"]), ("hold", right["hold"]), ("hold where it can be told", clear)):
        if hits:
            print(f"true {name}: {interval(hits)}")
    kinds = [(kind, [r for r in bent if r["kind"] == kind], 1.05) for kind in KINDS]
    for name, some, most in [("linear", linear, 1.02), *kinds, ("nonlinear", bent, 1.05)]:
        if some:
            ratios = [r["ratio"] for r in some]
            near = interval([ratio <= most for ratio in ratios])
            print(f"{name}: free run within {most} {near}, median {np.median(ratios):.4f}, worst {max(ratios):.3f}")
    for row in failed:
        print("refused:", row)


def main() -> None:
    """Draw, identify, print a line each and the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--linear", type=int, default=20, help="draws a seed")
    parser.add_argument("--nonlinear", type=int, default=0, help="draws a seed")
    parser.add_argument("--results", type=Path, help="one JSON line a draw; a run resumes from it")
    parser.add_argument("--table", action="store_true", help="only print what --results holds")
    parser.add_argument("--smoke", action="store_true", help="quick and meaningless")
    options = parser.parse_args()
    if options.smoke:
        options.seeds, options.linear, options.nonlinear = [1], 1, 0
    lines = options.results.read_text().splitlines() if options.results and options.results.exists() else []
    done = {tuple(row["cell"]): row for row in map(json.loads, lines)}
    cells = [(name, seed, k) for seed in options.seeds for name, count in
             (("linear", options.linear), ("nonlinear", options.nonlinear)) for k in range(count)]  # fmt: skip
    for cell in [] if options.table else [c for c in cells if c not in done]:
        try:
            row = (linear_draw if cell[0] == "linear" else nonlinear_draw)(*cell[1:])
        except pitp.ComputationFailed as error:
            row = {"refused": str(error)}
        done[cell] = {"cell": cell, **row}
        line = json.dumps(done[cell])
        print(line, flush=True)
        if options.results:
            with options.results.open("a") as file:
                file.write(line + "\n")
    table(list(done.values()) if options.table else [done[c] for c in cells])


if __name__ == "__main__":
    main()

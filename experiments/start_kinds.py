"""Count wrong estimates of how simulated recordings start: rest, settled or moving, sensor offset, direction.

    x'' / w^2 + 2 zeta x' / w + x = F(u),  exact between samples;   measured = direction * x + offset + noise
    effects that the model lacks:  electrode   T F' + F = u^2,  T = 0.03 to 0.5 periods
                                   stiffening  x + b (x / X)^2 x,  b = 0.3 to 1.5 at the largest force's X
                                   creep       x - c,  3 periods c' + c = k / (1 + k) x,  k = 0.1 to 0.5
    starts: at rest; settled at u(0); cut out of a motion where the state is 5 % of range from rest and equilibrium

    python experiments/start_kinds.py [--sets 50] [--seed 0] [--only equation] [--effect none] [--smoke]

Each set holds four recordings of one actuator: sines, sweeps, steps and multisines, 100 Hz to 10 kHz, 12 to 400
samples a period, 0.1 to 1 % of noise, white or coloured, a third of the sensors reversed; in half of the sets every
recording has its own offset. `equation` decides beside the equation without the effect; `identify` sees the set;
`predict` has a model of a sweep from rest, without the effect. Asked for: at most 2 % wrong kinds.
"""

import argparse
from collections import Counter
from typing import Any

import numpy as np
from _show import show
from scipy.signal import cont2discrete, lfilter

import pitp_jax as pitp
from pitp_jax.method.identify.linear_ode import poles as modes
from pitp_jax.method.identify.linear_ode import respond
from pitp_jax.method.signal.start import Response, estimate_start, first_part

RATES = (100.0, 300.0, 1000.0, 3000.0, 10_000.0)
KINDS, VERBS = ("rest", "held", "moving"), ("equation", "identify", "predict")
FINE = 8  # steps a sample
EFFECTS = {"none": (1, 1), "electrode": (0.03, 0.5), "stiffening": (0.3, 1.5), "creep": (0.1, 0.5)}


def drive(kind: str, t: np.ndarray, hz: float, rng: np.random.Generator) -> np.ndarray:
    """A drive between 0 and 1 over time t (s), whose first value is anything."""
    phase, seconds = rng.uniform(0, 2 * np.pi), t[-1]
    if kind == "sine":
        return 0.5 + 0.45 * np.sin(2 * np.pi * hz * np.exp(rng.uniform(-2, 0.7)) * t + phase)
    if kind == "sweep":
        return 0.5 + 0.45 * np.sin(2 * np.pi * hz * (0.1 * t + 0.75 * t * np.abs(t) / seconds) + phase)
    if kind == "steps":
        levels = rng.uniform(0.05, 1, 400)
        return levels[np.clip((t * hz / 4).astype(int) + 200 - (t < 0), 0, 399)]
    lines = np.exp(rng.uniform(-2, 0.7, 6)) * hz
    return 0.5 + 0.45 / 3 * np.sin(2 * np.pi * np.outer(t, lines) + rng.uniform(0, 2 * np.pi, 6)).sum(1).clip(-3, 3)


def simulated(u: np.ndarray, before: np.ndarray | None, held: bool, plant: tuple, dt: float) -> np.ndarray:
    """Displacement under u, from rest, settled at u(0) or after the drive `before`."""
    hz, zeta, square, name, size = plant
    w, whole = 2 * np.pi * hz, u if before is None else np.concatenate([before, u])
    fine = np.interp(np.arange((len(whole) - 1) * FINE + 1) / FINE, np.arange(len(whole)), whole)
    force = fine**2 if square else fine
    if name == "stiffening":
        x = stiffening(force, plant, dt / FINE, equilibria(force[0], plant)[0] if held else 0.0)
        return x[::FINE][len(whole) - len(u) :]
    poles, zeros = np.array([1 / w**2, 2 * zeta / w, 1]), np.ones(1)
    if name == "electrode":
        poles = np.polymul(poles, [size / hz, 1])
    if name == "creep":
        zeros = np.array([3 / hz, 1])
        poles = np.polyadd(np.polymul(poles, zeros), [-size / (1 + size)])
    sampled: Any = cont2discrete((zeros, poles), dt / FINE, method="zoh")
    b, a = (np.ravel(p) for p in sampled[:2])
    level = force[0] if held else 0.0
    x = np.asarray(lfilter(b, a, force - level)) + level * zeros[-1] / poles[-1]
    return x[::FINE][len(whole) - len(u) :]


def stiffening(force: np.ndarray, plant: tuple, h: float, x: float) -> np.ndarray:
    """Displacement behind a cubic spring, by velocity Verlet, from rest at x."""
    w, zeta, b = 2 * np.pi * plant[0], plant[1], plant[4] / largest(plant) ** 2
    v, path = 0.0, np.empty(len(force))
    for k, f in enumerate(force.tolist()):
        path[k] = x
        v += h / 2 * (w * w * (f - x - b * x**3) - 2 * zeta * w * v)
        x += h * v
        v = (v + h / 2 * w * w * (f - x - b * x**3)) / (1 + h * zeta * w)
    return path


def largest(plant: tuple) -> float:
    """The largest force, as a displacement of the linear spring."""
    return 1e6 if plant[2] else 1e3


def equilibria(force: float, plant: tuple) -> tuple[float, float]:
    """The smallest and the largest displacement that a force holds: before and after creep."""
    name, size = plant[3:]
    if name == "stiffening":
        roots = np.roots([size / largest(plant) ** 2, 0, 1, -force])
        only = float(roots[np.argmin(np.abs(roots.imag))].real)
        return only, only
    return force, force * (1 + size if name == "creep" else 1)


def noise(size: int, pole: float, rng: np.random.Generator) -> np.ndarray:
    """Noise of unit variance: white, or of order 1."""
    return np.asarray(lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.standard_normal(size + 2000)))[2000:]


def one_set(rng: np.random.Generator, effect: str) -> tuple[list[pitp.Record], list[tuple], pitp.Record, dict]:
    """Four recordings of one actuator, what is true of each, and a sweep of it from rest, without the effect."""
    rate, square = RATES[rng.integers(5)], bool(rng.integers(2))
    size = float(np.exp(rng.uniform(*np.log(EFFECTS[effect]))))
    hz, zeta = rate / np.exp(rng.uniform(*np.log((12, 400)))), np.exp(rng.uniform(*np.log((0.03, 0.6))))
    healthy, plant = ((hz, zeta, square, *one) for one in (("none", 0.0), (effect, size)))
    samples = int(np.clip(rng.uniform(20, 60) * rate / plant[0], 400, 20_000))
    pole = (0.0, 0.0, np.exp(-2 * np.pi * plant[0] / rate * rng.uniform(0.3, 3)))[rng.integers(3)]
    level_of_noise, gain, one_zero = 10 ** rng.uniform(-3, -2), 10 ** rng.uniform(-6, 0), bool(rng.integers(2))
    zero, records, truth = rng.uniform(-1, 1), [], []
    t, lead = np.arange(samples) / rate, int(60 * rate / plant[0])
    while len(records) < 5:
        k = len(records)
        kind = "rest" if k == 4 else KINDS[rng.integers(3)]
        u = drive("sweep" if k == 4 else ("sine", "sweep", "steps", "multisine")[rng.integers(4)],
                  np.concatenate([-t[lead:0:-1], t]) if lead < samples else t, plant[0], rng)  # fmt: skip
        before, u = (u[:-samples], u[-samples:]) if len(u) > samples else (u[::-1], u)
        ahead = int(rng.integers(2)) * int(rng.uniform(0, 0.3) * samples)
        u[:ahead] = (u[ahead] if kind == "held" else 0.0) if kind != "moving" and ahead else u[:ahead]
        u = u * 1000.0
        x = simulated(u, before * 1000.0 if kind == "moving" else None, kind == "held",
                      healthy if k == 4 else plant, 1 / rate)  # fmt: skip
        level, speed = (u[0] ** 2 if square else u[0]), (x[1] - x[0]) * rate / (2 * np.pi * plant[0])
        apart = min(np.hypot(x[0] - at, speed) for at in (0.0, np.clip(x[0], *equilibria(level, plant)))) / np.ptp(x)
        if kind == "moving" and apart < 0.05:
            continue
        direction = 1.0 if k == 4 or rng.random() > 1 / 3 else -1.0
        own = zero if one_zero or k == 4 else rng.uniform(-1, 1)
        own *= 1e6 if square else 1e3
        y = gain * (direction * x + own + np.ptp(x) * level_of_noise * noise(samples, pole, rng))
        records.append(pitp.Record(f"r{k}", t, u, y))
        truth.append((kind, direction, gain * own))
    about = {"rate": rate, "gain": gain, "noise": "coloured" if pole else "white", "plant": plant}
    return records[:4], truth[:4], records[4], about


def beside_the_equation(records: list[pitp.Record], about: dict):
    """Estimate the start of every record with the equation without the effect as the model."""
    hz, zeta, square, *_ = about["plant"]
    w = 2 * np.pi * hz
    logs = np.log([2 * zeta * w, w * w])
    for record in records:
        part = first_part(record, w)
        rest, held = (
            about["gain"] * respond(logs, part.voltage, step=part.dt, square=square, hold="foh", settled=settled)
            for settled in (False, True)
        )
        yield estimate_start(part, Response(rest, held, modes(logs), w))


def main(smoke: bool = False, argv=None):
    """Simulate the sets, estimate every start, and print the counts."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sets", type=int, default=50, help="of four recordings")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=VERBS)
    parser.add_argument("--effect", choices=EFFECTS, default="none", help="that the model lacks")
    parser.add_argument("--smoke", action="store_true", default=smoke)
    options = parser.parse_args([] if smoke and argv is None else argv)
    rows, wrong = [], []
    for verb in [options.only] if options.only else VERBS:
        drawn, errors, turned = Counter(), Counter(), 0
        for k in range(3 if options.smoke else options.sets):
            records, truth, sweep, about = one_set(np.random.default_rng([options.seed, k]), options.effect)
            named = "square" if about["plant"][2] else "linear"
            if verb == "equation":
                told = [(b.begins, b.direction) for b in beside_the_equation(records, about)]
            elif verb == "identify":
                begun = list(pitp.identify(records, order=2, input_map=named).beginnings.values())
                same = np.sign(sum(b.direction * d for b, (_, d, _) in zip(begun, truth, strict=True))) or 1.0
                told = [(b.begins, b.direction * same) for b in begun]
            else:
                model = pitp.identify([sweep], order=2, input_map=named).model
                told = [(p.begins, p.direction) for p in pitp.predict(model, records)]
            for j, ((begins, direction), (kind, true, _)) in enumerate(zip(told, truth, strict=True)):
                cells = ("all", kind, about["noise"], f"{about['rate']:g} Hz", "as usual" if true > 0 else "reversed")
                # at 0 V settled is rest
                off = begins != kind and not (kind == "held" and records[j].voltage[0] == 0)
                turned += direction != true
                drawn.update(cells)
                errors.update(cells if off else ())
                if off or direction != true:
                    wrong.append((verb, k, j, kind, begins, true, direction))
        rows += [(verb, c, drawn[c], errors[c], f"{100 * errors[c] / drawn[c]:.1f}") for c in sorted(drawn)]
        rows.append((verb, "wrong direction", drawn["all"], turned, f"{100 * turned / drawn['all']:.1f}"))
    show("starts of simulated recordings", ("verb", "cell", "recordings", "wrong", "%"), rows)
    for line in wrong:
        print(*line)
    return rows


if __name__ == "__main__":
    main()

"""The exported controller in a closed loop with withheld plants: how soon it is back on its target after a limit.

    F = 0.8 (model's force) until the change, then 1.15;   target 0.9 of the model's stroke at the voltage limit
    settled = (time from the change on after which |y - target| stays below 2 % of the stroke) / lambda

    python experiments/closed_loop.py [--seeds 300,301] [--effects healthy,stiffening,...] [--results FILE]
    python experiments/closed_loop.py --trained        twelve trained models (`_trained_loops`)

Compiled C (`export_c`, double precision) on a model identified on the case's healthy records; the plant, with the
case's effect, is integrated apart. The reading's zero is 5 mm off; at odd seeds it is negated. The change comes while
the voltage is at its limit, so the limit is left after it. Asked for: at most 4, with lambda at most 2 / (zeta w_0);
`wound` is the same without anti-windup and has to fail.
"""

import argparse
import ctypes
import json
import subprocess
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import jax.numpy as jnp
import numpy as np
from _show import show
from _trained_loops import KINDS, verified
from _withheld import plant as integrator
from _withheld.case import Spec, load_or_make
from _withheld.catalogue import FORMS

import pitp_jax as pitp

EFFECTS = ("healthy", "stiffening", "softening", "drag", "relaxation", "electrode_rc", "stretch_coupling", "added_mass")
WEAK, STRONG, AT, RISES, HELD, OFFSET = 0.8, 1.15, 0.9, 1.0, 8.0, 5e-3
HARNESS = """
#include "pitp_model.c"
static pitp_model_state s;
void begin(double y0, int bounded) { pitp_model_init(&s, y0, 0.0); if (!bounded) { s.track = 0.0; } }
double trim(const double *y, double measured) { uint32_t flags; return pitp_model_pi_step(&s, y, measured, &flags); }
"""


class Plant:
    """A withheld plant, sample by sample; the force is `gain` times what the voltage makes.

    `step`: sampling interval in 1/w0.
    """

    def __init__(self, forms, strengths, constants, zeta: float, step: float):
        self.count = integrator.substeps(forms, step)
        self.state = jnp.zeros(2 + sum(f.states for f in forms))

        @jax.jit
        def sample(y, u):
            def slope(y, u, push, t):
                return integrator.rate(forms, strengths, constants, zeta, y, u, push, t)

            for _ in range(self.count):
                y = integrator._advance(slope, y, step / self.count, (u, 0.0, 0.0), (u, 0.0, 0.0))
            return y

        self._sample = sample

    def __call__(self, u: float, gain: float = 1.0) -> float:
        """Displacement in X, one sample on, under a voltage in U that is held."""
        self.state = self._sample(self.state, np.sqrt(gain) * u)
        return float(self.state[0])


def smooth(t):
    """From 0 to 1, all derivatives up to the 4th continuous."""
    t = np.clip(t, 0, 1)
    return t**5 * (126 - 420 * t + 540 * t**2 - 315 * t**3 + 70 * t**4)


def compiled(model, folder: Path):
    """The exported controller as a library, and its closed loop's time constant in s."""
    pitp.export_c(model, folder / "c")
    (folder / "c" / "harness.c").write_text(HARNESS)
    library = folder / "c" / "harness.so"
    command = ["cc", "-O2", "-std=c99", "-shared", "-fPIC", "-o", library, "harness.c", "-lm"]
    subprocess.run(command, cwd=folder / "c", check=True)
    c = ctypes.CDLL(str(library))
    c.trim.restype = ctypes.c_double
    return c, pitp.pi_gains(model).time_constant


def loop(c, plant, target: np.ndarray, gain: np.ndarray, scale: tuple[float, float, float], bounded: bool):
    """Readings (m) and voltages (V) along a target (rows of y, y', ...); `scale`: of reading, its zero, and volts."""
    size, zero, volts = scale
    y, u = np.full(len(target) + 1, zero), np.empty(len(target))
    c.begin(ctypes.c_double(zero), int(bounded))
    rows = np.ascontiguousarray(target, float)
    for k, row in enumerate(rows):
        u[k] = c.trim(row.ctypes.data_as(ctypes.c_void_p), ctypes.c_double(y[k]))
        y[k + 1] = zero + size * plant(u[k] / volts, gain[k])
    return y[:-1], u


def settles(model, c, lag: float, made, scale, bounded: bool = True) -> dict:
    """One run of the script's course; `made`: fn() -> a fresh plant."""
    size, zero, _ = scale
    top, dt, last = max(model.domain.voltage_range), model.dt, HELD + 9 * lag
    stroke = AT * top**2 / model.physical_coefficients[0]
    t = np.arange(int(last / dt)) * dt
    rows = [stroke * smooth(t / RISES)]
    for _ in range(model.order):
        rows.append(np.gradient(rows[-1], dt))
    target = np.stack(rows, 1)
    y, u = loop(c, made(), target, np.where(t < HELD, WEAK, STRONG), scale, bounded)
    off = np.flatnonzero(np.abs(np.sign(size) * (y - zero) - target[:, 0]) > 0.02 * stroke)
    at_limit = (u[int(3 / dt) : int(HELD / dt)] > top * (1 - 1e-6)).all()
    settled = float((t[off[-1]] - HELD) / lag)
    return {"settled": settled, "at_limit": bool(at_limit), "kept": bool(u.max() <= top * (1 + 1e-9))}


def cell(effect: str, seed: int, polarity: float) -> dict:
    """One plant: how soon with and without anti-windup, and lambda times zeta w_0 / 2."""
    case = load_or_make(Spec(() if effect == "healthy" else (effect,), "cone", seed), None)
    facts, names = case.facts, zip(case.facts["label"].split("+"), case.facts["forms"], strict=False)
    forms = tuple(f for name, form in names if name in FORMS for f in FORMS[name] if f.name == form)
    read = [replace(r, displacement=OFFSET + polarity * r.displacement) for r in case.clean]
    model = pitp.identify(read).model
    step, top = 2 * np.pi * facts["f0_hz"] * model.dt, 5500.0
    ps = facts.get("strengths", [])
    with TemporaryDirectory() as folder, jax.enable_x64(True):
        c, lag = compiled(model, Path(folder))

        def made():
            return Plant(forms, ps, facts.get("constants", []), facts["zeta"], step)

        scale = polarity * facts["scale_m"], OFFSET, top
        kept, wound = (settles(model, c, lag, made, scale, bounded) for bounded in (True, False))
    slowest = facts["zeta"] * 2 * np.pi * facts["f0_hz"]
    return kept | {"wound": wound["settled"], "lambda": lag * slowest / 2, "order": model.order}


def trained(kinds):
    """The table of the trained models: time constants, margins, errors in percent of the stroke."""
    rows = []
    for kind in kinds:
        parts = f"order {kind.order}, {kind.hz:g} Hz, zeta {kind.zeta:g}, {kind.rate:g}/s"
        parts += f", lag {1e3 * kind.lag:g} ms" * (kind.lag > 0) + f", delay {1e3 * kind.delay:g} ms" * (kind.delay > 0)
        parts += ", reversed" * (kind.polarity < 0) + ", nearly linear" * (kind.size < 0.1)
        with TemporaryDirectory() as folder:
            row = verified(kind, Path(folder))
        worst, best = 100 * row.pop("worst_accepted"), 100 * row.pop("best_refused")
        rows.append((parts, *row.values(), worst, best))
        print(rows[-1], flush=True)
    header = (
        "model", "default (s)", "x zeta w0 / 2", "x smallest", "x smallest of 5 plants", "gain margin", "sensitivity",
        "linear's gain margin", "accepted", "refused", "worst accepted (%)", "best refused (%)",
    )  # fmt: skip
    show("the default time constant of trained models, and the error five time constants after a load", header, rows)
    return rows


def main(smoke: bool = False, argv=None):
    """All cells, then the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", default="300,301")
    parser.add_argument("--effects", default=",".join(EFFECTS))
    parser.add_argument("--results", type=Path, help="one line a cell; a run resumes from it")
    parser.add_argument("--trained", action="store_true", help="twelve trained models instead of withheld plants")
    parser.add_argument("--smoke", action="store_true", default=smoke)
    options = parser.parse_args([] if smoke and argv is None else argv)
    if options.smoke:
        options.seeds, options.effects = "0", "healthy"
    if options.trained:
        return trained(KINDS)
    kept = options.results.read_text().splitlines() if options.results and options.results.exists() else []
    done = {said["key"]: said for said in map(json.loads, kept)}
    rows = []
    for effect in options.effects.split(","):
        for seed in map(int, options.seeds.split(",")):
            key = f"{effect} {seed}"
            said = done.get(key) or {"key": key} | cell(effect, seed, -1.0 if seed % 2 else 1.0)
            if options.results and key not in done:
                with options.results.open("a") as out:
                    out.write(json.dumps(said) + "\n")
            rows.append((key, *(said[k] for k in ("settled", "wound", "lambda", "at_limit", "kept", "order"))))
    header = ("plant", "settled", "wound", "lambda zeta w0 / 2", "at its limit", "limit kept", "order")
    show("the exported controller after a limit, in time constants of the closed loop", header, rows)
    return rows


if __name__ == "__main__":
    main()

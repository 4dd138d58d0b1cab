"""Twelve trained models and the exported controller in closed loops around them, all in compiled C.

A model is a linear one with a random compact encoder, so that its stiffness, damping and gain vary over the stroke.
The controller is the export at the model's rate. The plant is the export of the model's decoder at four times this
rate; its stiffness is changed in the mechanical pair, its gain at the voltage.

    u_plant = sqrt(gain u^2 + load),   load = 0 until the step, then a tenth of the force that holds the target
"""

import ctypes
import subprocess
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import pitp_jax as pitp
from pitp_jax.files.export.c99 import write_sources
from pitp_jax.files.export.equilibria import equilibria
from pitp_jax.files.export.pi_gains import SENSITIVE, operating_points, tuning
from pitp_jax.files.export.plan import plan
from pitp_jax.method.effects import effect
from pitp_jax.method.model.constants import constant_array
from pitp_jax.method.model.domain import Domain
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.encoder import CompactEncoder, ConstantEncoder
from pitp_jax.method.model.input_map import SquareInput
from pitp_jax.method.model.memory import FadingMemory, NoMemory
from pitp_jax.method.model.model import Model, Output, linear_model
from pitp_jax.method.model.programs import in_double
from pitp_jax.method.simulate.decoder import rollout

TOP, STROKE, FINER = 3000.0, 1e-3, 4
PLANTS = {"same": (1.0, 1.0)} | {f"k {k:g} g {g:g}": (k, g) for k in (0.8, 1.2) for g in (0.8, 1.2)}
HELD_AT, AND_SAME_AT = (0.25, 0.5), 0.9  # of the stroke that the voltage holds; a plant 20 % off is not held at 0.9
RISES, ALLOWED = 1.0, 0.02  # s, of the stroke
TRIED = (4e-3, 1e-2, 2e-2, 3e-2, 5e-2, 0.1, 0.2, 0.3)  # s, time constants


@dataclass(frozen=True)
class Kind:
    """What a model is made of: poles, sampling, parts, sensor, and how far the encoder is from the linear model."""

    order: int
    hz: float
    zeta: float
    rate: float = 1000.0
    lag: float = 0.0  # s
    delay: float = 0.0  # s
    offset: float = 0.0  # m
    polarity: float = 1.0
    size: float = 0.15
    seed: int = 0


KINDS = (
    Kind(2, 7.0, 0.08, seed=11), Kind(2, 7.0, 0.08, lag=4.4e-3, polarity=-1.0, offset=18.4e-3, seed=13),
    Kind(2, 12.0, 0.05, delay=6e-3, seed=4), Kind(2, 22.0, 0.15, lag=2e-3, delay=3e-3, polarity=-1.0, seed=11),
    Kind(2, 5.0, 0.3, rate=500.0, lag=5e-3, seed=13), Kind(2, 40.0, 0.1, rate=4000.0, polarity=-1.0, seed=4),
    Kind(3, 22.0, 0.07, lag=4.4e-3, seed=6), Kind(3, 7.0, 0.08, polarity=-1.0, offset=5e-3, seed=10),
    Kind(3, 9.0, 0.15, delay=5e-3, seed=3), Kind(3, 15.0, 0.1, lag=3e-3, delay=4e-3, polarity=-1.0, seed=6),
    Kind(3, 30.0, 0.2, rate=2000.0, lag=1e-3, size=0.03), Kind(2, 10.0, 0.1, lag=3e-3, size=0.03),
)  # fmt: skip


def polynomial(kind: Kind, stiffness: float = 1.0) -> np.ndarray:
    """Coefficients a_0 ... a_n in V^2 s^i / m; at order 3 a real pole at six times the resonance."""
    w = 2 * np.pi * kind.hz
    pair = np.array([stiffness, 2 * kind.zeta / w, 1 / w**2])
    return TOP**2 / STROKE * (np.convolve(pair, [1, 1 / (6 * w)]) if kind.order == 3 else pair)


def made(kind: Kind) -> Model:
    """Build the model; its region is what a chirp through the resonance at full voltage reaches."""
    w, n = 2 * np.pi * kind.hz, kind.order
    scale = STROKE * w ** np.arange(n + 1)
    domain = Domain(dt=1 / kind.rate, voltage_range=(0.0, TOP), slew=1e7)
    model = linear_model(
        polynomial(kind), input_map=SquareInput(), state_scale=scale, force_scale=TOP**2, hold="foh",
        output=Output(kind.offset, kind.polarity), substeps=2 if n == 3 else 1, domain=domain,
    )  # fmt: skip
    memory = FadingMemory(jnp.log(jnp.asarray([0.05, 2.0], jnp.float32)))
    model = eqx.tree_at(lambda m: (m.encoder, m.memory), model, (_encoder(kind, memory.size), memory))
    if kind.lag:
        model = eqx.tree_at(lambda m: m.drive, model, ElectrodeLag(jnp.log(jnp.asarray(kind.lag, jnp.float32))))
    if kind.delay:
        model = replace(model, effects=(effect("delay", time=kind.delay),))
    t = np.arange(int(4 * kind.rate)) / kind.rate
    chirp = 0.35 * TOP * (1 - np.cos(2 * np.pi * (0.1 * t + kind.hz / 8 * t**2)))
    reached = np.asarray(rollout(model, jnp.asarray(chirp), 1 / kind.rate, pitp.rest_state(model)))
    region = np.stack([reached.min(0), reached.max(0)], 1)[: n + memory.size]
    return replace(model, domain=replace(domain, region=region))


def _encoder(kind: Kind, memories: int) -> CompactEncoder:
    encoder = CompactEncoder(kind.order, memories, width=6, key=jax.random.key(kind.seed))
    rng, bounds = np.random.default_rng(kind.seed), encoder.bounds

    def push(a):
        return a + jnp.asarray(kind.size * rng.standard_normal(a.shape) / np.sqrt(max(a.shape[-1], 1)), a.dtype)

    wide = constant_array(np.broadcast_to([[-1.2], [1.2]], bounds.shape))
    moved = jax.tree.map(lambda a: push(a) if eqx.is_inexact_array(a) else a, encoder)
    encoder = eqx.tree_at(lambda e: e.bounds, moved, wide)
    past = encoder.past
    assert past is not None
    at_rest = encoder(jnp.zeros(kind.order + memories))[-1]  # no force is left at rest
    return eqx.tree_at(lambda e: e.past.readout.bias, encoder, past.readout.bias - at_rest)


def linear_twin(model: Model) -> Model:
    """Return the same model without its encoder and memory."""
    parts = ConstantEncoder(model.order + 2), NoMemory()
    twin = eqx.tree_at(lambda m: (m.encoder, m.memory), model, parts)
    return replace(twin, domain=replace(model.domain, region=model.domain.region[: model.order]))


HARNESS = """
#include <math.h>
#include "pitp_model.h"
#include "pitp_same.h"
#include "pitp_soft.h"
#include "pitp_stiff.h"
void run(int which, unsigned count, unsigned at, double gain, double load, double rest, double way, double p, double i,
         double track, const double *target, double *read)
{
    pitp_model_state c;
    pitp_same_state same;
    pitp_soft_state soft;
    pitp_stiff_state stiff;
    uint32_t flags;
    double y = rest;
    pitp_model_init(&c, rest, 0.0);
    pitp_same_init(&same, rest, 0.0);
    pitp_soft_init(&soft, rest, 0.0);
    pitp_stiff_init(&stiff, rest, 0.0);
    c.p = p;
    c.i = i;
    c.track = track;
    for (unsigned k = 0; k < count; k++) {
        read[k] = y;
        const double u = pitp_model_pi_step(&c, target + k * PITP_MODEL_TOKENS, y, &flags);
        const double force = gain * u * u + ((k >= at) ? load : 0.0);
        const double v = sqrt((force > 0.0) ? force : 0.0);
        for (int s = 0; s < FINER; s++) {
            y = rest + way * ((which == 0) ? pitp_same_predict_step(&same, v)
                : (which == 1) ? pitp_soft_predict_step(&soft, v) : pitp_stiff_predict_step(&stiff, v));
        }
    }
}
"""


class Loop:
    """A model's exported controller around its plants, compiled into one library in a folder."""

    def __init__(self, kind: Kind, model: Model, folder: Path):
        self.kind, self.model, self.gains = kind, model, pitp.pi_gains(model)
        write_sources(plan(model, "model", None, "double", np.inf), folder)  # the harness sets P and I
        nominal = polynomial(kind)
        for name, stiffness in (("same", 1.0), ("soft", 0.8), ("stiff", 1.2)):
            plant = model.changed(polynomial(kind, stiffness) / nominal)
            write_sources(plan(plant, name, FINER * kind.rate, "double", np.inf, held=True), folder)
        (folder / "harness.c").write_text(HARNESS.replace("FINER", str(FINER)))
        sources = [f"{name}.c" for name in ("harness", "pitp_model", "pitp_same", "pitp_soft", "pitp_stiff")]
        command = ["cc", "-O2", "-std=c99", "-shared", "-fPIC", "-o", "loop.so", *sources, "-lm"]
        subprocess.run(command, cwd=folder, check=True)
        self.library = ctypes.CDLL(str(folder / "loop.so"))
        with jax.enable_x64(True):
            # its delay lies outside the equilibrium
            still = equilibria(in_double(replace(model, effects=())))
        self.reach = max(point.displacement for point in still)
        self.points = [(x * self.reach, self._force(still, x * self.reach)) for x in (*HELD_AT, AND_SAME_AT)]

    @cached_property
    def tuning(self):
        """fn(time constant): gains and margins, without a refusal."""
        return tuning(self.model, self.model.dt)

    @cached_property
    def slowest(self) -> float:
        """2 / (zeta w_0) of the resonance, s, at the operating point where it is damped least."""
        with jax.enable_x64(True):
            plants, _ = operating_points(in_double(self.model), self.model.dt)
        s = [np.log(p.poles[p.poles.imag > 1e-6]) * self.kind.rate for p in plants]
        w = 2 * np.pi * self.kind.hz
        return max(-2 / poles[np.argmin(np.abs(np.abs(poles) - w))].real for poles in s)

    @staticmethod
    def _force(still, x):
        return float(np.interp(x, [0.0, *(p.displacement for p in still)], [0.0, *(p.voltage**2 for p in still)]))

    def error(self, plant: str, seconds: float, gains=None) -> float:
        """Largest error from five time constants after the load step on, over the stroke; inf where it diverges."""
        gains = gains or self.tuned(seconds)
        stiffness, gain = PLANTS[plant]
        which = {1.0: 0, 0.8: 1, 1.2: 2}[stiffness]
        points = self.points if plant == "same" else self.points[: len(HELD_AT)]
        return max(self._after(which, gain, x, force, gains, seconds) for x, force in points)

    def tuned(self, seconds: float) -> tuple[float, float]:
        """P and I at a time constant, whether or not it would be accepted."""
        return tuple(g * self.gains.time_constant / seconds for g in (self.gains.p, self.gains.i))

    def accepts(self, seconds: float) -> bool:
        """Return whether `pi_gains` accepts a time constant."""
        return self.tuning(seconds).max_sensitivity <= SENSITIVE

    def _after(self, which, gain, x, force, gains, seconds):
        dt, output = self.model.dt, self.model.output
        quiet = RISES + max(20 * seconds, 12 / (self.kind.zeta * 2 * np.pi * self.kind.hz))
        at, last = int(quiet / dt), int((quiet + 5 * seconds + max(10 * seconds, 1.0)) / dt)
        t = np.arange(last) * dt
        rows = [x * _smooth(t / RISES)]
        for _ in range(self.model.order):
            rows.append(np.gradient(rows[-1], dt))
        target = np.ascontiguousarray(np.stack(rows, 1))
        read = np.empty(last)
        real = [
            ctypes.c_double(float(v)) for v in (gain, 0.1 * force, output.offset, output.polarity, *gains, 1 / seconds)
        ]
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (target, read)]
        self.library.run(which, last, at, *real, *pointers)
        off = np.abs(output.polarity * (read - output.offset) - target[:, 0]) / self.reach
        settled = np.concatenate([off[at - int(0.2 / dt) : at], off[at + int(5 * seconds / dt) :]])
        return float(settled.max()) if np.isfinite(settled).all() else np.inf


def _smooth(t):
    t = np.clip(t, 0, 1)
    return t**5 * (126 - 420 * t + 540 * t**2 - 315 * t**3 + 70 * t**4)


def smallest(loop: Loop, plants: tuple[str, ...]) -> float:
    """Find the shortest time constant that the simulation bears on these plants, s, down from the default in 5 %."""
    seconds = loop.gains.time_constant
    while max(loop.error(plant, seconds / 1.05) for plant in plants) < ALLOWED and seconds > loop.model.dt:
        seconds /= 1.05
    return seconds


def verified(kind: Kind, folder: Path) -> dict:
    """Compute one row of the table: the default, the smallest time constant that is borne, and every accepted one."""
    model = made(kind)
    loop = Loop(kind, model, folder)
    slowest, default = loop.slowest, loop.gains.time_constant
    worst = {s: max(loop.error(plant, s) for plant in PLANTS) for s in (*TRIED, default)}
    accepted = [s for s in worst if loop.accepts(s)]
    refused = {s: worst[s] for s in worst if s not in accepted}
    twin = tuning(linear_twin(model), model.dt)(default)
    return {
        "default": default, "over_slowest": default / slowest, "over_smallest": default / smallest(loop, ("same",)),
        "over_smallest_of_all": default / smallest(loop, tuple(PLANTS)), "gain_margin": loop.gains.gain_margin,
        "sensitivity": loop.gains.max_sensitivity, "linear_gain_margin": twin.gain_margin,
        "accepted": len(accepted), "worst_accepted": max(worst[s] for s in accepted),
        "refused": len(refused), "best_refused": min(refused.values(), default=np.inf),
    }  # fmt: skip

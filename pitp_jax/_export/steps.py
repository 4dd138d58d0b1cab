"""The steps that are written out: one sample of the decoder and one of eq. 13, with every effect, in rig coordinates.

    predict   (s, V, u_{-1}), u                    ->  y at the sample of u (7 samples later with hold "bandlimited")
    inverse   (m, z, x_{-1}, V_{-1}, V_{-2}), [y, y', ..., y^(n)]
              ->  u = drive^-1(map^-1(F)),  F = sigma_off + sum_i sigma_i x^(i) + effects

The array forms of `undo` look both ways; here they run along the parabola through the last three film voltages, whose
slope is (3 V - 4 V_{-1} + V_{-2}) / (2 dt). What a delay or a step later than the drive needs is asked for ahead.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import singledispatch
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._effects.amplifier import Delay
from .._effects.base import AbstractDriveEffect, AbstractSensorEffect
from .._effects.electrode import ChargeLeak, ChargeRetention
from .._invert.realtime import film_after, memory_after
from .._model.drive import DirectDrive
from .._model.model import Model
from .._numerics.intersample import weights
from .._numerics.linear_recurrence import lag_after
from .._simulate import ports
from .._simulate.decoder import settled_state, step
from .._simulate.prediction import at_rate

_HUGE = 1e3  # of the training force: what stands for a force no field makes, as in `_invert.equation`
_BESIDE = 8  # samples of the parabola on either side: four slopes, each of which looks two samples away
_ROUNDING = 1e-6  # of the model's unit of force


@dataclass(frozen=True)
class Step:
    """A pure step and what it starts from.

    Attributes:
        start: fn(y, u) -> carry of an actuator held at y (m) under u (V) for ever.
        run: fn(carry, input) -> (carry, outputs).
        inputs: how many numbers it takes per sample.
        late: samples by which its output is behind its input.
    """

    start: Callable[[Array, Array], Any]
    run: Callable[[Any, Array], tuple[Any, tuple]]
    inputs: int
    late: int = 0


def in_double(model: Model) -> Model:
    """The same model in float64; call it under `jax.enable_x64(True)`."""
    return jax.tree.map(lambda a: a.astype(jnp.float64) if eqx.is_inexact_array(a) else a, model)


def predict(model: Model, dt: float, *, held: bool = False) -> Step:
    """Displacement (rig, m) at the sample of a drive voltage (V).

    `held`: the voltage stands from this call to the next, and the displacement is that of the next.
    """
    model = at_rate(model, dt)
    scale = model.scales.state[0]
    taps = weights("foh" if held else model.hold, np.arange(2 * model.substeps + 1) / (2 * model.substeps))
    delays = [e for e in model.effects if isinstance(e, Delay)]

    def start(y, u):
        x = model.output.to_model(y) / scale
        still = jnp.zeros(model.order, x.dtype).at[0].set(x)
        lines = [jnp.full(samples_of(e, dt), u) for e in delays]
        return settled_state(model, still, x, u, 0.0), jnp.full(len(taps), u), u, lines

    def run(carry, values):
        state, films, before, lines = carry
        u, moved = values[0], []
        for effect, line in zip(delays, lines, strict=True):
            line = jnp.append(line[1:], u)
            u = effect.shifted(line, dt, line[0])[-1]
            moved.append(line)
        if held:
            before, films = u, jnp.full_like(films, u) if isinstance(model.drive, DirectDrive) else films
        films = jnp.append(films[1:], film_after(model.drive, films[-1], before, u, dt))
        state = step(model, state, films @ jnp.asarray(taps), dt)
        return (state, films, u, moved), (model.output.to_rig(ports.reading(model, state) * scale),)

    return Step(start, run, 1, len(taps) // 2 - 1)


def samples_of(effect: Delay, dt: float) -> int:
    """How many voltages a delay keeps."""
    return int(np.floor(float(effect.time) / dt)) + 2


def inverse(model: Model, dt: float) -> Step:
    """Drive voltage (V) and whether none makes it, for [y, ..., y^(n)] (rig, m / s^i) at this sample."""
    n, scales = model.order, jnp.asarray(model.scales.state)
    senses = any(isinstance(e, AbstractSensorEffect) for e in model.effects)

    def start(y, u):
        x = model.output.to_model(y) / scales[0]
        film, levels = u, []
        for effect in model.effects:
            if isinstance(effect, AbstractDriveEffect):
                levels.append(film)
                film = effect.film(effect.initial(film), film)
        states = ports.initial(model, x, u, 0.0)
        rows = jnp.zeros((3, n + 1)).at[:, 0].set(x) if senses else jnp.zeros((0, n + 1))
        return x, model.memory.initial(x), states, jnp.full(3, film), levels, rows, jnp.zeros(())

    def run(carry, values):
        before, memory, states, films, levels, rows, begun = carry
        x = values.at[0].add(-model.output.offset) * model.output.polarity / scales
        if senses:
            rows = jnp.concatenate([rows[1:], x[None]])
            x = behind_sensor(model, rows, dt)
        memory = jnp.where(begun > 0, memory_after(model.memory, memory, before, x[0], dt), memory)
        parts = ports.split(model, states)
        after = jnp.concatenate([states[:0], *ports.moved(model, parts, before, x[0], dt)])
        states = jnp.where(begun > 0, after, states)
        seen = jnp.concatenate([x[:-1], memory])
        force = ports.needed(model, ports.split(model, states), x, seen)
        force = jnp.where(jnp.isnan(force), jnp.inf, force)  # beyond what saturates: without end
        film = model.input_map.voltage(jnp.clip(force, -_HUGE, _HUGE) * model.scales.force)
        films = jnp.append(films[1:], film)
        drive, levels, passes = _undone(model, films, levels, begun > 0, dt)
        never = model.input_map.infeasible(force + _ROUNDING) | ~passes
        return (x[0], memory, states, films, levels, rows, jnp.ones(())), (drive, never)

    return Step(start, run, n + 1)


def _parabola(values: Float[Array, "3 ..."]) -> Float[Array, "window ..."]:
    """The last three samples carried on: k = -8 ... 8 of v + k (v' dt) + k^2 / 2 (v'' dt^2)."""
    k = np.arange(-_BESIDE, _BESIDE + 1.0)[:, None]
    through = np.concatenate([k * (k + 1) / 2, -k * (k + 2), (k + 1) * (k + 2) / 2], 1)
    return jnp.tensordot(jnp.asarray(through), values, 1)


def _undone(model: Model, films, levels, begun, dt: float):
    """The drive behind the film, new states of the drive effects' inverses, and whether the drive lets it pass."""
    window, passes, found = _parabola(films), jnp.ones((), bool), []
    places = [e for e in model.effects if isinstance(e, AbstractDriveEffect)]
    for effect, level in zip(reversed(places), reversed(levels), strict=True):
        passes = passes & effect.passes(window, dt)[_BESIDE]
        window, level = undo(effect, window, level, begun, dt)
        found.append(level)
    return model.drive.lead(window, dt)[_BESIDE], found[::-1], passes


@singledispatch
def undo(effect: AbstractDriveEffect, window, level, begun, dt: float):
    """The voltages before an effect, along a window, and its state carried on."""
    return effect.undo(window, dt), level


@undo.register
def _(effect: ChargeLeak, window, level, begun, dt: float):
    open_, tau = window / (1 - effect.kappa), effect.tau / (1 - effect.kappa)
    now = jnp.where(begun, lag_after(level, open_[_BESIDE - 1], open_[_BESIDE], tau, dt), level)

    k = dt * np.arange(-_BESIDE, _BESIDE + 1.0)
    pace = (open_[_BESIDE] - now) / tau
    bend = ((open_[_BESIDE + 1] - open_[_BESIDE - 1]) / (2 * dt) - pace) / tau
    return window + effect.kappa * (now + k * pace + k**2 / 2 * bend), now


@undo.register
def _(effect: ChargeRetention, window, level, begun, dt: float):
    """`level`: what is stored; the drive before the first sample, where it is settled."""
    q, film = jnp.where(begun, level, effect.k * jnp.abs(level)), window[_BESIDE]
    before = window[_BESIDE - 1] - q
    now = jnp.where(begun, effect.stored(q, before, film, dt), q)
    k, drive = dt * np.arange(-_BESIDE, _BESIDE + 1.0), film - now
    pace = (effect.k * jnp.abs(drive) - now) / effect.tau
    slope = (window[_BESIDE + 1] - window[_BESIDE - 1]) / (2 * dt) - pace
    bend = (effect.k * jnp.sign(drive) * slope - pace) / effect.tau
    return window - (now + k * pace + k**2 / 2 * bend), now


def behind_sensor(model: Model, rows: Float[Array, "3 tokens"], dt: float) -> Float[Array, " tokens"]:
    """[x, ..., x^(n)] behind a reading and its derivatives (scaled), by the chain rule along the reading's own motion.

    x(s) = undo(y(. + s)) at the sample, y_k(s) = sum_i y_k^(i) s^i / i!:   x^(i) = d^i x / ds^i at s = 0
    """
    scales = jnp.asarray(model.scales.state)
    window = _parabola(rows * scales)
    factorial = np.cumprod([1.0, *range(1, model.order + 1)])

    def at(s):
        y = sum(window[:, i] * s**i / factorial[i] for i in range(model.order + 1))
        return ports.moves(model, y / scales[0], dt)[_BESIDE] * scales[0]

    found, derivative = [], at
    for _ in range(model.order + 1):
        found.append(derivative(jnp.zeros(())))
        derivative = _slope(derivative)
    return jnp.stack(found) / scales


def _slope(function):
    return lambda s: jax.jvp(function, (s,), (jnp.ones_like(s),))[1]

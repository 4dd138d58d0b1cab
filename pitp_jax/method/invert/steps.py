"""Define the one-sample steps of exported code and of control loops: simulation and inverse, with effects.

Displacements y are in the one coordinate (`method.model.coordinate`): 0 at 0 V.

    predict   (s, V, u_{-1}), u                    ->  y at the sample of u (7 samples later with hold "bandlimited")
    inverse   (m, z, x_{-1}, V_{-1}, V_{-2}), [y, y', ..., y^(n)]
              ->  u = drive^-1(map^-1(F)),  F = sigma_off + sum_i sigma_i x^(i) + effects

Closed inverses use samples on both sides along a series. Here they use the parabola through the last three values,
whose slope is (3 V - 4 V_{-1} + V_{-2}) / (2 dt). An effect with a memory and no closed inverse is solved sample by
sample; its own last three values give the parabola for the effects before it. Values that a delay or a step needs later
than the input are requested ahead.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...common.quantity import Units
from ..effects.kernels import shifted
from ..model.coordinate import from_model, to_model
from ..model.model import Model
from ..numerics.intersample import weights
from ..numerics.where import where
from ..simulate import ports
from ..simulate.decoder import stage_fractions, step, still_state
from ..simulate.prediction import at_rate
from .equation import HUGE, tolerance
from .one_sample import film_held, memory_after

_BESIDE = 8  # samples of the parabola on either side: four slopes, each of which uses two samples on either side


@dataclass(frozen=True)
class Step:
    """A pure one-sample step with its initial state.

    Attributes:
        start: fn(y, u) -> carry of an actuator held at y (m from 0 V) under u (V) indefinitely.
        run: fn(carry, input) -> (carry, outputs).
        inputs: number of inputs per sample.
        late: samples by which its output is behind its input.
    """

    start: Callable[[Array, Array], Any]
    run: Callable[[Any, Array], tuple[Any, tuple]]
    inputs: int
    late: int = 0


def predict(model: Model, dt: float, *, held: bool = False) -> Step:
    """Build the step from a voltage (V) to the displacement at the same sample (m, from 0 V).

    `held`: the voltage is held from this call to the next, and the displacement is that of the next.
    """
    model = at_rate(model, dt)
    scale = model.scales.state[0]
    stages = stage_fractions(model)
    taps = weights("foh" if held else model.hold, stages)
    delays = [e for e in model.effects if e.delays]

    def start(y, u):
        x = to_model(model, y) / scale
        # the past voltages that a delay needs
        lines = [jnp.full(int(np.floor(float(e.time) / dt)) + 2, u) for e in delays]
        return still_state(model, x, u, 0.0), jnp.full(len(taps), u), u, lines

    def run(carry, values):
        state, films, before, lines = carry
        u, moved = values[0], []
        for effect, line in zip(delays, lines, strict=True):
            line = jnp.append(line[1:], u)
            u = shifted(line, effect.time / dt, line[0])[-1]
            moved.append(line)
        if held:
            volts, after = film_held(model.drive, films[-1], u, dt, stages)
            films = jnp.append(films[1:], after)
        else:
            films = jnp.append(films[1:], model.drive.after(films[-1], before, u, dt))
            volts = films @ jnp.asarray(taps)
        state = step(model, state, volts, dt)
        return (state, films, u, moved), (from_model(model, ports.reading(model, state) * scale),)

    return Step(start, run, 1, len(taps) // 2 - 1)


def in_units(step: Step, units: Units, *, inverse: bool) -> Step:
    """Convert inputs and outputs of a step from base units to the units of the exported code."""
    drive, motion = units.input.factor, units.si.factor
    if drive == motion == 1:
        return step
    into, out_of = (motion, drive) if inverse else (drive, motion)

    def run(carry, values):
        carry, (first, *more) = step.run(carry, values * into)
        return carry, (first / out_of, *more)

    return replace(step, start=lambda y, u: step.start(y * motion, u * drive), run=run)


def inverse(model: Model, dt: float) -> Step:
    """Build the step from a wanted [y, ..., y^(n)] (m/s^i, from 0 V) to (voltage in V, infeasible or not)."""
    n = model.order
    scales = np.asarray(model.scales.state)  # float64 wherever the step is built; jnp.asarray may round to float32
    senses = bool(ports.sensors(model))

    def start(y, u):
        x = to_model(model, y) / scales[0]
        film, levels = u, []
        for effect in ports.drives(model):
            begun = effect.start(film)
            levels.append((begun, jnp.full(3, film)))
            film = effect.apply(film, begun)
        states = ports.initial(model, x, u, 0.0)
        rows = jnp.zeros((3, n + 1)).at[:, 0].set(x) if senses else jnp.zeros((0, n + 1))
        return x, model.memory.initial(x), states, jnp.full(3, film), levels, rows, jnp.zeros(())

    def run(carry, values):
        before, memory, states, films, levels, rows, begun = carry
        x = to_model(model, values) / scales
        if senses:
            rows = jnp.concatenate([rows[1:], x[None]])
            x = behind_sensor(model, rows, dt)
        memory = where(begun > 0, memory_after(model.memory, memory, before, x[0], dt), memory)
        parts = ports.split(model, states)
        after = jnp.concatenate([states[:0], *ports.moved(model, parts, before, x[0], dt)])
        states = where(begun > 0, after, states)
        seen = jnp.concatenate([x[:-1], memory])
        force = ports.needed(model, ports.split(model, states), x, seen)
        force = jnp.where(jnp.isnan(force), jnp.inf, force)  # a force beyond saturation is infinite
        film = model.input_map.voltage(jnp.clip(force, -HUGE, HUGE) * model.scales.force)
        films = jnp.append(films[1:], film)
        drive, levels, passes = _undone(model, films, levels, begun > 0, dt)
        never = model.input_map.infeasible(force + tolerance(model)) | ~passes
        return (x[0], memory, states, films, levels, rows, jnp.ones(())), (drive, never)

    return Step(start, run, n + 1)


def _parabola(values: Float[Array, "3 ..."]) -> Float[Array, "window ..."]:
    """Continue three values by a parabola: values at k = -8 ... 8 samples from the last one."""
    k = np.arange(-_BESIDE, _BESIDE + 1.0)[:, None]
    # Lagrange's polynomials through k = -2, -1, 0
    through = np.concatenate([k * (k + 1) / 2, -k * (k + 2), (k + 1) * (k + 2) / 2], 1)
    return jnp.tensordot(jnp.asarray(through), values, 1)


def _undone(model: Model, films, levels, begun, dt: float):
    """Compute the voltage for the film voltage, the new states of the effects, and whether it is feasible.

    `levels`: per effect its states and the last three values of its input.
    """
    window, passes, carried = _parabola(films), jnp.ones((), bool), []
    for effect, (states, entered) in zip(reversed(ports.drives(model)), reversed(levels), strict=True):
        passes = passes & effect.passes(window, dt)[_BESIDE]
        if effect.spec.inverse or not effect.states:
            window = effect.undo(window, dt)
        else:
            after, w = effect.undo_sample(states, entered[-1], window[_BESIDE], dt)
            # the first call uses the initial state
            states, w = jnp.where(begun, after, states), jnp.where(begun, w, entered[-1])
            entered = jnp.append(entered[1:], w)
            window = _parabola(entered)
        carried.append((states, entered))
    return model.drive.lead(window, dt)[_BESIDE], carried[::-1], passes


def behind_sensor(model: Model, rows: Float[Array, "3 tokens"], dt: float) -> Float[Array, " tokens"]:
    """Compute [x, ..., x^(n)] from a sensor reading and its derivatives (scaled), by the chain rule.

    x(s) = undo(y(. + s)) at the sample, y_k(s) = sum_i y_k^(i) s^i / i!:   x^(i) = d^i x / ds^i at s = 0
    """
    scales = jnp.asarray(model.scales.state)
    window = _parabola(rows * scales)
    factorial = np.cumprod([1.0, *range(1, model.order + 1)])

    def at(s):
        y = sum(window[:, i] * s**i / factorial[i] for i in range(model.order + 1))
        moves = y / scales[0]
        for effect in reversed(ports.sensors(model)):
            # a memory without a closed inverse must be solved from the target's start, which no window contains
            if effect.spec.inverse or not effect.states:
                moves = effect.undo(moves, dt)
        return moves[_BESIDE] * scales[0]

    motion, derivative = [], at
    for _ in range(model.order + 1):
        motion.append(derivative(jnp.zeros(())))
        derivative = _slope(derivative)
    return jnp.stack(motion) / scales


def _slope(function):
    return lambda s: jax.jvp(function, (s,), (jnp.ones_like(s),))[1]

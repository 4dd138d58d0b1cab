"""Apply the effects of a model within one time step, each at its port, and advance their states.

    u --IN--> V --map--> F --SQ--> coupled force;   tokens, offset --K, C, M, T--> frozen equation;   x --OUT--> y

States of all effects lie behind S and memory in the decoder's state, in the order of `model.effects`.
"""

from itertools import pairwise
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..effects.effect import Effect, Instant, solve
from ..effects.kernels import advanced, shifted

if TYPE_CHECKING:
    from ..model.model import Model

_NEWTON = 4  # steps to the force of a term that depends on it


def drives(model: "Model") -> list[Effect]:
    """Return the effects on the voltage that act sample by sample (no delays), in the order of the model."""
    return [e for e in model.effects if e.port == "IN" and not e.delays]


def sensors(model: "Model") -> list[Effect]:
    """Return the effects on the sensor's reading, in the order of the model."""
    return [e for e in model.effects if e.port == "OUT"]


def split(model: "Model", states: Float[Array, " states"]) -> list[Float[Array, " own"]]:
    """Split the vector of effect states into one vector per effect."""
    parts, first = [], 0
    for effect in model.effects:
        parts.append(states[first : first + effect.states])
        first += effect.states
    return parts


def initial(model: "Model", x, voltage, age, reached=0.0) -> Float[Array, " states"]:
    """Return the initial states of all effects at displacement X and a voltage (0 at rest)."""
    parts = [jnp.zeros((0,), jnp.result_type(x))]  # gives the precision, and an array if no effect has states
    y = x  # the input of a sensor's effect: the reading of the one before it
    for effect in model.effects:
        held = effect.start({"IN": voltage, "OUT": y}.get(effect.port, x), age)
        parts.append(effect.resumed(held, reached))
        y = effect.apply(y, parts[-1]) if effect.port == "OUT" else y
    return jnp.concatenate([p.astype(parts[0].dtype) for p in parts])


def resumed(model: "Model", state: Float[Array, " state"], reached) -> Float[Array, " state"]:
    """Return a state after earlier records of the session have stretched the actuator to |X| = `reached`."""
    first = model.order + model.memory.size
    parts = zip(model.effects, split(model, state[first:]), strict=True)
    return jnp.concatenate([state[:first], *(e.resumed(p, reached) for e, p in parts)])


def delayed(model: "Model", voltage: Float[Array, " time"], dt: float, rest) -> Float[Array, " time"]:
    """Delay the voltage (V) by the sum of all delay effects."""
    for effect in model.effects:
        if effect.delays:
            # before the record, a rest was at 0 V; any other start is assumed at the first voltage
            voltage = shifted(voltage, effect.time / dt, jnp.where(rest, 0.0, voltage[0]))
    return voltage


def filmed(model: "Model", voltage: Float[Array, " time"], dt: float, rest) -> Float[Array, " time"]:
    """Compute the film voltage at every sample of u: delays, the model's own lag, then effects on the voltage."""
    film = model.drive.film(delayed(model, voltage, dt, rest), dt, rest)
    for effect in drives(model):
        begun = effect.start(jnp.where(rest, 0.0, film[0]))

        def advance(states, ends, effect=effect):
            after = effect.advance(states, ends[0], ends[1], dt)
            return after, effect.apply(ends[1], after)

        later = jax.lax.scan(advance, begun, (film[:-1], film[1:]))[1]
        film = jnp.append(effect.apply(film[0], begun), later)
    return film


def films(model: "Model", parts: list, stages: tuple, h: float) -> tuple[tuple, list]:
    """Compute the film voltages at the three stages of a time step of h (s), and the advanced effect states."""
    parts = list(parts)
    for k, effect in enumerate(model.effects):
        if effect.port == "IN" and not effect.delays:
            # stage by stage: a lag must be known at the middle of the step, where Runge-Kutta uses the force twice
            states, volts = parts[k], [effect.apply(stages[0], parts[k])]
            for before, after in pairwise(stages):
                states = effect.advance(states, before, after, h / 2)
                volts.append(effect.apply(after, states))
            parts[k], stages = states, tuple(volts)
    return stages, parts


def coupled(model: "Model", forces: tuple, x) -> tuple:
    """Compute the force on the structure from the film's force at every stage, at displacement X."""
    for effect in model.effects:
        if effect.port == "SQ":
            forces = tuple(effect.apply(f, x) for f in forces)
    return forces


def acted(model: "Model", parts: list, now: Instant) -> Instant:
    """Add the forces of all effects to the equation of a time step."""
    for effect, states in zip(model.effects, parts, strict=True):
        if effect.forces:
            now = effect.act(states, now)
    return now


def moved(model: "Model", parts: list, x, after, h) -> list:
    """Advance the states of force and sensor effects after X has moved from `x` to `after` in h seconds.

    Sensors are a chain: each effect follows the reading of the one before it (a gain, then a lag: the lag of the gain).
    """
    ahead, y = [], (x, after)
    for effect, states in zip(model.effects, parts, strict=True):
        if effect.port in ("IN", "SQ"):
            ahead.append(states)
            continue
        ahead.append(effect.advance(states, *(y if effect.port == "OUT" else (x, after)), h))
        if effect.port == "OUT":
            y = effect.apply(y[0], states), effect.apply(y[1], ahead[-1])
    return ahead


def reading(model: "Model", state: Float[Array, " state"]) -> Float[Array, ""]:
    """Compute the scaled sensor reading of one state."""
    y = state[0]
    parts = split(model, state[model.order + model.memory.size :])
    for effect, states in zip(model.effects, parts, strict=True):
        if effect.port == "OUT":
            y = effect.apply(y, states)
    return y + sum(e.spec.crosses(e.p, z) for e, z in zip(model.effects, parts, strict=True) if e.spec.crosses)


def readings(model: "Model", states: Float[Array, "time state"]) -> Float[Array, " time"]:
    """Compute the scaled sensor readings of the states of a simulation, shape (time,)."""
    return jax.vmap(lambda s: reading(model, s))(states) if model.effects else states[:, 0]


def required(
    model: "Model",
    equation: Float[Array, "time tokens"],
    features: Float[Array, "time features"],
    dt: float,
    age: float | Float[Array, ""] = 0.0,
) -> Float[Array, " time"]:
    """Compute the film's scaled force for a wanted motion from rest, for a model with effects, shape (time,).

    The states of a force effect depend on x alone, so they are known along the motion; then couplings are divided out.
    """
    parts = along(model, equation[:, 0], dt, age)
    return jax.vmap(lambda *instant: needed(model, *instant))(parts, equation, features)


def along(model: "Model", x: Float[Array, " time"], dt: float, age: float | Float[Array, ""] = 0.0) -> list:
    """Compute the states of all force and sensor effects at every sample of a motion that starts at rest."""
    start = split(model, initial(model, x[0], jnp.zeros_like(x[0]), age))

    def advance(parts, ends):
        return moved(model, parts, ends[0], ends[1], dt), parts

    # the last step needs no result
    return jax.lax.scan(advance, start, (x, jnp.append(x[1:], x[-1:])))[1]


def needed(
    model: "Model", parts: list, row: Float[Array, " tokens"], features: Float[Array, " features"]
) -> Float[Array, ""]:
    """Compute the film's scaled force at one instant of a wanted motion, with effects in the states `parts`."""
    n = model.order
    rates = jnp.asarray(model.scales.rates, row.dtype)
    # A motion has no step, so a tenth of the model's time scale sets how sharply friction acts at a reversal.
    blunt = 0.1 / (rates[0] if n == 1 else jnp.sqrt(rates[0] * rates[-1]))
    still, zero = model.tokens(features), jnp.zeros_like(row[0])

    def needs(force):
        now = Instant(row[:n], model.coefficients, rates, force, blunt, *still, last=row[n], wanted=True)
        now = acted(model, parts, now)
        return now.tokens @ row + now.offset

    force = needs(zero)  # sufficient if no effect depends on the force itself
    if any(e.spec.driven for e in model.effects):
        force = solve(lambda f: f - needs(f), zero, force, _NEWTON)
    for effect in reversed(model.effects):  # undone in the opposite order of `coupled`
        if effect.port == "SQ":
            force = effect.uncoupled(force, row[0])
    return force


def played(model: "Model", film: Float[Array, " time"], dt: float, exact: bool = False) -> Float[Array, " time"]:
    """Compute the voltage u for a smooth film voltage: undo the voltage effects, the model's lag and delays.

    `exact`: the lag is undone sample by sample (`drive.undo`), not by its continuous equation.
    """
    for effect in reversed(drives(model)):
        film = effect.undo(film, dt)
    # the model's own lag is between its delays and the effects
    film = model.drive.undo(film, dt, film[0]) if exact else model.drive.lead(film, dt)
    for effect in model.effects:
        if effect.delays:
            film = advanced(film, effect.time / dt)
    return film


def moves(model: "Model", reading: Float[Array, " time"], dt: float) -> Float[Array, " time"]:
    """Compute the scaled displacement that gives a wanted sensor reading."""
    for effect in reversed(sensors(model)):
        reading = effect.undo(reading, dt)
    return reading


def beyond(model: "Model", film: Float[Array, " time"], dt: float) -> Array:
    """Return True where an effect on the voltage cannot produce this film voltage."""
    out = ~jnp.isfinite(film)
    for effect in reversed(drives(model)):
        out = out | ~effect.passes(film, dt)
        film = effect.undo(film, dt)
    return out

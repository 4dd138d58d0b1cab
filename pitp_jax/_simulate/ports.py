"""A model's effects within one decoder step: where each port enters, and what its states become.

    u --IN--> V --map--> F --SQ--> coupled force;   tokens, offset --K, C, M, T--> frozen equation;   x --OUT--> y

States of all effects lie behind S and memory in the decoder's state, in the order of `model.effects`.
"""

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._effects.amplifier import Delay
from .._effects.base import (
    AbstractCouplingEffect,
    AbstractDriveEffect,
    AbstractForceEffect,
    AbstractSensorEffect,
    Instant,
    Wanted,
    states_of,
)
from .._effects.found_term import FoundTerm

if TYPE_CHECKING:
    from .._model.model import Model

_NEWTON, _STEEP = 4, 0.05  # steps to the force of a term that depends on it; least share of a newton that arrives


def split(model: "Model", states: Float[Array, " states"]) -> list[Float[Array, " own"]]:
    """Every effect's own states."""
    found, first = [], 0
    for effect in model.effects:
        found.append(states[first : first + effect.states])
        first += effect.states
    return found


def initial(model: "Model", x, voltage, age, reached=0.0) -> Float[Array, " states"]:
    """All effects' states of an actuator held at X under `voltage` (0 where it rests); age and reach of the session."""
    parts = [jnp.zeros((0,), jnp.result_type(x)), *(states_of(e, x, voltage, age, reached) for e in model.effects)]
    return jnp.concatenate([p.astype(parts[0].dtype) for p in parts])


def resumed(model: "Model", state: Float[Array, " state"], reached) -> Float[Array, " state"]:
    """A decoder state of an actuator that the session has stretched to |X| = `reached` before."""
    first = model.order + model.memory.size
    parts = [
        e.resumed(p, reached) if isinstance(e, AbstractForceEffect) else p
        for e, p in zip(model.effects, split(model, state[first:]), strict=True)
    ]
    return jnp.concatenate([state[:first], *parts])


def delayed(model: "Model", voltage: Float[Array, " time"], dt: float, rest) -> Float[Array, " time"]:
    """The voltage behind all delays."""
    for effect in model.effects:
        if isinstance(effect, Delay):
            voltage = effect.shifted(voltage, dt, jnp.where(rest, 0.0, voltage[0]))
    return voltage


def films(model: "Model", parts: list, stages: tuple, h: float) -> tuple[tuple, list]:
    """Film voltages at the three stages of a step of length h, and the parts with the drive's states moved on."""
    parts = list(parts)
    for k, effect in enumerate(model.effects):
        if isinstance(effect, AbstractDriveEffect):
            states, found = parts[k], [effect.film(parts[k], stages[0])]
            for before, after in zip(stages[:-1], stages[1:], strict=True):
                states = effect.advance(states, before, after, h / 2)
                found.append(effect.film(states, after))
            parts[k], stages = states, tuple(found)
    return stages, parts


def coupled(model: "Model", forces: tuple, x) -> tuple:
    """What the structure feels of the stages' forces at X."""
    for effect in model.effects:
        if isinstance(effect, AbstractCouplingEffect):
            forces = tuple(effect.couple(f, x) for f in forces)
    return forces


def acted(model: "Model", parts: list, now: Instant, tokens, offset):
    """Tokens and offset with every force effect in them."""
    for effect, states in zip(model.effects, parts, strict=True):
        if isinstance(effect, AbstractForceEffect):
            tokens, offset = effect.act(states, now, tokens, offset)
    return tokens, offset


def moved(model: "Model", parts: list, x, after, h) -> list:
    """The states of force and sensor effects after X ran from `x` to `after`."""
    return [
        e.advance(p, x, after, h) if isinstance(e, (AbstractForceEffect, AbstractSensorEffect)) else p
        for e, p in zip(model.effects, parts, strict=True)
    ]


def reading(model: "Model", state: Float[Array, " state"]) -> Float[Array, ""]:
    """The scaled output the sensor reads at a decoder state."""
    y = state[0]
    parts = split(model, state[model.order + model.memory.size :])
    for effect, states in zip(model.effects, parts, strict=True):
        if isinstance(effect, AbstractSensorEffect):
            y = effect.reading(states, y)
    return y


def readings(model: "Model", states: Float[Array, "time state"]) -> Float[Array, " time"]:
    """The same along a rollout."""
    return jax.vmap(lambda s: reading(model, s))(states) if model.effects else states[:, 0]


def required(
    model: "Model",
    equation: Float[Array, "time tokens"],
    features: Float[Array, "time features"],
    dt: float,
    age: float | Float[Array, ""] = 0.0,
) -> Float[Array, " time"]:
    """Eq. 13 with effects: the scaled force of the film along a wanted motion that starts at rest, at that age in s.

    Every state of a force effect follows x alone, so it is known along the way; then couplings are divided out.
    """
    x = equation[:, 0]
    start = split(model, initial(model, x[0], jnp.zeros_like(x[0]), age))

    def advance(parts, ends):
        return moved(model, parts, ends[0], ends[1], dt), parts

    along = jax.lax.scan(advance, start, (x, jnp.append(x[1:], x[-1:])))[1]
    return jax.vmap(lambda *instant: needed(model, *instant))(along, equation, features)


def needed(
    model: "Model", parts: list, row: Float[Array, " tokens"], features: Float[Array, " features"]
) -> Float[Array, ""]:
    """The film's scaled force at one instant of a wanted motion `row`, its effects in the states `parts`."""
    n = model.order
    rates = jnp.asarray(model.scales.rates, row.dtype)
    blunt = 0.1 / (rates[0] if n == 1 else jnp.sqrt(rates[0] * rates[-1]))
    still, zero = model.tokens(features), jnp.zeros_like(row[0])

    def needs(force):
        now = Wanted(row[:n], model.coefficients, rates, force, blunt, row[n])
        tokens, offset = acted(model, parts, now, *still)
        return tokens @ row + offset

    force = needs(zero)
    for _ in range(_NEWTON if any(isinstance(e, FoundTerm) and e.driven for e in model.effects) else 0):
        value, slope = jax.jvp(needs, (force,), (jnp.ones_like(zero),))
        force = force + (value - force) / jnp.maximum(1 - slope, _STEEP)
    for effect in reversed(model.effects):
        if isinstance(effect, AbstractCouplingEffect):
            force = effect.uncouple(force, row[0])
    return force


def played(model: "Model", film: Float[Array, " time"], dt: float) -> Float[Array, " time"]:
    """The drive u for a smooth film voltage, through all drive effects, the model's own lag and delays."""
    for effect in reversed(model.effects):
        if isinstance(effect, AbstractDriveEffect):
            film = effect.undo(film, dt)
    film = model.drive.lead(film, dt)
    for effect in model.effects:
        if isinstance(effect, Delay):
            film = effect.ahead(film, dt)
    return film


def moves(model: "Model", reading: Float[Array, " time"], dt: float) -> Float[Array, " time"]:
    """The scaled motion behind a wanted reading."""
    for effect in reversed(model.effects):
        if isinstance(effect, AbstractSensorEffect):
            reading = effect.undo(reading, dt)
    return reading


def beyond(model: "Model", film: Float[Array, " time"], dt: float) -> Array:
    """True where a drive effect lets no such film voltage pass; each is asked about what leaves it."""
    out = ~jnp.isfinite(film)
    for effect in reversed(model.effects):
        if isinstance(effect, AbstractDriveEffect):
            out = out | ~effect.passes(film, dt)
            film = effect.undo(film, dt)
    return out

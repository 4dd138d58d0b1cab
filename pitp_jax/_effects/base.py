"""Effects: what a nominal model leaves out, written on the force side so that it stands beside any order and encoder.

    sum_i sigma_i x^(i) + sigma_off + f(x, x', z) = coupling(V, x),    V = drive(u),    y = sensor(x)

Everything is in the model's scaled coordinates: X = x / scale_0, force over force_scale, stiffness in units of the
nominal's; voltages in V and times in s. `Parameter` says how a number returns to physical units. Within a decoder step
tokens are frozen at the drifted midpoint, and so is every effect's force; states advance by exact rules where one is
known. An effect at its neutral parameters vanishes exactly, so a model may carry many and switch them on by number.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes:
        name: the field of the effect that holds it.
        unit: physical unit; "x" stands for the displacement's unit.
        length, speed, acceleration, force: powers of the scales of x, x', x'' and of the force that take the stored
            value to physical units.
        positive: fitted by its logarithm (else as it is).
        neutral: where the effect vanishes; None: the number does not matter where another one is neutral.
        linear: the effect is proportional to it (asked of the first parameter only).
    """

    name: str
    unit: str = "1"
    length: float = 0
    speed: int = 0
    acceleration: int = 0
    force: float = 0
    positive: bool = True
    neutral: float | None = None
    linear: bool = True


@dataclass(frozen=True)
class Surroundings:
    """What starts and bounds are taken from: the nominal's dynamics and the ranges the records cover.

    Attributes:
        omega: natural frequency of the nominal, rad/s.
        dt: sampling interval, s.
        duration, session: longest record and whole session, s.
        top, bottom: highest and lowest scaled displacement measured.
        speed: rms of the scaled velocity X_1.
        acceleration: highest scaled X_2 the nominal reaches.
        voltage: largest absolute drive voltage, V.
        slew: largest absolute voltage slew, V/s.
        stiffness, inertia: scaled nominal coefficients of x and (order 2 and up) x''.
        damping: scaled nominal coefficient of x'.
    """

    omega: float
    dt: float
    duration: float
    session: float
    top: float
    bottom: float
    speed: float
    acceleration: float
    voltage: float
    slew: float
    stiffness: float
    inertia: float
    damping: float

    @property
    def reach(self) -> float:
        """Largest absolute scaled displacement."""
        return max(self.top, -self.bottom)


@dataclass(frozen=True)
class Start:
    """One active start: a value and bounds (low, high) for every parameter, in the order of PARAMETERS."""

    values: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


class Instant(eqx.Module):
    """What a force may depend on within one frozen step of length h (s).

    Attributes:
        state: scaled S at the drifted midpoint (x^(n-1) as at the step's beginning), shape (n,).
        coefficients: the nominal's scaled coefficients, shape (n + 1,).
        rates: dX_i/dt = rates_i X_(i+1), 1/s, shape (n,).
        force: scaled force at the middle of the step.
        h: length of the step, s.
    """

    state: Float[Array, " order"]
    coefficients: Float[Array, " tokens"]
    rates: Float[Array, " order"]
    force: Float[Array, ""]
    h: Float[Array, ""] | float

    def velocity(self, tokens, offset):
        """Scaled x' half a step on (order 2: by the acceleration the step begins with)."""
        n = self.state.shape[0]
        if n == 1:
            return self.highest(tokens, offset)
        if n == 2:
            return self.state[1] + self.h / 2 * self.rates[1] * self.highest(tokens, offset)
        return self.state[1]

    def highest(self, tokens, offset):
        """Scaled x^(n) of the frozen step."""
        n = self.state.shape[0]
        return (self.force - offset - tokens[:n] @ self.state) / tokens[n]


class AbstractEffect(eqx.Module):
    """One form of one effect; its fields are scalars, named in PARAMETERS.

    `name` is what a diagnosis prints, `form` one way to write it down, `port` where it enters: IN, SQ, K, C, M, T, OUT.
    `only`: there is no other way to write it down, so where it is the cause, it leaves noise.
    """

    name: ClassVar[str]
    form: ClassVar[str]
    family: ClassVar[str]
    port: ClassVar[str]
    PARAMETERS: ClassVar[tuple[Parameter, ...]]
    states: ClassVar[int] = 0
    only: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def starts(cls, s: Surroundings) -> list[Start]:
        """Active starts with bounds; empty where the effect cannot be at work on such records."""

    @classmethod
    def neutral(cls):
        """The effect that is not there."""
        return cls(*(jnp.asarray(1.0 if p.neutral is None else p.neutral, jnp.float32) for p in cls.PARAMETERS))

    @classmethod
    def of(cls, values):
        """The effect with these numbers, in the order of PARAMETERS."""
        return cls(*(jnp.asarray(v, jnp.float32) for v in values))

    def numbers(self) -> list[tuple[Parameter, Array]]:
        """Its numbers, and what each of them is."""
        return [(p, getattr(self, p.name)) for p in self.PARAMETERS]

    def times(self, factors):
        """The effect with each of its numbers times a factor."""
        return type(self)(*(v * f for (_, v), f in zip(self.numbers(), factors, strict=True)))


class AbstractDriveEffect(AbstractEffect):
    """Before the square (IN): u to V, sample interval by sample interval."""

    @abstractmethod
    def initial(self, voltage) -> Float[Array, " states"]:
        """States before the first sample: `voltage` is u where the record starts moving, 0 V where it rests."""

    @abstractmethod
    def advance(self, states, before, after, h) -> Array:
        """States after u ran linearly from `before` to `after` in h seconds."""

    @abstractmethod
    def film(self, states, voltage) -> Array:
        """V at an instant."""

    @abstractmethod
    def undo(self, film: Float[Array, " time"], dt: float) -> Float[Array, " time"]:
        """The u whose film voltage is V, for a smooth V of a record that starts at rest; V itself where none is."""

    @abstractmethod
    def passes(self, film: Float[Array, " time"], dt: float) -> Array:
        """True where some u gives this V."""


class AbstractCouplingEffect(AbstractEffect):
    """At the square (SQ): what the film's force becomes at a displacement X."""

    @abstractmethod
    def couple(self, force, x) -> Array:
        """Scaled force on the structure from the scaled force `force`."""

    @abstractmethod
    def uncouple(self, force, x) -> Array:
        """The film's force behind a force on the structure; infinite where no field makes it."""


class AbstractForceEffect(AbstractEffect):
    """Restoring, dissipative and inertial forces (K, C, M, T)."""

    @abstractmethod
    def initial(self, x, age) -> Float[Array, " states"]:
        """States of an actuator that has been held at X; `age` of the session in s."""

    def resumed(self, states, reached) -> Array:
        """States of one that the session has stretched to |X| = `reached` before; most forget."""
        return states

    @abstractmethod
    def act(self, states, now: Instant, tokens, offset) -> tuple[Array, Array]:
        """Tokens and offset of the frozen step with the effect's force in them."""

    @abstractmethod
    def advance(self, states, x, after, h) -> Array:
        """States after X ran linearly from `x` to `after` in h seconds."""


class AbstractSensorEffect(AbstractEffect):
    """After the motion (OUT): X to what the sensor reads."""

    @abstractmethod
    def initial(self, x) -> Float[Array, " states"]:
        """States of a sensor that has been reading X for ever."""

    @abstractmethod
    def advance(self, states, x, after, h) -> Array:
        """States after X ran linearly from `x` to `after` in h seconds."""

    @abstractmethod
    def reading(self, states, x) -> Array:
        """What the sensor reads."""

    @abstractmethod
    def undo(self, y: Float[Array, " time"], dt: float) -> Float[Array, " time"]:
        """The X behind a smooth reading; the reading itself where that is not known."""


def states_of(effect: AbstractEffect, x, voltage, age, reached=0.0) -> Float[Array, " states"]:
    """An effect's states in an actuator held at X under `voltage` (0 where it rests), at that age of the session.

    `reached`: the largest |X| of the session before.
    """
    if isinstance(effect, AbstractDriveEffect):
        return effect.initial(voltage)
    if isinstance(effect, AbstractForceEffect):
        return effect.resumed(effect.initial(x, age), reached)
    if isinstance(effect, AbstractSensorEffect):
        return effect.initial(x)
    return nothing()


class Known(Instant):
    """An instant whose motion is given (measured, or wanted); `h` only says how sharply friction sets in.

    Attributes:
        last: scaled x^(n).
    """

    last: Float[Array, ""]

    def velocity(self, tokens, offset):
        """As given."""
        return self.state[1] if self.state.shape[0] > 1 else self.last


class Wanted(Known):
    """A known motion whose force is what is asked for: x^(n) is not the force's to decide."""

    def highest(self, tokens, offset):
        """As given."""
        return self.last


def bounded(values, low, high) -> Start:
    """A start from three tuples."""
    return Start(tuple(map(float, values)), tuple(map(float, low)), tuple(map(float, high)))


def nothing() -> Array:
    """No states."""
    return jnp.zeros((0,))

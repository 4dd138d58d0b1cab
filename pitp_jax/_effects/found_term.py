"""A term found in the data where no name fits: a sum of functions of the motion, the drive and one memory.

    f = sum_j c_j phi_j(x, x', F, z; knees) + c x x'',   tau z' = x - z      F the film's force (V^2 or V), U = sqrt|F|

phi are products, signs and thresholds (`LIBRARY`). Dry friction among them is resolved as the catalogue's is. Which
functions there are is static, their coefficients are data: with all of them, absent ones at c = 0, every sparse sum is
a row of numbers under one compiled program.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .base import AbstractForceEffect, Instant, Known, Parameter, Surroundings, bounded
from .dissipation import resolved_friction
from .viscoelastic import lag_after

KNEES = (
    Parameter("a", "x", length=1, positive=False),
    Parameter("b", "x/s", speed=1),
    Parameter("e", "V^2", force=1),
    Parameter("tau", "s"),
    Parameter("d", "x", length=1, positive=False),
)
_EDGE = 0.02  # of the reach or more: what a step [x > a] is rounded over, scaled


class Values(NamedTuple):
    """What a function reads, all scaled: displacement, velocity, force of the film, the memory; and the knees."""

    x: Any
    v: Any
    f: Any
    z: Any
    knees: Sequence

    @property
    def u(self):
        """Absolute voltage, sqrt|F|, without an infinite slope at zero."""
        return jnp.sqrt(jnp.abs(self.f) + 1e-6)


@dataclass(frozen=True)
class Function:
    """One function of the library.

    Attributes:
        text: how it is written; F stands for the film's force, U for the voltage.
        powers: of x, x', x'' and F in it.
        of: the function; a level, where it is one of friction; of the position alone, where it multiplies x''.
        knee: which of `KNEES` it has, or None.
    """

    text: str
    powers: tuple[float, float, float, float]
    of: Callable[[Values], Any]
    knee: int | None = None

    @property
    def friction(self) -> bool:
        """Whether it is dry friction."""
        return self.text.endswith("sgn x'") and self.knee is None

    @property
    def inertial(self) -> bool:
        """Whether it multiplies x''."""
        return self.powers[2] != 0

    @property
    def parameter(self) -> Parameter:
        """Its coefficient."""
        x, v, a, f = self.powers
        top, bottom = ("V^2" if f == 0 else "V" if f == 0.5 else "1"), x + v + a
        seconds = v + 2 * a
        time = "" if not seconds else " s" if seconds == 1 else f" s^{seconds:g}"
        low = ("" if not bottom else "x" if bottom == 1 else f"x^{bottom:g}") + (" V^2" if f == 2 else "")
        unit = (top + time).removeprefix("1 ") if time else top
        low = low.strip()
        return Parameter(
            self.text, f"{unit}/{low}" if low else unit, length=-x, speed=-int(v), acceleration=-int(a), force=1 - f,
            positive=False, neutral=0.0,
        )  # fmt: skip


def _over(values: Values):
    """[x > a], rounded."""
    return 0.5 * (1 + jnp.tanh((values.x - values.knees[0]) / _EDGE))


_LISTED = (
    Function("x", (1, 0, 0, 0), lambda q: q.x),
    Function("x^2", (2, 0, 0, 0), lambda q: q.x**2),
    Function("x^3", (3, 0, 0, 0), lambda q: q.x**3),
    Function("x^5", (5, 0, 0, 0), lambda q: q.x**5),
    Function("x'", (0, 1, 0, 0), lambda q: q.v),
    Function("|x'|", (0, 1, 0, 0), lambda q: jnp.abs(q.v)),
    Function("x'^2", (0, 2, 0, 0), lambda q: q.v**2),
    Function("x' |x'|", (0, 2, 0, 0), lambda q: q.v * jnp.abs(q.v)),
    Function("x'^3", (0, 3, 0, 0), lambda q: q.v**3),
    Function("x x'", (1, 1, 0, 0), lambda q: q.x * q.v),
    Function("x^2 x'", (2, 1, 0, 0), lambda q: q.x**2 * q.v),
    Function("x |x'|", (1, 1, 0, 0), lambda q: q.x * jnp.abs(q.v)),
    Function("x x'^2", (1, 2, 0, 0), lambda q: q.x * q.v**2),
    Function("sgn x'", (0, 0, 0, 0), lambda q: jnp.ones_like(q.x)),
    Function("|x| sgn x'", (1, 0, 0, 0), lambda q: jnp.abs(q.x)),
    Function("|F| sgn x'", (0, 0, 0, 1), lambda q: jnp.abs(q.f)),
    Function("F", (0, 0, 0, 1), lambda q: q.f),
    Function("x F", (1, 0, 0, 1), lambda q: q.x * q.f),
    Function("x^2 F", (2, 0, 0, 1), lambda q: q.x**2 * q.f),
    Function("x' F", (0, 1, 0, 1), lambda q: q.v * q.f),
    Function("|x'| F", (0, 1, 0, 1), lambda q: jnp.abs(q.v) * q.f),
    Function("F^2", (0, 0, 0, 2), lambda q: q.f**2),
    Function("x F^2", (1, 0, 0, 2), lambda q: q.x * q.f**2),
    Function("U", (0, 0, 0, 0.5), lambda q: q.u - 1e-3),
    Function("x U", (1, 0, 0, 0.5), lambda q: q.x * q.u),
    Function("x' U", (0, 1, 0, 0.5), lambda q: q.v * q.u),
    Function("max(x - a, 0)", (1, 0, 0, 0), lambda q: jnp.maximum(q.x - q.knees[0], 0.0), 0),
    Function("max(x - d, 0)", (1, 0, 0, 0), lambda q: jnp.maximum(q.x - q.knees[4], 0.0), 4),
    Function("max(a - x, 0)", (1, 0, 0, 0), lambda q: jnp.maximum(q.knees[0] - q.x, 0.0), 0),
    Function("max(x - a, 0) x'", (1, 1, 0, 0), lambda q: jnp.maximum(q.x - q.knees[0], 0.0) * q.v, 0),
    Function("max(x - a, 0) F", (1, 0, 0, 1), lambda q: jnp.maximum(q.x - q.knees[0], 0.0) * q.f, 0),
    Function("x' [x > a]", (0, 1, 0, 0), lambda q: _over(q) * q.v, 0),
    Function("max(|x'| - b, 0) sgn x'", (0, 1, 0, 0), lambda q: q.v - jnp.clip(q.v, -q.knees[1], q.knees[1]), 1),
    Function("max(F - e, 0)", (0, 0, 0, 1), lambda q: jnp.maximum(q.f - q.knees[2], 0.0), 2),
    Function("x - z", (1, 0, 0, 0), lambda q: q.x - q.z, 3),
    Function("x (x - z)", (2, 0, 0, 0), lambda q: q.x * (q.x - q.z), 3),
    Function("z x'", (1, 1, 0, 0), lambda q: q.z * q.v, 3),
    Function("x x''", (1, 0, 1, 0), lambda q: q.x),
)
LIBRARY: dict[str, Function] = {f.text: f for f in _LISTED}
NAMES = tuple(LIBRARY)


def held_knees(functions: tuple[str, ...]) -> list[int]:
    """Which of the knees some functions have."""
    return sorted({k for name in functions if (k := LIBRARY[name].knee) is not None})


class FoundTerm(AbstractForceEffect):
    """f = sum_j c_j phi_j(x, x', F, z), found in the data.

    Attributes:
        functions: names of the functions present.
        c: their coefficients, scaled.
        knees: those of a, b, e, tau and d that they have.
    """

    name, form, family, port, states = "found_term", "sum of functions", "found", "K", 1
    PARAMETERS = (*(f.parameter for f in _LISTED), *KNEES)
    functions: tuple[str, ...] = eqx.field(static=True)
    c: Float[Array, " functions"]
    knees: Float[Array, " knees"]

    @classmethod
    def neutral(cls):
        """All functions, none of them at work."""
        return cls.of_functions(NAMES)

    @classmethod
    def of_functions(cls, names: tuple[str, ...]):
        """These functions, none of them at work."""
        return cls(names, jnp.zeros(len(names), jnp.float32), jnp.ones(len(held_knees(names)), jnp.float32))

    @classmethod
    def of(cls, values):
        """The sum without the functions that are not in it, from numbers in the order of PARAMETERS."""
        kept = [k for k in range(len(NAMES)) if values[k] != 0]
        chosen = tuple(NAMES[k] for k in kept)
        knees = [values[len(NAMES) + k] for k in held_knees(chosen)]
        return cls(chosen, *(jnp.asarray(np.array(v, float), jnp.float32) for v in ([values[k] for k in kept], knees)))

    def numbers(self):
        """Coefficients, then knees."""
        known = [*(LIBRARY[name].parameter for name in self.functions), *(KNEES[k] for k in held_knees(self.functions))]
        return list(zip(known, [*self.c, *self.knees], strict=True))

    def times(self, factors):
        """Each of them times a factor."""
        both, count = jnp.concatenate([self.c, self.knees]), len(self.functions)
        both = both * jnp.asarray(np.array(factors, float), both.dtype)
        return FoundTerm(self.functions, both[:count], both[count:])

    def _knees(self) -> list:
        """All of them, those that are not there at one."""
        held = held_knees(self.functions)
        return [self.knees[held.index(k)] if k in held else jnp.ones((), self.c.dtype) for k in range(len(KNEES))]

    @property
    def driven(self) -> bool:
        """Whether the film's force is in it: its inverse solves for that force."""
        return any(LIBRARY[name].powers[3] for name in self.functions)

    @classmethod
    def starts(cls, s: Surroundings):
        """All coefficients at zero, bounded by thirty times the restoring force; knees within the records."""
        force, speed = s.stiffness * s.reach, 2 * s.speed
        units = [force / (s.reach ** f.powers[0] * speed ** f.powers[1] * force ** f.powers[3]) for f in _LISTED]
        units[-1] = s.inertia / s.reach
        knees = (0.0, s.speed, 0.5 * force, 1 / s.omega, s.top)
        low = [*(-30 * u for u in units), s.bottom, 0.02 * s.speed, 0.02 * force, 2 * s.dt, s.bottom]
        high = [*(30 * u for u in units), s.top, 5 * s.speed, 2 * force, s.duration, s.top]
        return [bounded((*[0.0] * len(units), *knees), low, high)]

    def initial(self, x, age):
        """The memory has followed."""
        return jnp.reshape(x, (1,))

    def advance(self, states, x, after, h):
        """Exact for X linear."""
        return lag_after(states, x, after, jnp.reshape(self._knees()[3], (1,)), h)

    def act(self, states, now: Instant, tokens, offset):
        """The sum, at the velocity half a step on that it makes itself; friction is resolved after the rest."""
        v = now.velocity(tokens, offset)
        if not isinstance(now, Known):
            heavier, force, _ = self._parts(states, now, v, tokens)
            v = now.velocity(heavier, offset + force)
        tokens, force, level = self._parts(states, now, v, tokens)
        offset = offset + force
        if level is None:
            return tokens, offset
        if isinstance(now, Known):
            return tokens, offset + level * jnp.tanh(100 * v)
        dry = resolved_friction(now, tokens, offset, jnp.abs(level))
        return tokens, offset + jnp.sign(level) * dry

    def _parts(self, states, now: Instant, v, tokens):
        """Tokens with what multiplies x'', the force but for dry friction, and the level of that (None without)."""
        q, force, level = Values(now.state[0], v, now.force, states[0], self._knees()), jnp.zeros_like(v), None
        for k, name in enumerate(self.functions):  # not along self.c: an iteration cannot be written as C
            value = self.c[k] * LIBRARY[name].of(q)
            if LIBRARY[name].friction:
                level = value if level is None else level + value
            elif not LIBRARY[name].inertial:
                force = force + value
            elif tokens.shape[0] > 2:
                tokens = tokens.at[2].add(value)
        return tokens, force, level

"""A term found in the data where no name fits: a sum of functions of the motion, the drive and one memory.

    f = sum_j c_j phi_j(x, x', F, z; knees) + c x x'',   tau z' = x - z      F the film's force (V^2 or V), U = sqrt|F|

phi are products, signs and thresholds (`LIBRARY`). Dry friction among them is resolved as the catalogue's is. Which
functions there are is static, their coefficients are data.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import prod
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax.numpy as jnp

from .dissipation import dry
from .effect import Instant
from .kernels import Kernel, lags
from .spec import EffectSpec, Parameter

KNEES = (
    Parameter("a", "x", length=1, positive=False),
    Parameter("b", "x/s", speed=1),
    Parameter("e", "V^2", force=1),
    Parameter("tau", "s"),
    Parameter("d", "x", length=1, positive=False),
)
_EDGE = 0.02  # scaled: what a step [x > a] is rounded over, so that a fit can move a


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
        return jnp.sqrt(jnp.abs(self.f) + 1e-6)  # a thousandth of the largest voltage


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
    powers: tuple[float, ...]
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
        """Its coefficient, in the unit that makes a force (V^2) of the function."""
        x, v, a, f = self.powers
        top, bottom = ("V^2" if f == 0 else "V" if f == 0.5 else "1"), x + v + a
        seconds = v + 2 * a
        time = "" if not seconds else " s" if seconds == 1 else f" s^{seconds:g}"
        low = ("" if not bottom else "x" if bottom == 1 else f"x^{bottom:g}") + (" V^2" if f == 2 else "")
        unit = (top + time).removeprefix("1 ") if time else top
        low = low.strip()
        # powers of the scales that take the stored coefficient back: those of the force over those of the function
        return Parameter(
            self.text, f"{unit}/{low}" if low else unit, length=-x, speed=-int(v), acceleration=-int(a), force=1 - f,
            positive=False, off=0.0,
        )  # fmt: skip


def _over(q: Values):
    """Compute the step [x > a], rounded."""
    return 0.5 * (1 + jnp.tanh((q.x - q.knees[0]) / _EDGE))


# what functions are products of: (powers of x, x', x'' and F; value; knee); the longest names first
_FACTORS: dict[str, tuple] = {
    "max(|x'| - b, 0) sgn x'": ((0, 1, 0, 0), lambda q: q.v - jnp.clip(q.v, -q.knees[1], q.knees[1]), 1),
    "max(x - a, 0)": ((1, 0, 0, 0), lambda q: jnp.maximum(q.x - q.knees[0], 0.0), 0),
    "max(x - d, 0)": ((1, 0, 0, 0), lambda q: jnp.maximum(q.x - q.knees[4], 0.0), 4),
    "max(a - x, 0)": ((1, 0, 0, 0), lambda q: jnp.maximum(q.knees[0] - q.x, 0.0), 0),
    "max(F - e, 0)": ((0, 0, 0, 1), lambda q: jnp.maximum(q.f - q.knees[2], 0.0), 2),
    "[x > a]": ((0, 0, 0, 0), _over, 0),
    "x - z": ((1, 0, 0, 0), lambda q: q.x - q.z, 3),
    "z": ((1, 0, 0, 0), lambda q: q.z, 3),
    "sgn x'": ((0, 0, 0, 0), lambda q: jnp.ones_like(q.x), None),
    "x''": ((0, 0, 1, 0), lambda q: 1.0, None),
    "|x'|": ((0, 1, 0, 0), lambda q: jnp.abs(q.v), None),
    "|x|": ((1, 0, 0, 0), lambda q: jnp.abs(q.x), None),
    "|F|": ((0, 0, 0, 1), lambda q: jnp.abs(q.f), None),
    "x'": ((0, 1, 0, 0), lambda q: q.v, None),
    "x": ((1, 0, 0, 0), lambda q: q.x, None),
    "F": ((0, 0, 0, 1), lambda q: q.f, None),
    "U": ((0, 0, 0, 0.5), lambda q: q.u, None),
}
_FACTOR = re.compile(rf"({'|'.join(map(re.escape, _FACTORS))})(?:\^(\d))?")


def _function(text: str) -> Function:
    """Build a function from how it is written: a product of factors and their powers."""
    factors = [(*_FACTORS[name], int(power or 1)) for name, power in _FACTOR.findall(text)]
    powers = tuple(sum(p[i] * n for p, _, _, n in factors) for i in range(4))
    alone = 1e-3 if text == "U" else 0.0  # zero where there is no voltage, whose root is rounded

    def of(q: Values):
        return prod(value(q) ** n for _, value, _, n in factors) - alone

    return Function(text, powers, of, next((k for *_, k, _ in factors if k is not None), None))


_LISTED = tuple(map(_function, (
    "x", "x^2", "x^3", "x^5", "x'", "|x'|", "x'^2", "x' |x'|", "x'^3", "x x'", "x^2 x'", "x |x'|", "x x'^2",
    "sgn x'", "|x| sgn x'", "|F| sgn x'", "F", "x F", "x^2 F", "x' F", "|x'| F", "F^2", "x F^2", "U", "x U", "x' U",
    "max(x - a, 0)", "max(x - d, 0)", "max(a - x, 0)", "max(x - a, 0) x'", "max(x - a, 0) F", "x' [x > a]",
    "max(|x'| - b, 0) sgn x'", "max(F - e, 0)", "x - z", "x (x - z)", "z x'", "x x''",
)))  # fmt: skip
LIBRARY: dict[str, Function] = {f.text: f for f in _LISTED}
NAMES = tuple(LIBRARY)


def held_knees(functions: tuple[str, ...]) -> list[int]:
    """List which of the knees some functions have."""
    return sorted({k for name in functions if (k := LIBRARY[name].knee) is not None})


def _knees(p, functions) -> list:
    """List all of a, b, e, tau and d, those that the sum does not have at one."""
    held = held_knees(functions)
    return [p.knees[held.index(k)] if k in held else jnp.ones((), p.c.dtype) for k in range(len(KNEES))]


@lru_cache(maxsize=256)
def term_row(functions: tuple[str, ...]) -> EffectSpec:
    """Build the row of a sum of these functions; its numbers are their coefficients c and those knees they have."""
    held = held_knees(functions)
    lag = lags(1.0)

    def value(p, now: Instant, name: str, v):
        q = Values(now.x, v, now.force, now.z[0], _knees(p, functions))
        return p.c[functions.index(name)] * LIBRARY[name].of(q)  # not along p.c: an iteration cannot be written as C

    def total(p, now: Instant, v, chosen):
        return sum((value(p, now, name, v) for name in functions if chosen(LIBRARY[name])), jnp.zeros_like(v))

    def mass(p, now: Instant):
        return total(p, now, now.x, lambda f: f.inertial) if now.order > 1 else 0.0

    def law(p, now: Instant):
        """Compute the sum at the velocity half a step on that it makes itself; friction is resolved last."""
        v = now.v
        if now.last is None:  # one corrector step: a strong damping at the old velocity would overshoot
            v = now.pulled(total(p, now, v, _smooth)).v
        force = total(p, now, v, _smooth)
        if not any(LIBRARY[name].friction for name in functions):
            return force
        level = total(p, now, v, lambda f: f.friction)
        if now.last is not None:
            return force + level * jnp.tanh(100 * v)
        return force + jnp.sign(level) * dry(now.pulled(force), jnp.abs(level))

    def with_tau(rule):
        return lambda p, *others: rule(SimpleNamespace(tau=_knees(p, functions)[3]), *others)

    return EffectSpec(
        "found_term", "sum of functions", (*(LIBRARY[name].parameter for name in functions), *(KNEES[k] for k in held)),
        "An equation found in the data, where no name fits.", "f = sum_j c_j phi_j(x, x', F, z), tau z' = x - z",
        "found", "K", law=law, mass=mass if any(LIBRARY[name].inertial for name in functions) else None,
        kernel=Kernel(1, lambda p, w, age: jnp.reshape(w, (1,)), with_tau(lag.advance), once=with_tau(lag.once)),
        driven=any(LIBRARY[name].powers[3] for name in functions),
        arrays=(("c", len(functions)), ("knees", len(held))), functions=functions,
    )  # fmt: skip


def _smooth(f: Function) -> bool:
    return not f.friction and not f.inertial

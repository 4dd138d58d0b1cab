"""Rows of the catalogue: the name of an effect, its port, its parameters, its law and its memory.

    sum_i sigma_i x^(i) + sigma_off + f(x, x', z) = coupling(V, x),    V = drive(u),    y = sensor(x)

Ports: IN u to V, SQ the film's force at a displacement, K C M T forces added to the nominal's, OUT x to the reading; z
are the kernel's states. All is in the model's scaled coordinates: X_i = x^(i) / scale_i, force over force_scale,
stiffness in units of the nominal's; voltages in V, times in s. `Parameter` defines the conversion to physical units.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .effect import Effect
from .kernels import NOTHING, Kernel


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes:
        name: how the law reads it.
        unit: physical unit; "x" stands for the displacement's unit.
        length, speed, acceleration, force: powers of the scales of x, x', x'' and of the force that take the stored
            value to physical units.
        positive: fitted by its logarithm (else as it is).
        off: where the effect vanishes; None: the number does not matter where another one is off.
        linear: the effect is proportional to it (asked of the first parameter only).
        least, most: bounds of a fit, in the model's scaled coordinates.
        slow: a time constant that is fitted no shorter than the plant's own.
        fixed: never fitted: a unit decides it.
    """

    name: str
    unit: str = "1"
    length: float = 0
    speed: int = 0
    acceleration: int = 0
    force: float = 0
    positive: bool = True
    off: float | None = None
    linear: bool = True
    least: float = -np.inf
    most: float = np.inf
    slow: bool = False
    fixed: bool = False


@dataclass(frozen=True)
class EffectSpec:
    """One form of one effect, as data; two rows are equal where name, form and parameters are.

    Attributes:
        name: the effect, as a diagnosis prints it; form: one way to write it down.
        title: what it does, one plain sentence.
        equation: its law in symbols.
        family, port: see above.
        parameters: its numbers.
        law: p are the numbers by name.
            IN, OUT: fn(p, w, z), what leaves where w enters, z the states at that instant.
            SQ: fn(p, force, x), the force on the structure.
            K, C, M, T: fn(p, now), the extra force at an `Instant`.
        kernel: its memory.
        mass: fn(p, now) of a force: what it adds to the coefficient of x'' (of x^(n) below order 2).
        inverse: in closed form; without one, a guarded Newton solves the law.
            IN, OUT: fn(p, series, dt) for a smooth series that begins at rest.
            SQ: fn(p, force, x), infinite where no field makes it.
        solvable: fn(p), false where solving a law with a memory would grow without end: what leaves is then handed on.
        passes: fn(p, series, dt), true where some drive gives this film voltage (IN).
        driven: its force depends on that of the film, for which an inverse then solves.
        costly: a step of it takes exponentials or many states; the search simulates such sets apart.
        resolved: friction and slack, whose force is found within a step on the motion that all other forces leave.
        linear: a part of a linear model (what delays or filters drive or reading).
        stiffens: its first number is a stiffness beside the nominal's, in units of that.
        moves: the one number of a linear model that it changes: "mass", "gain" or "delay".
        twin: the name that one linear plant, or one sensor, cannot tell from it whatever is played.
        second: name and form of the row that is the same law once more, for a second time constant beside it.
        reported: fn(p, k, plant), name, form and numbers of the row that it is reported as: signs and sizes decide
            between those that share a law. k is the plant's stiffness, `plant` has its tau, area, bottom and top.
        needs_mass: it means nothing for a nominal of order one.
    """

    name: str
    form: str
    parameters: tuple[Parameter, ...]
    title: str = field(compare=False)
    equation: str = field(compare=False)
    family: str = field(compare=False)
    port: str = field(compare=False)
    law: Callable[..., Any] = field(compare=False)
    kernel: Kernel = field(default=NOTHING, compare=False)
    mass: Callable[..., Any] | None = field(default=None, compare=False)
    inverse: Callable[..., Any] | None = field(default=None, compare=False)
    solvable: Callable[..., Any] | None = field(default=None, compare=False)
    passes: Callable[..., Any] | None = field(default=None, compare=False)
    driven: bool = field(default=False, compare=False)
    costly: bool = field(default=False, compare=False)
    resolved: bool = field(default=False, compare=False)
    linear: bool = field(default=False, compare=False)
    stiffens: bool = field(default=False, compare=False)
    moves: str = field(default="", compare=False)
    twin: str = field(default="", compare=False)
    second: tuple[str, str] | None = field(default=None, compare=False)
    reported: Callable[..., Any] | None = field(default=None, compare=False)
    needs_mass: bool = field(default=False, compare=False)

    @property
    def key(self) -> str:
        """Return its name in files and tables: name, then form."""
        return f"{self.name}: {self.form}"

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of its parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def off(self) -> tuple[float, ...]:
        """Return the parameters for which the effect vanishes."""
        return tuple(1.0 if p.off is None else p.off for p in self.parameters)  # 1: any width or time, with strength 0

    def __call__(self, *values) -> Effect:
        """Return the effect with these parameters, in the order of `parameters`."""
        if len(values) != len(self.parameters):
            raise TypeError(f"{self.key} has {len(self.parameters)} numbers, not {len(values)}")
        # an array keeps its precision, a plain number gets that of training and rollout
        return Effect(self, tuple(v if isinstance(v, jax.Array) else jnp.asarray(v, jnp.float32) for v in values))

    def neutral(self) -> Effect:
        """Return the effect with no influence."""
        return self(*self.off)

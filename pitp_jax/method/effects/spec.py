"""Entries of the catalogue: the name of an effect, its port, its parameters, its law and its memory.

    sum_i sigma_i x^(i) + sigma_off + f(x, x', z) = coupling(V, x),    V = drive(u),    y = sensor(x)

Ports: IN u to V, SQ the film's force at a displacement, K C M T forces added to the nominal's, OUT x to the reading; z
are the kernel's states. All is in the model's scaled coordinates: X_i = x^(i) / scale_i, force over force_scale,
stiffness in units of the nominal's; voltages in V, times in s. `Parameter` defines the conversion to physical units.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .effect import Effect
from .kernels import NOTHING, Kernel


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect: its name, its unit, and how it is fitted.

    Attributes:
        name: its key in the law.
        unit: physical unit; "x" stands for the displacement's unit.
        length, speed, acceleration, force: powers of the scales of x, x', x'' and of the force that convert the stored
            value to physical units.
        positive: fitted by its logarithm (otherwise directly).
        off: value at which the effect vanishes; None: it has no influence when another parameter is off.
        least, most: bounds of a fit, in the model's scaled coordinates.
        slow: a time constant that is fitted at least as long as the plant's own.
        resonance: a frequency that is fitted inside the excited band, with both its sides visible.
        fixed: never fitted, because a unit determines it.
    """

    name: str
    unit: str = "1"
    length: float = 0
    speed: float = 0
    acceleration: int = 0
    force: float = 0
    positive: bool = True
    off: float | None = None
    least: float = -np.inf
    most: float = np.inf
    slow: bool = False
    resonance: bool = False
    fixed: bool = False


# Parameters at whose value 0 the effect vanishes.
strength = partial(Parameter, off=0.0)  # positive
signed = partial(Parameter, positive=False, off=0.0)  # of either sign


@dataclass(frozen=True, eq=False)
class EffectSpec:
    """One form of an effect, as data; two entries are equal if name, form and parameters are equal.

    Attributes:
        name: the effect, as a diagnosis prints it; form: one of its laws.
        title: one plain sentence about the effect.
        equation: its law in symbols.
        family, port: see above.
        parameters: its numbers.
        law: p are the parameters by name. IN, OUT: fn(p, w, z), output for the input w, z the states at that instant.
            SQ: fn(p, force, x), the force on the structure. K, C, M, T: fn(p, now), the extra force at an `Instant`.
        kernel: its memory.
        mass: fn(p, now) of a force: its addition to the coefficient of x'' (of x^(n) below order 2).
        crosses: fn(p, z), what an effect on the voltage adds to the sensor's reading, behind all effects of the sensor.
        inverse: in closed form; without one, a guarded Newton solves the law.
            IN, OUT: fn(p, series, dt) for a smooth series that begins at rest.
            SQ: fn(p, force, x), infinite where no field makes it.
        solvable: fn(p), false if solving a law with a memory would diverge: the output is then passed on.
        passes: fn(p, series, dt), true where some input gives this film voltage (IN).
        driven: its force depends on the film's force, so an inverse must solve for that.
        resolved: friction and slack, whose force follows within a step after all other forces.
        only_given: fitted if the nominal model has it; the search does not add it (docs/decisions/verdict.md).
        stiffens: its first parameter is an additional stiffness, in units of the nominal's.
        moves: the parameter of a linear model that it changes: "mass", "gain" or "delay".
        twin: the effect that a linear plant, or one sensor, cannot separate from it for any input.
        commutes: it acts in the same way on the input and on the reading of every plant, so no recording separates it
            from its twin.
        second: name and form of the row with the same law for a second time constant.
        reported: fn(p, k, plant), name, form and parameters of the reported row: signs and sizes decide between rows
            with one law. k is the plant's stiffness, `plant` has its tau, area, bottom and top.
        squares: it differs from a lag of the input only if the force is the square of the voltage.
        needs_mass: it does not apply to a nominal of order one.
    """

    name: str
    form: str
    parameters: tuple[Parameter, ...]
    title: str
    equation: str
    family: str
    port: str
    law: Callable[..., Any]
    kernel: Kernel = NOTHING
    mass: Callable[..., Any] | None = None
    crosses: Callable[..., Any] | None = None
    inverse: Callable[..., Any] | None = None
    solvable: Callable[..., Any] | None = None
    passes: Callable[..., Any] | None = None
    driven: bool = False
    resolved: bool = False
    only_given: bool = False
    stiffens: bool = False
    moves: str = ""
    twin: str = ""
    commutes: bool = False
    second: tuple[str, str] | None = None
    reported: Callable[..., Any] | None = None
    needs_mass: bool = False
    squares: bool = False

    def __eq__(self, other: object) -> bool:
        return isinstance(other, EffectSpec) and self._row == other._row

    def __hash__(self) -> int:
        return hash(self._row)

    @property
    def _row(self) -> tuple:
        return self.name, self.form, self.parameters

    @property
    def key(self) -> str:
        """Return the effect's key in files and tables: its name, then its form."""
        return f"{self.name}: {self.form}"

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the effect's parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def off(self) -> tuple[float, ...]:
        """Return the parameter values with which the effect has no influence."""
        return tuple(1.0 if p.off is None else p.off for p in self.parameters)  # 1: any width or time, with strength 0

    def __call__(self, *values) -> Effect:
        """Build the effect with these values, in the order of `parameters`."""
        if len(values) != len(self.parameters):
            raise TypeError(f"{self.key} has {len(self.parameters)} parameters, not {len(values)}")
        # an array keeps its precision, a plain number gets that of training and rollout
        return Effect(self, tuple(v if isinstance(v, jax.Array) else jnp.asarray(v, jnp.float32) for v in values))

    def neutral(self) -> Effect:
        """Build the effect with parameters for which it has no influence."""
        return self(*self.off)

"""An effect: a catalogue entry with its parameters, used by simulation, diagnosis and inverse.

    IN, SQ, OUT   apply: w -> law(p, w, z)            undo: closed form, else Newton on  law(p, w, z(w)) = wanted
    K C M T       act:   sigma_2 += mass(p, now),  sigma_off += law(p, now)

If the law has a memory, Newton solves sample by sample for the w whose advanced state gives the wanted value.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jax.tree_util import GetAttrKey
from jaxtyping import Array, Float

from ..numerics.where import where
from .kernels import DELAY

if TYPE_CHECKING:
    from .spec import EffectSpec, Parameter

_STEPS = 8  # of Newton's method


@dataclass(frozen=True)
class Instant:
    """The variables on which a force depends: those of one time step, or of one instant of a given motion.

    Attributes:
        state: scaled S at the drifted midpoint (x^(n-1) as at the step's beginning), shape (n,).
        coefficients: the nominal's scaled coefficients, shape (n + 1,).
        rates: dX_i/dt = rates_i X_(i+1), 1/s, shape (n,).
        force: scaled force of the film at the middle of the step.
        h: length of the step, s; along a given motion it only sets how sharply friction starts.
        tokens, offset: of the frozen equation, including the effects before this one.
        last: scaled x^(n) of a given motion (measured, or wanted); None within a step.
        wanted: the force is the unknown, so x^(n) does not follow from it.
        z: the effect's own states at this instant.
    """

    state: Any
    coefficients: Any
    rates: Any
    force: Any
    h: Any
    tokens: Any
    offset: Any
    last: Any = None
    wanted: bool = False
    z: Any = None

    @property
    def order(self) -> int:
        """Return the order n of the differential equation."""
        return self.state.shape[0]

    @property
    def x(self):
        """Return the scaled displacement x."""
        return self.state[0]

    @property
    def k(self):
        """Return the scaled stiffness of the nominal model."""
        return self.coefficients[0]

    @property
    def v(self):
        """Return the scaled velocity x' half a time step later (order 2: from the acceleration at its start)."""
        # at order 1 x' is the highest derivative: not a state, but the frozen step's result
        if self.order == 1:
            return self.highest if self.last is None else self.last
        if self.order > 2 or self.last is not None:  # drifted already, or of a given motion
            return self.state[1]
        return self.state[1] + self.h / 2 * self.rates[1] * self.highest

    @property
    def highest(self):
        """Return the scaled highest derivative x^(n) of the time step, or of a wanted motion."""
        if self.wanted:
            return self.last
        n = self.order
        return (self.force - self.offset - self.tokens[:n] @ self.state) / self.tokens[n]

    @property
    def free(self):
        """Return the scaled velocity x' at the end of the time step without the force of this effect."""
        return self.highest if self.order == 1 else self.state[1] + self.h * self.rates[1] * self.highest

    @property
    def reply(self):
        """Return by how much a unit of scaled force slows x' until the end of the time step."""
        return 1 / self.tokens[1] if self.order == 1 else self.h * self.rates[1] / self.tokens[2]

    @property
    def inertial(self):
        """Return the scaled inertial force a_2 x'' of the time step; zero below order 2."""
        if self.order < 2:
            return 0.0 * self.x
        return self.tokens[2] * (self.highest if self.order == 2 else self.state[2])

    def pulled(self, force) -> "Instant":
        """Return the equation of the time step with one more force."""
        return replace(self, offset=self.offset + force)

    def heavier(self, mass) -> "Instant":
        """Return the equation of the time step with more mass: before x'', or before x^(n) below order 2."""
        return replace(self, tokens=self.tokens.at[min(2, self.order)].add(mass))


@jax.tree_util.register_pytree_with_keys_class
class Effect:
    """A catalogue entry (`spec`, static) with its parameters (`theta`, arrays); both are attributes by name."""

    spec: "EffectSpec"
    theta: tuple

    def __init__(self, spec: "EffectSpec", theta: tuple):
        self.spec, self.theta = spec, tuple(theta)

    def __getattr__(self, name: str) -> Any:
        """Return a parameter of this name, otherwise an attribute of the catalogue entry."""
        # before __init__ ran (copy, pickle), a look-up of `spec` would recurse without end
        if name in ("spec", "theta") or name.startswith("__"):
            raise AttributeError(name)
        names = self.spec.names
        return self.theta[names.index(name)] if name in names else getattr(self.spec, name)

    def __repr__(self) -> str:
        numbers = ", ".join(f"{k}={v}" for k, v in vars(self.p).items())
        return f"effect({self.name!r}, form={self.form!r}, {numbers})"

    def tree_flatten_with_keys(self):
        """Flatten to parameters by name, so that files and messages can name them."""
        return [(GetAttrKey(k), v) for k, v in zip(self.spec.names, self.theta, strict=True)], self.spec

    @classmethod
    def tree_unflatten(cls, spec, theta):
        """Rebuild an effect from a catalogue entry and parameters."""
        return cls(spec, theta)

    @property
    def states(self) -> int:
        """Return the number of states in the memory of the effect."""
        return self.spec.kernel.size

    @property
    def forces(self) -> bool:
        """Return whether the effect is a force added to the forces of the nominal model."""
        return self.port in ("K", "C", "M", "T")

    @property
    def delays(self) -> bool:
        """Return whether the effect is a delay, which shifts the whole record."""
        return self.kernel is DELAY

    @property
    def p(self) -> SimpleNamespace:
        """Return the parameters of the effect by name, as its law and memory use them."""
        return SimpleNamespace(**dict(zip(self.spec.names, self.theta, strict=True)))

    def numbers(self) -> list[tuple["Parameter", Array]]:
        """Return the parameters of the effect, each with its value."""
        return list(zip(self.spec.parameters, self.theta, strict=True))

    def times(self, factors) -> "Effect":
        """Return the effect with each of its parameters multiplied by a factor."""
        return self.spec(*(v * f for (_, v), f in zip(self.numbers(), factors, strict=True)))

    def start(self, w, age=0.0) -> Float[Array, " states"]:
        """Return the memory states after a long constant input w, at this time since the session started (s)."""
        return self.kernel.start(self.p, w, age)

    def resumed(self, z, reached) -> Float[Array, " states"]:
        """Return the memory states after earlier records have reached the displacement |X| = `reached`."""
        return self.kernel.resumed(self.p, z, reached)

    def advance(self, z, before, after, h) -> Float[Array, " states"]:
        """Return the memory states after the input w has changed linearly from `before` to `after` in h seconds."""
        return self.kernel.advance(self.p, z, before, after, h)

    def apply(self, w, beside):
        """Return the output of the effect for the input w; `beside`: the states (IN, OUT) or the displacement (SQ)."""
        return self.spec.law(self.p, w, beside)

    def act(self, z, now: Instant) -> Instant:
        """Return the equation of the time step with the force of the effect."""
        p, spec = self.p, self.spec
        # along a given motion the states are those of the instant; a step's force is evaluated half a step later
        if now.last is None:
            z = self.kernel.ahead(p, z, now)
        now = replace(now, z=z)
        if spec.mass:  # first, so that the acceleration in a law is that of the changed mass
            now = now.heavier(spec.mass(p, now))
        return now.pulled(spec.law(p, now))

    def uncoupled(self, force, x):
        """Compute the film's force that gives a wanted force on the structure (SQ)."""
        if self.spec.inverse:
            return self.spec.inverse(self.p, force, x)
        return solve(lambda f: self.apply(f, x), force)

    def undo(self, values: Float[Array, " time"], dt: float) -> Float[Array, " time"]:
        """Compute the input that gives a smooth output, for a record that starts at rest (ports IN and OUT)."""
        if self.spec.inverse:
            return self.spec.inverse(self.p, values, dt)
        if not self.states:
            return solve(lambda w: self.apply(w, jnp.zeros((0,))), values)
        # a film at rest is uncharged; a sensor has settled at its first value
        begun = self.start(jnp.zeros_like(values[0]) if self.port == "IN" else values[0])
        first = solve(lambda w: self.apply(w, begun), values[0])

        def sample(carry, wanted):
            carry = self.undo_sample(carry[0], carry[1], wanted, dt)
            return carry, carry[1]

        return jnp.append(first, jax.lax.scan(sample, (begun, first), values[1:])[1])

    def undo_sample(self, z, before, wanted, dt: float) -> tuple:
        """Compute (states, input w) one sample later such that the output is `wanted`."""

        def advanced(w):
            return self.advance(z, before, w, dt)

        # from the previous sample, because with memory a law is nearly linear over one
        w = solve(lambda w: self.apply(w, advanced(w)), wanted, before, _STEPS // 2)
        if self.spec.solvable:
            w = jnp.where(self.spec.solvable(self.p), w, wanted)
        return advanced(w), w

    def passes(self, values: Float[Array, " time"], dt: float) -> Array:
        """Return True where some input gives these output values (port IN)."""
        if self.spec.passes:
            return self.spec.passes(self.p, values, dt)
        if self.states:  # a memory delays the output but excludes nothing
            return jnp.ones(values.shape, bool)
        # beyond a limit no input gives the value, whatever the inverse returns there; 3e-6 is the rounding of float32
        w = self.undo(values, dt)
        return jnp.abs(self.apply(w, jnp.zeros((0,))) - values) <= 3e-6 * (jnp.abs(values) + jnp.abs(w))


def solve(function: Callable, wanted: Array, begin: Array | None = None, steps: int = _STEPS) -> Array:
    """Solve function(w) = wanted for every element by Newton's method, starting at `begin` or at `wanted`.

    A step is taken only if it reduces the error: w does not change in a flat part (a clip). The least slope is 0.05.
    """
    w = wanted if begin is None else begin
    for _ in range(steps):
        # one pass gives the value and its exact slope, for any law that JAX can trace
        value, rise = jax.jvp(function, (w,), (jnp.ones_like(w),))
        tried = w + (wanted - value) / where(jnp.abs(rise) < 0.05, 0.05, rise)
        w = where(jnp.abs(function(tried) - wanted) < jnp.abs(value - wanted), tried, w)
    return w

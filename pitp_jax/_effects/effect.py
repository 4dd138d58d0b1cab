"""An effect: a row of the catalogue with its numbers. One `act` serves rollout, screening and inverse.

    IN, SQ, OUT   apply: w -> law(p, w, z)            undo: closed form, else Newton on  law(p, w, z(w)) = wanted
    K C M T       act:   sigma_2 += mass(p, now),  sigma_off += law(p, now)

Where the law has a memory, Newton solves sample by sample for the w whose advanced state gives what is wanted.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jax.tree_util import GetAttrKey
from jaxtyping import Array, Float

from .._numerics.where import where
from .kernels import DELAY

if TYPE_CHECKING:
    from .spec import EffectSpec, Parameter

_STEPS, _FLATTEST = 8, 0.05  # of Newton's method, and the least slope that it divides by
_ROUNDING = 3e-6  # relative, in float32: how exactly a law must give back what was solved for


@dataclass(frozen=True)
class Instant:
    """What a force may depend on: the frozen step so far, or an instant of a motion that is given.

    Attributes:
        state: scaled S at the drifted midpoint (x^(n-1) as at the step's beginning), shape (n,).
        coefficients: the nominal's scaled coefficients, shape (n + 1,).
        rates: dX_i/dt = rates_i X_(i+1), 1/s, shape (n,).
        force: scaled force of the film at the middle of the step.
        h: length of the step, s; along a given motion it only says how sharply friction sets in.
        tokens, offset: of the frozen equation, with the effects before this one in them.
        last: scaled x^(n) of a motion that is given (measured, or wanted); None within a step.
        wanted: the force is what is asked for, so that x^(n) is not the force's to decide.
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
        """Order n of the equation."""
        return self.state.shape[0]

    @property
    def x(self):
        """Scaled displacement x."""
        return self.state[0]

    @property
    def k(self):
        """Scaled stiffness of the nominal."""
        return self.coefficients[0]

    @property
    def v(self):
        """Scaled x' half a step on (order 2: by the acceleration the step begins with)."""
        # at order 1 x' is the highest derivative: not a state, but what the frozen step makes of the force
        if self.order == 1:
            return self.highest if self.last is None else self.last
        if self.order > 2 or self.last is not None:  # drifted already, or of a motion that is given
            return self.state[1]
        return self.state[1] + self.h / 2 * self.rates[1] * self.highest

    @property
    def highest(self):
        """Scaled x^(n) of the frozen step."""
        if self.wanted:
            return self.last
        n = self.order
        return (self.force - self.offset - self.tokens[:n] @ self.state) / self.tokens[n]

    @property
    def free(self):
        """Scaled x' at the end of the step without the force that is asked for."""
        return self.highest if self.order == 1 else self.state[1] + self.h * self.rates[1] * self.highest

    @property
    def reply(self):
        """By how much a unit of scaled force slows x' until the end of the step."""
        return 1 / self.tokens[1] if self.order == 1 else self.h * self.rates[1] / self.tokens[2]

    @property
    def inertial(self):
        """Scaled a_2 x'' of the frozen step; none below order 2."""
        if self.order < 2:
            return 0.0 * self.x
        return self.tokens[2] * (self.highest if self.order == 2 else self.state[2])

    def pulled(self, force) -> "Instant":
        """Add one more force to the frozen equation."""
        return replace(self, offset=self.offset + force)

    def heavier(self, mass) -> "Instant":
        """Add mass: more in front of x'', or of x^(n) below order 2."""
        return replace(self, tokens=self.tokens.at[min(2, self.order)].add(mass))


@jax.tree_util.register_pytree_with_keys_class
class Effect:
    """A row of the catalogue (`spec`, static) with its numbers (`theta`, arrays); both are attributes by name."""

    spec: "EffectSpec"
    theta: tuple

    def __init__(self, spec: "EffectSpec", theta: tuple):
        self.spec, self.theta = spec, tuple(theta)

    def __getattr__(self, name: str) -> Any:
        """Look up a number by its name, else what its row says."""
        # asked before __init__ ran (copy, pickle), `spec` would ask for itself without end
        if name in ("spec", "theta") or name.startswith("__"):
            raise AttributeError(name)
        names = self.spec.names
        return self.theta[names.index(name)] if name in names else getattr(self.spec, name)

    def __repr__(self) -> str:
        numbers = ", ".join(f"{k}={v}" for k, v in vars(self.p).items())
        return f"effect({self.name!r}, form={self.form!r}, {numbers})"

    def tree_flatten_with_keys(self):
        """Flatten to leaves by name, so that files and messages name them."""
        return [(GetAttrKey(k), v) for k, v in zip(self.spec.names, self.theta, strict=True)], self.spec

    @classmethod
    def tree_unflatten(cls, spec, theta):
        """Build an effect of other leaves."""
        return cls(spec, theta)

    @property
    def states(self) -> int:
        """How many numbers it remembers."""
        return self.spec.kernel.size

    @property
    def forces(self) -> bool:
        """Whether it is a force beside the nominal's."""
        return self.port in ("K", "C", "M", "T")

    @property
    def delays(self) -> bool:
        """Whether it shifts the whole record."""
        return self.kernel is DELAY

    @property
    def p(self) -> SimpleNamespace:
        """Its numbers by name, as laws and kernels read them."""
        return SimpleNamespace(**dict(zip(self.spec.names, self.theta, strict=True)))

    def numbers(self) -> list[tuple["Parameter", Array]]:
        """List its numbers one by one, and what each of them is."""
        return list(zip(self.spec.parameters, self.theta, strict=True))

    def times(self, factors) -> "Effect":
        """Multiply each of its numbers by a factor."""
        return self.spec(*(v * f for (_, v), f in zip(self.numbers(), factors, strict=True)))

    def start(self, w, age=0.0) -> Float[Array, " states"]:
        """Set the states of what has been held at w, at that age of the session in s."""
        return self.kernel.start(self.p, w, age)

    def resumed(self, z, reached) -> Float[Array, " states"]:
        """Set the states where the session has gone to |X| = `reached` before."""
        return self.kernel.resumed(self.p, z, reached)

    def once(self, h) -> Any:
        """Compute the numbers of its memory that depend on the step alone (h, s), so that a loop need not."""
        return self.kernel.once(self.p, h)

    def advance(self, z, before, after, h, once=None) -> Float[Array, " states"]:
        """Advance the states: w ran linearly from `before` to `after` in h seconds; `once`: of this h."""
        return self.kernel.advance(self.p, z, before, after, self.once(h) if once is None else once)

    def apply(self, w, beside):
        """Compute what leaves the port where w enters; `beside`: the states (IN, OUT), the displacement (SQ)."""
        return self.spec.law(self.p, w, beside)

    def act(self, z, now: Instant, once=None) -> Instant:
        """Put the effect's force into the frozen equation; `once`: of the step's h."""
        p, spec = self.p, self.spec
        # along a given motion the states are those of the instant; a step's force is read half a step on
        if now.last is None:
            z = self.kernel.ahead(p, z, replace(now, h=self.once(now.h) if once is None else once))
        now = replace(now, z=z)
        if spec.mass:  # first: the acceleration that a law reads is then that of the changed mass
            now = now.heavier(spec.mass(p, now))
        return now.pulled(spec.law(p, now))

    def uncoupled(self, force, x):
        """Solve for the film's force behind a force on the structure (SQ)."""
        if self.spec.inverse:
            return self.spec.inverse(self.p, force, x)
        return solve(lambda f: self.apply(f, x), force)

    def undo(self, values: Float[Array, " time"], dt: float) -> Float[Array, " time"]:
        """Solve for what must enter for these smooth values to leave, of a record that starts at rest (IN, OUT)."""
        if self.spec.inverse:
            return self.spec.inverse(self.p, values, dt)
        if not self.states:
            return solve(lambda w: self.apply(w, jnp.zeros((0,))), values)
        # a film that rests is uncharged; a sensor has been reading its first value
        begun = self.start(jnp.zeros_like(values[0]) if self.port == "IN" else values[0])
        first = solve(lambda w: self.apply(w, begun), values[0])

        def sample(carry, wanted):
            carry = self.undo_sample(carry[0], carry[1], wanted, dt)
            return carry, carry[1]

        return jnp.append(first, jax.lax.scan(sample, (begun, first), values[1:])[1])

    def undo_sample(self, z, before, wanted, dt: float) -> tuple:
        """Solve for (states, w) a sample on, w such that `wanted` leaves."""

        def advanced(w):
            return self.advance(z, before, w, dt)

        # from the sample before: with memory a law is nearly linear over one
        w = solve(lambda w: self.apply(w, advanced(w)), wanted, before, _STEPS // 2)
        if self.spec.solvable:
            w = jnp.where(self.spec.solvable(self.p), w, wanted)
        return advanced(w), w

    def passes(self, values: Float[Array, " time"], dt: float) -> Array:
        """Mark where something that enters makes these values leave (IN)."""
        if self.spec.passes:
            return self.spec.passes(self.p, values, dt)
        if self.states:  # a memory delays what passes; it forbids nothing
            return jnp.ones(values.shape, bool)
        # beyond a limit no input gives the value back, whatever the inverse says there
        w = self.undo(values, dt)
        return jnp.abs(self.apply(w, jnp.zeros((0,))) - values) <= _ROUNDING * (jnp.abs(values) + jnp.abs(w))


def solve(function: Callable, wanted: Array, begin: Array | None = None, steps: int = _STEPS) -> Array:
    """Solve function(w) = wanted element by element by Newton's method, from `begin` (default: from what is wanted).

    A step is taken only where it comes nearer: at a flat piece (a clip) w stays where it is.
    """
    w = wanted if begin is None else begin
    for _ in range(steps):
        # one pass gives the value and its slope, exactly, for any law that JAX can trace
        value, rise = jax.jvp(function, (w,), (jnp.ones_like(w),))
        tried = w + (wanted - value) / where(jnp.abs(rise) < _FLATTEST, _FLATTEST, rise)
        w = where(jnp.abs(function(tried) - wanted) < jnp.abs(value - wanted), tried, w)
    return w

"""Springs that forget: force branches behind dampers (port K), k = sigma_0 of the nominal.

    f = k kappa mean_i (x - z_i)        or, where the nominal is the stiff fresh film,   f = -k kappa mean_i z_i
    z_i' = (x - z_i) / tau_i,           tau_i = tau (one branch), or tau / 4, tau, 4 tau

`creep` where tau omega_0 > 15, `relaxation` below: one family, parted by a border, so near it they are tied.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._numerics.linear_recurrence import lag_after
from .base import AbstractForceEffect, Instant, Parameter, Surroundings, bounded

BORDER = 15.0  # tau omega_0


class _Branches(AbstractForceEffect):
    """Branches with spread-out time constants."""

    family, port = "viscoelastic", "K"
    PARAMETERS = (Parameter("kappa", neutral=0.0), Parameter("tau", "s"))
    spread: ClassVar[tuple[float, ...]]
    fresh: ClassVar[bool]
    slow: ClassVar[bool]
    kappa: Float[Array, ""]
    tau: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Time constants a decade apart on the right side of the border."""
        border, widest = BORDER / s.omega, max(cls.spread)
        if cls.slow:
            low, high = border, max(2 * s.duration, 2 * border)
            first = (2.5 * border, min(12 * border, 0.7 * high))
        else:
            low, high = 0.15 / s.omega, border
            first = (1.0 / s.omega, 5.0 / s.omega)
        del widest
        most = 0.9 if cls.fresh else 20.0
        return [bounded((0.2, tau), (1e-4, low), (most, high)) for tau in first]

    def initial(self, x, age):
        """Settled at X."""
        return jnp.full((len(self.spread),), x)

    def _taus(self):
        return self.tau * jnp.asarray(self.spread, jnp.result_type(self.tau))

    def act(self, states, now: Instant, tokens, offset):
        """The branches' mean force, their states half a step on."""
        x = now.state[0]
        half = states + (x - states) * -jnp.expm1(-now.h / 2 / self._taus())
        pull = -half if self.fresh else x - half
        return tokens, offset + now.coefficients[0] * self.kappa * pull.mean()

    def advance(self, states, x, after, h):
        """Exact for X linear."""
        return lag_after(states, x, after, self._taus(), h)


class Creep(_Branches):
    """One slow branch."""

    name, form, states, spread, fresh, slow = "creep", "one branch", 1, (1.0,), False, True


class SpreadCreep(_Branches):
    """Three slow branches."""

    name, form, states, spread, fresh, slow = "creep", "three branches", 3, (0.2, 1.0, 5.0), False, True


class LosingCreep(_Branches):
    """A spring that gives way with time."""

    name, form, states, spread, fresh, slow = "creep", "loss of stiffness", 1, (1.0,), True, True


class Relaxation(_Branches):
    """One branch in band."""

    name, form, states, spread, fresh, slow = "relaxation", "one branch", 1, (1.0,), False, False


class SpreadRelaxation(_Branches):
    """Three branches in band."""

    name, form, states, spread, fresh, slow = "relaxation", "three branches", 3, (0.25, 1.0, 4.0), False, False


class LosingRelaxation(_Branches):
    """A spring that gives way within a period."""

    name, form, states, spread, fresh, slow = "relaxation", "loss of stiffness", 1, (1.0,), True, False

"""Lags and oscillators that several effects are made of, forward by a step and back by lead.

tau v' = u - v  in a row,    u = v + tau v'            z'' = w^2 (x - z) - 2 zeta w z'
"""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._model.drive import slope
from .._numerics.linear_recurrence import lag_after
from .base import Start, Surroundings, bounded


def lags_in_a_row(states, x, after, taus: Sequence, h):
    """The states of first-order lags behind each other: exact for the first, whose output the next takes as linear."""
    found = []
    for state, tau in zip(states, taus, strict=True):
        later = lag_after(state, x, after, jnp.maximum(tau, 1e-9), h)
        found.append(later)
        x, after = state, later
    return jnp.stack(found)


def lead(values: Float[Array, " time"], taus: Sequence, dt: float) -> Float[Array, " time"]:
    """What lags in a row made these smooth values of: v + tau v', lag by lag."""
    for tau in taus:
        values = values + tau * slope(values, dt)
    return values


def lag_starts(s: Surroundings) -> list[Start]:
    """Of one time constant, around and below the time scale of the resonance."""
    low, high = min(0.2 * s.dt, 0.003 / s.omega), 5.0 / s.omega
    return [bounded((share / s.omega,), (low,), (high,)) for share in (0.1, 0.5)]


def oscillate(states, x, w, zeta, h):
    """(z, z' in 1/s) after h of z'' = w^2 (X - z) - 2 zeta w z', by the implicit midpoint rule."""
    middle = (states[1] + h / 2 * w**2 * (x - states[0])) / (1 + (h * w / 2) ** 2 + h * zeta * w)
    return jnp.stack([states[0] + h * middle, 2 * middle - states[1]])

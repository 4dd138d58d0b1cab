"""Effects of additional masses, and of loads that lose contact (port M).

a_2 is the mass of the nominal model, k its stiffness.

added_mass    d a_2 x''
second_mode   f = k kappa (x - z + r (x' - z')),  r = 2 zeta / w,  z'' = w^2 (x - z) + 2 zeta w (x' - z')
force_limit   |a_2 x''| <= f: an actuator that saturates behind the controller with the nominal's spring and damper
slack         x'' >= -g: a load that is only pulled falls freely once the film lets go
"""

import jax.numpy as jnp

from .effect import Instant
from .kernels import oscillator
from .spec import EffectSpec, Parameter, signed, strength


def _hung(p, now: Instant):
    """Return the force of an attached mass whose damper also acts on the body: z = q + r q', q the oscillator."""
    r, (q, speed) = 2 * p.zeta / p.omega, now.z
    # q'' by the equation of the oscillator; then z' = q' + r q''
    acceleration = p.omega**2 * (now.x - q - r * speed)
    return now.k * p.kappa * (now.x - q - r * speed + r * (now.rates[0] * now.v - speed - r * acceleration))


# an overdamped second mode is equivalent to a relaxation or a delay
MODE = Parameter("omega", "rad/s", resonance=True), Parameter("zeta", most=0.5)

MASSES = (
    EffectSpec(
        "added_mass", "share", (signed("d"),),
        "More (or less) mass moves than the model contains.", "f = d a_2 x''", "inertia", "M", moves="mass",
        law=lambda p, now: 0.0 * now.x,
        mass=lambda p, now: p.d * now.coefficients[min(2, now.order)],
    ),
    EffectSpec(
        "second_mode", "hung on", (strength("kappa"), *MODE),
        "A second mass hangs on the first one by a spring and a damper.",
        "f = k kappa (x - z + r (x' - z')), z'' = omega^2 (x - z + r (x' - z')), r = 2 zeta / omega", "inertia", "M",
        kernel=oscillator(), law=_hung, needs_mass=True,
    ),
)  # fmt: skip


def _free_fall(p, now: Instant):
    """Return the force that is missing to keep the acceleration x'' >= -g."""
    if now.order != 2:
        return 0.0 * now.x
    # the force that keeps x'' at the limit: x'' is linear in the force with the slope 1 / sigma_2
    missing = jnp.maximum(-1 / jnp.maximum(p.inverse, 1e-30) - now.highest, 0.0)
    return -now.tokens[2] * missing


def _saturated(p, now: Instant):
    """Return the part of the controller's force that exceeds the limit."""
    if now.order != 2:
        return 0.0 * now.x
    # inverse 0 is no limit; 1e30 instead of inf keeps the slopes finite
    asked, limit = now.tokens[2] * now.highest, 1 / jnp.maximum(p.inverse, 1e-30)
    return asked - jnp.clip(asked, -limit, limit)


LIMITS = (
    EffectSpec(
        "force_limit", "inside the loop", (strength("inverse", "1/V^2", force=-1),),
        "The drive of a position controller cannot exceed a force.",
        "a_2 x'' = min(max(k (u - x) - a_1 x', -f), f), inverse = 1 / f", "drive", "M", resolved=True, needs_mass=True,
        law=_saturated,
    ),
    EffectSpec(
        "slack", "free fall", (strength("inverse", "s^2/x", acceleration=-1),),
        "The actuator can only pull the load; otherwise the load falls freely.",
        "x'' >= -g, inverse = 1 / g", "stiffness", "M", resolved=True, needs_mass=True, law=_free_fall,
    ),
)  # fmt: skip

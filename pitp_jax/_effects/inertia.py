"""Add masses the nominal does not have, and loads that let go (port M); a_2 is the nominal's mass, k its stiffness.

added_mass    d a_2 x''
second_mode   f = k kappa (x - z),  z'' = w^2 (x - z) - 2 zeta w z'       a mass that a spring carries and air holds,
              f = k kappa (x - z + r (x' - z')),  r = 2 zeta / w          a mass hung on a spring and a damper,
              f = p a_2 (w^2 (x - z) + 2 zeta w (x' - z') - x'')          or a part of the mass come loose
slack         x'' >= -g, sharp or soft: a load that is only pulled falls freely once the film lets go
"""

import jax
import jax.numpy as jnp

from .effect import Instant
from .kernels import oscillator
from .spec import EffectSpec, Parameter


def _loosened(p, now: Instant):
    if now.order < 2:
        return 0.0 * now.x
    slip = now.rates[0] * now.state[1] - now.z[1]  # z' is kept in 1/s, x' in a scale of its own
    # the loose mass accelerates with the pull of its spring, and no longer with the body
    pull = p.omega**2 * (now.x - now.z[0]) + 2 * p.zeta * p.omega * slip
    return p.p * now.coefficients[2] / (now.rates[0] * now.rates[1]) * pull


def _hung(p, now: Instant):
    """Compute the pull of a mass whose damper, too, ends at the body: z = q + r q', q the oscillator of the kernel."""
    r, (q, speed) = 2 * p.zeta / p.omega, now.z
    # q'' by the equation of the oscillator; then z' = q' + r q''
    acceleration = p.omega**2 * (now.x - q - r * speed)
    return now.k * p.kappa * (now.x - q - r * speed + r * (now.rates[0] * now.v - speed - r * acceleration))


# an overdamped second mode is a relaxation or a delay by another name
MODE = Parameter("omega", "rad/s"), Parameter("zeta", most=0.5)

MASSES = (
    EffectSpec(
        "added_mass", "share", (Parameter("d", positive=False, off=0.0),),
        "More (or less) mass moves than the model knows of.", "f = d a_2 x''", "inertia", "M",
        law=lambda p, now: 0.0 * now.x,
        mass=lambda p, now: p.d * now.coefficients[min(2, now.order)],
    ),
    EffectSpec(
        "second_mode", "attached", (Parameter("kappa", off=0.0), *MODE),
        "A second moving mass resonates beside the first one.",
        "f = k kappa (x - z), z'' = omega^2 (x - z) - 2 zeta omega z'", "inertia", "M", kernel=oscillator(),
        law=lambda p, now: now.k * p.kappa * (now.x - now.z[0]),
    ),
    EffectSpec(
        "second_mode", "hung on", (Parameter("kappa", off=0.0), *MODE),
        "A second mass hangs on the first one by a spring and a damper.",
        "f = k kappa (x - z + r (x' - z')), z'' = omega^2 (x - z + r (x' - z')), r = 2 zeta / omega", "inertia", "M",
        kernel=oscillator(), law=_hung, needs_mass=True,
    ),
    EffectSpec(
        "second_mode", "come loose", (Parameter("p", off=0.0), *MODE),
        "Part of the mass has come loose and hangs on a spring.",
        "f = p a_2 (omega^2 (x - z) + 2 zeta omega (x' - z') - x''), z as of the attached mass", "inertia", "M",
        kernel=oscillator(), law=_loosened,
        mass=lambda p, now: -p.p * now.coefficients[2] if now.order > 1 else 0.0,
    ),
)  # fmt: skip


def _free_fall(sign: float):
    """Build the law: as much push as is missing for sign x'' >= -g."""

    def law(p, now: Instant):
        if now.order != 2:
            return 0.0 * now.x
        # what keeps x'' at the limit, once it would be beyond: x'' is linear in the force with the slope 1 / sigma_2
        missing = jnp.maximum(-1 / jnp.maximum(p.inverse, 1e-30) - sign * now.highest, 0.0)
        return -sign * now.tokens[2] * missing

    return law


def _soft_fall(p, now: Instant):
    if now.order != 2:
        return 0.0 * now.x
    g = 1 / jnp.maximum(p.inverse, 1e-12)
    width = p.softness * g
    # softplus: max(-(x'' + g), 0) without its corner
    missing = width * jax.nn.softplus(-(now.highest + g) / width)
    return -now.tokens[2] * missing * (p.inverse > 0)


_FALL = Parameter("inverse", "s^2/x", acceleration=-1, off=0.0, linear=False)
SLACK = (
    EffectSpec(
        "slack", "free fall", (_FALL,), "The load is only pulled, and falls freely where the actuator lets go.",
        "x'' >= -g, inverse = 1 / g", "stiffness", "M", resolved=True, needs_mass=True, law=_free_fall(1.0),
    ),
    EffectSpec(
        "slack", "free fall, hanging", (_FALL,), "A hanging load is only pulled, and falls in the direction of motion.",
        "x'' <= g, inverse = 1 / g", "stiffness", "M", resolved=True, needs_mass=True, law=_free_fall(-1.0),
    ),
    EffectSpec(
        "slack", "free fall, soft", (_FALL, Parameter("softness")), "The load is only pulled, and lets go gradually.",
        "x'' = -g + w log(1 + exp((a + g) / w)), a without it, w = softness g, inverse = 1 / g", "stiffness", "M",
        law=_soft_fall, resolved=True, needs_mass=True,
    ),
)  # fmt: skip

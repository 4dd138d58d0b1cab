"""Add masses the nominal does not have, and loads that let go (port M); a_2 is the nominal's mass, k its stiffness.

added_mass    d a_2 x''
second_mode   f = k kappa (x - z),  z'' = w^2 (x - z) - 2 zeta w z'       a mass carried along by a spring,
              f = p a_2 (w^2 (x - z) + 2 zeta w (x' - z') - x'')          or a part of the mass come loose
slack         x'' >= -g, sharp or soft: a load that is only pulled falls freely once the film lets go
"""

import jax
import jax.numpy as jnp

from .effect import Instant
from .kernels import oscillator
from .spec import EffectSpec, Parameter, Surroundings, starts


def _massive(start):
    """Build starts that are none for a nominal of order 1, which has no mass."""
    return lambda s: start(s) if s.inertia > 0 else []


def mode_starts(s: Surroundings, strength: float, most: float = 20.0, ratios=(0.6, 1.6, 2.5, 4.5)):
    """Start resonances below and above the nominal's, within reach of the sampling; `most`: bound of the strength."""
    high = min(20 * s.omega, 1.5 / s.dt)  # half a turn a sample and more cannot be told from less
    values = [(strength, min(m * s.omega, 0.9 * high), 0.04) for m in ratios]
    return starts(1.0, values, (1e-4, 0.2 * s.omega, 1e-3), (most, high, 0.4))  # with more damping it is a lag


def _loosened(p, now: Instant):
    if now.order < 2:
        return 0.0 * now.x
    slip = now.rates[0] * now.state[1] - now.z[1]  # z' is kept in 1/s, x' in a scale of its own
    # the loose mass accelerates with the pull of its spring, and no longer with the body
    pull = p.omega**2 * (now.x - now.z[0]) + 2 * p.zeta * p.omega * slip
    return p.p * now.coefficients[2] / (now.rates[0] * now.rates[1]) * pull


MODE = Parameter("omega", "rad/s"), Parameter("zeta")

MASSES = (
    EffectSpec(
        "added_mass", "share", (Parameter("d", positive=False, off=0.0),),
        "More (or less) mass moves than the model knows of.", "f = d a_2 x''", "inertia", "M", only=True,
        start=_massive(lambda s: starts(1.0, [0.15, -0.15], -0.8, 5.0)), law=lambda p, now: 0.0 * now.x,
        mass=lambda p, now: p.d * now.coefficients[min(2, now.order)],
    ),
    EffectSpec(
        "second_mode", "attached", (Parameter("kappa", off=0.0), *MODE),
        "A second moving mass resonates beside the first one.",
        "f = k kappa (x - z), z'' = omega^2 (x - z) - 2 zeta omega z'", "inertia", "M", kernel=oscillator(),
        start=lambda s: mode_starts(s, 0.2), law=lambda p, now: now.k * p.kappa * (now.x - now.z[0]),
    ),
    EffectSpec(
        "second_mode", "come loose", (Parameter("p", off=0.0), *MODE),
        "Part of the mass has come loose and hangs on a spring.",
        "f = p a_2 (omega^2 (x - z) + 2 zeta omega (x' - z') - x''), z as of the attached mass", "inertia", "M",
        kernel=oscillator(), law=_loosened,
        start=_massive(lambda s: mode_starts(s, 0.1, 0.9, (1.2, 1.6, 2.5, 4.5))),
        mass=lambda p, now: -p.p * now.coefficients[2] if now.order > 1 else 0.0,
    ),
)  # fmt: skip


def _falling(start):
    """Build starts that are none where there is no mass, or no acceleration that a load could not follow."""
    return lambda s: start(s) if s.inertia > 0 and s.acceleration > 0 else []


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
_fall_starts = _falling(lambda s: starts(1 / s.acceleration, [1.3, 2.5], 0.7, 50))

SLACK = (
    EffectSpec(
        "slack", "free fall", (_FALL,), "The load is only pulled, and falls freely where the actuator lets go.",
        "x'' >= -g, inverse = 1 / g", "stiffness", "M", start=_fall_starts, law=_free_fall(1.0),
    ),
    EffectSpec(
        "slack", "free fall, hanging", (_FALL,), "A hanging load is only pulled, and falls in the direction of motion.",
        "x'' <= g, inverse = 1 / g", "stiffness", "M", start=_fall_starts, law=_free_fall(-1.0),
    ),
    EffectSpec(
        "slack", "free fall, soft", (_FALL, Parameter("softness")), "The load is only pulled, and lets go gradually.",
        "x'' = -g + w log(1 + exp((a + g) / w)), a without it, w = softness g, inverse = 1 / g", "stiffness", "M",
        start=_falling(lambda s: starts(
            (1 / s.acceleration, 1), [(1.3, 0.1), (3.0, 0.1)], (0.7, 0.01), (50, 1)
        )),
        law=_soft_fall,
    ),
)  # fmt: skip

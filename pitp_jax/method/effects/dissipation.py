"""Effects that dissipate energy: drag and dry friction (port C, a force that depends on the velocity).

drag              f = c x' |x'|, or the powers 1.5, 2 and 3 of the speed together
coulomb_friction  f = F_c sgn(x'),  F_c tanh(x' / v_s),  with a rise r exp(-(x' / v_s)^2) at low speed (Stribeck),
                  or F_c z / g,  dz = dx - |dx| z / g  (bristles: Dahl's hysteresis with an invisible play),
                  or mu_avg |f| z / g + mu_dif f (z / g)^2,  f the transmitted force k x + a_2 x''  (gears under load)

Friction is resolved: f brings x' to rest within the step and is at most F_c (orders 1 and 2). Above that, and along a
given motion of order 1, it is regularised at a hundredth of the usual speed.
"""

from functools import partial

import jax.numpy as jnp

from .effect import Instant
from .kernels import dahl
from .spec import EffectSpec, Parameter, signed, strength

_loss = partial(EffectSpec, family="dissipation", port="C")  # a force against the velocity


def dry(now: Instant, level):
    """Return the friction force that stops the motion within the time step, limited to `level`.

    The sign of the velocity would overshoot and chatter at every step at standstill.
    """
    if now.order <= 2 and now.last is None:
        return jnp.clip(now.free / now.reply, -level, level)
    # the force cannot stop x' within a step
    return level * jnp.tanh(100.0 * now.v)


def _smooth(p, now: Instant):
    """Return the friction F_c tanh(x' / v_s) at the end of the time step, or at the x' of a given motion."""
    if now.order > 2 or now.last is not None:
        return p.level * jnp.tanh(now.v / p.speed)
    reply, free = now.reply, now.free
    most, knee = reply * p.level, p.speed + reply * p.level
    # the solution for tanh cut to a ramp, then two Newton steps of  v + most tanh(v / v_s) = free
    v = jnp.where(jnp.abs(free) < knee, free * p.speed / knee, free - jnp.sign(free) * most)
    for _ in range(2):
        t = jnp.tanh(v / p.speed)
        v = v - (v + most * t - free) / (1 + most / p.speed * (1 - t * t))
    return p.level * jnp.tanh(v / p.speed)


def _stribeck(p, now: Instant):
    # at the speed at the start of the step, because half a step later the friction itself would set its level
    speed = (now.state[1] if now.order > 1 else now.v) / p.speed
    return dry(now, p.level * (1 + p.rise * jnp.exp(-(speed**2))))


def _loaded(p, now: Instant):
    g, z = now.k * now.x + now.inertial, now.z[0] / p.give
    return p.mu_avg * jnp.abs(g) * z + p.mu_dif * g * z**2


def _powers(p, now: Instant):
    speed = jnp.abs(now.v) + 1e-30  # not from zero: there a root has no slope
    return now.v * (p.low * jnp.sqrt(speed) + p.c * speed + p.high * speed**2)


_LEVEL = strength("level", "V^2", force=1)

LOSSES = (
    _loss(
        "drag", "quadratic", (strength("c", "V^2 s^2/x^2", speed=-2, force=1),),
        "Damping grows with speed, as for a body in a fluid.", "f = c x' |x'|",
        law=lambda p, now: p.c * now.v * jnp.abs(now.v),
    ),
    _loss(
        "drag", "three powers",
        (strength("low", "V^2 s^1.5/x^1.5", speed=-1.5, force=1), strength("c", "V^2 s^2/x^2", speed=-2, force=1),
         strength("high", "V^2 s^3/x^3", speed=-3, force=1)),
        "Damping grows with a power of the speed between the half and the square.",
        "f = x' (low |x'|^(1/2) + c |x'| + high x'^2)",
        law=_powers,
    ),
    _loss(
        "coulomb_friction", "Coulomb", (_LEVEL,), "Dry friction opposes the motion with the same force at any speed.",
        "f = level sgn(x')", resolved=True,
        law=lambda p, now: dry(now, p.level),
    ),
    _loss(
        "coulomb_friction", "loaded by the spring", (_LEVEL, strength("mu")),
        "Dry friction that grows with the force of the spring, as in a loaded gear.", "f = (level + mu |k x|) sgn(x')",
        resolved=True,
        law=lambda p, now: dry(now, p.level + p.mu * jnp.abs(now.k * now.x)),
    ),
    _loss(
        "coulomb_friction", "loaded by spring and mass", (_LEVEL, strength("mu")),
        "Dry friction that grows with the force of spring and mass together.",
        "f = (level + mu |k x + a_2 x''|) sgn(x'), x'' without the friction", resolved=True,
        law=lambda p, now: dry(now, p.level + p.mu * jnp.abs(now.k * now.x + now.inertial)),
    ),
    _loss(
        "coulomb_friction", "smooth", (_LEVEL, Parameter("speed", "x/s", speed=1)),
        "Dry friction that creeps under a small force.", "f = level tanh(x' / speed)",
        law=_smooth, resolved=True,
    ),
    _loss(
        "coulomb_friction", "Stribeck", (_LEVEL, Parameter("rise"), Parameter("speed", "x/s", speed=1)),
        "Dry friction that is larger at low speed.", "f = level (1 + rise exp(-(x' / speed)^2)) sgn(x')",
        resolved=True, law=_stribeck,
    ),
    _loss(
        "coulomb_friction", "bristles", (_LEVEL, Parameter("give", "x", length=1)),
        "Dry friction whose contact gives a little before it slides (Dahl 1968).",
        "f = level z / give, dz = dx - |dx| z / give", kernel=dahl("give"),
        law=lambda p, now: p.level * now.z[0] / p.give,
    ),
    _loss(
        "coulomb_friction", "bristles under load",
        (
            strength("mu_avg"), signed("mu_dif"),
            Parameter("give", "x", length=1),
        ),
        "Dry friction that grows with the force that a gear transmits, and differs when the load drives it.",
        "f = mu_avg |g| z / give + mu_dif g (z / give)^2, g = k x + a_2 x'', dz = dx - |dx| z / give",
        kernel=dahl("give"), law=_loaded,
    ),
)  # fmt: skip

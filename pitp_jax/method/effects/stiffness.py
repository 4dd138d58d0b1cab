"""Nonlinear springs (port K): forces in addition to the linear spring force of the nominal model.

k = sigma_0 is the stiffness of the nominal model; each force f is added to k x.

stiffening  k c x^3,   k x (1/(1 - (x/L)^2) - 1),   k (c2 x^2 + c3 x^3 + c5 x^5)
softening   -k c x^2,  k (L tanh(x/L) - x),   k ((1 - exp(-b x))/b - x),   k (L sin(x/L) - x),
            k (L (sqrt(1 + 2|x|/L) - 1) sgn(x) - x),   k (c2 x^2 + c3 x^3 + c5 x^5)
mullins     -k d (1 - exp(-m/L)) x,   m = max |x| so far
end_stop    k kappa max(x - x_s, 0),   its mirror image, or both;   d + tau d' in the place of d: it does not throw back

A Gent-like spring fitted by a cubic alone fitted worse than an end stop, so an effect has several forms.
"""

from functools import partial

import jax.numpy as jnp
import numpy as np

from .kernels import FARTHEST
from .spec import EffectSpec, Parameter, signed, strength

_spring = partial(EffectSpec, family="stiffness", port="K")  # a force beside the linear spring


def _gent(p, now):
    square, limit = (p.curvature * now.x) ** 2, 0.97**2  # of the squared length
    inside = square / (1 - jnp.minimum(square, limit))
    # the tangent there, so that a rollout beyond the chain's end meets a steep spring instead of a division by zero
    beyond = limit / (1 - limit) + (square - limit) / (1 - limit) ** 2
    return now.k * now.x * jnp.where(square < limit, inside, beyond)


def _quadratic(p, now):
    # up to where the spring's slope is a tenth of k, because -k c x^2 alone would reverse it
    turn = 0.45 / jnp.maximum(p.c, 1e-9)
    inside = jnp.where(now.x > turn, turn + 0 * now.x, now.x)
    beyond = jnp.maximum(now.x - turn, 0.0)
    return -now.k * (p.c * inside**2 + 0.9 * beyond * (p.c > 0))


def _ratio(r, of, series):
    """Compute of(r) / r - 1, by the given series for small r, because 0/0 is undefined in float32."""
    small = jnp.abs(r) < 0.03
    return jnp.where(small, series, of(r) / jnp.where(small, 1.0, r) - 1)


def _saturating(p, now):
    r = p.curvature * now.x
    # the remaining 3 % of the spring restore it
    return 0.97 * now.k * now.x * _ratio(r, jnp.tanh, -(r**2) / 3)


def _gravity(p, now):
    r = p.curvature * now.x
    return now.k * now.x * _ratio(r, jnp.sin, -(r**2) / 6)


def _exponential(p, now):
    r = jnp.clip(p.b * now.x, -3.0, 6.0)  # far on the hard side the exponential would be too steep for any step
    return now.k * now.x * _ratio(r, lambda r: -jnp.expm1(-r), -r / 2 + r**2 / 6)


def _root(p, now):
    # (sqrt(1 + 2 r) - 1) / r falls from 1 as the root does, and is smooth at x = 0, unlike a bare root
    r = p.curvature * jnp.abs(now.x)
    return now.k * now.x * _ratio(r, lambda r: jnp.sqrt(1 + 2 * r) - 1, -r / 2 + r**2 / 2)


def _by_tangent(p, k, plant):
    """Name a polynomial spring by its tangents at the ends of the motion: stiffening or softening.

    For a motion to one side, the mean of the tangents of c2 x^2 at its ends equals that at its middle, for either sign.
    """
    ends = np.array([plant.bottom, plant.top])
    change = np.polyval([5 * p.c5, 0, 3 * p.c3, 2 * p.c2, 0], ends)
    return "stiffening" if np.abs(ends) @ change > 0 else "softening", "polynomial", (p.c2, p.c3, p.c5)


def _polynomial(name: str, title: str) -> EffectSpec:
    """Build the catalogue entry of a polynomial spring whose terms may have either sign."""
    parameters = tuple(signed(f"c{n}", unit, length=1 - n) for n, unit in ((2, "1/x"), (3, "1/x^2"), (5, "1/x^4")))
    return _spring(
        name, "polynomial", parameters, title, "f = k (c2 x^2 + c3 x^3 + c5 x^5)",
        reported=_by_tangent, law=lambda p, now: now.k * now.x**2 * (p.c2 + now.x * (p.c3 + p.c5 * now.x**2)),
    )  # fmt: skip


def _pushed(p, now, depth, sign):
    """Compute penetration plus damping of an end stop, which pushes and never pulls."""
    return jnp.where(depth > 0, jnp.maximum(depth + sign * p.tau * now.rates[0] * now.v, 0.0), 0.0)


_STOP = (strength("kappa"), Parameter("place", "x", length=1, positive=False))
_STOPS = (*_STOP, Parameter("opposite", "x", length=1, positive=False))
_CURVATURE = (strength("curvature", "1/x", length=-1),)

SPRINGS = (
    _spring(
        "stiffening", "cubic", (strength("c", "1/x^2", length=-2),),
        "The spring gets harder with displacement.", "f = k c x^3",
        law=lambda p, now: now.k * p.c * now.x**3,
    ),
    _spring(
        "stiffening", "limited chain", _CURVATURE, "The spring cannot be stretched further than a length L (Gent).",
        "f = k x (1 / (1 - r^2) - 1), r = |x| / L, curvature = 1 / L",
        law=_gent,
    ),
    _polynomial("stiffening", "The spring gets harder towards the ends of the motion."),
    _spring(
        "softening", "quadratic", (strength("c", "1/x", length=-1),),
        "The spring gets softer with displacement.",
        "f = -k c x^2, no further than where the spring's slope is a tenth of k",
        law=_quadratic,
    ),
    _polynomial("softening", "The spring gets softer towards the ends of the motion."),
    _spring(
        "softening", "saturating", _CURVATURE, "The spring's force stops growing at large displacements.",
        "f = 0.97 k (L tanh(x / L) - x), curvature = 1 / L",
        law=_saturating,
    ),
    _spring(
        "softening", "exponential", (strength("b", "1/x", length=-1),),
        "The spring gets softer in one direction and harder in the other.",
        "f = k ((1 - exp(-b x)) / b - x)",
        law=_exponential,
    ),
    _spring(
        "softening", "gravity", _CURVATURE, "The spring is a weight on an arm, whose torque grows less than the angle.",
        "f = k (L sin(x / L) - x), curvature = 1 / L",
        law=_gravity,
    ),
    _spring(
        "softening", "weight on an arm",
        (signed("kappa"), Parameter("curvature", "1/x", length=-1, fixed=True)),
        "A weight on an arm acts in addition to the spring; its torque grows less than the angle.",
        "f = k kappa L sin(x / L), L = 1 / curvature = 1 rad", stiffens=True,
        law=lambda p, now: p.kappa * (_gravity(p, now) + now.k * now.x),
    ),
    _spring(
        "softening", "root", _CURVATURE, "The spring's force grows as the root of a large displacement.",
        "f = k (L (sqrt(1 + 2 |x| / L) - 1) sgn(x) - x), curvature = 1 / L",
        law=_root,
    ),
    _spring(
        "mullins", "exponential", (strength("d"), Parameter("length", "x", length=1)),
        "The spring is softer after a larger stretch (Mullins effect).",
        "f = -k d (1 - exp(-m / L)) x, m the largest |x| so far", kernel=FARTHEST,
        law=lambda p, now: now.k * p.d * jnp.expm1(-now.z[0] / p.length) * now.x,
    ),
    _spring(
        "end_stop", "above", _STOP, "Above a displacement the motion runs into a stiff stop.",
        "f = k kappa max(x - place, 0)",
        law=lambda p, now: now.k * p.kappa * jnp.maximum(now.x - p.place, 0.0),
    ),
    _spring(
        "end_stop", "below", _STOP, "Below a displacement the motion runs into a stiff stop.",
        "f = -k kappa max(-x - place, 0)",
        law=lambda p, now: -now.k * p.kappa * jnp.maximum(-now.x - p.place, 0.0),
    ),
    _spring(
        "end_stop", "each side", _STOPS,
        "On each side, at its own displacement, the motion runs into a stiff stop.",
        "f = k kappa (max(x - place, 0) - max(-x - opposite, 0))",
        law=lambda p, now: now.k * p.kappa * (now.x - jnp.clip(now.x, -p.opposite, p.place)),
    ),
    _spring(
        "end_stop", "each side, damped", (*_STOPS, Parameter("tau", "s")),
        "On each side the motion runs into something stiff that does not throw it back.",
        "f = k kappa max(d + tau d', 0) where d = x - place > 0, and from the other side where d = -x - opposite > 0",
        law=lambda p, now: (
            now.k * p.kappa * (_pushed(p, now, now.x - p.place, 1) - _pushed(p, now, -now.x - p.opposite, -1))
        ),
    ),
)  # fmt: skip

"""Effects that change the film's force behind the square of the voltage (port SQ).

stretch_coupling        F (1 + b x),  F exp(b x): never a pushing force
dielectric_saturation   F / (1 + |F| / F_s)
"""

from collections.abc import Callable

import jax.numpy as jnp

from .spec import EffectSpec, nonlinear, signed


def _stretched(form: str, title: str, equation: str, factor: Callable) -> EffectSpec:
    """Build a catalogue entry: F times a positive factor that depends on x; the inverse divides by it."""
    return EffectSpec(
        "stretch_coupling", form, (signed("b", "1/x", length=-1),), title, equation,
        "coupling", "SQ",
        law=lambda p, force, x: force * factor(p.b * x), inverse=lambda p, force, x: force / factor(p.b * x),
    )  # fmt: skip


def _unsaturated(p, force, x):
    """Return the film's force for a wanted force; infinite if no electric field can produce it."""
    remains = 1 - p.inverse * jnp.abs(force)  # of the limit F_s, as a fraction of it
    inside = force / jnp.where(remains > 0, remains, 1.0)
    return jnp.where(remains > 0, inside, jnp.sign(force) * jnp.inf)


COUPLING = (
    _stretched(
        "linear", "The film's force depends on how far it is stretched.", "F (1 + b x)",
        # large, because an actuator that snaps in one record has a range that other records never reach
        lambda r: jnp.maximum(1 + r, 0.05),
    ),
    _stretched(
        "exponential", "Zipping electrodes pull less and less, or more and more, as they move.", "F exp(b x)",
        lambda r: jnp.exp(jnp.clip(r, -8.0, 8.0)),
    ),
    EffectSpec(
        "dielectric_saturation", "rational", (nonlinear("inverse", "1/V^2", force=-1),),
        "At high field the force grows less than with the square of "
        "the voltage.",
        "F / (1 + |F| / F_s), inverse = 1 / F_s", "coupling", "SQ",
        law=lambda p, force, x: force / (1 + p.inverse * jnp.abs(force)), inverse=_unsaturated,
    ),
)  # fmt: skip

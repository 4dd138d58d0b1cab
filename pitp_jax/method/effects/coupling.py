"""Effects that change the film's force behind the square of the voltage (port SQ).

stretch_coupling        F (1 + b x),  F exp(b x): never a pushing force
dielectric_saturation   F / (1 + (|F| / F_s)^n)^(1/n),  n = 1 (rational) or 2 (sharp)
"""

from collections.abc import Callable

import jax.numpy as jnp

from .spec import EffectSpec, signed, strength


def _stretched(form: str, title: str, equation: str, factor: Callable) -> EffectSpec:
    """Build a catalogue entry: F times a positive factor that depends on x; the inverse divides by it."""
    return EffectSpec(
        "stretch_coupling", form, (signed("b", "1/x", length=-1),), title, equation,
        "coupling", "SQ",
        law=lambda p, force, x: force * factor(p.b * x), inverse=lambda p, force, x: force / factor(p.b * x),
    )  # fmt: skip


def _saturating(form: str, title: str, equation: str, n: int, root: Callable) -> EffectSpec:
    """Build a catalogue entry: a force below F_s, with the power n and its root; no field makes a force beyond F_s."""

    def unsaturated(p, force, x):
        remains = 1 - (p.inverse * jnp.abs(force)) ** n
        return jnp.where(remains > 0, force / root(jnp.where(remains > 0, remains, 1.0)), jnp.sign(force) * jnp.inf)

    return EffectSpec(
        "dielectric_saturation", form, (strength("inverse", "1/V^2", force=-1),), title,
        f"{equation}, inverse = 1 / F_s", "coupling", "SQ",
        law=lambda p, force, x: force / root(1 + (p.inverse * jnp.abs(force)) ** n), inverse=unsaturated,
    )  # fmt: skip


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
    _saturating(
        "rational", "At high field the force grows less than with the square of the voltage.", "F / (1 + |F| / F_s)",
        1, lambda v: v,
    ),
    _saturating(
        "sharp", "The force grows with the square of the voltage up to near its limit.", "F / sqrt(1 + (F / F_s)^2)",
        2, jnp.sqrt,
    ),
)  # fmt: skip

"""The longest way through a diagnosis: effects it does not know and a refit, so pairs in vain, and the other split."""

import jax.numpy as jnp

from pitp_jax._effects.amplifier import VoltageClip
from pitp_jax._effects.electrode import ChargeLeak
from pitp_jax._effects.hysteresis import PlayHysteresis

from .diagnose import diagnosed


def measure(seconds: float) -> dict:
    """One diagnosis, compilation included."""
    parts = (
        PlayHysteresis(jnp.asarray(0.4), jnp.asarray(0.3)),
        VoltageClip(jnp.asarray(1 / 450.0)),
        ChargeLeak(jnp.asarray(0.4), jnp.asarray(0.2)),
    )
    return diagnosed(parts, refit_nominal=True, exclude=[p.name for p in parts])

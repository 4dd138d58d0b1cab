"""The longest way through a diagnosis: effects it does not know and a refit, so pairs in vain, and the other split."""

from pitp_jax.method.effects import effect

from .diagnose import diagnosed


def measure(seconds: float) -> dict:
    """One diagnosis, compilation included."""
    parts = (
        effect("hysteresis", kappa=0.4, width=0.3),
        effect("voltage_clip", inverse=1 / 450.0),
        effect("charge_leak", kappa=0.4, tau=0.2),
    )
    return diagnosed(parts, refit_nominal=True, exclude=[p.name for p in parts])

"""The longest way through a diagnosis: effects it does not know and a refit, so pairs in vain, and the other split."""

import time
from dataclasses import replace

import jax.numpy as jnp

import pitp_jax as pitp
from pitp_jax._effects.amplifier import VoltageClip
from pitp_jax._effects.electrode import ChargeLeak
from pitp_jax._effects.hysteresis import PlayHysteresis

from ..clock import summary
from ..subjects import nominal
from .diagnose import RECORDS, STEPS, records


def measure(seconds: float) -> dict:
    """One diagnosis, compilation included."""
    model = nominal()
    parts = (
        PlayHysteresis(jnp.asarray(0.4), jnp.asarray(0.3)),
        VoltageClip(jnp.asarray(1 / 450.0)),
        ChargeLeak(jnp.asarray(0.4), jnp.asarray(0.2)),
    )
    real = records(replace(model, effects=parts))
    began = time.perf_counter()
    finding = pitp.diagnose(model, real, refit_nominal=True, exclude=[p.name for p in parts])
    taken = time.perf_counter() - began
    told = {"records": RECORDS, "samples": RECORDS * STEPS, "verdict": f"{finding.verdict} {finding.effects}"}
    return summary([taken]) | {"peer": None, "peer_median_ms": None, "ratio": None} | told

"""Diagnosis of a virtual cone's sines against its identified linear model; nothing else does the same."""

import time

import pitp_jax as pitp
from pitp_jax import _demo

from ..clock import Skipped, summary


def measure(seconds: float) -> dict:
    """One diagnosis of eight of the quick protocol's training records, compilation included."""
    diagnose = getattr(pitp, "diagnose", None)
    if not callable(diagnose):
        raise Skipped("pitp_jax.diagnose is not available")
    actuator = pitp.plant("cone100")
    parts = (_demo.measure(actuator, _demo.excitations("cone100", part, True)) for part in ("sweep", "train"))
    (swept,), records = parts
    nominal = pitp.identify([swept], order=2).model
    records = records[:: max(len(records) // 8, 1)][:8]
    began = time.perf_counter()
    finding = diagnose(nominal, records)
    return {**summary([time.perf_counter() - began]), "peer": None, "peer_median_ms": None, "ratio": None,
            "records": len(records), "verdict": str(getattr(finding, "verdict", finding))[:80]}  # fmt: skip

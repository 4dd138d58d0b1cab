"""Diagnosis of eight records of 10,000 samples whose film charges late, against a nominal without. No peer does it."""

import time
from dataclasses import replace

import numpy as np

import pitp_jax as pitp
from pitp_jax.method.effects import effect

from ..clock import summary
from ..sizes import size
from ..subjects import DT, nominal, voltages

RECORDS, STEPS = size((8, 10_000), (4, 1000))
NOISE = 2e-6  # m


def records(model) -> tuple[pitp.Record, ...]:
    """Free runs of a model from rest, 1 to 4 Hz, with sensor noise."""
    rng, time_s = np.random.default_rng(0), np.arange(STEPS) * DT
    bare = [
        pitp.Record(f"sine {k}", time_s, u.astype(float), np.zeros(STEPS))
        for k, u in enumerate(voltages(RECORDS, STEPS))
    ]
    runs = pitp.predict(model, bare)
    return tuple(
        replace(r, displacement=p.displacement + NOISE * rng.standard_normal(STEPS))
        for r, p in zip(bare, runs, strict=True)
    )


def measure(seconds: float) -> dict:
    """One diagnosis, compilation included."""
    return diagnosed((effect("electrode_rc", tau=0.01),))


def diagnosed(effects: tuple, **how) -> dict:
    """The row of one diagnosis of records that have these effects; `how`: options of `diagnose`."""
    model = nominal()
    real = records(replace(model, effects=effects))
    began = time.perf_counter()
    finding = pitp.diagnose(model, real, **how)
    taken = time.perf_counter() - began
    told = {"records": RECORDS, "samples": RECORDS * STEPS, "verdict": f"{finding.verdict} {finding.effects}"}
    told |= {"lane_steps": finding.lane_steps}  # samples x steps a sample x simulations
    return summary([taken]) | {"peer": None, "peer_median_ms": None, "ratio": None} | told

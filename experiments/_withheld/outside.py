"""Disturbances and sensor faults that no name of the catalogue covers: the verdict on them must be `unknown`.

    hum            y + p sin(2 pi 50 t + phi), mains on the sensor          wander    y + p (random walk from 0)
    pumping        force p x cos(w t), w = 0.06 to 0.2 w0: a stiffness that something outside moves
    tremor         force p z, z'' - 0.5 (1 - z^2) w z' + w^2 z = 0
    impulses       force p (sum of half sines 0.6/w0 long, at random times)
    dropouts       u (1 - p) for some 2/w0, at random times

`tremor` swings by itself (van der Pol), at 0.45 to 0.8 of the resonance, from another phase in every record.
"""

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from .form import Form


def _hum(rng, time, stats):
    return {"add": np.sin(2.0 * np.pi * 50.0 * time + rng.uniform(0.0, 2.0 * np.pi))}


def _wander(rng, time, stats):
    walk = np.cumsum(rng.standard_normal(len(time)))
    return {"add": (walk - walk[0]) / np.sqrt(stats.length / (time[1] - time[0]))}


def _tremor(rng, time, stats):
    w = 2.0 * np.pi * stats.f0 * rng.uniform(0.45, 0.8)
    start, ts = (rng.uniform(-2.0, 2.0), rng.uniform(-2.0, 2.0)), w * (time - time[0])
    path = solve_ivp(
        lambda t, z: (z[1], 0.5 * (1.0 - z[0] ** 2) * z[1] - z[0]), (0.0, ts[-1]), start, t_eval=ts, rtol=1e-8
    )
    return {"push": path.y[0]}


def _pump(rng, stats):
    return {"w": 2.0 * np.pi * stats.f0 * rng.uniform(0.06, 0.2), "phi": rng.uniform(0.0, 2.0 * np.pi)}


def _bursts(rng, time, stats, shape, width, per_record):
    """Non-overlapping or not, `shape` over [0, 1) at random times, `width` in 1/w0."""
    seconds = width / (2.0 * np.pi * stats.f0)
    begins = rng.uniform(time[0], time[-1], max(3, rng.poisson(per_record)))
    phase = (time[None] - begins[:, None]) / seconds
    signs = rng.choice([-1.0, 1.0], len(begins)) * rng.uniform(0.5, 1.0, len(begins))
    return np.where((phase >= 0) & (phase < 1), shape(phase), 0.0), signs


def _impulses(rng, time, stats):
    bursts, signs = _bursts(rng, time, stats, lambda s: np.sin(np.pi * s), 0.6, 15)
    return {"push": signs @ bursts}


def _dropouts(rng, time, stats):
    bursts, _ = _bursts(rng, time, stats, np.ones_like, 2.0, 8)
    return {"gate": bursts.max(axis=0)}


OUTSIDE = {
    "hum": (Form("mains", (1e-3, 1.0), arrays=_hum),),
    "wander": (Form("random_walk", (1e-3, 2.0), arrays=_wander),),
    "pumping": (
        Form("cosine", (1e-2, 0.9), draw=_pump, force=lambda p, c, x, v, s, t: p * x * jnp.cos(c["w"] * t + c["phi"])),
    ),
    "tremor": (Form("van_der_pol", (1e-3, 2.0), arrays=_tremor),),
    "impulses": (Form("half_sines", (1e-2, 30.0), arrays=_impulses),),
    "dropouts": (Form("amplifier_trips", (0.02, 1.0), arrays=_dropouts),),
}

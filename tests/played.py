"""A nominal, its records under seven drives, and a smaller catalogue: what the tests of the diagnosis share."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import pitp_jax as pitp
from pitp_jax.method.effects import CATALOGUE
from pitp_jax.method.simulate import ports
from pitp_jax.method.simulate.decoder import rest_state, rollout

HZ, DT, SAMPLES = 5.0, 4e-3, 1500
TIME = np.arange(SAMPLES) * DT
NOISE = 2e-6  # of a range near 2e-3
KEPT = "creep delay drag electrode_rc second_mode sensor_gain sensor_lag stiffening voltage_clip voltage_offset".split()
FEW = sorted({c.name for c in CATALOGUE} - set(KEPT))  # excluded where these will do, in half the time


def nominal_of(linear):
    """Of one mode, with the limits of a rig."""
    model = linear(hz=HZ, dt=DT)
    return replace(model, domain=replace(model.domain, voltage_range=(0.0, 1e3), slew=1e6))


def drives():
    """A sweep, four sines, a multisine and steps, from rest."""
    rng = np.random.default_rng(3)
    sweep = np.sin(2 * np.pi * (0.3 + 0.9 * TIME) * TIME)
    many = sum(np.sin(2 * np.pi * f * TIME + rng.uniform(0, 6)) for f in (0.7, 1.3, 2.9, 4.3, 6.1)) / 2.5
    found = {"sweep": sweep, "multisine": many}
    found |= {f"sine{k}": np.sin(2 * np.pi * f * TIME) for k, f in enumerate((0.5, 1.1, 2.2, 3.6))}
    steps = np.repeat([0.2, 0.9, -0.5, 0.6, -0.9], SAMPLES // 5)
    return {k: 600 + 350 * v for k, v in (found | {"steps": steps}).items()}


@eqx.filter_jit  # otherwise every drive would compile the loop again
def run(model, volts):
    """Scaled readings of the model from rest."""
    return ports.readings(model, rollout(model, volts, DT, rest_state(model)))


def play(model, noise=NOISE, extra=0.0, seed=0, louder=(), inputs=None):
    """Records of a model, one after the other on the session's clock.

    `louder`: drives at 1.5 times the voltage; `inputs`: other ones, V by name.
    """
    rng, found = np.random.default_rng(seed), []
    for k, (name, u) in enumerate((inputs or drives()).items()):
        u = 1.5 * u if name in louder else u
        x = np.asarray(run(model, jnp.asarray(u, jnp.float32)), float) * model.scales.state[0]
        x = x + noise * rng.standard_normal(SAMPLES)
        found.append(pitp.Record(name, TIME + 10 * k, u, x + extra * np.sin(2 * np.pi * 17.3 * TIME + k)))
    return found

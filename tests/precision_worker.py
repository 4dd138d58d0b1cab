"""Run by test_precision.py under JAX's x64: what the public functions answer, as .npz at argv[1]."""

import sys
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from played import FEW

import pitp_jax as pitp
from pitp_jax.method.effects import effect
from pitp_jax.method.simulate.decoder import rollout

DT, SAMPLES, NOISE = 2e-3, 1500, 2e-6
TIME = np.arange(SAMPLES) * DT
SETTINGS = pitp.Settings(width=2, memories=2, epochs=5, stages=1, batch=256, refine_steps=8)


def drives():
    """A sweep, then sines."""
    raised = [(1 - np.cos(2 * np.pi * hz * TIME)) for hz in (1.0, 2.0, 3.2)]
    return [1500 * (1 - np.cos(2 * np.pi * (0.2 + 2 * TIME) * TIME)), *(2000 * v for v in raised)]


def dtypes(model):
    """Of all its numbers but the scales, which are NumPy's."""
    return sorted(
        {str(a.dtype) for a in jax.tree.leaves(eqx.filter(model, eqx.is_inexact_array)) if isinstance(a, jax.Array)}
    )


def main(place):
    """Identify, train, predict, invert, diagnose."""
    rng = np.random.default_rng(0)
    plant = pitp.plant("cone100")
    measured = []
    for k, (u, x) in enumerate(zip(drives(), pitp.simulate(plant, TIME, np.stack(drives())), strict=True)):
        measured.append(pitp.Record(f"r{k}", TIME, u, x + NOISE * rng.standard_normal(SAMPLES)))
    nominal = pitp.identify(measured[:1], order=2).model
    model = pitp.train(nominal, measured[:3], settings=SETTINGS, key=jax.random.key(0)).model
    record = measured[3]
    later = replace(record, time=TIME[400:], voltage=record.voltage[400:], displacement=record.displacement[400:])
    step, mesh = record.time[1] - record.time[0], pitp.records_mesh()  # a float64 of numpy's, as people have it
    start = np.asarray(pitp.rest_state(model))[None]
    late = replace(nominal, effects=(effect("electrode_rc", tau=0.03),))
    moved = pitp.predict(late, measured)
    real = [
        replace(r, displacement=p.displacement + NOISE * rng.standard_normal(SAMPLES))
        for r, p in zip(measured, moved, strict=True)
    ]
    found = pitp.diagnose(nominal, real, exclude=FEW)
    predicted = pitp.predict(model, [record])[0].displacement

    def rig(states):
        return model.output.to_rig(np.asarray(states, np.float64)[:, 0] * model.scales.state[0])

    np.savez(
        place,
        measured=record.displacement,
        predicted=predicted,
        moving=pitp.predict(model, [later])[0].displacement,
        nominal=pitp.predict(nominal, [record])[0].displacement,
        rolled=rig(rollout(model, jnp.asarray(record.voltage), step, start[0])),
        sharded=rig(pitp.sharded_rollout(model, record.voltage[None], step, start, mesh)[0]),
        self_check=pitp.feedforward(model, pitp.Target(TIME, predicted)).self_check_e_rms_percent,
        dtypes=dtypes((model, found.model)),
        effects=found.effects,
    )


if __name__ == "__main__":
    main(sys.argv[1])

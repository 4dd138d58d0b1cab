"""The sensor's offset of a model where no recording shows it at rest."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from pitp_jax import Record, predict
from pitp_jax.method.effects import lookup
from pitp_jax.method.fit.sensor_offset import with_offset
from pitp_jax.method.simulate.decoder import rest_state
from pitp_jax.method.simulate.model_runs import model_runs
from pitp_jax.method.train.errors import judge


def test_an_offset_that_no_recording_shows_is_that_of_the_free_runs(linear):
    """The planted 0.4 mm, where a model has 0.1 mm; a recording that begins at rest shows it, and nothing changes."""
    time = np.arange(4000) / 500
    plant = linear(hz=5.0, dt=2e-3, damping=0.2)
    plant = replace(plant, effects=(lookup("stiffening", "cubic")(jnp.asarray(0.3)),))
    volts = 1000 + 600 * np.sin(2 * np.pi * 1.3 * time) + 300 * np.sin(2 * np.pi * 3.1 * time)
    volts = np.where(time < 0.5, 0.0, volts)
    x = model_runs(plant, volts[None], 2e-3, np.asarray(rest_state(plant))[None])[1][0] * plant.scales.state[0]
    wrong = replace(plant, output=replace(plant.output, offset=1e-4))
    moving, whole = (Record("r", time[k:], volts[k:], x[k:] + 4e-4) for k in (1003, 0))
    assert [p.begins for p in predict(wrong, [moving]) + predict(wrong, [whole])] == ["moving", "rest"]
    np.testing.assert_allclose(with_offset(wrong, [moving]).output.offset, 4e-4, atol=2e-6)
    assert with_offset(wrong, [whole]).output.offset == 1e-4
    trained = judge(wrong, [moving])(wrong)
    np.testing.assert_allclose(trained.model.output.offset, 4e-4, atol=2e-6)
    assert trained.trained[0] < 0.1 < trained.nominal[0]

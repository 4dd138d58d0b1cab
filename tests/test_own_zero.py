"""A record's own zero, direction and beginning: read off by predict, taken out by diagnosis and training."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from test_rest import NOISE, TIME, planted

import pitp_jax as pitp
from pitp_jax.method.diagnose.data import build_case
from pitp_jax.method.fit.forward_sensitivity import Runs, run_errors
from pitp_jax.method.simulate.prediction import begin

DRIVES = [1000 + 800 * np.sin(2 * np.pi * f * TIME + f) for f in (2.0, 3.3, 5.1)]


def records(kind, *, zero=1e-3, direction=1):
    return [planted(kind, k, voltage=u, zero=zero, direction=direction) for k, u in enumerate(DRIVES)]


@pytest.fixture(scope="module")
def model():
    return pitp.identify(records("rest"), order=2, hold="foh").model


@pytest.mark.parametrize("kind", ["rest", "held", "moving"])
@pytest.mark.parametrize(("zero", "direction"), [(1e-3, 1), (-4e-3, 1), (2e-3, -1)])
def test_predict_reads_zero_and_direction_from_the_beginning(model, kind, zero, direction):
    """A motion's zero is not told by its first 50 samples: the model's is taken."""
    if kind == "moving" and (zero, direction) != (1e-3, 1):
        pytest.skip("unknown from the beginning alone")
    given = records(kind, zero=zero, direction=direction)
    for record, run in zip(given, pitp.predict(model, given), strict=True):
        assert (run.begins, run.direction) == (kind, direction)
        assert abs(run.zero - zero) < 5 * min(run.zero_stderr, NOISE)
        error = (run.displacement - record.displacement)[run.scored]
        assert np.sqrt(np.mean(error**2)) < 1.5 * NOISE


def test_a_case_has_no_zero_and_no_direction(model):
    plain, moved = (records("rest", **how) for how in ({}, {"zero": -4e-3, "direction": -1}))
    first, second = ([s.output for s in build_case(model, rs).series] for rs in (plain, moved))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_allclose(b, a, atol=0.02 * (np.nanmax(a) - np.nanmin(a)))


def test_a_zero_of_its_own_is_projected_out_of_a_free_run(model):
    given = records("held")
    start, *_ = begin(model, given)
    voltage = jnp.asarray(np.stack([r.voltage for r in given]), jnp.float32)
    target = np.stack([model.output.to_model(r.displacement) / model.scales.state[0] for r in given])
    runs = Runs(start, voltage, jnp.asarray(target, jnp.float32), jnp.ones(voltage.shape), jnp.ones(3))
    moved = replace(runs, target=runs.target + 0.7)
    here, there = (np.asarray(run_errors(model, r, given[0].dt, 4)) for r in (runs, moved))
    np.testing.assert_allclose(there, here, atol=1e-4)
    kept = np.asarray(run_errors(model, replace(moved, own_zero=jnp.zeros(3)), given[0].dt, 4))
    assert np.abs(kept - here).min() > 1.0

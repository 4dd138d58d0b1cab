"""Sample by sample against whole records: the decoder exactly, the inverse up to how V' is taken."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pitp_jax import BadInput, Record, decoder_step, inverse_step, predict, rest_state, restore_step
from pitp_jax.method.invert.equation import invert_path
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.memory import ElapsedTime
from pitp_jax.method.numerics.spline_derivative import derivatives
from pitp_jax.method.simulate.decoder import rollout

DT = 1e-3


@pytest.fixture(scope="module")
def lagging(nonlinear):
    return eqx.tree_at(lambda m: m.drive, nonlinear(2), ElectrodeLag(jnp.asarray(np.log(4e-3), jnp.float32)))


def play(compiled, inputs):
    carry, out = compiled.carry, []
    for row in np.asarray(inputs, np.float32).reshape(len(inputs), -1):
        carry, value = compiled.run(carry, row)
        out.append(float(value))
    return np.array(out)


def drive(count=300):
    t = np.arange(count) * DT
    return 500 * np.sin(9 * t) ** 2 * (1 + 0.2 * np.sin(70 * t))


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"hold": "zoh", "substeps": 2}])
def test_decoder_steps_are_the_rollout(nonlinear, options):
    model = nonlinear(2, offset=1e-3, polarity=-1.0, **options)
    u = drive()
    truth = rollout(model, jnp.asarray(u, jnp.float32), DT, rest_state(model))[:, 0] * model.scales.state[0]
    found = play(decoder_step(model, DT), u[1:])
    np.testing.assert_allclose(found, truth[1:], rtol=0, atol=2e-6 * np.abs(truth).max())


def test_decoder_with_an_electrode(lagging):
    u = drive()
    truth = rollout(lagging, jnp.asarray(u, jnp.float32), DT, rest_state(lagging))[:, 0] * lagging.scales.state[0]
    found = play(decoder_step(lagging, DT), u[1:])
    np.testing.assert_allclose(found, truth[1:], rtol=0, atol=1e-5 * np.abs(truth).max())


def test_a_step_coarser_than_the_models_has_substeps(linear):
    """One Runge-Kutta step of 5 rad would leave every range."""
    model, dt = linear(2, 20.0, dt=DT), 40 * DT
    u = 500 * np.sin(2 * np.pi * 0.3 * dt * np.arange(100)) ** 2
    found = play(decoder_step(model, dt), u[1:])
    truth = predict(model, [Record("slow", dt * np.arange(100), u, np.append(0.0, found))])[0].displacement
    assert np.ptp(found) > 0
    np.testing.assert_allclose(found, truth[1:], rtol=0, atol=1e-5 * np.ptp(truth))


def wanted(dt, count):
    t = np.arange(count) * dt
    return derivatives(3e-4 * np.sin(2.5 * t) ** 4, dt, 2)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["fading", "elapsed", "ringing"])
def test_inverse_steps_are_the_path(nonlinear, kind):
    if kind == "elapsed":
        model = eqx.tree_at(lambda m: m.memory, nonlinear(2, tau=(0.1,)), ElapsedTime(2.0))
    else:
        model = nonlinear(2, ring=(60.0, 0.1) if kind == "ringing" else ())
    x = wanted(DT, 300)
    truth = np.asarray(invert_path(model, jnp.asarray(x / np.asarray(model.scales.state), jnp.float32), DT)[1])
    found = play(inverse_step(model, DT), x)
    np.testing.assert_allclose(found**2, truth**2, rtol=0, atol=2e-5 * truth.max() ** 2)


@pytest.mark.slow
def test_inverse_through_an_electrode_is_of_second_order(lagging):
    """Halving dt: at least 3 times nearer to the central difference of 4th order."""
    errors = []
    for dt, count in ((4e-3, 150), (2e-3, 300)):
        x = wanted(dt, count)
        truth = np.asarray(invert_path(lagging, jnp.asarray(x / np.asarray(lagging.scales.state), jnp.float32), dt)[1])
        inside = slice(4 * count // 5, count - 3)  # F > 0 since long: the root has a corner at 0
        errors.append(np.abs(play(inverse_step(lagging, dt), x) - truth)[inside].max() / truth.max())
    assert errors[1] < errors[0] / 3
    assert 1e-6 < errors[0] < 1e-3


def test_bytes_run_without_the_model(lagging):
    pytest.importorskip("flatbuffers")
    made = decoder_step(lagging, DT)
    u = drive(50)[1:]
    again = replace(made, run=restore_step(bytes(made.exported.serialize())))
    np.testing.assert_array_equal(play(again, u), play(made, u))


def test_what_needs_the_future_is_refused(nonlinear):
    with pytest.raises(BadInput, match="hold 'bandlimited' has no real-time step"):
        decoder_step(nonlinear(2, hold="bandlimited"), DT)
    with pytest.raises(BadInput, match="effects"):
        inverse_step(eqx.tree_at(lambda m: m.effects, nonlinear(2), (1.0,)), DT)


@pytest.mark.parametrize("make", [decoder_step, inverse_step])
def test_no_interval_is_refused(nonlinear, make):
    with pytest.raises(BadInput, match="dt must be positive"):
        make(nonlinear(2), 0.0)


@pytest.mark.parametrize("make", [inverse_step, decoder_step])
def test_a_lost_sample_is_lost_alone(lagging, make):
    """Nan out, and the next sample follows on the last sound one."""
    compiled = make(lagging, DT)
    rows = np.abs(np.random.default_rng(0).standard_normal((5, compiled.inputs))).astype(np.float32) * 1e-4
    gap = np.insert(rows, 2, np.nan, axis=0)
    found = play(compiled, gap)
    assert np.isnan(found[2])
    np.testing.assert_array_equal(np.delete(found, 2), play(compiled, rows))


@pytest.mark.slow
@pytest.mark.parametrize("make", [inverse_step, decoder_step])
@pytest.mark.parametrize("made_wide", [False, True])
def test_a_step_runs_with_and_without_64_bit_numbers(lagging, double, make, made_wide):
    """Wherever it was made, with a model of either precision, and whatever its caller has enabled."""
    with jax.enable_x64(made_wide):
        compiled = make(double(lagging) if made_wide else lagging, DT)
    row = np.full(compiled.inputs, 1e-4)
    truth = compiled.run(compiled.carry, row.astype(np.float32))
    for wide in (False, True):
        with jax.enable_x64(wide):
            carry, value = compiled.run(*compiled.run(compiled.carry, row)[:1], row)
            again = compiled.run(compiled.carry, row)
        assert carry.dtype == value.dtype == np.float32
        for one, other in zip(again, truth, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-6)


def test_bytes_of_something_else_are_refused():
    with pytest.raises(BadInput, match="do not hold a step"):
        restore_step(b"a model file")

"""Adapt: planted factors come back within their intervals; what is the sensor's, or nobody's, changes nothing."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter

import pitp_jax as pitp
from pitp_jax.application.plan.waveforms import smooth_step
from pitp_jax.method.adapt.evidence import covariance, directions, select, subsets
from pitp_jax.method.fit.factors import adapted, factors_of
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.encoder import AdaptedEncoder, CompactEncoder
from pitp_jax.method.model.fitted import Fitted, model_of
from pitp_jax.method.model.memory import FadingMemory
from pitp_jax.method.model.origin import Origin
from pitp_jax.method.simulate.batched_rollout import fast_rollout
from pitp_jax.method.simulate.decoder import rest_state, rollout_batch

TIME, U = pitp.excitation.multisine((0.3, 8.0), 4.0, 1e3, 500.0, 600.0, seed=3, rise=0.3)


def measured(model, u=U, *, noise=2e-6, zero=0.0, direction=1.0, seed=0, start=None):
    """What a sensor reads of a model under a voltage."""
    start = rest_state(model) if start is None else start
    x = np.asarray(rollout_batch(model, jnp.asarray(u, jnp.float32)[None], 1e-3, start[None])[0, :, 0], float)
    y = direction * x * model.scales.state[0] + zero + noise * np.random.default_rng(seed).standard_normal(len(x))
    return pitp.Record("day", TIME[: len(u)], u, y)


def with_factors(model, **by):
    """The model with its numbers moved."""
    model = model_of(model)
    factors = factors_of(model, 4.0, 0.0)
    z = np.array([np.log(by[n]) if n in by else 0.0 for n in factors.names])
    return adapted(model, factors, z, 1e-3)


@pytest.fixture
def creeping(actuator):
    """As if trained to 0.1 % of range: 30 % of the fresh spring gives way in 0.1 and 0.6 s, and it hardens."""
    encoder = CompactEncoder(2, 2, width=2, key=jax.random.key(0))
    poly = jnp.zeros((2, 3)).at[0, 1].set(0.02)
    encoder = eqx.tree_at(lambda e: (e.fading, e.spring_poly), encoder, (jnp.zeros((2, 3)).at[:, 0].set(-0.15), poly))
    model = eqx.tree_at(lambda m: m.encoder, actuator, encoder)
    model = replace(model, memory=FadingMemory(jnp.log(jnp.asarray([0.1, 0.6]))))
    return Fitted(model, Origin(level=0.1))


def test_a_planted_factor_comes_back_within_its_interval(actuator):
    found = pitp.adapt(actuator, measured(with_factors(actuator, stiffness=0.92)))
    low, high = found.changed["stiffness"].ci95
    assert found.verdict == "adapted" and set(found.changed) == {"stiffness"}
    assert low <= 0.92 <= high and high - low < 0.03
    assert found.heldout and found.after < 0.1 * found.before
    ratio = found.model.physical_coefficients / actuator.physical_coefficients
    np.testing.assert_allclose(ratio, [found.changed["stiffness"].factor, 1.0, 1.0], rtol=1e-6)


def test_all_coefficients_alike_are_a_gain_and_each_on_its_own_is_not(actuator):
    alike = pitp.adapt(actuator, measured(with_factors(actuator, stiffness=1.1, damping=1.1, inertia=1.1)))
    low, high = alike.changed["gain"].ci95
    assert set(alike.changed) == {"gain"} and low <= 1 / 1.1 <= high
    other = with_factors(actuator, stiffness=1.07, damping=1.3, inertia=0.85)
    found = pitp.adapt(actuator, measured(other))
    assert set(found.changed) == {"stiffness", "damping", "inertia"}
    for name, truth in (("stiffness", 1.07), ("damping", 1.3), ("inertia", 0.85)):
        assert found.changed[name].ci95[0] <= truth <= found.changed[name].ci95[1]


@pytest.mark.parametrize("volts", [500.0, 0.0])
def test_a_constant_velocity_shows_few_factors(actuator, volts):
    """Under no input no factor is known; under a constant one a weak spring and a strong damper move like this."""
    a = np.asarray(actuator.physical_coefficients, float)
    velocity = 0.1 * volts**2 / a[1] if volts else 1e-4
    y = velocity * TIME + 1e-3 * velocity * np.random.default_rng(5).standard_normal(len(TIME))
    found = pitp.adapt(actuator, pitp.Record("day", TIME, np.full(len(TIME), volts), y))
    if volts:
        low, high = found.changed["damping"].ci95
        assert found.verdict == "adapted" and low <= 10 <= high
    else:
        assert found.verdict == "retrain" and not any(c.is_significant for c in found.changed.values())


def test_an_unseen_direction_has_a_large_variance():
    """Two of three columns are one: their sum is as certain as without the third number, their difference unknown."""
    rng = np.random.default_rng(2)
    one, other = rng.standard_normal((2, 4000))
    residual = 0.1 * rng.standard_normal((1, 4000))
    spread = covariance(residual, np.stack([one, one, other], 1), 0.1)
    alone = covariance(residual, np.stack([2 * one, other], 1), 0.1)
    half = np.array([0.5, 0.5, 0.0])
    assert half @ spread @ half == pytest.approx(alone[0, 0], rel=1e-3)
    assert spread[2, 2] == pytest.approx(alone[1, 1], rel=1e-3)
    apart = np.array([1.0, -1.0, 0.0])
    assert apart @ spread @ apart > 1e4


@pytest.mark.parametrize("sensor", [{}, {"zero": 3e-4}, {"direction": -1.0}, {"zero": -2e-4, "direction": -1.0}])
def test_the_same_actuator_is_unchanged_whatever_the_sensor_shows(actuator, sensor):
    found = pitp.adapt(actuator, measured(actuator, **sensor))
    assert found.verdict == "unchanged" and found.model.model is actuator and not found.changed


@pytest.mark.parametrize(("level", "error", "verdict"), [
    (6.0, 5.0, "unchanged"), (6.0, 13.0, "retrain"), (6.0, 20.0, "retrain"), (14.0, 20.0, "retrain"),
])  # fmt: skip
def test_a_model_that_misses_the_recording_is_not_unchanged(actuator, level, error, verdict):
    """A linear model of an error of several % finds no certain factor in what is not of its kind: it is retrained."""
    record = measured(actuator)
    beside = np.sign(np.sin(2 * np.pi * 0.9 * TIME)) * error / 100 * np.ptp(record.displacement)
    given = Fitted(actuator.model if isinstance(actuator, Fitted) else actuator, Origin(level=level))
    found = pitp.adapt(given, replace(record, displacement=record.displacement + np.where(TIME > 0.3, beside, 0)))
    assert found.verdict == verdict and (found.before > min(1.5 * level, 10)) == (verdict == "retrain")
    assert found.as_json()["advice"] == ([found.advice] if verdict == "retrain" else [])
    assert verdict == "unchanged" or "pitp diagnose" in found.advice


def test_the_same_actuator_from_a_held_start_is_unchanged_and_a_softer_one_is_not(actuator):
    held = np.where(TIME < 0.3, U[300], U)

    def settled(model):
        x = U[300] ** 2 / model.physical_coefficients[0] / model.scales.state[0]
        return jnp.zeros(2).at[0].set(x)

    assert pitp.adapt(actuator, measured(actuator, held, start=settled(actuator), zero=1e-4)).verdict == "unchanged"
    softer = with_factors(actuator, stiffness=0.9)
    found = pitp.adapt(actuator, measured(softer, held, start=settled(softer), zero=1e-4))
    assert set(found.changed) == {"stiffness"} and abs(found.changed["stiffness"].factor - 0.9) < 0.01


def test_late_electrodes_are_a_time_and_no_factor_where_there_were_none(actuator):
    late = replace(actuator, drive=ElectrodeLag(jnp.log(jnp.asarray(8e-3))))
    found = pitp.adapt(actuator, measured(late))
    tau = found.changed["electrode_tau"]
    assert np.isnan(tau.factor) and tau.seconds_ci95 is not None and tau.seconds_ci95[0] <= 8e-3 <= tau.seconds_ci95[1]
    assert found.as_json()["changed"]["electrode_tau"].keys() == {"factor", "ci95"}
    slower = pitp.adapt(late, measured(replace(late, drive=ElectrodeLag(jnp.log(jnp.asarray(12e-3))))))
    assert slower.changed["electrode_tau"].ci95[0] <= 1.5 <= slower.changed["electrode_tau"].ci95[1]


@pytest.mark.slow
def test_creep_and_stiffness_of_a_trained_encoder_come_back(creeping):
    truth = {"stiffness": 0.9, "creep": 1.6}
    found = pitp.adapt(creeping, measured(with_factors(creeping, **truth)))
    for name, value in truth.items():
        assert found.changed[name].ci95[0] <= value <= found.changed[name].ci95[1], name
    assert found.verdict == "adapted" and isinstance(found.model.encoder, AdaptedEncoder)


def test_what_no_factor_explains_is_to_be_trained_anew(actuator):
    r = measured(actuator)
    bent = replace(r, displacement=np.abs(r.displacement - np.median(r.displacement)))
    found = pitp.adapt(actuator, bent)
    assert found.verdict == "retrain" and "record" in found.advice


def test_factors_of_one_leave_the_model_as_it_is(nonlinear):
    model = nonlinear()
    wrapped = eqx.tree_at(lambda m: m.encoder, model, with_factors(model, stiffness=1.0 + 1e-7).encoder)
    start, u = rest_state(model)[None], jnp.asarray(U[:500], jnp.float32)[None]
    np.testing.assert_allclose(fast_rollout(wrapped, u, 1e-3, start), fast_rollout(model, u, 1e-3, start), atol=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 3])
def test_an_adapted_encoder_is_one_formula_and_survives_its_file(nonlinear, order, tmp_path):
    model = with_factors(nonlinear(order), stiffness=0.8, creep=1.5)
    model = eqx.tree_at(lambda m: m.encoder.tilt, model, jnp.asarray([0.05, -0.1]))
    f = jax.random.normal(jax.random.key(1), (order + 2, 7))
    one = eqx.filter_jit(lambda m: jax.vmap(m.encoder, 1, 1)(f))(model)
    many = eqx.filter_jit(lambda m: [jnp.stack(list(m.encoder.over(w)(list(f)))) for w in ("instant", "instants")])
    for rows in many(model):
        np.testing.assert_allclose(rows, one, rtol=1e-4, atol=1e-5)
    pitp.save(tmp_path / "m", model)
    again = pitp.load(tmp_path / "m")
    assert eqx.tree_equal(again.encoder, model.encoder)


def test_an_adapted_model_is_inverted_as_any(creeping):
    model = with_factors(creeping, stiffness=0.8, creep=1.4)
    time = np.arange(1000) * 1e-3
    found = pitp.feedforward(model, pitp.Target(time, 1e-3 * smooth_step(time / 0.8)), shots=0)
    assert found.self_check_e_rms_percent < 0.5


def test_evidence_of_noise_alone_names_nothing_and_gain_stands_alone(actuator):
    factors = factors_of(actuator, 4.0, 0.0)
    assert all(not {"gain", "stiffness"} <= set(s) for s in subsets(factors))
    rng = np.random.default_rng(0)
    spread = np.diag([0.02, 0.05, 0.02, 0.5]) ** 2
    draws = rng.multivariate_normal(np.zeros(4), spread, 200)
    assert np.mean([select(z, spread, factors) == () for z in draws]) >= 0.95
    assert select(np.array([0.3, 0.0, 0.0, 0.0]), spread, factors) == ("stiffness",)
    assert directions(factors, ("gain",)).ravel().tolist() == [-1.0, -1.0, -1.0, 0.0]


def test_the_covariance_is_that_of_estimates_under_coloured_noise():
    rng, size = np.random.default_rng(1), 2000
    columns = np.stack([np.sin(np.arange(size) / 40), np.ones(size)], 1)
    estimates, told = [], []
    for _ in range(80):
        e = lfilter([0.2], [1, -0.98], rng.standard_normal(size + 400))[400:]
        q = np.linalg.lstsq(columns, e, rcond=None)[0]
        estimates.append(q)
        told.append(np.diag(covariance((e - columns @ q)[None], columns, 0.0)))
    assert 0.5 < np.sqrt(np.mean(told, 0)[0]) / np.std(estimates, 0)[0] < 2.0

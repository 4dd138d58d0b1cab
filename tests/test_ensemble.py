"""Ensembles: members as `train` makes them, the band by its formula, and coverage where the spread is known."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm as normal
from scipy.stats import t as student

from pitp_jax.files.model_file.ensemble import train_ensemble
from pitp_jax.method.effects import effect
from pitp_jax.method.signal.record import Record
from pitp_jax.method.simulate.decoder import rest_state, rollout, rollout_batch
from pitp_jax.method.simulate.moving_start import initial_samples
from pitp_jax.method.simulate.prediction import predict
from pitp_jax.method.train.ensemble import Ensemble, predict_band
from pitp_jax.method.train.settings import Settings
from pitp_jax.method.train.training import train

DT, SAMPLES = 2e-3, 500
TIME = np.arange(SAMPLES) * DT
TINY = Settings(width=4, memories=1, epochs=4, stages=1, batch=256, rate=1e-2, refine_steps=0)
KEY = jax.random.key(3)
run = eqx.filter_jit(rollout)


def sine(hz):
    return 900 * (1 - np.cos(2 * np.pi * hz * TIME))


def record(model, hz, start=0):
    """What the model itself does, from rest or cut while it moves."""
    x = np.asarray(run(model, jnp.asarray(sine(hz), jnp.float32), DT, rest_state(model)), np.float64)[:, 0]
    x = model.output.to_rig(x * model.scales.state[0])
    return Record(f"{hz} Hz", TIME[start:], sine(hz)[start:], x[start:])


@pytest.fixture(scope="module")
def plant(linear, nonlinear):
    """The linear nominal, two training records of a nonlinear model, and a held-out one."""
    truth = nonlinear(2, size=0.3, tau=(0.05,), dt=DT)
    return linear(2, dt=DT), [record(truth, 1.5), record(truth, 3.0)], [record(truth, 2.2)]


@pytest.fixture(scope="module")
def ensemble(plant):
    """Three members, trained in a moment."""
    return train_ensemble(plant[0], plant[1], members=3, settings=TINY, key=KEY)


def arrays(model):
    return jax.tree.leaves(eqx.filter(model, eqx.is_inexact_array))


@pytest.fixture(scope="module")
def alone(plant, ensemble):
    """Displacements of every member, predicted alone, shape (members, T), and the samples that count, by record."""
    records = plant[1] + plant[2]
    found = zip(records, *[predict(m, records) for m in ensemble.models], strict=True)
    return {r.name: (np.stack([p.displacement for p in own]), own[0].scored) for r, *own in found}


def test_members_are_what_train_makes_of_their_keys(plant, ensemble):
    keys = jax.random.split(KEY, 3)
    alone = train(plant[0], plant[1], settings=TINY, key=keys[1]).model
    for a, b in zip(arrays(alone), arrays(ensemble.models[1]), strict=True):
        np.testing.assert_array_equal(a, b)
    assert len(ensemble.models) == 3


def test_members_differ_in_trained_numbers_only(ensemble):
    one, two, three = ensemble.models
    for other in (two, three):
        assert not bool(jnp.array_equal(one.encoder.spring.hidden.weight, other.encoder.spring.hidden.weight))
        np.testing.assert_array_equal(one.coefficients, other.coefficients)
        assert jax.tree.structure(one.encoder) == jax.tree.structure(other.encoder)
        assert (one.scales, one.output.polarity, one.hold) == (other.scales, other.output.polarity, other.hold)


def test_the_band_is_the_formula_of_the_members_own_predictions(plant, ensemble, alone):
    left = []
    for r in plant[1]:
        x, scored = alone[r.name]
        error = np.abs((x.mean(0) - r.displacement)[scored]) / np.ptp(r.displacement)
        left.append(np.quantile(error, np.linspace(0, 1, 2001)))  # recordings count alike
    for level in (0.5, 0.95):
        scaled = student.ppf(0.5 + level / 2, len(left)) / normal.ppf(0.5 + level / 2)
        for band, r in zip(predict_band(ensemble, plant[2], level=level), plant[2], strict=True):
            x, scored = alone[r.name]
            span = np.ptp(r.displacement)
            floor = np.quantile(np.abs(left), level) * scaled * span
            width = np.hypot(student.ppf(0.5 + level / 2, 2) * np.sqrt(4 / 3) * x.std(0, ddof=1), floor)
            np.testing.assert_allclose(band.displacement, x.mean(0), rtol=0, atol=1e-5 * span)
            # the quantiles of the errors are kept every half percent
            np.testing.assert_allclose(band.half_width, width, rtol=5e-3, atol=1e-4 * span)
            assert band.name == r.name and (band.scored == scored).all()
            assert x.std(0, ddof=1).max() > 1e-4 * span  # there is a spread to speak of


def test_the_error_is_the_means_on_the_training_records(plant, ensemble, alone):
    left = []
    for r in plant[1]:
        x, scored = alone[r.name]
        left.append(np.mean((x.mean(0) - r.displacement)[scored] ** 2) / np.ptp(r.displacement) ** 2)
    assert ensemble.error == pytest.approx(np.sqrt(np.mean(left)), rel=1e-3)


def test_identical_members_have_no_width(plant, ensemble, alone):
    """But for the error they share."""
    model, (r,) = ensemble.models[0], plant[2]
    (band,) = predict_band(Ensemble((model,) * 4, 0.0), [r])
    np.testing.assert_allclose(band.half_width, 0, atol=1e-12)
    np.testing.assert_allclose(band.displacement, alone[r.name][0][0], atol=1e-5 * np.ptp(r.displacement))
    (band,) = predict_band(Ensemble((model,) * 4, 0.01), [r])
    np.testing.assert_allclose(band.half_width, student.ppf(0.975, 3) * 0.01 * np.ptp(r.displacement), rtol=1e-6)


def test_errors_that_are_not_normal_are_covered_as_often_as_asked(linear):
    """Errors of a free run: most samples have small ones. A normal band would hold 63 % instead of half of them."""
    model, rng = linear(2, dt=DT), np.random.default_rng(3)
    one = record(model, 2.0)

    def measured(count):
        error = 0.01 * np.ptp(one.displacement) * rng.laplace(size=(count, SAMPLES))
        return [replace(one, name=str(k), displacement=one.displacement + e) for k, e in enumerate(error)]

    ensemble, held = Ensemble.calibrated((model, model), measured(30)), measured(4)
    for level in (0.5, 0.8, 0.95):
        bands = predict_band(ensemble, held, level=level)
        inside = [np.abs(b.displacement - r.displacement) <= b.half_width for b, r in zip(bands, held, strict=True)]
        assert np.mean(inside) == pytest.approx(level, abs=0.03)


def test_a_record_that_starts_moving_is_scored_later(linear):
    model = linear(2, dt=DT, offset=3e-3, polarity=-1.0)
    moving = record(model, 2.0, start=120)
    (band,) = predict_band(Ensemble((model, model), 0.0), [moving])
    used = initial_samples(model, moving)
    assert not band.scored[:used].any() and band.scored[used:].all()
    np.testing.assert_allclose(band.displacement, moving.displacement, atol=2e-2 * np.ptp(moving.displacement))


@pytest.mark.slow
@pytest.mark.parametrize("level", [0.5, 0.95])
def test_a_known_spread_is_covered(linear, level):
    """Members and plants drawn alike, springs of 1 +- 0.5 %: the level's share of plants lies in the band.

    40 ensembles of 4 with 10 plants each; Student's quantile makes up for a spread known from four members.
    """
    nominal, rng = linear(2, dt=DT), np.random.default_rng(7)
    voltage = jnp.tile(jnp.asarray(sine(2.0), jnp.float32), (10, 1))
    start = jnp.tile(rest_state(nominal), (10, 1))

    def drawn(count):
        springs = nominal.coefficients[0] * (1 + 0.005 * rng.standard_normal(count))
        return [eqx.tree_at(lambda m: m.coefficients, nominal, nominal.coefficients.at[0].set(s)) for s in springs]

    inside = []
    for _ in range(40):
        ensemble = Ensemble(tuple(drawn(4)), 0.0)
        stack = jax.tree.map(lambda *leaves: jnp.stack(leaves), *drawn(10))
        x = eqx.filter_vmap(rollout_batch, in_axes=(0, None, None, None))(stack, voltage[:1], DT, start[:1])
        x = np.asarray(x, np.float64)[:, 0, :, 0] * nominal.scales.state[0]
        (band,) = predict_band(ensemble, [Record("first", TIME, sine(2.0), x[0])], level=level)
        settled = slice(SAMPLES // 4, None)
        inside.append(np.abs(x - band.displacement)[:, settled] <= band.half_width[settled])
    assert np.mean(inside) == pytest.approx(level, abs=0.04)


@pytest.mark.parametrize("members", [0, 1])
def test_fewer_than_two_members_are_refused(plant, ensemble, members):
    with pytest.raises(ValueError, match=f"at least 2 members, not {members}"):
        train_ensemble(plant[0], plant[1], members=members, settings=TINY, key=KEY)
    with pytest.raises(ValueError, match=f"at least 2 members, not {members}"):
        Ensemble(ensemble.models[:members], 0.0)


@pytest.mark.parametrize("level", [0.0, 1.0, 95.0])
def test_a_level_that_is_no_share_is_refused(plant, ensemble, level):
    with pytest.raises(ValueError, match="is not between 0 and 1"):
        predict_band(ensemble, plant[2], level=level)


def test_a_member_that_runs_away_is_told(plant):
    nominal, records, _ = plant
    away = nominal.changed(np.array([-30.0, 1.0, 1.0]))
    (band,) = predict_band(Ensemble((nominal, away), 0.0), records[:1])
    assert band.diverged and np.isnan(band.displacement[-1]) and np.isfinite(band.displacement[:10]).all()
    assert not predict_band(Ensemble((nominal, nominal), 0.0), records[:1])[0].diverged


def test_members_of_two_makes_are_refused(plant, linear):
    other = replace(plant[0], effects=(effect("delay", time=0.01),))
    for member in (other, linear(3, dt=DT)):
        with pytest.raises(ValueError, match="members differ"):
            Ensemble((plant[0], member), 0.0)

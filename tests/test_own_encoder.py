"""An encoder of the user's own predicts, inverts, is trained, diagnosed, adapted, saved and exported."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from played import FEW
from scipy.signal import lsim

import pitp_jax as pitp
from pitp_jax.method.numerics.scalar.jaxpr import program

DT = 2e-3
TIME = DT * np.arange(1500)
SMALL = pitp.Settings(epochs=2, stages=1, refine_steps=3, starts=1, memories=2)


class Spring(eqx.Module):
    """A user's encoder: sigma_0 follows x^2, all else is the nominal's; two weights."""

    weight: jax.Array
    bias: jax.Array
    order: int = eqx.field(static=True, default=2)

    def __call__(self, features):
        logits = jnp.zeros(self.order + 2, features.dtype)
        return logits.at[0].set(self.weight * features[0] ** 2 + self.bias)


class Net(eqx.Module):
    """A user's network whose last layer begins at zero."""

    net: eqx.nn.MLP

    def __init__(self, features, logits, *, key):
        net = eqx.nn.MLP(features, logits, 6, 1, jnp.tanh, dtype=jnp.float32, key=key)
        self.net = eqx.tree_at(
            lambda m: m.layers[-1], net, replace_fn=lambda layer: jax.tree.map(jnp.zeros_like, layer)
        )

    def __call__(self, features):
        return self.net(features)


def spring(weight=0.25):
    return Spring(jnp.asarray(weight, jnp.float32), jnp.zeros((), jnp.float32))


def volts(hz, high=900.0):
    return high * np.sin(np.pi * hz * TIME) ** 2


@pytest.fixture(scope="module")
def known(linear, bounded):
    return bounded(linear(2, 10.0, dt=DT))


def hardening(model, weight=0.25):
    return replace(model, encoder=spring(weight))


@pytest.fixture(scope="module")
def records(known):
    """Of a hardening spring, the truth that the user's encoder can express."""
    truth = hardening(known)
    rng = np.random.default_rng(0)
    drives = {"low": volts(1.0, 1100.0), "high": volts(3.0, 1000.0), "sweep": volts(0.5 + TIME, 900.0)}
    runs = {k: np.asarray(pitp.free_run(truth, u), np.float64) for k, u in drives.items()}
    return [pitp.Record(k, TIME, u, runs[k] + 1e-6 * rng.standard_normal(1500)) for k, u in drives.items()]


def test_a_linear_model_is_built_from_its_coefficients():
    model = pitp.linear_model([1e9, 2e6, 1e6], dt=1e-3)
    np.testing.assert_allclose(model.physical_coefficients, [1e9, 2e6, 1e6], rtol=1e-6)
    t = np.arange(1000) * 1e-3
    u = 1000 * np.sin(np.pi * t) ** 2
    truth = lsim(([1.0], [1e6, 2e6, 1e9]), u**2, t)[1]
    np.testing.assert_allclose(pitp.free_run(model, u), truth, rtol=0, atol=1e-4 * np.ptp(truth))
    assert np.abs(np.asarray(model.coefficients)).max() == pytest.approx(1.0)
    straight = pitp.linear_model([2.0, 0.1], dt=1e-3, input_map=pitp.LinearInput())
    np.testing.assert_allclose(pitp.free_run(straight, np.ones(500))[-1], 0.5, rtol=1e-3)
    with pytest.raises(pitp.BadInput, match="needs dt"):
        pitp.linear_model([1.0, 1.0])


@pytest.mark.slow
def test_own_parts_make_a_model_by_replacing(known):
    parts = {
        "encoder": pitp.CompactEncoder(2, 2, width=4, key=jax.random.key(0)),
        "memory": pitp.FadingMemory(jnp.log(jnp.array([0.05, 0.5]))),
        "drive": pitp.ElectrodeLag(jnp.log(jnp.asarray(4e-3))),
    }
    model = replace(known, **parts)
    # an untrained encoder is the linear model, behind the lag's charging
    late = np.asarray(parts["drive"].film(jnp.asarray(volts(2.0), jnp.float32), DT, jnp.asarray(True)))
    np.testing.assert_allclose(pitp.free_run(model, volts(2.0)), pitp.free_run(known, late), atol=1e-9, rtol=2e-3)


def test_an_own_encoder_moves_the_tokens(known, double):
    """sigma_0 = a0 (1 + w X^2) along a motion, and the inverse of the decoder meets it."""
    with jax.enable_x64(True):
        model, u = double(hardening(known)), volts(2.0)
        x = np.asarray(pitp.free_run(model, u))
        scale = model.scales.state[0]
        tokens = np.asarray(pitp.tokens_along(model, x))
        a = model.physical_coefficients
        np.testing.assert_allclose(tokens[:, 0], a[0] * (1 + 0.25 * (x / scale) ** 2), rtol=1e-12)
        np.testing.assert_allclose(tokens[:, 1:], np.tile(a[1:], (1500, 1)), rtol=1e-12)
        assert np.abs(x - np.asarray(pitp.free_run(double(known), u))).max() > 0.02 * np.ptp(x)
        again = pitp.free_run(model, pitp.inverse(model, x, kind="discrete")[0])
        # the spline's x' is not quite the decoder's: some (w dt)^4 / 12
        np.testing.assert_allclose(again, x, rtol=0, atol=5e-5 * np.ptp(x))


def test_parameters_of_an_own_encoder_are_its_arrays(known):
    model = replace(known, encoder=Net(2, 4, key=jax.random.key(0)))
    params = eqx.filter(model, eqx.is_inexact_array)
    assert len(jax.tree.leaves(params)) == 1 + 4 + 1  # coefficients, two layers, factor
    assert "Net" in repr(model)
    half = replace(hardening(known, 0.4), encoder=model.encoder.scaled(0.5))
    run, other = (np.asarray(pitp.free_run(m, volts(2.0))) for m in (half, known))
    np.testing.assert_allclose(run, other, rtol=0, atol=1e-6 * np.ptp(other))  # programs of their own: they round apart


def test_an_own_encoder_is_saved_and_restored_by_a_template(known, tmp_path):
    model = hardening(known, 0.37)
    path = tmp_path / "own.pitp"
    pitp.save(path, model)
    again = pitp.load(path, encoder=spring(0.0))
    assert float(again.encoder.module.weight) == pytest.approx(0.37)
    np.testing.assert_array_equal(pitp.free_run(again, volts(2.0)), pitp.free_run(model, volts(2.0)))
    pitp.save(tmp_path / "twice.pitp", again)
    assert (tmp_path / "twice.pitp").read_bytes() == path.read_bytes()
    with pytest.raises(
        pitp.BadInput, match=r"encoder of your own \(Spring\): give pitp.load\(FILE, encoder=Spring"
    ) as e:
        pitp.load(path)
    assert len(str(e.value)) - len(str(path)) < 150
    with pytest.raises(pitp.BadInput, match="Net does not match the stored encoder"):
        pitp.load(path, encoder=Net(2, 4, key=jax.random.key(0)))
    pitp.save(path, known)
    with pytest.raises(pitp.BadInput, match="no encoder of your own"):
        pitp.load(path, encoder=spring())


def test_an_encoder_of_other_sizes_is_refused(known, records):
    with pytest.raises(pitp.BadInput, match="4 logits|returns 3"):
        pitp.free_run(replace(known, encoder=Spring(jnp.ones(()), jnp.zeros(()), order=1)), volts(2.0))
    wrong = Spring(jnp.ones(()), jnp.zeros(()), order=1)
    with pytest.raises(pitp.BadInput, match=r"take 4 features .* return 4 logits .* shape \(3,\)"):
        pitp.train(known, records, settings=SMALL, encoder=wrong, key=jax.random.key(0))
    with pytest.raises(pitp.BadInput, match="encoder=MODULE"):
        pitp.train(known, records, settings=replace(SMALL, encoder="own"), key=jax.random.key(0))


def error(model, records):
    return max(pitp.e_rms_percent(p.displacement, r.displacement) for p, r in
               zip(pitp.predict(model, records), records, strict=True))  # fmt: skip


@pytest.mark.slow
def test_an_own_encoder_is_trained_diagnosed_and_adapted(known, records, tmp_path):
    """The hardening is found, as the records' maker; the trained model serves every function."""
    before = error(known, records)
    trained = pitp.train(known, records, settings=SMALL, encoder=spring(0.0), key=jax.random.key(0))
    assert not trained.problems and error(trained.model, records) < 0.1 * before
    x = 1.5e-4
    token = pitp.tokens_along(trained.model, np.full(200, x))[100, 0] / known.physical_coefficients[0]
    assert float(token) == pytest.approx(1 + 0.25 * (x / known.scales.state[0]) ** 2, rel=0.02)
    pitp.save(tmp_path / "m.pitp", trained.model)
    model = pitp.load(tmp_path / "m.pitp", encoder=spring())
    softer = hardening(known).changed(np.array([0.85, 1.0, 1.0]))
    noise = 1e-6 * np.random.default_rng(1).standard_normal(1500)
    runs = [np.asarray(pitp.free_run(softer, r.voltage), float) for r in records]
    today = [replace(r, displacement=x + noise) for r, x in zip(records, runs, strict=True)]
    day = pitp.adapt(hardening(known), today[:1])
    assert day.verdict == "adapted" and error(day.model, today) < 0.1 * error(hardening(known), today)
    pitp.save(tmp_path / "day.pitp", day.model)
    assert error(pitp.load(tmp_path / "day.pitp", encoder=spring()), today) == error(day.model, today)
    found = pitp.diagnose(model, today, exclude=[*FEW, "creep", "second_mode", "sensor_lag", "drag"])
    each = [pitp.e_rms_percent(p.displacement, r.displacement, p.scored) for p, r in
            zip(pitp.predict(model, today), today, strict=True)]  # fmt: skip
    # the diagnosis fits each record's zero and start, which can only lower the error
    assert 0.5 < found.gap.unrefitted / np.sqrt(np.mean(np.square(each))) < 1.001
    assert found.gap.after <= found.gap.before
    pitp.export_c(model, tmp_path / "c")
    plan = pitp.feedforward(model, pitp.Target(TIME, 1e-4 * np.sin(np.pi * TIME) ** 4))
    assert plan.infeasible.mean() == 0


@pytest.mark.slow
def test_a_network_of_ones_own_is_made_by_a_function_of_its_sizes(known, records):
    """A band of two members, whose networks hold functions beside arrays."""
    short = replace(SMALL, refine_steps=0)
    one = pitp.train(known, records, settings=short, encoder=Net, key=jax.random.key(0)).model
    assert error(one, records) < error(known, records)
    other = replace(one.model, encoder=one.encoder.scaled(0.8))
    band = pitp.predict_band(pitp.Ensemble((one, other), error=0.01), records[:1])[0]
    runs = np.stack([pitp.predict(m, records[:1])[0].displacement for m in (one, other)])
    np.testing.assert_allclose(band.displacement, runs.mean(0), rtol=0, atol=1e-6 * np.ptp(runs))
    assert np.ptp(runs, axis=0).max() > 0


def test_an_export_names_the_operation_that_c_cannot_express():
    class Sorted(eqx.Module):
        def __call__(self, features):
            return 0.01 * jnp.append(jnp.sort(features), jnp.zeros(2))

    with pytest.raises(
        pitp.BadInput, match="operation sort cannot be written as C; use other operations in your encoder"
    ):
        program(pitp.OwnEncoder(Sorted()), jnp.zeros(2))

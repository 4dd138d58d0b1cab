"""The decoder against closed forms, scipy and adaptive solvers; what predictions say about themselves."""

from dataclasses import replace
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lsim

from pitp_jax.method.effects import effect
from pitp_jax.method.model.encoder import CompactEncoder, PaperEncoder
from pitp_jax.method.model.fitted import Fitted
from pitp_jax.method.model.input_map import LinearInput
from pitp_jax.method.model.memory import ElapsedTime, FadingMemory
from pitp_jax.method.model.origin import Origin
from pitp_jax.method.signal.excited import tabulate
from pitp_jax.method.signal.record import Record
from pitp_jax.method.simulate import ports
from pitp_jax.method.simulate.decoder import frozen_increment, rest_state, rollout
from pitp_jax.method.simulate.moving_start import initial_samples
from pitp_jax.method.simulate.prediction import outside_fraction, outside_words, predict

DT = 4e-3
COARSE = 1000 + 800 * np.random.default_rng(5).uniform(-1, 1, 26)  # V, linear between 26 samples
run = eqx.filter_jit(rollout)


def refined(factor):
    """The same voltage, linear between the coarse samples, on a grid `factor` times finer."""
    return np.interp(np.arange(25 * factor + 1) / factor, np.arange(26), COARSE)


def adaptive(model, voltage=COARSE, dt=DT, tolerance=1e-10):
    """The continuous-token ODE by Dopri8, its steps ending at every kink of the voltage; states at the samples."""
    times = jnp.arange(len(voltage)) * dt
    drive = diffrax.LinearInterpolation(times, jnp.asarray(voltage))
    rates = jnp.asarray(model.scales.rates)
    n = model.order

    def slope(t, s, args):
        tokens, offset = model.tokens(s)
        force = model.input_map.force(drive.evaluate(t)) / model.scales.force
        highest = (force - offset - tokens[:n] @ s[:n]) / tokens[n]
        return jnp.concatenate([rates * jnp.append(s[1:n], highest), jnp.array(model.memory.rate()(s[n:], s[0]))])

    control = diffrax.ClipStepSizeController(
        diffrax.PIDController(rtol=tolerance, atol=tolerance), step_ts=times, jump_ts=times
    )
    found = diffrax.diffeqsolve(
        diffrax.ODETerm(slope), diffrax.Dopri8(), times[0], times[-1], None, rest_state(model),
        stepsize_controller=control, saveat=diffrax.SaveAt(ts=times), max_steps=100_000,
    )  # fmt: skip
    return np.asarray(found.ys)


def error(model, truth, factor=1):
    """Largest error of the scaled displacement at the coarse samples, on a grid `factor` times finer."""
    found = run(model, jnp.asarray(refined(factor)), DT / factor, rest_state(model))
    return float(np.abs(np.asarray(found)[::factor, 0] - truth[:, 0]).max())


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2, 3])
def test_constant_tokens_are_fourth_order(linear, double, order):
    """The voltage is squared inside the step: with u^2 taken linear, halving dt would gain 4, not 16."""
    with jax.enable_x64(True):
        model = double(linear(order))
        truth = (
            adaptive(model)
            if order == 2
            else np.asarray(run(model, jnp.asarray(refined(64)), DT / 64, rest_state(model)))[::64]
        )
        assert np.ptp(truth[:, 0]) > 0.1
        errors = [error(model, truth, factor) for factor in (2, 4, 8)]
        assert errors[-1] < 1e-6 * np.ptp(truth[:, 0])
        np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 4, atol=0.3)
        if order == 2:
            assert error(model, truth, 64) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("drag", "order"), [(False, 2), (True, 1)])
def test_state_dependent_tokens_have_their_order(nonlinear, double, drag, order):
    """Tokens are read where the state drifts to by half a step: order 2. What x^(n-1), the one derivative whose drift
    takes the force, changes them by is read at the beginning: order 1.
    """
    with jax.enable_x64(True):
        model = double(nonlinear(2, size=0.4, drag=drag))
        truth = adaptive(model)
        linearised = eqx.tree_at(lambda m: m.encoder, model, model.encoder.scaled(0.0))
        assert error(linearised, truth) > 0.03 * np.ptp(truth[:, 0])  # the tokens do vary
        errors = [error(model, truth, factor) for factor in (8, 32)]
        assert np.log2(errors[0] / errors[1]) / 2 == pytest.approx(order, abs=0.15)
        finer = replace(model, substeps=8)
        assert error(finer, truth) == pytest.approx(errors[0], rel=1e-6)  # a substep is a step


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_holds_against_scipy(linear, double, coefficients, hold):
    voltage = np.random.default_rng(6).standard_normal(80)
    a = coefficients(3)
    truth = lsim(([1.0], a[::-1]), voltage, np.arange(80) * DT, interp=hold == "foh")[1]
    with jax.enable_x64(True):
        model = double(linear(3, hold=hold, substeps=16, input_map=LinearInput()))
        found = run(model, jnp.asarray(voltage), DT, rest_state(model))
    np.testing.assert_allclose(np.asarray(found)[:, 0] * 1e-3, truth, rtol=0, atol=1e-7 * np.abs(truth).max())


@pytest.mark.slow
def test_a_frozen_step_is_affine_in_the_force(nonlinear, double):
    with jax.enable_x64(True):
        model = double(nonlinear(2, size=0.5))
        state = jnp.array([0.5, -0.7, 0.2, 0.4])
        ends = [
            frozen_increment(model, state, (f, f, f), DT)
            for f in (jnp.float64(0.0), jnp.float64(2.0), jnp.float64(0.6))
        ]
        np.testing.assert_allclose(ends[2], 0.7 * ends[0] + 0.3 * ends[1], rtol=0, atol=1e-14)


def test_rest_stays_at_rest_without_voltage(nonlinear):
    model = nonlinear(2)
    silent = eqx.tree_at(lambda m: m.encoder.past, model, jax.tree.map(jnp.zeros_like, model.encoder.past))
    still = run(silent, jnp.zeros(100), DT, rest_state(model))
    assert bool((still == 0).all())
    assert (
        float(jnp.abs(run(model, jnp.zeros(100), DT, rest_state(model))[:, 0]).max()) > 1e-3
    )  # its offset token pushes


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["compact", "paper"])
def test_a_fresh_encoder_is_the_identified_model(linear, kind):
    model, key = linear(3, substeps=2), jax.random.key(4)
    if kind == "compact":
        parts = CompactEncoder(3, 2, width=8, key=key), FadingMemory(jnp.log(jnp.array([0.01, 1.0])))
    else:
        parts = PaperEncoder(4, 4, key=key, width=8), ElapsedTime(10.0)
    fresh = eqx.tree_at(lambda m: (m.encoder, m.memory), model, parts)
    voltage = jnp.asarray(refined(8), jnp.float32)
    truth = run(model, voltage, DT / 8, rest_state(model))
    found = run(fresh, voltage, DT / 8, rest_state(fresh))[:, :3]
    np.testing.assert_allclose(found, truth, rtol=0, atol=2e-6 * float(jnp.abs(truth).max()))


# ------------------------------------------------------------------------------------------------ predictions

TIME = np.arange(1500) * 1e-3
VOLTAGE = 1000 * (1 - np.cos(2 * np.pi * 3 * TIME))


def measured(a, voltage=VOLTAGE, start=0, stop=1500, offset=0.0, polarity=1.0, noise=0.0, name="r"):
    x = lsim(([1.0], a[::-1]), voltage**2, TIME)[1] + noise * np.random.default_rng(8).standard_normal(1500)
    return Record(name, TIME[start:stop], voltage[start:stop], (polarity * x + offset)[start:stop])


def test_predictions_follow_the_rig(linear, coefficients):
    model = linear(2, offset=7e-3, polarity=-1.0)
    record = measured(coefficients(2), offset=7e-3, polarity=-1.0, noise=1e-6)
    (found,) = predict(model, [record])
    assert not found.diverged and not found.estimated_start and found.scored.all()
    assert np.abs(found.displacement - record.displacement).max() < 2e-3 * np.ptp(record.displacement)


@pytest.mark.slow
def test_ragged_records_are_predicted_one_by_one(nonlinear, coefficients):
    model, a = nonlinear(2), coefficients(2)
    records = [measured(a, stop=stop, name=str(stop)) for stop in (1500, 200, 1100)]
    records.append(measured(a, start=333, name="moving"))
    together = predict(model, records)
    for record, found in zip(records, together, strict=True):
        (alone,) = predict(model, [record])
        assert found.name == record.name and len(found.displacement) == record.samples
        assert found.estimated_start == (record.name == "moving")
        np.testing.assert_allclose(
            found.displacement, alone.displacement, rtol=0, atol=1e-5 * np.ptp(alone.displacement)
        )


def test_divergence_is_told(linear, coefficients):
    model = linear(2)
    runaway = eqx.tree_at(lambda m: m.coefficients, model, model.coefficients * jnp.array([1.0, -4.0, 1.0]))
    (found,) = predict(runaway, [measured(coefficients(2))])
    assert found.diverged
    finite = np.isfinite(found.displacement)
    lost = int(np.argmin(finite))
    assert 10 < lost < 1500
    assert finite[:lost].all() and not finite[lost:].any()


@pytest.mark.parametrize("fading", [False, True])
def test_a_moving_start_is_estimated(linear, coefficients, fading):
    """Cut at high velocity: the free run from the planted state is recovered; the samples it cost are not scored."""
    model, start = linear(2), 333
    if fading:
        parts = (
            CompactEncoder(2, 2, width=4, key=jax.random.key(0)),
            FadingMemory(jnp.log(jnp.array([0.01, 1.0]))),
        )
        model = eqx.tree_at(lambda m: (m.encoder, m.memory), model, parts)
    clean = measured(coefficients(2), start=start)
    span = np.ptp(clean.displacement)
    record = measured(coefficients(2), start=start, noise=2e-3 * span)
    lost = np.where((np.arange(record.samples) >= 3) & (np.arange(record.samples) < 9), np.nan, record.displacement)
    record = replace(record, displacement=lost)
    (found,) = predict(model, [record])
    assert found.estimated_start
    spent = len(record.time) // 4  # a quarter of the record: less than one and a half periods of 5 Hz
    assert not found.scored[:spent].any() and found.scored[spent:].all()
    assert np.abs(found.displacement - clean.displacement).max() < 5e-3 * span


def test_share_outside_training(linear):
    model = linear(2)
    features = np.stack([np.linspace(0.0, 2.0, 2001), np.zeros(2001)], -1)
    assert outside_fraction(model, features) == 0.0  # never trained: no region
    trained = replace(model, domain=replace(model.domain, region=((0.0, 1.0), (-1.0, 1.0))))
    assert outside_fraction(trained, features) == pytest.approx((2.0 - 1.05) / 2.0, abs=1e-3)
    features[:, 1] = 1.2  # beyond 1 + 5 % of 2
    assert outside_fraction(trained, features) == 1.0
    assert outside_words(model, features, np.arange(2001)) == ""
    assert outside_words(trained, features, 0.01 * np.arange(2001)) == (
        "stroke by up to 100 % of its trained range, first at 10.5 s and "
        "speed by up to 10 % of its trained range, first at 0 s"
    )


def test_a_stroke_beyond_the_trained_one_counts_only_with_a_spring(linear):
    model = linear(2)
    free = replace(model, coefficients=model.coefficients.at[0].set(0.0))
    for m, stroke in ((model, 1.0), (free, 0.0)):
        trained = replace(m, domain=replace(m.domain, region=((0.0, 1.0), (-1.0, 1.0))))
        assert outside_fraction(trained, np.full((10, 2), [5.0, 0.0])) == stroke
        assert outside_fraction(trained, np.full((10, 2), [5.0, 2.0])) == 1.0
    for bounds, stroke in (([[0.0, -1.0], [0.0, 1.0]], 0.0), ([[0.0, -1.0], [1.0, 1.0]], 1.0)):  # or a network sees x
        encoder = CompactEncoder(2, 0, width=2, bounds=np.array(bounds), key=jax.random.key(0))
        trained = replace(free, encoder=encoder, domain=replace(free.domain, region=((0.0, 1.0), (-1.0, 1.0))))
        assert outside_fraction(trained, np.full((10, 2), [5.0, 0.0])) == stroke


def test_a_memory_outside_its_training_is_named_by_its_time(linear):
    model = replace(linear(2), memory=FadingMemory(jnp.log(jnp.array([0.01, 80.0]))))
    model = replace(model, domain=replace(model.domain, region=((0.0, 1.0),) * 4))
    features = np.full((10, 4), 0.5)
    features[4:, 3] = 1.3
    assert outside_words(model, features, np.arange(10)) == (
        "memory with time constant 80 s by up to 30 % of its trained range, first at 4 s"
    )


@pytest.mark.parametrize(
    ("dt", "count", "used"), [(1e-3, 4000, 300), (1e-3, 800, 200), (0.02, 1000, 50), (1e-4, 20000, 3000)]
)
def test_a_moving_start_takes_one_and_a_half_periods(linear, dt, count, used):
    """Of 5 Hz; not fewer than 50 samples, not more than a quarter of the record."""
    time = dt * np.arange(count)
    record = Record("r", time, np.zeros(count), np.sin(time))
    assert initial_samples(linear(2), record) == used


def test_predictions_carry_the_share(linear, coefficients):
    model, record = linear(2), measured(coefficients(2))
    top = np.ptp(record.displacement) / 1e-3
    box = ((0.0, top / 2), (-1e3, 1e3))
    (found,) = predict(replace(model, domain=replace(model.domain, region=box)), [record])
    truth = (np.abs(record.displacement / 1e-3 - top / 4) > top / 4 * 1.1).mean()
    assert found.outside_training_share == pytest.approx(truth, abs=0.01)
    # an input that its training never held lies outside as a whole; one that it held, not at all
    other = tabulate([1e-3 * np.sin(0.1 * record.time)], record.dt)
    for table, share in ((other, 1.0), (tabulate([record.voltage], record.dt), 0.0)):
        (found,) = predict(Fitted(model, Origin(excited_input=table)), [record])
        assert found.outside_training_share == pytest.approx(share, abs=0.01)
        assert found.not_excited.startswith("The input has 100 % of its energy") == (share > 0)


@pytest.mark.parametrize("first", ["sensor_gain", "backlash"])
def test_sensors_are_a_chain(linear, first):
    """A lag behind a gain is the lag of the gain, behind a play that of the play."""
    dt, tau = 1e-3, 0.02
    size: dict[str, Any] = {"sensor_gain": {"d": 0.2}, "backlash": {"width": 0.3}}[first]
    model = replace(linear(2, dt=dt), effects=(effect(first, **size), effect("sensor_lag", tau=tau)))
    time = np.arange(2000) * dt
    states = rollout(model, jnp.asarray(800 * np.sin(2 * np.pi * time) ** 2, jnp.float32), dt, rest_state(model))
    x = np.asarray(states[:, 0], float)
    seen = 1.2 * x
    if first == "backlash":
        seen = np.zeros_like(x)
        for k in range(1, len(x)):
            seen[k] = np.clip(seen[k - 1], x[k] - 0.15, x[k] + 0.15)
    truth = lsim(([1.0], [tau, 1.0]), seen, time)[1]
    np.testing.assert_allclose(ports.readings(model, states), truth, rtol=0, atol=2e-5 * np.ptp(truth))

"""Creep beyond the training records: the kept record, its balance's slopes, and a creep of minutes that is learned."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import StateSpace, lsim
from typed import some

from pitp_jax.files.model_file.model_file import load, save
from pitp_jax.method.fit.parameters import parameters, with_parameters
from pitp_jax.method.identify.identification import identify
from pitp_jax.method.model.memory import FadingMemory
from pitp_jax.method.signal import long_record
from pitp_jax.method.signal.long_record import thinned
from pitp_jax.method.signal.record import Record
from pitp_jax.method.simulate.prediction import predict
from pitp_jax.method.train import creep_balance
from pitp_jax.method.train.dataset import build_dataset
from pitp_jax.method.train.settings import PRESETS, with_encoder
from pitp_jax.method.train.training import _prepared, train

DT, OMEGA, TAU, SHARE = 0.02, 2 * np.pi, 15.0, 0.5  # s, rad/s, s; creep's share of the stiffness


def creeping(voltage):
    """x'' + 0.3 w x' + w^2 (x + share (x - z)) = w^2 u^2,  z' = (x - z) / tau, at rest before; in mm for kV."""
    a = np.array([[0, 1, 0], [-(OMEGA**2) * (1 + SHARE), -0.3 * OMEGA, OMEGA**2 * SHARE], [1 / TAU, 0, -1 / TAU]])
    system = StateSpace(a, [[0], [OMEGA**2], [0]], [[1, 0, 0]], [[0]])
    return lsim(system, (1e-3 * voltage) ** 2, DT * np.arange(len(voltage)))[1]


def record(name, seconds, phase, peak=1000.0, seed=0):
    """0 to `peak` V along (1 - cos phase) / 2; 0.1 % of noise."""
    t = DT * np.arange(round(seconds / DT))
    voltage = peak * (1 - np.cos(phase(t))) / 2
    x = creeping(voltage)
    noise = 1e-3 * np.ptp(x) * np.random.default_rng(seed).standard_normal(len(t))
    return Record(name, t, voltage, 1e-3 * (x + noise))


def sine(hz, seconds, **how):
    return record(f"{hz} Hz, {seconds} s, {how}", seconds, lambda t: 2 * np.pi * hz * t, **how)


@pytest.fixture(scope="module")
def sweep():
    return record("sweep", 120, lambda t: 2 * np.pi * (0.1 * t + 2.4 * t**2 / 240), peak=800)


@pytest.fixture(scope="module")
def nominal(sweep):
    return identify([sweep], order=2).model


@pytest.fixture(scope="module")
def records():
    return [
        sine(hz, 8, peak=peak, seed=k)
        for k, (hz, peak) in enumerate(((0.25, 1000), (0.6, 1000), (1.1, 1000), (2.0, 1000)))
    ]


def test_the_longest_record_is_kept_as_it_was(sweep):
    voltage, lost = sweep.voltage, sweep.displacement.copy()
    lost[1000:1100] = np.nan
    fine = replace(sweep, displacement=lost)
    kept = some(thinned(fine, voltage**2, True))
    back = kept.record()
    assert kept.step > 1 and back.samples - fine.samples < kept.step
    assert kept.seconds == pytest.approx(120, abs=kept.step * DT)
    inside = slice(50, fine.samples - 50)
    assert np.std((back.voltage[: fine.samples] - voltage)[inside]) < 1e-3 * np.ptp(voltage)
    missing = ~back.observed[: fine.samples]
    assert missing[1000:1100].all() and missing.sum() < 100 + 2 * kept.step
    seen = np.flatnonzero(~missing[inside]) + 50
    away = seen[(seen < 900) | (seen > 1200)]
    left = (back.displacement[: fine.samples] - fine.displacement)[away]
    assert np.std(left) < 1.2e-3 * np.ptp(sweep.displacement)  # the noise it was given


def test_its_ends_are_kept_whatever_the_sensor_calls_zero(sweep):
    """Low-passed about zero, 50 mm of offset would read 26 mm at either end."""
    cut = slice(300, 4000)  # begins and ends while it moves
    moved = replace(
        sweep, time=sweep.time[cut], voltage=sweep.voltage[cut], displacement=sweep.displacement[cut] + 0.05
    )
    kept = some(thinned(moved, moved.voltage**2, False))
    back = kept.record()
    assert kept.step > 1
    for found, meant in ((back.displacement, moved.displacement), (back.voltage, moved.voltage)):
        left = np.abs(found[: moved.samples] - meant)[: -kept.step]  # none is kept behind those
        assert max(left[:50].max(), left[-50:].max()) < 0.04 * np.ptp(meant)  # five times its noise


def test_of_a_record_too_long_to_follow_its_beginning_is_kept(sweep, monkeypatch):
    monkeypatch.setattr(long_record, "_READ", 2000)
    kept = some(thinned(sweep, sweep.voltage**2, True))
    assert kept.seconds == pytest.approx(2000 * DT, abs=kept.step * DT)
    rests = replace(sweep, voltage=np.where(np.arange(sweep.samples) < 2000, 0.0, sweep.voltage))
    assert thinned(rests, rests.voltage**2, True) is None


def test_a_nominal_keeps_it_on_file(nominal, tmp_path):
    save(tmp_path / "m", nominal)
    stored, known = load(tmp_path / "m").origin.long_record, nominal.origin.long_record
    np.testing.assert_equal(vars(some(stored)), vars(some(known)))


def cost(balance, model, vector):
    left = balance.errors(with_parameters(model, vector))
    return left @ left


@pytest.mark.slow
def test_slopes_are_those_of_the_residuals(nominal, records, double):
    """Central differences along random directions, in float64."""
    memory = FadingMemory(jnp.log(jnp.asarray([0.3, 5.0, 30.0], jnp.float32)))
    data = build_dataset(nominal.model, records, scaling="rms", difference="stencil", memory=lambda states: memory)
    settings = replace(PRESETS["default"], memories=3, width=4)
    model = with_encoder(data, settings, None, jax.random.key(1))
    balance = some(creep_balance.slow_balance(data.model, some(nominal.origin.long_record), data.region))
    rng = np.random.default_rng(0)
    start = parameters(model)[0]
    start = start + 0.1 * rng.standard_normal(len(start))
    with jax.enable_x64(True):
        exact, wide = replace(balance, series=double(balance.series)), with_parameters(double(model), start)
        left, slopes = exact.errors(wide), exact.slopes(wide, len(start))
        for _ in range(4):
            d = rng.standard_normal(len(start))
            d /= np.linalg.norm(d)
            up, down = (exact.errors(with_parameters(wide, start + s * 1e-5 * d)) for s in (1, -1))
            np.testing.assert_allclose((up - down) / 2e-5, slopes @ d, rtol=1e-4, atol=1e-7 * np.abs(slopes @ d).max())
    assert left @ left > 0 and np.abs(slopes).max() > 0
    assert cost(balance, model, start) == pytest.approx(left @ left, rel=1e-3)
    shorter = with_parameters(model, start - np.where(np.arange(len(start)) >= len(start) - 3, 1.0, 0.0))
    assert cost(balance, shorter, start) == pytest.approx(cost(balance, model, start))  # theta alone counts


def test_a_spring_that_is_off_shows_beside_a_mean_that_is_not(nominal, records):
    """1 % too stiff leaves r = 0.01 x: in a window 0.01 mean x, and, below the resonance, 3 times 0.01 std x."""
    data = build_dataset(nominal.model, records, scaling="rms", difference="stencil",
                         memory=lambda states: FadingMemory(jnp.zeros(1)))  # fmt: skip
    balance = some(creep_balance.slow_balance(data.model, some(nominal.origin.long_record), [(-1e3, 1e3)] * 3))
    stiffer = replace(data.model, coefficients=data.model.coefficients * jnp.asarray([1.01, 1.0, 1.0], jnp.float32))
    more = np.asarray(
        creep_balance._moments(stiffer, balance.series) - creep_balance._moments(data.model, balance.series), np.float64
    )
    used, force = balance.scale > 0, 0.01 * float(data.model.coefficients[0])
    x, inside = np.asarray(balance.series.states[..., 0]), np.asarray(balance.series.weight[:, 0]) > 0
    slow = more[:, 1] != 0
    hz = 0.1 + 2.4 * (np.arange(100) + 0.5) / 100
    assert slow[hz < 0.6].sum() > 5 and not slow[hz > 1.0].any()
    for w in np.flatnonzero(used):
        here = x[w][inside[w]]
        expected = force * np.array([here.mean(), 3 * here.std() * slow[w]])
        np.testing.assert_allclose(more[w], expected, rtol=2e-2, atol=1e-5)


@pytest.mark.parametrize("seconds", [1.5, 4, 8, 15, 30, 60, 240])
@pytest.mark.parametrize("rate_hz", [50, 500])
def test_a_long_record_of_any_length_and_rate_is_balanced(nominal, seconds, rate_hz):
    """A spring that is 1 % too stiff leaves 0.01 mean x in each window, however few samples are kept."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    fine = np.arange(round(seconds / DT)) * DT
    voltage = np.interp(t, fine, 500 * (1 - np.cos(2 * np.pi * 0.25 * fine)))
    slow = Record("slow", t, voltage, 1e-3 * np.interp(t, fine, creeping(np.interp(fine, t, voltage))))
    model = replace(nominal.model, domain=replace(nominal.model.domain, dt=1 / rate_hz))
    balance = creep_balance.slow_balance(model, some(thinned(slow, voltage**2, True)), [(-1e6, 1e6)] * 3)
    if balance is None:  # too few windows: allowed for one period of the drive
        assert seconds <= 4
        return
    stiffer = replace(model, coefficients=model.coefficients * jnp.asarray([1.01, 1.0, 1.0], jnp.float32))
    more = creep_balance._moments(stiffer, balance.series) - creep_balance._moments(model, balance.series)
    mean_x = jnp.einsum("wt,wt->w", balance.series.weight[:, 0], balance.series.states[..., 0])
    expected = 0.01 * float(model.coefficients[0]) * np.asarray(mean_x)
    np.testing.assert_allclose(np.asarray(more)[:, 0], expected, rtol=2e-2, atol=2e-5)


def test_what_training_covers_counts_and_nothing_else(nominal, records):
    """The sweep meets the resonance, which the two slowest records do not."""
    data = build_dataset(nominal.model, records[:2], scaling="rms", difference="stencil",
                         memory=lambda states: FadingMemory(jnp.zeros(1)))  # fmt: skip
    long = some(nominal.origin.long_record)
    everything = some(creep_balance.slow_balance(data.model, long, [(-1e3, 1e3)] * 3))
    covered = some(creep_balance.slow_balance(data.model, long, data.region))
    assert np.count_nonzero(covered.scale) < 95 <= np.count_nonzero(everything.scale)
    assert creep_balance.slow_balance(data.model, long, [(-1e-6, 1e-6)] * 3) is None
    low, high = np.array(data.region)[:2].T
    rows = covered.features(data.model)
    assert (rows[:, :2] >= low).all() and (rows[:, :2] <= high).all() and rows.shape[1] == 3


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{"memory": "none"}, {"memory": "elapsed"}, {"refine_steps": 0}])
def test_other_memories_take_no_notice(nominal, records, changes):
    assert (
        _prepared(nominal.model, nominal.origin.long_record, records, replace(PRESETS["default"], **changes))[1] is None
    )
    assert _prepared(nominal.model, nominal.origin.long_record, records, PRESETS["default"])[1] is not None


@pytest.mark.slow
def test_creep_that_outlasts_training_is_learned_from_the_sweep(nominal, records):
    """A minute of a sine after 8 s of training; its last 20 s are 2.9 % off where the nominal keeps no sweep."""
    settings = replace(PRESETS["default"], stages=1, epochs=2, refine_steps=15, width=4, memories=4)
    held_out = sine(0.5, 60, seed=9)
    found = train(nominal, records, settings=settings, key=jax.random.key(0))
    left = predict(found.model, [held_out])[0].displacement - held_out.displacement
    assert found.notes["creep_held_to_s"] == pytest.approx(120, abs=1)
    assert 100 * np.sqrt(np.mean(left[-1000:] ** 2)) < 0.5 * np.ptp(held_out.displacement)

"""Training lowers the error of free runs on drives it never saw, repeats exactly, and ends as it says."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim
from typed import of_kind, untyped

from pitp_jax.common.errors import BadInput, ComputationFailed
from pitp_jax.common.metrics import e_rms_percent, rmse
from pitp_jax.method.effects import effect
from pitp_jax.method.model.drive import DirectDrive, ElectrodeLag
from pitp_jax.method.model.encoder import CompactEncoder, PaperEncoder
from pitp_jax.method.model.input_map import LinearInput
from pitp_jax.method.model.memory import ElapsedTime, FadingMemory
from pitp_jax.method.model.model import linear_model
from pitp_jax.method.model.substeps import substeps
from pitp_jax.method.signal.record import Record
from pitp_jax.method.simulate.devices import records_mesh
from pitp_jax.method.simulate.prediction import at_rate, predict
from pitp_jax.method.train import training
from pitp_jax.method.train.cross_validation import cross_validate
from pitp_jax.method.train.dataset import build_dataset
from pitp_jax.method.train.refine import refine
from pitp_jax.method.train.settings import PRESETS, Settings, firmness_of, with_encoder, with_parts
from pitp_jax.method.train.training import train

DT, SAMPLES = 2e-3, 1000
TIME = np.arange(SAMPLES) * DT
TINY = Settings(width=8, memories=2, epochs=30, stages=2, batch=256, rate=1e-2, refine_steps=0)
QUICK = replace(TINY, epochs=1, stages=1)
KEY = jax.random.key(11)


def duffing(a, hz, peak=2000.0, noise=2e-6, delay=0.0, sensor=0.0):
    """A spring 80 % stiffer at 4 mm: a_0 x (1 + 0.8 (x / 4 mm)^2) + a_1 x' + a_2 x'' = u^2(t - delay); s y' = x - y."""

    def drive(t):
        return peak / 2 * (1 - np.cos(2 * np.pi * hz * np.maximum(t, 0)))

    def slope(t, s):
        spring = a[0] * s[0] * (1 + 0.8 * (s[0] / 4e-3) ** 2)
        lag = (s[0] - s[2]) / sensor if sensor else 0.0
        return [s[1], (drive(t - delay) ** 2 - spring - a[1] * s[1]) / a[2], lag]

    run = solve_ivp(slope, (0, TIME[-1]), [0.0, 0.0, 0.0], t_eval=TIME, rtol=1e-9, atol=1e-12).y
    x = run[2] if sensor else run[0]
    return Record(
        f"{hz} Hz", TIME, drive(TIME), x + noise * np.random.default_rng(int(10 * hz)).standard_normal(SAMPLES)
    )


@pytest.fixture(scope="module")
def plant(linear, coefficients):
    """The model of small motions, three training records, and two held-out ones."""
    a = coefficients(2, 5.0, 0.15)
    held_out = [duffing(a, 2.5), duffing(a, 1.5, 1800.0)]
    return linear(2, 5.0, 0.15, dt=DT), [duffing(a, hz) for hz in (1.0, 2.0, 3.2)], held_out


@pytest.fixture(scope="module")
def first(plant):
    """One training on the equation error."""
    return train(plant[0], plant[1], settings=TINY, key=KEY)


def errors(model, records):
    found = predict(model, records)
    return np.array([rmse(p.displacement, r.displacement) for p, r in zip(found, records, strict=True)])


def leaves(model):
    return jax.tree.leaves(eqx.filter(model, eqx.is_array))


@pytest.mark.slow
def test_equation_error_alone_beats_the_nominal_threefold(plant, first):
    nominal, _, held_out = plant
    assert (errors(first.model, held_out) * 3 < errors(nominal, held_out)).all()
    assert not first.interrupted
    assert isinstance(first.model.drive, DirectDrive)  # no lag that only free runs could have fitted
    assert of_kind(CompactEncoder, first.model.encoder).frugal  # three records behind a square
    assert len(first.history) == 2 and first.history[1]["physics"] <= first.history[0]["physics"]


def test_few_records_behind_a_square_get_a_frugal_encoder(plant):
    """And it is held more firmly the fewer they are; a linear input or many records keep nets that see memories."""
    nominal, records, _ = plant

    def untrained(model, settings):
        data = build_dataset(model, records, scaling="rms", difference="stencil",
                             memory=lambda states: FadingMemory(jnp.zeros(2)))  # fmt: skip
        return with_encoder(data, settings, None, KEY)

    few, enough = untrained(nominal, TINY), untrained(nominal, replace(TINY, few=3))
    straight = untrained(replace(nominal, input_map=LinearInput()), TINY)
    assert [of_kind(CompactEncoder, m.encoder).frugal for m in (few, enough, straight)] == [True, False, False]
    assert [firmness_of(TINY, m, 3) for m in (few, enough, straight)] == [0.02, 1e-4, 1e-3]
    assert firmness_of(TINY, few, 2) == 0.03
    assert firmness_of(replace(TINY, firmness=0.5), few, 3) == 0.5


def test_without_a_spring_no_position_differs_from_another():
    """A moved axis has the tokens of the unmoved one: its network sees no x; with a spring it does."""
    voltage = np.sin(2 * np.pi * TIME) * np.exp(-TIME)

    def randomly_trained(a0):
        a = np.array([a0, 40.0, 2.0])
        nominal = linear_model(a, dt=DT, input_map=LinearInput())
        record = Record("axis", TIME, voltage, lsim(([1.0], a[::-1]), voltage, TIME)[1])
        settings = training._settings_for(None, Settings(), nominal)
        data, _ = training._prepared(nominal, None, [record], settings)
        encoder = with_encoder(data, settings, None, KEY).encoder
        keys = iter(jax.random.split(KEY, 50))
        return data.features[0], jax.tree.map(
            lambda w: w + 0.1 * jax.random.normal(next(keys), w.shape) if eqx.is_inexact_array(w) else w, encoder
        )

    for a0, alike in ((0.0, True), (300.0, False)):
        features, encoder = randomly_trained(a0)
        moved = features + (np.arange(features.shape[1]) != 1)  # x and its lags, not x'
        tokens, elsewhere = (np.asarray(jax.vmap(encoder)(jnp.asarray(f))) for f in (features, moved))
        assert np.allclose(tokens, elsewhere) is alike
        assert np.ptp(tokens, 0).max() > 0.01  # of the velocity


@pytest.mark.exhaustive
def test_a_mesh_of_one_trains_the_same_model(plant):
    """What it shares among devices are its `FreeRuns`, tested on eight in `test_shard`."""
    short = replace(TINY, epochs=2, stages=1, refine_steps=2)
    alone = train(plant[0], plant[1], settings=short, key=KEY).history[-1]
    shared = train(plant[0], plant[1], settings=short, mesh=records_mesh(jax.devices()[:1]), key=KEY).history[-1]
    assert shared["stage"] == "free runs"
    assert shared["error"] == pytest.approx(alone["error"], rel=1e-4)


@pytest.mark.parametrize("word", ["encoder", "memory", "drive", "scaling", "difference"])
def test_an_unknown_word_is_refused(word):
    with pytest.raises(BadInput, match=f"{word} 'typo'"):
        untyped(Settings)(**{word: "typo"})


def test_an_unknown_part_is_refused():
    with pytest.raises(BadInput, match="part 'typo'"):
        Settings(parts=("typo",))


def test_a_delay_of_the_nominal_is_learned_and_no_second_one(linear):
    nominal = replace(linear(2), effects=(effect("delay", time=0.006),))
    started = with_parts(linear(2), nominal, Settings(parts=("delay", "sensor_lag"), drive="direct"))
    assert [e.name for e in started.effects] == ["delay", "sensor_lag"]
    assert float(started.effects[0].time) == pytest.approx(0.006)
    assert float(started.effects[1].tau) == pytest.approx(0.1 / nominal.natural_frequency)


@pytest.mark.slow
def test_a_delay_and_a_sensors_lag_are_learned_with_the_model(plant, coefficients):
    """Both planted in scipy, found by name and number, down to the noise of a drive that was not seen.

    The lag is given in a model of other scales, half of what it is: it stays an effect, as the drag does.
    """
    a, late = coefficients(2, 5.0, 0.15), {"delay": 0.012, "sensor": 0.02}
    records, held_out = [duffing(a, hz, **late) for hz in (1.0, 2.0, 3.2, 7.3)], [duffing(a, 2.5, **late)]
    given = replace(plant[0], effects=(effect("sensor_lag", tau=0.01), effect("drag", c=1e-3)))
    settings = replace(
        TINY, width=4, memories=1, epochs=4, stages=1, refine_steps=25, drive="direct", parts=("delay", "sensor_lag")
    )
    found = train(given, records, settings=settings, key=KEY).model
    assert [e.name for e in found.effects] == ["sensor_lag", "drag", "delay"]
    assert found.scales.state != given.scales.state
    np.testing.assert_allclose([found.effects[2].time, found.effects[0].tau], [0.012, 0.02], rtol=0.1)
    assert errors(found, held_out)[0] < 3e-6  # noise of 2 um; without the two, 191 um are left


@pytest.mark.slow
def test_free_runs_end_at_the_noise(plant):
    nominal, records, held_out = plant
    settings = replace(TINY, epochs=4, stages=1, refine_steps=15)
    seen = []
    found = train(nominal, records, settings=settings, progress=seen.append, key=KEY)
    partial, runs = ([p.loss for p in seen if p.stage == stage] for stage in ("partial runs", "free runs"))
    noise = np.mean([(100 * 2e-6 / np.ptp(r.displacement)) ** 2 for r in records])
    assert runs[-1] < 1.05 * noise < 1.3 * noise < partial[0]
    assert [h["error"] for h in found.history if h["stage"] == "free runs"] == runs[1:]
    assert (errors(found.model, held_out) * 10 < errors(nominal, held_out)).all()
    assert isinstance(found.model.drive, ElectrodeLag)
    assert list(dict.fromkeys(p.stage for p in seen)) == ["stage 1", "short runs", "partial runs", "free runs"]


@pytest.mark.slow
def test_the_nominal_and_the_records_stay(plant, first):
    nominal, records, _ = plant
    again = train(nominal, records, settings=replace(TINY, epochs=1, stages=1), key=KEY)
    assert again.model.order == nominal.order and again.model.hold == nominal.hold
    for model in (again.model, first.model):
        np.testing.assert_allclose(model.physical_coefficients, nominal.physical_coefficients, rtol=1e-6)
    region = np.asarray(first.model.domain.region)
    assert region.shape == (4, 2)
    top = np.max([r.displacement.max() for r in records]) / first.model.scales.state[0]
    assert region[0, 1] == pytest.approx(top, rel=0.02)


@pytest.mark.slow
def test_limits_and_rate_are_those_of_what_was_seen(plant):
    """A sweep at half the voltage bounds nothing that training went beyond; its rate is not that of the records."""
    nominal, records, _ = plant
    swept = replace(nominal.domain, voltage_range=(-5.0, 1000.0), slew=10.0, dt=DT / 2)
    settings = replace(TINY, epochs=1, stages=1)
    found = train(replace(nominal, domain=swept), records, settings=settings, key=KEY).model.domain
    assert found.dt == pytest.approx(DT)
    assert tuple(found.voltage_range) == (-5.0, max(r.voltage.max() for r in records))
    assert found.slew == pytest.approx(2000 * np.pi * 3.2, rel=1e-2)  # of 2000 V (1 - cos) / 2 at 3.2 Hz


@pytest.mark.slow
def test_the_same_key_gives_the_same_model(plant):
    nominal, records, _ = plant
    quick = replace(TINY, epochs=2, stages=1)
    one, two, other = (train(nominal, records, settings=quick, key=jax.random.key(k)).model for k in (1, 1, 2))
    assert all(bool(jnp.array_equal(a, b)) for a, b in zip(leaves(one), leaves(two), strict=True))
    assert any(not bool(jnp.array_equal(a, b)) for a, b in zip(leaves(one), leaves(other), strict=True))


def stop_at(stage):
    def progress(line):
        if line.stage == stage:
            raise KeyboardInterrupt

    return progress


def test_interrupted_before_the_first_stage_there_is_nothing(plant):
    with pytest.raises(KeyboardInterrupt):
        train(plant[0], plant[1], settings=TINY, progress=stop_at("stage 1"), key=KEY)


@pytest.mark.slow
def test_interrupted_later_the_best_so_far_is_kept(plant):
    nominal, records, held_out = plant
    found = train(nominal, records, settings=TINY, progress=stop_at("stage 2"), key=KEY)
    assert found.interrupted and found.notes["interrupted"]
    assert [h["stage"] for h in found.history] == [1]
    assert (errors(found.model, held_out) < errors(nominal, held_out)).all()


@pytest.mark.slow
def test_gaps_are_masked(plant):
    """A fifth of the samples missing: the model is as good (free runs with a gap: `test_refine`)."""
    nominal, records, held_out = plant
    torn = []
    for r in records:
        x = r.displacement.copy()
        x[300:400] = x[640:740] = np.nan
        torn.append(Record(r.name, r.time, r.voltage, x))
    model = train(nominal, torn, settings=TINY, key=KEY).model
    # the domain's limits are no numbers of the fit: those of a nominal that was never limited stay infinite
    fitted = leaves((model.coefficients, model.encoder, model.memory, model.drive))
    assert all(bool(jnp.isfinite(a).all()) for a in fitted if eqx.is_inexact_array(a))
    assert (errors(model, held_out) * 3 < errors(nominal, held_out)).all()


@pytest.mark.slow
def test_what_does_not_move_is_left_out_and_told(plant, first):
    """Weighted by its own range, a sensor that never moved would weigh without end."""
    nominal, records, _ = plant
    noise = 2e-6 * np.random.default_rng(3).standard_normal(SAMPLES)
    still = [Record(name, TIME, np.zeros(SAMPLES), x) for name, x in (("rest", noise), ("dead", 0 * noise))]
    found = train(nominal, [*records, *still], settings=TINY, key=KEY)
    assert found.notes["left_out"] == ("left out, because they show no motion beyond their noise: rest, dead",)
    assert found.notes["records"] == [r.name for r in records]
    for here, there in zip(leaves(found.model), leaves(first.model), strict=True):
        np.testing.assert_array_equal(here, there)
    with pytest.raises(BadInput, match="no recording shows motion"):
        train(nominal, still[1:], settings=TINY, key=KEY)


@pytest.mark.slow
def test_records_coarser_than_the_nominals_get_substeps(plant):
    """Identified at a fine rate, trained on every fourth sample: as many steps as a model identified there takes."""
    nominal, records, _ = plant
    coarse = [Record(r.name, r.time[::4], r.voltage[::4], r.displacement[::4]) for r in records]
    found = train(nominal, coarse, settings=replace(TINY, epochs=1, stages=1), key=KEY).model
    assert found.substeps == substeps(nominal.physical_coefficients, 4 * DT) and found.dt == pytest.approx(4 * DT)
    assert at_rate(found.model, 4 * DT).substeps == found.substeps


def test_nothing_left_to_train_on(plant):
    nominal, records, _ = plant
    x = records[0].displacement.copy()
    x[::8] = np.nan
    with pytest.raises(BadInput, match="no sample of these recordings remains"):
        train(nominal, [Record("sieve", TIME, records[0].voltage, x)], settings=TINY, key=KEY)
    with pytest.raises(BadInput, match="unknown preset 'fast'"):
        train(nominal, records, preset="fast", key=KEY)


@pytest.mark.slow
def test_a_start_that_diverges_costs_that_start_alone(plant, monkeypatch):
    """The first start's free runs diverge: the next one trains. Where all do, and the loss too, the nominal stays."""
    nominal, records, _ = plant
    starts = []

    def lost_once(*given, **how):
        starts.append(given)
        if len(starts) == 1:
            raise ComputationFailed("the free runs diverged")
        yield from refine(*given, **how)

    monkeypatch.setattr(training, "refine", lost_once)
    settings = replace(QUICK, rate=0.5, epochs=3, refine_steps=6, starts=2)  # a loss that ends far away
    found = train(nominal, records, settings=settings, key=KEY)
    assert len(starts) == 2 and found.fallback is None
    assert max(e.trained for e in found.errors) < 0.2 * min(e.nominal for e in found.errors)

    def lost(*given, **how):
        raise ComputationFailed("the free runs diverged")
        yield

    monkeypatch.setattr(training, "refine", lost)
    found = train(nominal, records, settings=replace(settings, rate=1e6), key=KEY)
    assert found.history[0]["diverged"]
    assert all(e.trained <= 1.01 * e.nominal for e in found.errors)


@pytest.mark.slow
def test_oversampled_records_train_on_block_means(plant, monkeypatch):
    """Beyond the budget: the model is as good, and is one for the records' own rate."""
    nominal, records, held_out = plant
    monkeypatch.setattr(training, "_PER_PERIOD", 30)
    monkeypatch.setattr(training, "BUDGET", 2 * SAMPLES)
    found = train(nominal, records, settings=TINY, key=KEY)
    assert found.notes["trained_at_hz"] == pytest.approx(1 / (2 * DT))
    assert (found.model.substeps, found.model.hold) == (nominal.substeps, nominal.hold)
    assert found.model.dt == pytest.approx(DT)
    assert (errors(found.model, held_out) * 5 < errors(nominal, held_out)).all()


@pytest.mark.slow
def test_the_paper_preset(plant):
    nominal, records, held_out = plant
    settings = replace(PRESETS["paper"], epochs=6, stages=1, batch=256)
    found = train(nominal, records, settings=settings, key=KEY)
    assert isinstance(found.model.encoder, PaperEncoder)
    assert isinstance(found.model.memory, ElapsedTime)
    assert isinstance(found.model.drive, DirectDrive)
    assert found.model.memory.horizon == pytest.approx(SAMPLES * DT, rel=1e-6)
    assert (errors(found.model, held_out) < errors(nominal, held_out)).all()
    assert found.history[0]["box"] == pytest.approx([0.8, 1.2])


def after_standstill(r, at=600):
    """The beginning of a record after a rest: 60 % of it stands still."""
    noise = 2e-6 * np.random.default_rng(at).standard_normal(at)
    voltage, x = (
        np.r_[before, v[: SAMPLES - at]] for before, v in ((np.zeros(at), r.voltage), (noise, r.displacement))
    )
    return replace(r, voltage=voltage, displacement=x)


@pytest.mark.slow
def test_bursts_after_standstill_train_where_the_equation_error_diverges(plant):
    """The equation error diverges at once: the free runs, from the nominal, are met nevertheless by the first start."""
    records = [after_standstill(r) for r in plant[1]]
    found = train(plant[0], records, settings=replace(QUICK, rate=0.5, epochs=3, refine_steps=15, starts=1), key=KEY)
    assert not found.problems
    assert found.history[0]["diverged"]
    assert max(e.trained for e in found.errors) < 0.2 * min(e.nominal for e in found.errors)


@pytest.mark.slow
def test_training_that_fails_hands_back_the_nominal(plant):
    """An encoder driven wild by its learning rate: what comes back runs as the nominal does, and says so."""
    nominal, records, _ = plant
    wild = replace(QUICK, rate=3.0, epochs=3)
    found = train(nominal, records, settings=wild, key=KEY)
    assert any("is returned" in line for line in found.problems)
    runs = zip(predict(found.model, records), records, found.errors, strict=True)
    for p, r, e in runs:
        assert e.trained == pytest.approx(e_rms_percent(p.displacement, r.displacement), rel=1e-3)
        assert e.trained <= 1.01 * e.nominal and not e.worse


@pytest.mark.slow
def test_left_out_is_a_split_made_by_hand(plant):
    nominal, records, _ = plant
    records = records[:2]
    whole = train(nominal, records, settings=QUICK, key=KEY).model
    found = cross_validate(nominal, records, whole, settings=QUICK, key=KEY)
    others = train(nominal, records[:1], settings=QUICK, key=KEY).model
    by_hand = [
        e_rms_percent(predict(m, [records[1]])[0].displacement, records[1].displacement) for m in (whole, others)
    ]
    assert [h.name for h in found] == [r.name for r in records]
    np.testing.assert_allclose([found[1].fitted, found[1].predicted], by_hand, rtol=1e-3)


def test_a_split_that_cannot_be_trained_is_told(plant):
    def refuses(records):
        raise BadInput("not identifiable")

    nominal, records, _ = plant
    (one, _) = cross_validate(refuses, records[:2], nominal, settings=QUICK, key=KEY)
    assert one.suspect and one.problem == "not identifiable" and one.predicted == np.inf
    with pytest.raises(BadInput, match="at least two"):
        cross_validate(nominal, records[:1], nominal, settings=QUICK, key=KEY)

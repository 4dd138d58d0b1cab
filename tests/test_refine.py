"""Refinement on free runs: a planted electrode lag is found, nothing else is touched, and a bad start is tamed."""

from dataclasses import replace
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typed import of_kind

from pitp_jax.common.errors import ComputationFailed
from pitp_jax.common.metrics import e_rms_percent
from pitp_jax.method.fit.lower_bound import UNBOUNDED
from pitp_jax.method.fit.parameters import parameters
from pitp_jax.method.model.constants import constant_array
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.encoder import CompactEncoder
from pitp_jax.method.model.memory import FadingMemory
from pitp_jax.method.signal.record import Record
from pitp_jax.method.simulate import prediction
from pitp_jax.method.simulate.decoder import at_rest, rest_state, rollout, rollout_batch
from pitp_jax.method.simulate.prediction import predict
from pitp_jax.method.train import refine as refining
from pitp_jax.method.train.dataset import build_dataset
from pitp_jax.method.train.refine import HeldOut, lower_bound, refine

DT, SAMPLES, TAU = 2e-3, 900, 0.012  # s; 0.4 / omega_0
TIME = np.arange(SAMPLES) * DT


def quiet(*line):
    pass


@pytest.fixture(scope="module")
def plant(linear):
    """The linear actuator without and with the lag, two chirps of it, one with a gap, and a held-out sine."""
    nominal = linear(2, 5.0, 0.15, dt=DT)
    truth = eqx.tree_at(lambda m: m.drive, nominal, ElectrodeLag(jnp.log(jnp.float32(TAU))))
    run = eqx.filter_jit(rollout)

    def record(name, peak, low, high, seed):
        voltage = peak / 2 * (1 - np.cos(2 * np.pi * (low * TIME + (high - low) * TIME**2 / (2 * TIME[-1]))))
        x = np.asarray(run(truth, jnp.asarray(voltage, jnp.float32), DT, rest_state(truth)))[:, 0] * 1e-3
        return Record(name, TIME, voltage, x + 1e-6 * np.random.default_rng(seed).standard_normal(SAMPLES))

    records = [record("up", 1800, 0.5, 8.0, 1), record("down", 1200, 7.0, 0.5, 2)]
    lost = records[0].displacement.copy()
    lost[400:440] = np.nan
    records[0] = replace(records[0], displacement=lost)
    return nominal, records, [record("sine", 1500, 2.0, 2.0, 3)]


@pytest.fixture(scope="module")
def start(plant):
    """What the first stages hand over: data, and a model with a fresh encoder and a lag of a tenth of a radian."""
    nominal, records, _ = plant
    memory = FadingMemory(jnp.log(jnp.asarray([0.06, 0.5, 1.0], jnp.float32)))
    data = build_dataset(nominal, records, scaling="rms", difference="stencil", memory=lambda states: memory)
    low, high = np.asarray(data.region).T
    encoder = CompactEncoder(2, 3, width=4, bounds=np.stack([1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low]),
                             key=jax.random.key(2))  # fmt: skip
    drive = ElectrodeLag(jnp.log(jnp.float32(0.1 / (2 * np.pi * 5))))
    return eqx.tree_at(lambda m: (m.encoder, m.drive), data.model, (encoder, drive)), data


@pytest.fixture(scope="module")
def refined(plant, start):
    """All that one refinement yields and reports."""
    lines = []
    model, data = start
    return list(refine(model, data, HeldOut(plant[1]), 25, lambda *line: lines.append(line))), lines


def error(model, records):
    """Largest e_rms, %."""
    runs = predict(model, records)
    return max(e_rms_percent(p.displacement, r.displacement) for p, r in zip(runs, records, strict=True))


@pytest.mark.slow
def test_a_planted_lag_is_found(plant, start, refined):
    """Tau within 10 %, the error of a free run on a drive never seen cut fivefold."""
    found = refined[0][-1][0]
    assert float(jnp.exp(found.drive.log_tau)) == pytest.approx(TAU, rel=0.1)
    assert error(found, plant[2]) < 0.2 * error(start[0], plant[2])
    assert error(found, plant[1]) < 0.1 * error(start[0], plant[1])


@pytest.mark.slow
def test_every_step_goes_down_and_is_told(refined):
    steps, lines = refined
    assert [e["stage"] for _, e in steps] == sorted((e["stage"] for _, e in steps), reverse=True)
    # no longer windows where these were enough
    assert {e["stage"] for _, e in steps} == {"short runs", "partial runs", "free runs"}
    for stage in ("short runs", "partial runs", "free runs"):
        errors = [e["error"] for _, e in steps if e["stage"] == stage]
        told = [line for line in lines if line[0] == stage]
        assert (np.diff(errors) <= 0).all()
        assert [line[3] for line in told][1:] == errors
        assert told[0][3] >= errors[0]  # the start is told too
        assert [line[1] for line in told] == list(range(len(told)))
        assert len(told) - 1 <= {"short runs": refining._SHORT_STEPS}.get(stage, 25)


@pytest.mark.slow
def test_only_trained_numbers_move(start, refined):
    before, after = start[0], refined[0][-1][0]
    np.testing.assert_array_equal(after.encoder.bounds, before.encoder.bounds)
    np.testing.assert_array_equal(after.coefficients, before.coefficients)
    assert after.scales == before.scales and after.domain == before.domain
    for part in (lambda m: m.encoder.spring_poly, lambda m: m.memory.log_tau, lambda m: m.drive.log_tau):
        assert float(jnp.abs(part(after) - part(before)).max()) > 1e-4


def test_whole_records_weigh_the_same(plant, start):
    """Padded to one length; a record's weights add up to 1e4 / (range^2 records); what is missing has none."""
    model, records = start[0], plant[1]
    holes = records[1].displacement.copy()
    holes[200:300] = np.nan
    short = Record("short", TIME[:600], records[1].voltage[:600], holes[:600])
    (runs,) = refining._free(model, [records[0], short])
    assert runs.voltage.shape == (2, SAMPLES)
    weight, target = np.asarray(runs.weight), np.asarray(runs.target)
    assert (weight[1, 600:] == 0).all() and (weight[1, 200:300] == 0).all() and (weight[1, :200] > 0).all()
    assert np.isfinite(target).all()
    scale = model.scales.state[0]
    spans = [(np.nanmax(x) - np.nanmin(x)) / scale for x in (records[0].displacement, holes[:600])]
    np.testing.assert_allclose(weight.sum(1), 1e4 / np.square(spans) / 2, rtol=0.02)
    assert at_rest(model, runs.start).all()


def test_a_noisy_record_does_not_drown_the_others(plant, start):
    """Two sensors: at 5 % of range noise alone would leave 25, at 0.1 % it leaves 0.01."""
    clean = plant[1][1]
    sigma = 0.05 * np.ptp(clean.displacement)
    noise = sigma * np.random.default_rng(5).standard_normal(SAMPLES)
    noisy = replace(clean, name="noisy", displacement=clean.displacement + noise)
    weight = refining._record_weights(start[0], [clean, noisy])
    span = [np.ptp(r.displacement) / start[0].scales.state[0] for r in (clean, noisy)]
    share = np.square(sigma / np.ptp(noisy.displacement))  # what noise leaves of a range, squared
    assert weight[0] * span[0] ** 2 == pytest.approx(1e4)
    assert weight[1] * span[1] ** 2 * share < 1.5 < 15 < 1e4 * share
    alone = refining._record_weights(start[0], [noisy])
    np.testing.assert_allclose(alone * span[1] ** 2, 1e4, rtol=1e-6)


def test_windows_start_where_the_record_is(plant, start):
    """Every window's first scaled displacement is its filtered state, its last sample still on the record."""
    model, data = start
    runs = refining._windows(model, data, plant[1])
    count, size = runs.target.shape
    assert count == 2 and size == pytest.approx(6 * 0.2 / DT, abs=2)  # one a record
    assert not any(valid[0] for valid in data.valid)
    np.testing.assert_allclose(runs.start[:, 0], runs.target[:, 0], atol=0.02)
    assert not at_rest(model, runs.start).any()
    measured = np.concatenate([r.displacement for r in plant[1]]) / model.scales.state[0]
    known = np.asarray(runs.weight) > 0
    assert 0.9 < known.mean() < 1  # a gap lies in one of them
    assert np.isin(np.asarray(runs.target)[known], measured.astype(np.float32)).all()


@pytest.fixture(scope="module")
def runaway(start):
    """A fast memory that pushes five times as hard as the spring pulls, and no bounds that would stop it."""
    model, _ = start
    wide = 1e6 * jnp.asarray([[-1.0], [1.0]]) * jnp.ones((2, 5))
    push = model.encoder.fading.at[0, 0].set(-5.0 * model.coefficients[0])
    return eqx.tree_at(lambda m: (m.encoder.bounds, m.encoder.fading), model, (constant_array(wide), push))


def lost(model, runs):
    states = np.asarray(rollout_batch(model, runs.voltage, DT, runs.start))[..., 0]
    return not np.isfinite(states).all() or np.abs(states).max() > 100 * float(jnp.abs(runs.target).max())


def how(**changes):
    return refining._How(DT, quiet, 1e-4, None, None, 8)


@pytest.mark.slow
def test_a_diverging_start_is_scaled_down(plant, start, runaway):
    (runs,) = refining._free(runaway, plant[1])
    assert lost(runaway, runs)
    tamed = refining._nearest(runaway, (runs,), how())
    assert not lost(tamed, runs)
    encoder, wild = (of_kind(CompactEncoder, m.encoder) for m in (tamed, runaway))
    assert float(encoder.fading[0, 0] / wild.fading[0, 0]) < 0.5
    np.testing.assert_array_equal(encoder.bounds, wild.bounds)
    found = list(refine(runaway, start[1], HeldOut(plant[1]), 2, quiet))
    assert not lost(found[-1][0], runs)


def test_a_start_is_never_further_off_than_the_nominal(plant, start):
    """Runs that stay finite but are pushed 50 % of range off: nothing of that encoder is worth keeping."""
    pushed = eqx.tree_at(lambda m: m.encoder.spring_poly, start[0], start[0].encoder.spring_poly.at[0, 0].set(3.0))
    free = refining._free(pushed, plant[1])
    before, after = (refining._miss(m, free, how()) for m in (pushed, refining._nearest(pushed, free, how())))
    nominal = eqx.tree_at(lambda m: m.encoder, pushed, pushed.encoder.scaled(0.0))
    assert after <= refining._miss(nominal, free, how()) < 0.5 * before


@pytest.mark.parametrize(("miss", "longer"), [(8.0, 0), (12.0, 1)])
def test_longer_windows_come_where_whole_records_are_far_off(plant, start, monkeypatch, miss, longer):
    """Windows of one period of 0.2 s, then of four, where records of 1.8 s are further off than 10 % of range."""
    sizes = []

    def descend(model, batches, count, stage, how):
        sizes.append((stage, batches[0].target.shape[1]))
        yield model, {"stage": stage}

    monkeypatch.setattr(refining, "_PERIODS", 1.0)
    monkeypatch.setattr(refining, "_descend", descend)
    monkeypatch.setattr(refining, "_nearest", lambda model, batches, how: model)
    monkeypatch.setattr(refining, "_miss", lambda model, batches, how: miss if batches[0].own_zero is not None else 1.0)
    list(refine(start[0], start[1], HeldOut(plant[1]), 1, quiet))
    whole = [("partial runs", SAMPLES), ("free runs", SAMPLES)]
    assert sizes == [("short runs", 100), *[("longer runs", 400)] * longer, *whole]


def test_the_fitted_error_of_a_record_in_motion_is_that_of_its_prediction(plant, start):
    """Both keep the model's sensor offset, here wrong by 0.3 mm, which a fit with offsets of its own would not see."""
    nominal, (_, record), _ = plant
    cut = Record("cut", TIME[:-200], record.voltage[200:], record.displacement[200:] + 3e-4)
    (run,) = predict(nominal, [cut])
    assert run.begins == "moving"
    predicted = e_rms_percent(run.displacement, cut.displacement, run.scored)
    fitted = refining._miss(nominal, refining._free(nominal, [cut]), how(every=1))
    assert fitted == pytest.approx(predicted, rel=1e-3) and predicted > 1.0


def test_a_record_at_rest_by_the_nominal_is_fitted_from_rest(plant):
    """In every fit, also where the model in training explains another start better, as here that of a motion."""
    nominal, (_, record), _ = plant
    cut = Record("cut", TIME[:-200], record.voltage[200:], record.displacement[200:])
    memory = FadingMemory(jnp.zeros(2, jnp.float32))
    data = build_dataset(nominal, [record, cut], scaling="rms", difference="stencil", memory=lambda states: memory)
    assert [b.begins for b in data.begun] == ["rest", "moving"]
    (own,), (given,) = (refining._free(nominal, [cut], known) for known in ((), data.begun[:1]))
    assert np.abs(own.start).max() > 0.1 and not np.asarray(own.weight[0, :20]).any()
    np.testing.assert_array_equal(given.start, 0)
    assert np.asarray(given.weight[0]).all()
    np.testing.assert_allclose(given.target[0] * nominal.scales.state[0], cut.displacement, atol=1e-9)


def test_held_out_blocks_choose_the_model_and_fit_nothing(plant, start, monkeypatch):
    """A third of a record, never its beginning. Of four scores the last fit starts at the least."""
    held_out = HeldOut(plant[1])
    gone = [np.isnan(r.displacement) & o.observed for r, o in zip(held_out.rest, plant[1], strict=True)]
    assert all(0.28 < g.mean() < 0.35 and not g[: SAMPLES // 9].any() for g in gone) and not (gone[0] & gone[1]).any()
    models = [eqx.tree_at(lambda m: m.drive.log_tau, start[0], jnp.float32(k)) for k in range(4)]
    scores = dict(zip(map(float, range(4)), (3.0, 1.0, 2.0, 2.5), strict=True))
    fits = []

    def descend(model, batches, count, stage, how):
        fits.append((stage, float(model.drive.log_tau), batches[0].weight))
        yield from ((m, {"stage": stage}) for m in models if stage == "partial runs")

    monkeypatch.setattr(refining, "_descend", descend)
    monkeypatch.setattr(refining, "_nearest", lambda model, batches, how: model)
    monkeypatch.setattr(refining, "_miss", lambda *_: 1.0)
    monkeypatch.setattr(HeldOut, "score", lambda self, model: scores.get(float(model.drive.log_tau), 9.0))
    steps = list(refine(start[0], start[1], held_out, 9, quiet))
    assert [e["held_out"] for _, e in steps] == [3.0, 1.0, 1.0, 1.0] and steps[-1][0] is models[1]
    (_, _, partial), (stage, tau, whole) = fits[-2:]
    assert (stage, tau) == ("free runs", 1.0)
    assert not (np.asarray(partial) * np.stack(gone)).any() and (np.asarray(whole)[np.stack(gone)] > 0).all()


def test_the_score_is_the_error_on_held_out_blocks(plant, start):
    """By hand: mean log of the mean square, about a reading shifted by 1 mm there alone."""
    held_out = HeldOut(plant[1])
    gone = [np.isnan(r.displacement) & o.observed for r, o in zip(held_out.rest, plant[1], strict=True)]
    runs = predict(start[0], held_out.rest)
    shifted = [replace(r, displacement=r.displacement + 1e-3 * g) for r, g in zip(plant[1], gone, strict=True)]
    squares = [np.mean((p.displacement - r.displacement)[g] ** 2) for p, r, g in zip(runs, shifted, gone, strict=True)]
    assert HeldOut(shifted).score(start[0]) == pytest.approx(np.mean(np.log(squares)), rel=1e-6)
    assert HeldOut(shifted).score(start[0]) > held_out.score(start[0]) + 1


def test_a_score_estimates_no_start_of_a_record_at_rest(plant, start, monkeypatch):
    """The score from the nominal's starts equals that of estimated ones, and asks only for those in motion."""
    held_out, data = HeldOut(plant[1]), start[1]
    estimated = held_out.score(start[0])
    monkeypatch.setattr(prediction, "beginnings", None)
    assert HeldOut(plant[1], data.begun).score(start[0]) == pytest.approx(estimated, rel=1e-6)


@pytest.mark.parametrize(("kept", "steps"), [(0.992, 5), (0.988, 20)])
def test_steps_that_win_little_are_the_last(start, monkeypatch, kept, steps):
    """Five steps that together lower the error by 3.9 % end it, by 5.9 % not."""
    vector = parameters(start[0])[0]
    monkeypatch.setattr(refining, "_problem", lambda *_: SimpleNamespace(errors=None, slopes=None, bound=UNBOUNDED))
    monkeypatch.setattr(refining, "accelerated", lambda *_: ((vector, kept**k, False) for k in range(99)))
    how = refining._How(DT, quiet, 1e-4, None, None, 8)
    assert len(list(refining._descend(start[0], (), 20, "free runs", how))) == steps


def test_no_start_at_all_is_told(plant, start):
    """Where the linear nominal is lost too there is nothing to step down from."""
    broken = eqx.tree_at(lambda m: m.coefficients, start[0], start[0].coefficients * jnp.array([1.0, jnp.nan, 1.0]))
    with pytest.raises(ComputationFailed, match="diverged before refinement"):
        list(refine(broken, start[1], HeldOut(plant[1]), 3, quiet))


@pytest.mark.parametrize(("hz", "every"), [(0.2, 8), (5.0, 8), (20.0, 2), (100.0, 1)])
def test_ten_errors_to_a_period(linear, hz, every):
    assert refining.thinning(linear(2, hz), DT) == every


def test_records_shorter_than_the_filter_still_have_a_window(plant, start):
    """Where no window starts at a valid sample the first record's beginning serves."""
    model, data = start
    nowhere = replace(data, valid=tuple(np.zeros_like(v) for v in data.valid))
    runs = refining._windows(model, nowhere, plant[1])
    assert runs.target.shape[0] == 1 and bool(jnp.isfinite(runs.weight).all())


def squares(net):
    return float(sum(np.sum(np.square(leaf)) for leaf in jax.tree.leaves(eqx.filter(net, eqx.is_array))))


@pytest.mark.slow
def test_firm_nets_stay_small(plant, start):
    """Firmness holds the nets of spring and damping, and nothing else."""
    model, data = start
    ends = (list(refine(model, data, HeldOut(plant[1]), 6, quiet, firmness=f))[-1][0] for f in (1e-4, 1.0))
    loose, firm = (of_kind(CompactEncoder, m.encoder) for m in ends)
    assert squares(firm.spring) < 0.3 * squares(loose.spring)
    assert squares(firm.damping) < 0.3 * squares(loose.damping)
    held = model.encoder.token_nets()
    assert squares(held.spring) > 0 and squares(held.damping) > 0
    assert squares(held.past) == squares(held.spring_poly) == squares(held.fading) == 0


@pytest.mark.slow
def test_where_all_are_too_many_some_run_to_their_end(plant, start, monkeypatch):
    """Half of the budget for whole records, half for the beginnings of the others; each half of the weight."""
    model, records = start[0], [replace(plant[1][0], name=f"r{k}") for k in range(20)]
    for name, value in {"BUDGET": 14 * SAMPLES, "_FEWEST_WHOLE": 6, "_SHORTEST": 300}.items():
        monkeypatch.setattr(refining, name, value)
    long, brief = refining._free(model, records)
    assert long.voltage.shape == (7, SAMPLES)
    assert brief.voltage.shape == (13, 7 * SAMPLES // 13)
    assert float(long.weight.sum()) == pytest.approx(float(brief.weight.sum()), rel=1e-3)
    assert refining.run_samples(records) == SAMPLES
    (whole,) = refining._free(model, records[:6])
    assert whole.voltage.shape == (6, SAMPLES)


@pytest.mark.slow
def test_a_long_record_among_short_ones_runs_to_its_end(plant, start, monkeypatch):
    """Its padding is not charged: sets of like length, each record of the same weight."""
    model, long = start[0], plant[1][1]
    short = [Record(f"r{k}", TIME[:200], long.voltage[:200], long.displacement[:200]) for k in range(10)]
    monkeypatch.setattr(refining, "BUDGET", SAMPLES + 2000)
    monkeypatch.setattr(refining, "_SHORTEST", 100)
    records = [*short[:5], long, *short[5:]]
    assert refining.run_samples(records) == SAMPLES
    whole, brief = refining._free(model, records)
    assert whole.voltage.shape == (1, SAMPLES) and brief.voltage.shape == (10, 200)
    span = [np.ptp(r.displacement) / model.scales.state[0] for r in (long, short[0])]
    np.testing.assert_allclose(whole.weight.sum(1), 1e4 / span[0] ** 2 / 11, rtol=0.02)
    np.testing.assert_allclose(brief.weight.sum(1), 1e4 / span[1] ** 2 / 11, rtol=0.02)


def test_one_short_record_does_not_shorten_the_windows(plant, start):
    model, data = start
    short = Record("short", TIME[:64], plant[1][1].voltage[:64], plant[1][1].displacement[:64])
    more = replace(data, features=(*data.features, data.features[1][:64]), valid=(*data.valid, data.valid[1][:64]))
    among = refining._windows(model, more, [*plant[1], short])
    assert among.voltage.shape == refining._windows(model, data, plant[1]).voltage.shape


@pytest.mark.parametrize(("ring", "lags"), [((), 2), ((60.0, 0.1), 2)])
def test_a_lag_at_its_bound_is_stable_and_a_far_shorter_one_diverges(nonlinear, ring, lags):
    """Runge-Kutta steps of z' = (x - z) / tau grow for a step above 2.79 tau: a quarter of the bound is outside."""
    dt = 5e-3
    model = nonlinear(2, size=0.0, ring=ring, dt=dt)
    numbers, sizes = parameters(model)
    bound = lower_bound(model, sizes, dt / model.substeps)
    bounded = np.isfinite(bound.least)
    assert bounded.sum() == lags and np.exp(bound.least[bounded]) == pytest.approx(dt / model.substeps)
    voltage = jnp.full((3000,), 900.0)

    def ends(factor):
        lag = jnp.asarray(bound.least[bounded] + np.log(factor), jnp.float32)
        changed = eqx.tree_at(lambda m: m.memory.log_tau, model, lag)
        return rollout(changed, voltage, dt, rest_state(changed))[-1]

    assert np.isfinite(ends(1.0)).all() and not np.isfinite(ends(0.25)).all()

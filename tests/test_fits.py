"""The fits of a diagnosis: they find what was planted, without a fold as well, and take zeros and starts out."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from played import DT, FEW, TIME, nominal_of, play
from typed import some

import pitp_jax as pitp
from pitp_jax.method.diagnose import data, fit
from pitp_jax.method.diagnose.data import build_case, excitations
from pitp_jax.method.diagnose.evidence import probability
from pitp_jax.method.diagnose.fit import Fit, Fitter
from pitp_jax.method.diagnose.handing_back import at_their_rate, fitter_of_all, is_steady, stable
from pitp_jax.method.diagnose.library import INDEX, PLACES, bounds, sections, slots_of_row
from pitp_jax.method.diagnose.search import Search
from pitp_jax.method.effects import lookup
from pitp_jax.method.model.domain import Domain
from pitp_jax.method.model.input_map import LinearInput
from pitp_jax.method.model.model import linear_model
from pitp_jax.method.simulate.decoder import rest_state, rollout
from pitp_jax.method.simulate.model_runs import model_runs

GENT = "stiffening: limited chain, curvature"


def effect(name, form, *values):
    return lookup(name, form)(*values)


@pytest.fixture(scope="module")
def nominal(linear):
    return nominal_of(linear)


@pytest.fixture(scope="module")
def stiff(nominal):
    """A case with a Gent-like spring of 1 / L = 0.25."""
    planted = replace(nominal, effects=(effect("stiffening", "limited chain", jnp.asarray(0.25)),))
    return build_case(nominal, play(planted))


def test_a_fit_finds_the_number_that_was_planted(stiff):
    slots = stiff.nominal.copy()
    slots[INDEX[GENT]] = 0.4
    (found,) = Fitter(stiff).fit([Fit(("spring",), (GENT,), slots, stiff.starts.copy())], 15)
    assert found.value(GENT) == pytest.approx(0.25, rel=1e-2)  # another integrator at 50 steps a period
    rms = [np.sqrt(np.nanmean(r**2)) for r in found.residuals]
    assert max(rms) < 3 * max(s.noise for s in stiff.series) + 1e-3


def test_what_is_handed_back_is_fitted_to_every_sample(nominal, monkeypatch):
    """Dry friction is found to 1 in 100,000 from all samples; means of more than ten are off by over 1 in 10,000."""
    row, dt, time = lookup("coulomb_friction", "Coulomb"), 1e-3, np.arange(12_000) * 1e-3
    (level,), plain = slots_of_row(row), replace(nominal, domain=replace(nominal.domain, dt=dt))
    model = replace(plain, effects=(row(jnp.asarray(0.05)),))
    u = 800 + 500 * np.sin(0.6 * np.pi * time) * np.sin(0.26 * np.pi * time + 1)
    start = np.asarray(rest_state(model), np.float64)[None]
    x = float(model.scales.state[0]) * model_runs(model, u[None], dt, start)[1][0]
    monkeypatch.setattr(data, "THINNED_SAMPLES", 600)
    case = build_case(plain, [pitp.Record("slow", time, u, x)])
    slots = case.nominal.copy()
    slots[INDEX[level]] = 0.03
    start = Fit(("coulomb_friction",), (level,), slots, case.starts.copy())
    (fit,) = Fitter(case).fit([start.again()], 20)
    whole = at_their_rate(fit, fitter_of_all(case, Fitter(case)))
    assert case.thinned > 10 and whole.value(level) == pytest.approx(0.05, rel=1e-5)
    assert fit.value(level) != pytest.approx(0.05, rel=1e-4)
    bounded = Fitter(case)
    bounded.bounds = {level: (0.0, 0.04)}
    assert at_their_rate(start, fitter_of_all(case, bounded)).value(level) == pytest.approx(0.04)


@pytest.mark.slow
def test_out_of_fold_no_record_is_seen_by_its_own_fit(stiff):
    """Residuals without a record are those of a fit to the others alone."""
    fitter, slots = Fitter(stiff), stiff.nominal.copy()
    slots[INDEX[GENT]] = 0.3
    start = Fit(("spring",), (GENT, "a0"), slots, stiff.starts.copy())
    (whole,) = fitter.fit([start.again()], 15)
    (rows,), _ = fitter.refitted_without([whole], 6)
    (alone,) = fitter.fit([start.again(fold=0)], 15)
    ((_, residuals, _),) = fitter.evaluate([alone], [alone.slots], everything=True)
    for k in stiff.folds[0]:
        np.testing.assert_allclose(rows[k], residuals[k], atol=1e-3 * stiff.series[k].span)


def test_simulations_are_counted_and_blocks_of_them_change_nothing(stiff, monkeypatch):
    """Three fits of two numbers: one run of every record each, then three more for the slopes."""
    slots = stiff.nominal.copy()
    slots[INDEX[GENT]] = 0.3
    start = Fit(("spring",), (GENT, "a0"), slots, stiff.starts.copy())

    def fitted():
        fitter = Fitter(stiff)
        fits = fitter.fit([start.again() for _ in range(3)], 0)
        fitter.differentiate(fits)
        return fits, fitter.budget.simulated_steps

    whole, steps = fitted()
    samples = sum(len(s.output) for s in stiff.series) * stiff.simulator.substeps
    assert steps == 3 * (1 + 3) * samples
    monkeypatch.setattr(fit, "_SAMPLES_AT_ONCE", 1)
    parts, again = fitted()
    assert again == steps
    for a, b in zip(whole, parts, strict=True):
        assert a.cost == pytest.approx(b.cost, rel=1e-9)
        for one, other in zip(some(a.jacobian), some(b.jacobian), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-6 * np.abs(one).max())


def test_a_number_does_not_fall_below_its_lowest(stiff):
    slots = stiff.nominal.copy()
    slots[INDEX[GENT]] = 0.5
    fitter = Fitter(stiff)
    fitter.bounds = {GENT: (0.4, np.inf)}  # 0.25 was planted
    (found,) = fitter.fit([Fit(("spring",), (GENT,), slots, stiff.starts.copy())], 15)
    assert found.value(GENT) == pytest.approx(0.4)


def test_a_refused_step_does_not_leave_a_fold_where_it_has_seen_what_it_is_judged_on(stiff, monkeypatch):
    """The first moves of every fold are thrown far off: what it ends at is its own optimum all the same."""
    fitter, slots = Fitter(stiff), stiff.nominal.copy()
    (whole,) = fitter.fit([Fit((), ("a0",), slots, stiff.starts.copy())], 6)
    (wanted,), _ = fitter.refitted_without([whole], 3)
    move = Fitter._move
    far = {True: 3.0, False: 0.0}
    monkeypatch.setattr(Fitter, "_move", lambda self, fit: move(self, fit) + far[fit.descent.damping < 0.05])
    (found,), _ = fitter.refitted_without([whole], 3)
    for rows, other, seen in zip(found, wanted, whole.residuals, strict=True):
        apart = np.nanmax(np.abs(rows - other))
        assert apart < 0.2 * np.nanmax(np.abs(other - seen))


def test_every_sample_is_judged_once_by_a_fit_that_has_not_seen_it(nominal):
    played = play(nominal)
    for records in (1, 2, 3, 4):
        case = build_case(nominal, played[:records])
        judged = [np.zeros(len(s.output), int) for s in case.series]
        for fold in range(len(case.folds)):
            for count, tested, seen in zip(judged, case.tested(fold), case.masks(fold), strict=True):
                count += tested
                assert not (tested & (seen > 0)).any()
        assert len(case.folds) >= 4 and all((n == s.counts).all() for n, s in zip(judged, case.series, strict=True))


@pytest.mark.slow
def test_numbers_that_differ_from_record_to_record_are_told_by_a_model_of_each(nominal):
    """Springs of 1.4 and 0.7: no numbers shared by two records leave what those of each do."""
    played = [play(nominal.changed(np.array([k, 1.0, 1.0])))[n] for n, k in enumerate((1.4, 0.7))]
    search = Search(build_case(nominal, played), refit=False)
    alone = search.each_alone()
    assert alone is not None and probability(alone.bare, search.linear.evidence.bare, 0.5) >= 0.9
    same = Search(build_case(nominal, play(nominal)[:2]), refit=False)
    alone = same.each_alone()
    assert alone is not None and probability(alone.bare, same.linear.evidence.bare, 0.98) < 0.9


@pytest.mark.slow
def test_coefficients_that_have_not_moved_are_the_nominals(nominal):
    search = Search(build_case(nominal, play(nominal.changed(np.array([1.3, 1.0, 1.0])))), refit=False)
    assert set(search.linear.fit.free) == {"a0", "a1", "a2"}
    search.fewer_moved()
    (moved,) = search.level(1)
    assert moved.fit.free == ("a0",)
    assert moved.fit.value("a0") == pytest.approx(1.3 * search.case.nominal[INDEX["a0"]], rel=1e-2)


@pytest.mark.slow
def test_names_are_measured_against_the_nominal_where_a_refit_is_worse(nominal):
    """Four records, four springs: a fit to three is farther from the fourth than the nominal between them.

    With names measured against such a refit, one that only mended it was said while nothing could be handed back.
    """
    played = [play(nominal.changed(np.array([k, 1.0, 1.0])))[n] for n, k in enumerate((1.3, 1.1, 0.9, 0.7))]
    search = Search(build_case(nominal, played), refit=True)
    assert search.linears[0].rms > 1.2 * search.given.rms
    assert search.base.rms == search.given.rms
    assert set(search.base.fit.free) >= {"a0", "a1", "a2"}  # effects are fitted with the coefficients all the same


@pytest.mark.slow
def test_friction_under_load_is_recovered_from_a_joint_with_two_loads(nominal):
    """Planted at 0.2, 0.1 and a give of 0.05, in two records; one transmits six times the force."""
    row = lookup("coulomb_friction", "bristles under load")
    planted = replace(nominal, effects=(row(0.2, 0.1, 0.05),), substeps=8)
    swing = 0.6 * np.sin(2 * np.pi * 0.7 * TIME) + 0.3 * np.sin(2 * np.pi * 1.9 * TIME)
    records, rng = [], np.random.default_rng(1)
    for load in (1e5, 6e5):
        u = np.sqrt(load * (1 + swing))
        states = rollout(planted, jnp.asarray(u, jnp.float32), DT, rest_state(planted))
        x = np.asarray(states[:, 0], float) * nominal.scales.state[0] + 2e-7 * rng.standard_normal(len(u))
        records.append(pitp.Record(f"{load:g}", TIME + 10 * len(records), u, x))
    case = build_case(nominal, records)
    slots = case.nominal.copy()
    slots[PLACES[row]] = 0.1, 0.03, 0.02
    (found,) = Fitter(case).fit([Fit(("coulomb_friction",), slots_of_row(row), slots, case.starts.copy())], 25)
    np.testing.assert_allclose(found.slots[PLACES[row]], (0.2, 0.1, 0.05), rtol=0.03)


def test_a_moved_zero_is_no_part_of_a_residual(nominal):
    """A sensor that was zeroed elsewhere in one record leaves the same residuals."""
    records = play(nominal, noise=0.0)
    moved = [replace(r, displacement=r.displacement + 3e-4 * (k == 2)) for k, r in enumerate(records)]
    rms = []
    for given in (records, moved):
        case = build_case(nominal, given)
        (plain,) = Fitter(case).fit([Fit((), (), case.nominal.copy(), case.starts.copy())], 0)
        rms.append([np.sqrt(np.nanmean(r**2)) for r in plain.residuals])
    np.testing.assert_allclose(rms[1], rms[0], atol=2e-4)


def test_a_record_that_begins_in_motion_has_its_first_state_fitted(nominal):
    records = [
        replace(r, time=r.time[333:], voltage=r.voltage[333:], displacement=r.displacement[333:]) for r in play(nominal)
    ]
    case = build_case(nominal, records)
    assert "moving" in {s.begins for s in case.series}
    (plain,) = Fitter(case).fit([Fit((), (), case.nominal.copy(), case.starts.copy())], 0)
    for s, r in zip(case.series, plain.residuals, strict=True):
        assert np.sqrt(np.nanmean(r**2)) < 5e-3 * s.span


def test_the_start_of_a_single_record_is_no_part_of_what_its_first_block_is_judged_on(nominal):
    """Cut in motion; left out of the fit, the first block tells the start all the same, which dies out within it."""
    (sweep, *_) = play(nominal)
    cut = replace(sweep, time=sweep.time[333:], voltage=sweep.voltage[333:], displacement=sweep.displacement[333:])
    case = build_case(nominal, [replace(cut, name="alone")])
    assert case.blocks and case.series[0].begins == "moving"
    case = replace(case, simulator=replace(case.simulator, substeps=16))  # the core's own responses to 1e-9
    fitter = Fitter(case)
    (plain,) = fitter.fit([Fit((), (), case.nominal.copy(), case.starts.copy())], 0)
    ((rows,),), _ = fitter.refitted_without([plain], 0)
    np.testing.assert_allclose(rows, plain.residuals[0], atol=1e-9)


@pytest.mark.parametrize(
    ("roots", "core", "lag", "filtered"),
    [
        ([-1 + 9j, -1 - 9j, -50], [-1 + 9j, -1 - 9j], 1 / 50, None),
        ([-2, -5, -80], [-2, -5], 1 / 80, None),
        ([-1 + 9j, -1 - 9j, -4 + 60j, -4 - 60j], [-1 + 9j, -1 - 9j], 0.0, True),
    ],
)
def test_a_nominal_of_high_order_is_its_dominant_pair_and_what_follows(roots, core, lag, filtered):
    a = np.real(np.poly(roots))[::-1] * 3.0
    found, tau, second = sections(a)
    assert found[0] == pytest.approx(a[0]) and tau == pytest.approx(lag)
    np.testing.assert_allclose(
        sorted(np.roots(found[::-1]), key=lambda p: (p.real, p.imag)),
        sorted(core, key=lambda p: (np.real(p), np.imag(p))),
    )
    assert (second is not None) == bool(filtered)
    s = 7j
    rest = (1 + tau * s) * ((second[0] * s) ** 2 + 2 * second[1] * second[0] * s + 1 if second else 1)
    assert np.polyval(found[::-1], s) * rest == pytest.approx(np.polyval(a[::-1], s))


def test_distinct_excitations_are_counted(nominal):
    records = play(nominal, noise=0.0)
    assert excitations(build_case(nominal, records)) >= 4
    one = [replace(records[2], name=f"same{k}") for k in range(3)]
    assert excitations(build_case(nominal, one)) <= 2


def test_oversampled_records_are_thinned_and_the_mode_stays_resolved(nominal):
    case = build_case(nominal, play(nominal, noise=0.0))
    assert case.thinned >= 1 and case.dt * 5.0 < 1 / 16
    fine = [
        replace(
            r,
            time=np.arange(8 * len(r.time)) * 5e-4,
            voltage=np.repeat(r.voltage, 8),
            displacement=np.repeat(r.displacement, 8),
        )
        for r in play(nominal, noise=0.0)[:2]
    ]
    assert build_case(nominal, fine).thinned > case.thinned


@pytest.mark.parametrize("samples", range(3000, 3009))
def test_drive_and_motion_have_as_many_thinned_samples(nominal, samples, monkeypatch):
    """Whatever is left over at the end, and whether the mean is over an even or an odd number."""
    monkeypatch.setattr(data, "THINNED_SAMPLES", 600)
    time = np.arange(samples) * 1e-3
    for factor in (1.0, 1.3):
        u = 300 + 200 * np.sin(2 * np.pi * factor * 2.0 * time)
        case = build_case(nominal, [pitp.Record("fine", time, u, 1e-3 * np.sin(time))])
        assert case.thinned > 1 and len(case.simulator.drives[0].voltage) == len(case.series[0].output)


def test_a_long_record_is_seen_to_its_end(nominal):
    """300,000 samples: the first 240,000 were once diagnosed as if they were all."""
    time = np.arange(300_000) * 1e-4
    record = pitp.Record("long", time, 300 + 200 * np.sin(2 * np.pi * 2.0 * time), 1e-3 * np.sin(time))
    case = build_case(nominal, [record])
    assert len(case.series[0].output) * case.dt == pytest.approx(30.0, abs=2 * case.dt)
    seen = case.series[0].output
    there = np.sin(np.linspace(0.0, 30.0, len(seen)))
    assert abs(np.corrcoef(seen[5:-5], there[5:-5])[0, 1]) > 0.99  # cut at 24 s: near nothing


def test_what_a_session_has_stretched_stays_stretched(nominal):
    """Mullins: the second record begins where the first one went; the model carries it, and so does what judges it."""
    softened = replace(nominal, effects=(lookup("mullins", "exponential")(0.3, 0.5),))
    records = play(softened, noise=0.0)[:2]
    case = build_case(nominal, records)
    slots = case.nominal.copy()
    slots[PLACES[lookup("mullins", "exponential")]] = 0.3, 0.5
    mine = case.simulator.run(np.tile(slots, (2, 1)), [0, 1], case.starts)[1]
    truth = pitp.predict(softened, records)[1].displacement / nominal.scales.state[0]
    fresh = pitp.predict(softened, records[1:])[0].displacement / nominal.scales.state[0]
    assert case.thinned == 1 and np.std(mine - truth) < 0.4 * np.std(fresh - truth)


def test_a_law_of_acceleration_starts_where_the_records_reach_it(nominal):
    """x'' >= -g with g at 0.6 of the fall that the 4 % quantile shows: the best of its starts is near."""
    healthy = build_case(nominal, play(nominal))
    scale = Search(healthy, False).scale
    (p,) = lookup("slack", "free fall").parameters
    inverse = scale.stored(p) / (0.6 * scale.fall)
    case = build_case(nominal, play(replace(nominal, effects=(effect("slack", "free fall", jnp.asarray(inverse)),))))
    search = Search(case, False)
    starts = [search._started(search.base.fit, form) for form in search.library if form.name == "slack"]
    best = min(search.fitter.fit(starts, 8), key=lambda f: f.cost)
    assert best.value("slack: free fall, inverse") == pytest.approx(inverse, rel=0.1)


@pytest.mark.parametrize(("hz", "hold"), [(2.0, "foh"), (25.0, "bandlimited")])
def test_a_band_limited_input_is_a_line_where_samples_are_dense(nominal, hz, hold):
    """125 and 10 samples a period; what is handed back keeps the nominal's own input."""
    model = replace(nominal, hold="bandlimited")
    drive = {"sine": 600 + 350 * np.sin(2 * np.pi * hz * TIME)}
    case = build_case(model, play(model, inputs=drive, noise=0.0))
    assert case.simulator.model.hold == hold and case.model.hold == "bandlimited"


@pytest.mark.parametrize("gain", [-0.09, 0.12])
def test_a_gain_of_either_sign_is_foreseen(nominal, gain):
    """From a start of the other sign one step ends halfway, and twelve other effects were fitted instead."""
    records = play(replace(nominal, effects=(effect("sensor_gain", "share", jnp.asarray(gain)),)), noise=0.0)
    search = Search(build_case(nominal, records), False)
    starts = [search._started(search.base.fit, form) for form in search.library if form.name == "sensor_gain"]
    costs = search.fitter.foreseen(starts, [search.base.fit] * len(starts))
    before = search.fitter._cost(search.base.fit.residuals, fit.PREVIEW)
    samples = sum(rows.sum() for rows in search.case.screened())
    assert np.exp((min(costs) - before) / samples) < 1e-3  # of the mean square error


def test_a_returned_model_takes_steps_that_its_friction_can_follow():
    """A finger at 60 Hz behind its valve: steep friction chatters at two steps a sample, and rounding grows."""
    steep = linear_model(
        np.array([107.0, 7.0, 0.587, 0.0158]), input_map=LinearInput(), state_scale=np.array([0.7, 4.1, 54.0, 790.0]),
        force_scale=120.0, domain=Domain(1 / 60), hold="zoh", substeps=2,
    )  # fmt: skip
    steep = replace(steep, effects=(effect("coulomb_friction", "smooth", jnp.asarray(0.043), jnp.asarray(8e-4)),))
    time = np.arange(1500) / 60
    drive = 60 * (1 - np.cos(2 * np.pi * (0.1 + 0.05 * time) * time))
    x = model_runs(replace(steep, substeps=32), drive[None], 1 / 60, np.asarray(rest_state(steep))[None])[1][0]
    y = 0.7 * (x + 1e-3 * np.random.default_rng(0).standard_normal(len(x)))
    records = [pitp.Record("r", time, drive, y)]
    made, errors = stable(steep, records, np.inf)
    assert (
        not is_steady(steep, records) and is_steady(made, records) and made.substeps > 2 and np.isfinite(errors).all()
    )


def test_a_held_input_is_held_at_the_rate_of_the_recordings(linear):
    """A nominal of 50 Hz beside recordings of 200 Hz: half a sample of the delay is theirs, so only noise is left."""
    held = replace(linear(hz=2.5, dt=0.02, hold="zoh"), substeps=4)
    volts = 300 * (1 - np.cos(2 * np.pi * (0.2 + 0.5 * TIME) * TIME))
    x = model_runs(held, volts[None], 5e-3, np.asarray(rest_state(held))[None])[1][0] * held.scales.state[0]
    noise = 1e-3 * np.std(x)
    rngs = [np.random.default_rng(k) for k in range(4)]
    records = [pitp.Record(f"r{k}", 5e-3 * np.arange(len(x)), volts, x + noise * g.standard_normal(len(x)))
               for k, g in enumerate(rngs)]  # fmt: skip
    search = Search(build_case(held, records), False)
    assert search.given.rms * held.scales.state[0] < 1.2 * noise


@pytest.mark.slow
def test_a_model_handed_back_has_the_offset_of_its_free_runs(nominal):
    """Every recording begins in motion, with an offset of 0.4 mm that the nominal does not have."""
    real = replace(nominal, effects=(effect("stiffening", "cubic", jnp.asarray(0.3)),))
    records = [pitp.Record(r.name, r.time[301:], r.voltage[301:], r.displacement[301:] + 4e-4) for r in play(real)]
    found = pitp.diagnose(nominal, records, exclude=FEW)
    assert found.effects == ("stiffening",) and found.model.model.output.offset == pytest.approx(4e-4, abs=2e-5)


def test_times_are_those_of_a_plant_without_a_spring(linear):
    """a_2 x'' + a_1 x' = F with a spring of rounding: the unit of time is a_2 / a_1; no memory outlasts it all."""
    real = linear(2, hz=1e-4, damping=2e3, dt=5e-3)  # real poles at 1.6e-7 and 2.5 rad/s
    real = replace(real, input_map=LinearInput())
    time = np.arange(4000) * 5e-3
    volts = 100 * np.sin(2 * np.pi * 0.3 * time)
    x = model_runs(real, volts[None], 5e-3, np.asarray(rest_state(real))[None])[1][0] * real.scales.state[0]
    scale = Search(build_case(real, [pitp.Record("r", time, volts, x + 1e-9)]), False).scale
    a = real.physical_coefficients
    assert scale.tau == pytest.approx(a[2] / a[1], rel=0.05)
    times = {k: high for k, (_, high) in bounds(scale).items() if k.endswith(", tau")}
    assert times and max(times.values()) == pytest.approx(10 * 20.0, rel=0.01)

"""What a diagnosis is made of: the split, the noise floor, the screening filter, and fits that reach their numbers."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from played import DT, HZ, SAMPLES, TIME, nominal_of, play
from scipy.signal import lfilter

import pitp_jax._diagnose.fit as fitting
from pitp_jax._diagnose.batched_rollouts import Lane, Lanes
from pitp_jax._diagnose.case import build_case, split
from pitp_jax._diagnose.effect_responses import nominal_filter, responses
from pitp_jax._diagnose.effect_selection import Attribution, _part_of_a_change
from pitp_jax._diagnose.evaluation import Judged, sides
from pitp_jax._diagnose.fit import Candidate, fit
from pitp_jax._diagnose.noise import estimate
from pitp_jax._diagnose.regress import singles
from pitp_jax._diagnose.result import Gap
from pitp_jax._diagnose.screen import screen
from pitp_jax._diagnose.verdict import verdict
from pitp_jax._effects import CATALOGUE, effect, lookup
from pitp_jax._record.excitation_kind import kind


@pytest.fixture(scope="module")
def nominal(linear):
    return nominal_of(linear)


@pytest.mark.slow
def test_kinds_and_the_split(nominal):
    records = play(nominal)
    assert [kind(r) for r in records] == ["sweep", "broadband", "sine", "sine", "sine", "sine", "steps"]
    assert split(records) == {"sweep", "sine0", "sine2", "steps"}
    assert split(records, "second") == {"sweep", "sine1", "sine3", "steps"}
    assert split(records, "none") == {r.name for r in records}
    each = records[:2]  # a sweep and a multisine, one of either kind
    assert split(each) == {"sweep"} and split(each, "second") == {"multisine"}
    assert split(records[:1], "second") == {"sweep"}
    fitted, held = sides(build_case(nominal, records))
    assert not set(fitted) & set(held) and len(fitted) + len(held) == 7


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_the_noise_floor_is_that_of_the_noise(nominal, colour):
    """Beside a gap of lines: white within 10 %; AR(0.9), steep within a band of these short records, within 20 %."""
    case = build_case(nominal, play(nominal, noise=0.0))
    rng, errors = np.random.default_rng(1), []
    for k, s in enumerate(case.series):
        e = lfilter([1.0], [1.0, -colour], rng.standard_normal(SAMPLES)) * np.sqrt(1 - colour**2) * 1e-3
        gap = 0.05 * np.sin(2 * np.pi * (0.5 + k) * TIME) if k > 1 else 0.0
        errors.append(e + gap + 0.0 * s.run)
    found = estimate(case, errors)
    assert found.sigma == pytest.approx(1e-3, rel=0.2 if colour else 0.1)
    assert found.sensor == pytest.approx(found.sigma, rel=0.05)


def test_what_was_simulated_without_noise_has_the_floor_of_its_rounding(nominal):
    case = build_case(nominal, play(replace(nominal, substeps=4), noise=0.0))
    errors = [s.error for s in case.series]
    found = estimate(case, errors)
    assert 0 < max(np.std(e) / s.span for e, s in zip(errors, case.series, strict=True)) < 1e-5
    low = found.floor_percent(min(s.span for s in case.series))
    assert low == pytest.approx(1e-3)
    bare = Judged(Candidate((), (), (), np.ones(3), False), tuple(errors), 3e-4, 3e-4)
    gap = Gap(3e-4, 3e-4, 3e-4, low, "", None, None)
    assert verdict(gap, Attribution(bare, bare, (bare,), (), bare, (), (), found), 1.0) == "no_gap"


@pytest.mark.parametrize(
    ("own", "name"), [(1.0, "parameter_change"), (1.05, "sensor_gain"), (np.inf, "parameter_change")]
)
def test_what_the_nominal_left_before_is_no_change_of_it(own, name):
    """Beside a floor of 0.291 %, all coefficients leave 0.292 and one gain 0.306: the nominal was a twentieth off."""
    ones = np.ones(3)
    changed = Judged(Candidate((), (), (), ones, True), (), 0.29, 0.292)
    gain = Judged(Candidate((lookup("sensor_gain"),), ((0.1,),), (), ones, False), (), 0.3, 0.306)
    spring = Judged(Candidate((lookup("stiffening"),), ((0.1,),), (), ones, False), (), 0.3, 0.3)
    assert _part_of_a_change(changed, [changed, gain, spring], 0.291, own).names == (name,)
    assert _part_of_a_change(spring, [changed, gain, spring], 0.291, own) is spring


def test_the_screening_filter_is_the_nominal(nominal):
    """Its response to a force linear between samples is the rollout's, and the transfer function the same recursion."""
    nominal = nominal.changed(np.array([1.2, 0.9, 0.8]))  # no two coefficients alike in its coordinates
    case = build_case(nominal, play(nominal, noise=0.0))
    s = case.series[0]
    f, x = nominal_filter(nominal, DT), np.zeros(2)
    found = [0.0]
    for before, after in zip(s.force[:-1], s.force[1:], strict=True):
        x = f.a @ x + f.b * before + f.c * after
        found.append(x[0])
    np.testing.assert_allclose(found, s.run, atol=2e-3 * s.span)  # the square of a linear voltage is not linear
    step = np.where(np.arange(SAMPLES) > 5, s.force, 0.0)
    slow, x = [0.0], np.zeros(2)
    for before, after in zip(step[:-1], step[1:], strict=True):
        x = f.a @ x + f.b * before + f.c * after
        slow.append(x[0])
    np.testing.assert_allclose(responses(nominal, DT, step[:, None])[:, 0], slow, atol=1e-9 * s.span)


def test_a_number_far_from_its_start_is_reached(nominal):
    """120 V away: steps are limited in shares of the bounds, not in volts."""
    offset = lookup("voltage_offset")
    case = build_case(nominal, play(replace(nominal, effects=(offset(jnp.asarray(150.0)),))))
    begin = Candidate((offset,), ((30.0,),), (offset.start(case.surroundings)[0],), np.ones(3), False)
    (found,) = fit(Lanes(case, [(offset,)]), [begin])
    assert found.values[0][0] == pytest.approx(150.0, abs=0.5)


def test_a_start_that_diverges_is_left_where_it_is(nominal, monkeypatch):
    """In silence (warnings are errors here) though float32 left inf where it overflowed, beside one that is fitted."""
    coupling = next(c for c in CATALOGUE if c.form == "quadratic" and c.name == "stretch_coupling")
    case = build_case(nominal, play(nominal))
    (start, _) = coupling.start(case.surroundings)
    begin = [Candidate((coupling,), ((b,),), (start,), np.ones(3), False) for b in (12 / case.surroundings.reach, 0.02)]
    finite = fitting.residuals
    overflowed = lambda *a: [[np.where(np.isnan(r), np.inf, r) for r in rows] for rows in finite(*a)]  # noqa: E731
    monkeypatch.setattr(fitting, "residuals", overflowed)
    wild, tame = fit(Lanes(case, [(coupling,)]), begin)
    assert wild.train == np.inf and wild.values == begin[0].values
    assert tame.train < 0.2 and abs(tame.values[0][0]) < 0.01


@pytest.mark.slow
def test_a_refit_starts_where_the_screening_saw_the_coefficients(nominal):
    """Beside the effect, in both: a nominal 25 % too soft and 20 % too light starts within 3 %, not at what it is."""
    truth = np.array([1.25, 0.9, 1.2])
    form = lookup("stiffening")
    stiff = replace(nominal.changed(truth), effects=(form(jnp.asarray(0.3)),))
    case = build_case(nominal, play(stiff))
    found = next(s for s in singles(screen(case, (form,), np.ones(3), refit=True)) if s.forms == (form,))
    np.testing.assert_allclose(found.factors, truth, rtol=0.03)
    again = screen(build_case(nominal.changed(truth), play(stiff)), (form,), truth, refit=True)
    np.testing.assert_allclose(singles(again)[0].factors, truth, rtol=0.01)
    alone = screen(case, (form,), np.ones(3), refit=False)
    assert (singles(alone)[0].factors == 1).all()


def test_what_cannot_come_near_is_given_up(nominal):
    """A gain beside a drag of 14 %: fitted to its end where nothing is better, dropped early where something was."""
    form = lookup("sensor_gain")
    case = build_case(nominal, play(replace(nominal, effects=(effect("voltage_offset", offset=150.0),))))
    begin = Candidate((form,), ((0.3,),), (form.start(case.surroundings)[0],), np.ones(3), True)
    steps, left = {}, {}
    for beat in (np.inf, 1e-6):
        told = []
        (found,) = fit(Lanes(case, [(form,)]), [begin], beat=beat, progress=lambda k, b, told=told: told.append(k))
        steps[beat], left[beat] = len(told), found.train
    assert steps[1e-6] == 4 < steps[np.inf]
    assert left[np.inf] <= left[1e-6] < 4 * left[np.inf]


@pytest.mark.slow
def test_a_lane_is_the_same_in_any_group(nominal):
    """Alone, or in a composite with all forms of other names; a drive that is late among them."""
    case = build_case(nominal, play(nominal))
    drag = next(c for c in CATALOGUE if c.name == "drag")
    forms = (lookup("delay"), lookup("voltage_offset"), lookup("stiffening"), drag)
    jobs = [Lane((f,), (f.start(case.surroundings)[0].values,), np.ones(3), k) for f in forms for k in (0, 3, 6)]
    jobs += [Lane((drag, lookup("delay")), (jobs[-1].values[0], jobs[0].values[0]), np.ones(3), 1)]
    jobs += [Lane((), (), np.array([1.1, 1.0, 0.9]), 2)]
    together = Lanes(case, [forms]).run(jobs)
    apart = Lanes(case, [*[(f,) for f in forms], (drag, lookup("delay"))]).run(jobs)
    for a, b, job in zip(together, apart, jobs, strict=True):
        s = case.series[job.series]
        np.testing.assert_allclose(b, a, atol=3e-6 * s.span)
        assert np.abs(a - s.run).max() > 1e-2 * s.span


def test_a_long_delay_is_read(nominal):
    """Two thirds of a period of the resonance."""
    case = build_case(nominal, play(replace(nominal, effects=(effect("delay", time=0.13),))))
    starts = lookup("delay").start(case.surroundings)
    fitted = fit(
        Lanes(case, [(lookup("delay"),)]),
        [Candidate((lookup("delay"),), (s.values,), (s,), np.ones(3), False) for s in starts],
    )
    assert min(fitted, key=lambda c: c.train).values[0][0] == pytest.approx(0.13, rel=1e-3)


@pytest.mark.slow
def test_an_actuator_that_is_struck_is_unknown(linear):
    """Blows at random are as broad as noise, and no effect explains them; but no sensor's noise has the resonance."""
    fast = linear(hz=4 * HZ, dt=DT)
    case = build_case(fast, play(fast, noise=0.0))
    w, rng = 2 * np.pi * 4 * HZ * DT, np.random.default_rng(5)
    ring = [1.0, -2 * np.exp(-0.1 * w) * np.cos(w), np.exp(-0.2 * w)]
    white = rng.standard_normal((len(case.series), 2 * SAMPLES))
    gap = Gap(1.0, 1.0, 1.0, 0.95, "", None, None)
    bare = Judged(Candidate((), (), (), np.ones(3), False), (), 1.0, 1.0)
    for errors, said in ((white, "no_gap"), (lfilter([1.0], ring, white), "unknown")):
        noise = estimate(case, [1e-3 * e[SAMPLES:] for e in errors])
        assert ("peaks at the resonance" in noise.source) == (said == "unknown")
        assert verdict(gap, Attribution(bare, bare, (), (), bare, (), (), noise), 1.0) == said

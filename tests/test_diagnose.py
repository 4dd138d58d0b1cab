"""A diagnosis names what was planted, with its numbers; says no gap where there is none, and unknown where it must."""

import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter

import pitp_jax as pitp
import pitp_jax._diagnose.fit as fitting
from pitp_jax._decode import rest_state, rollout
from pitp_jax._diagnose.along import nominal_filter, responses
from pitp_jax._diagnose.attribute import Attribution
from pitp_jax._diagnose.case import build_case, kind, split
from pitp_jax._diagnose.diagnosis import _verdict
from pitp_jax._diagnose.doubt import doubted
from pitp_jax._diagnose.fit import Candidate, fit
from pitp_jax._diagnose.found import Gap
from pitp_jax._diagnose.hold import settled
from pitp_jax._diagnose.judged import Judged, judge, sides
from pitp_jax._diagnose.lanes import Lanes
from pitp_jax._diagnose.noise import estimate
from pitp_jax._effects import CATALOGUE, amplifier, electrode, sensor, stiffness
from pitp_jax._model import augment

HZ, DT, SAMPLES = 5.0, 4e-3, 1500
TIME = np.arange(SAMPLES) * DT
NOISE = 2e-6  # of a range near 2e-3
KEPT = {
    "creep",
    "delay",
    "drag",
    "electrode_rc",
    "second_mode",
    "sensor_gain",
    "sensor_lag",
    "stiffening",
    "voltage_clip",
}
FEW = sorted(
    {c.name for c in CATALOGUE} - KEPT - {"voltage_offset"}
)  # excluded where half the catalogue does: half the time


def drives():
    """A sweep, four sines, a multisine and steps, from rest."""
    rng = np.random.default_rng(3)
    sweep = np.sin(2 * np.pi * (0.3 + 0.9 * TIME) * TIME)
    many = sum(np.sin(2 * np.pi * f * TIME + rng.uniform(0, 6)) for f in (0.7, 1.3, 2.9, 4.3, 6.1)) / 2.5
    found = {"sweep": sweep, "multisine": many}
    found |= {f"sine{k}": np.sin(2 * np.pi * f * TIME) for k, f in enumerate((0.5, 1.1, 2.2, 3.6))}
    steps = np.repeat([0.2, 0.9, -0.5, 0.6, -0.9], SAMPLES // 5)
    return {k: 600 + 350 * v for k, v in (found | {"steps": steps}).items()}


def play(model, noise=NOISE, extra=0.0, seed=0, louder=()):
    """Records of a model, one after the other on the session's clock; `louder`: drives at 1.5 times the voltage."""
    rng, found = np.random.default_rng(seed), []
    for k, (name, u) in enumerate(drives().items()):
        u = 1.5 * u if name in louder else u
        states = rollout(model, jnp.asarray(u, jnp.float32), DT, rest_state(model))
        x = np.asarray(augment.readings(model, states), float) * model.scales.state[0]
        x = x + noise * rng.standard_normal(SAMPLES)
        found.append(pitp.Record(name, TIME + 10 * k, u, x + extra * np.sin(2 * np.pi * 17.3 * TIME + k)))
    return found


@pytest.fixture(scope="module")
def nominal(linear):
    model = linear(hz=HZ, dt=DT)
    return replace(model, provenance=model.provenance.with_(voltage_range=(0.0, 1e3), slew=1e6))


def test_kinds_and_the_split(nominal):
    records = play(nominal)
    assert [kind(r) for r in records] == ["sweep", "broadband", "sine", "sine", "sine", "sine", "steps"]
    assert split(records) == {"sweep", "sine0", "sine2", "steps"}
    assert split(records, "second") == {"sweep", "sine1", "sine3", "steps"}
    assert split(records, "none") == {r.name for r in records}
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


def test_the_screening_filter_is_the_nominal(nominal):
    """Its response to a force linear between samples is the rollout's, and the transfer function the same recursion."""
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


@pytest.fixture(scope="module")
def hardened(nominal):
    """The nominal with a Gent-like spring of 1 / L = 0.25 per scaled unit, and its diagnosis."""
    planted = replace(nominal, effects=(stiffness.GentStiffening(jnp.asarray(0.25)),))
    return pitp.diagnose(nominal, play(planted))


def test_a_planted_spring_is_named_with_its_number(nominal, hardened):
    assert hardened.verdict == "explained" and hardened.effects == ("stiffening",)
    (added,) = hardened.added
    assert added.form == "limited chain"
    told = added.parameters["curvature"]
    assert told["unit"] == "1/m"
    assert abs(told["value"] - 0.25 / nominal.scales.state[0]) < 3 * told["stderr"] + 0.002 * told["value"]
    assert hardened.gap.closed_fraction > 0.97
    low, high = hardened.gap.ci95
    assert low <= hardened.gap.closed_fraction <= high
    assert hardened.gap.noise_floor == pytest.approx(hardened.gap.after, rel=0.1)
    assert hardened.where["tone"] is None  # its lines are the drives', each its own


def test_the_augmented_model_predicts_what_was_not_fitted(nominal, hardened):
    planted = replace(nominal, effects=(stiffness.GentStiffening(jnp.asarray(0.25)),))
    records = play(planted, noise=0.0, seed=4)
    for old, new, r in zip(pitp.predict(nominal, records), pitp.predict(hardened.model, records), records, strict=True):
        before, after = (pitp.e_rms_percent(p.displacement, r.displacement) for p in (old, new))
        assert after < 0.1 * before


def test_shares_sum_to_one_and_the_loud_cells_are_the_large_motions(hardened):
    where = hardened.where
    for axis in ("frequency", "displacement", "velocity", "voltage", "time", "cells"):
        assert sum(row["share"] for row in where[axis]) == pytest.approx(1.0)
    assert sum(where["records"].values()) == pytest.approx(1.0)
    assert sum(where["harmonics"].values()) == pytest.approx(1.0)
    middle = np.mean([c["amplitude"][1] for c in where["cells"]])
    loudest = max(where["cells"], key=lambda c: c["share"])
    assert loudest["flagged"] and loudest["amplitude"][1] > middle


def test_no_gap_where_there_is_none(nominal):
    found = pitp.diagnose(nominal, play(nominal, seed=7))
    assert found.verdict == "no_gap" and found.effects == () and found.equivalent == ()
    assert found.gap.closed_fraction is None and found.model.effects == ()


def test_a_number_far_from_its_start_is_reached(nominal):
    """120 V away: steps are limited in shares of the bounds, not in volts."""
    offset = amplifier.VoltageOffset
    case = build_case(nominal, play(replace(nominal, effects=(offset(jnp.asarray(150.0)),))))
    begin = Candidate((offset,), ((30.0,),), (offset.starts(case.surroundings)[0],), np.ones(3), False)
    (found,) = fit(Lanes(case, (offset,)), [begin])
    assert found.values[0][0] == pytest.approx(150.0, abs=0.5)


def test_a_start_that_diverges_is_left_where_it_is(nominal, monkeypatch):
    """In silence (warnings are errors here) though float32 left inf where it overflowed, beside one that is fitted."""
    coupling = next(c for c in CATALOGUE if c.form == "quadratic" and c.name == "stretch_coupling")
    case = build_case(nominal, play(nominal))
    (start, _) = coupling.starts(case.surroundings)
    begin = [Candidate((coupling,), ((b,),), (start,), np.ones(3), False) for b in (12 / case.surroundings.reach, 0.02)]
    finite = fitting.residuals
    overflowed = lambda *a: [[np.where(np.isnan(r), np.inf, r) for r in rows] for rows in finite(*a)]  # noqa: E731
    monkeypatch.setattr(fitting, "residuals", overflowed)
    wild, tame = fit(Lanes(case, (coupling,)), begin)
    assert wild.train == np.inf and wild.values == begin[0].values
    assert tame.train < 0.2 and abs(tame.values[0][0]) < 0.01


def test_the_nominals_own_doubt_widens_an_effects_interval(nominal):
    """All coefficients off by one common 1 % are a gain off by 1 %: that much the sensor's gain is not known."""
    a = nominal.physical_coefficients
    row = {
        "order": 2,
        "coefficients": a.tolist(),
        "stderr": (0.01 * a).tolist(),
        "correlation": np.ones((3, 3)).tolist(),
    }
    told = nominal.provenance.with_(notes=json.dumps({"identification": {"orders": [row]}}))
    records = play(replace(nominal, effects=(sensor.SensorGain(jnp.asarray(0.3)),)))
    sure, unsure = (
        pitp.diagnose(m, records, exclude=FEW).added[0].parameters["d"]
        for m in (nominal, replace(nominal, provenance=told))
    )
    assert sure["stderr"] < 1e-3 and unsure["value"] == sure["value"]
    assert unsure["stderr"] == pytest.approx(0.01 * 1.3, rel=0.02)


def test_a_clip_that_only_held_out_drives_reach_is_found_on_the_other_split(nominal):
    """Fitted on the quiet sines nothing clips: the fit is done again on those that were held out."""
    planted = replace(nominal, effects=(amplifier.VoltageClip(jnp.asarray(1 / 1100)),))
    found = pitp.diagnose(nominal, play(planted, louder=("sine1", "sine3", "multisine")), exclude=FEW)
    assert found.effects == ("voltage_clip",) and "sine1" in found.fitted
    assert found.gap.closed_fraction > 0.95


def test_a_clip_that_only_one_drive_reaches_is_judged_where_it_is(nominal):
    """Nothing else than the sweep comes near the limit: no gap on what is held out, and none either way round."""
    planted = replace(nominal, effects=(amplifier.VoltageClip(jnp.asarray(1 / 1340)),))
    found = pitp.diagnose(nominal, play(planted, louder=("sweep",)), exclude=FEW)
    assert found.effects == ("voltage_clip",) and found.heldout == () and len(found.fitted) == 7
    assert found.added[0].parameters["inverse"]["value"] == pytest.approx(1 / 1340, rel=0.01)


def test_a_long_delay_is_read(nominal):
    """Two thirds of a period of the resonance."""
    case = build_case(nominal, play(replace(nominal, effects=(amplifier.Delay(jnp.asarray(0.13)),))))
    starts = amplifier.Delay.starts(case.surroundings)
    fitted = fit(
        Lanes(case, (amplifier.Delay,)),
        [Candidate((amplifier.Delay,), (s.values,), (s,), np.ones(3), False) for s in starts],
    )
    assert min(fitted, key=lambda c: c.train).values[0][0] == pytest.approx(0.13, rel=1e-3)


def test_two_effects_are_both_named(nominal):
    """A hard spring behind a slow electrode: no single effect comes near, and the strongest is named first."""
    parts = stiffness.GentStiffening(jnp.asarray(0.25)), electrode.ElectrodeRC(jnp.asarray(0.02))
    found = pitp.diagnose(nominal, play(replace(nominal, effects=parts)))
    assert found.verdict == "explained" and set(found.effects) == {"stiffening", "electrode_rc"}
    assert found.gap.closed_fraction > 0.95 and found.gap.after < 0.5 * found.ranking[0].heldout


def test_effects_the_nominal_has_are_kept(nominal):
    """A model with three lags of its own: no gap on its own records, and a new effect stands beside them."""
    own = (
        electrode.ElectrodeRC(jnp.asarray(0.01)),
        amplifier.Delay(jnp.asarray(7e-3)),
        sensor.SensorLag(jnp.asarray(8e-3)),
    )
    model = replace(nominal, effects=own)
    assert pitp.diagnose(model, play(model), exclude=FEW).verdict == "no_gap"
    stiffer = replace(model, effects=(*own, stiffness.GentStiffening(jnp.asarray(0.25))))
    found = pitp.diagnose(model, play(stiffer), exclude=FEW)
    assert found.effects == ("stiffening",) and found.gap.closed_fraction > 0.95
    assert [e.name for e in found.model.effects] == ["electrode_rc", "delay", "sensor_lag", "stiffening"]


@pytest.mark.parametrize("exclude", [FEW, pytest.param((), marks=pytest.mark.slow)], ids=("few", "all"))
def test_hum_is_unknown(nominal, exclude):
    told: list[str] = []
    found = pitp.diagnose(nominal, play(nominal, extra=4e-5), exclude=exclude, progress=told.append)
    assert not any(line.startswith("once more") for line in told)  # nothing that helps here would help the other way
    assert found.verdict == "unknown" and found.effects == ()
    assert found.where["tone"]["hz"] == pytest.approx(17.3, abs=0.2) and found.where["tone"]["records"] == 7
    assert found.where["summary"].startswith("A steady tone at 17")


def test_an_actuator_that_is_struck_is_unknown(linear):
    """Blows at random are as broad as noise, and no effect explains them; but no sensor's noise has the resonance."""
    fast = linear(hz=4 * HZ, dt=DT)
    case = build_case(fast, play(fast, noise=0.0))
    w, rng = 2 * np.pi * 4 * HZ * DT, np.random.default_rng(5)
    ring = [1.0, -2 * np.exp(-0.1 * w) * np.cos(w), np.exp(-0.2 * w)]
    white = rng.standard_normal((len(case.series), 2 * SAMPLES))
    gap = Gap(1.0, 1.0, 1.0, 0.95, "", None, None)
    bare = Judged(Candidate((), (), (), np.ones(3), False), (), 1.0, 1.0)
    for errors, verdict in ((white, "no_gap"), (lfilter([1.0], ring, white), "unknown")):
        noise = estimate(case, [1e-3 * e[SAMPLES:] for e in errors])
        assert ("peaks at the resonance" in noise.source) == (verdict == "unknown")
        assert _verdict(gap, Attribution(bare, bare, (), (), bare, (), (), noise), 1.0) == verdict


@pytest.mark.slow
def test_a_moved_coefficient_is_a_parameter_change_and_a_heavier_load_added_mass(nominal):
    a = np.asarray(nominal.coefficients)
    changed = replace(nominal, coefficients=jnp.asarray(a * [0.9, 1.3, 1.1], jnp.float32))
    found = pitp.diagnose(nominal, play(changed))
    assert found.effects == ("parameter_change",)
    np.testing.assert_allclose(found.shift, [0.9, 1.3, 1.1], rtol=0.01)
    heavier = replace(nominal, coefficients=jnp.asarray(a * [1.0, 1.0, 1.2], jnp.float32))
    found = pitp.diagnose(nominal, play(heavier))
    assert found.effects == ("added_mass",)
    assert found.added[0].parameters["d"]["value"] == pytest.approx(0.2, rel=0.02)
    refitted = pitp.diagnose(nominal, play(heavier), refit_nominal=True)
    assert refitted.verdict == "no_gap"
    np.testing.assert_allclose(refitted.shift, [1.0, 1.0, 1.2], rtol=0.02)


def test_a_refit_reads_the_sensors_zero_anew(nominal):
    """A nominal whose zero is 4 um off, twice the noise, as one that was identified without the effect."""
    off = replace(nominal, output=replace(nominal.output, offset=4e-6))
    planted = replace(nominal, effects=(amplifier.VoltageOffset(jnp.asarray(60.0)),))
    found = pitp.diagnose(off, play(planted), refit_nominal=True, exclude=FEW)
    assert found.effects == ("voltage_offset",)
    told = found.added[0].parameters["offset"]
    assert abs(told["value"] - 60.0) < 3 * told["stderr"] < 6.0
    assert found.model.output.offset == pytest.approx(0.0, abs=5e-7)
    np.testing.assert_allclose(found.shift, 1.0, rtol=0.01)


def test_a_refit_does_not_know_the_hold(nominal):
    """A zero-order hold is half a sample of delay: so little is a delay known behind one, and no more."""
    held = replace(nominal, hold="zoh")
    case = build_case(held, play(nominal))
    begin = Candidate((amplifier.Delay,), ((0.02,),), (amplifier.Delay.starts(case.surroundings)[0],), np.ones(3), True)
    judged = Judged(replace(begin, covariance=np.zeros((5, 5))), (), 1.0, 1.0)
    told = doubted(case, judged, held).candidate.covariance
    np.testing.assert_allclose(np.sqrt(np.diag(told)) * 0.02, [DT / 2, 0, 0, 0, 0])
    np.testing.assert_array_equal(doubted(case, judged, nominal).candidate.covariance, 0.0)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_a_refit_settles_the_hold_once_the_effect_is_known(nominal, hold):
    """A nominal that took its hold from lagged records: under the wrong one tau was read half a sample short."""
    held = replace(nominal, hold="zoh")
    lag = sensor.SensorLag(jnp.asarray(0.02))
    records = play(replace(nominal, hold=hold, effects=(lag,)))
    case = build_case(held, records)
    begin = Candidate(
        (sensor.SensorLag,), ((0.015,),), (sensor.SensorLag.starts(case.surroundings)[0],), np.ones(3), True
    )
    lanes = Lanes(case, (sensor.SensorLag,))
    (best,) = judge(lanes, fit(lanes, [begin]))
    found, model = settled(case, best, held)
    assert model.hold == hold
    assert found.candidate.values[0][0] == pytest.approx(0.02, rel=5e-3)


def test_what_has_one_form_has_no_excuse_for_what_it_leaves(nominal):
    """A sensor's lag passes for a delay in part only: excused for a nominal of unknown quality, not for a good one."""
    lag = replace(nominal, effects=(sensor.SensorLag(jnp.asarray(0.015)),))
    others = {c.name for c in CATALOGUE if c.name != "delay"} | {"parameter_change"}
    records = play(lag)
    known = pitp.identify(play(nominal, seed=1), order=2).model
    excused, not_excused = (pitp.diagnose(m, records, exclude=sorted(others)) for m in (nominal, known))
    assert excused.effects == ("delay",) and excused.gap.after > 2.5 * excused.gap.noise_floor
    assert not_excused.verdict == "unknown" and not_excused.gap.closed_fraction > 0.72


def test_an_excluded_effect_does_not_come_back_inside_another_form(nominal):
    """A slew limit with a lag, its limit out of reach, is the lag: left out with it."""
    records = play(replace(nominal, effects=(electrode.ElectrodeRC(jnp.asarray(0.02)),)))
    others = sorted({c.name for c in CATALOGUE} - {"slew_limit", "electrode_rc"} | {"parameter_change"})
    assert pitp.diagnose(nominal, records, exclude=others).effects == ("electrode_rc",)
    found = pitp.diagnose(nominal, records, exclude=[*others, "electrode_rc"])
    assert found.effects == () and {r.form for r in found.ranking} == {"rate limit"}


def test_no_records_is_bad_input(nominal):
    with pytest.raises(pitp.BadInput, match="at least one record"):
        pitp.diagnose(nominal, [])

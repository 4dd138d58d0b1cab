"""A diagnosis names what was planted, with its numbers; says no gap where there is none, and unknown where it must."""

import json
import re
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import pytest
from played import DT, FEW, NOISE, TIME, nominal_of, play
from scipy.signal import lsim
from typed import some

import pitp_jax as pitp
from pitp_jax.application.pages.diagnosis.page import report
from pitp_jax.method.diagnose import diagnosis, handing_back, result
from pitp_jax.method.diagnose.budget import Budget
from pitp_jax.method.diagnose.own_error import own_error
from pitp_jax.method.diagnose.words import result_line, verdict_lines
from pitp_jax.method.effects import CATALOGUE, lookup
from pitp_jax.method.effects.found_term import TERM
from pitp_jax.method.model.fitted import Fitted, model_of
from pitp_jax.method.model.origin import Origin

FEW_BUT_FRICTION = [n for n in FEW if n != "coulomb_friction"]


def effect(name, form, *values):
    return lookup(name, form)(*values)


@pytest.fixture(scope="module")
def nominal(linear):
    """With an error of its own, as identification leaves it."""
    model = nominal_of(linear)
    return Fitted(model, Origin(misfit=1.0))


@pytest.fixture(scope="module")
def hardened(nominal):
    """The nominal with a Gent-like spring of 1 / L = 0.25 per scaled unit, and its diagnosis."""
    planted = replace(nominal, effects=(effect("stiffening", "limited chain", 0.25),))
    return pitp.diagnose(nominal, play(planted))


@pytest.mark.slow
def test_a_planted_spring_is_named_with_its_number(nominal, hardened):
    assert hardened.verdict == "explained" and hardened.effects == ("stiffening",)
    assert hardened.probability["stiffening"] >= 0.9 and hardened.handed_back == ("stiffening",)
    added = hardened.added[0]
    assert added.form == "limited chain"
    told = added.parameters["curvature"]
    assert told["unit"] == "1/m"
    assert abs(told["value"] - 0.25 / nominal.scales.state[0]) < 4 * told["stderr"] + 0.01 * told["value"]
    assert some(hardened.gap.closed_fraction) > 0.95


@pytest.mark.slow
def test_an_interrupt_leaves_the_best_so_far(nominal, monkeypatch):
    """Ctrl-C behind the effects one by one: the planted spring is handed back, and a place that fails is a note."""

    def stop(*_):
        raise KeyboardInterrupt

    def broken(*_):
        raise RuntimeError("nowhere")

    monkeypatch.setattr(diagnosis.Search, "_backward", stop)
    monkeypatch.setattr(diagnosis, "locate", broken)
    planted = replace(nominal, effects=(effect("stiffening", "limited chain", 0.25),))
    found = pitp.diagnose(nominal, play(planted), exclude=FEW)
    assert found.interrupted and found.handed_back == ("stiffening",)
    assert any("the place of the gap failed (RuntimeError: nowhere)" in note for note in found.notes)
    assert any("interrupted" in note for note in found.notes)
    assert json.dumps(found.as_json()) and str(found)


@pytest.mark.slow
def test_the_model_that_is_handed_back_knows_its_own_error(nominal, hardened):
    """Its error is noise, not that of the linear model before; a later change of its stiffness by 6 % is a gap."""
    origin = hardened.model.origin
    assert origin.misfit < 1.5 and origin.level < 1.5 * hardened.gap.after and origin.errors
    assert origin.stderr == () and origin.covariance.shape == (0, 0)
    later = play(hardened.model.model.changed(np.array([1.06, 1.0, 1.0])), seed=9)
    runs = own_error(cast(Any, hardened.model), later)
    assert runs.ratio(runs.residuals) > 1.2
    healthy = own_error(cast(Any, hardened.model), play(hardened.model.model, seed=10))
    assert healthy.ratio(healthy.residuals) < 1.05


@pytest.mark.slow
def test_the_budget_adds_to_one(hardened):
    b = hardened.budget
    parts = [b["nuisance"], b["parameters"], *b["effects"].values(), b["unnamed"], b["unexplainable"]]
    assert sum(p["share"] for p in parts) == pytest.approx(1.0)
    assert b["effects"]["stiffening"]["share"] > 0.9
    assert all(p["ci95"][0] <= p["share"] <= p["ci95"][1] for p in parts)
    assert json.loads(json.dumps(hardened.as_json()))["records"]["folds"]


@pytest.mark.slow
def test_the_augmented_model_predicts_what_was_not_fitted(nominal, hardened):
    planted = replace(nominal, effects=(effect("stiffening", "limited chain", 0.25),))
    records = play(planted, noise=0.0, seed=4)
    for old, new, r in zip(pitp.predict(nominal, records), pitp.predict(hardened.model, records), records, strict=True):
        before, after = (pitp.e_rms_percent(p.displacement, r.displacement) for p in (old, new))
        assert after < 0.1 * before


@pytest.mark.slow
def test_shares_sum_to_one_and_the_loud_cells_are_the_large_motions(hardened):
    where = hardened.where
    for axis in ("frequency", "displacement", "velocity", "voltage", "time", "cells"):
        assert sum(row["share"] for row in where[axis]) == pytest.approx(1.0)
    assert sum(where["records"].values()) == pytest.approx(1.0)
    middle = np.mean([c["amplitude"][1] for c in where["cells"]])
    loudest = max(where["cells"], key=lambda c: c["share"])
    assert loudest["flagged"] and loudest["amplitude"][1] > middle


@pytest.mark.slow
def test_no_gap_where_there_is_none(nominal):
    found = pitp.diagnose(nominal, play(nominal, seed=7))
    assert found.verdict == "no_gap" and found.effects == () and found.equivalent == ()
    assert found.gap.closed_fraction is None and found.model is not None and found.handed_back == ()
    assert found.model.effects == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "form", "values"),
    [
        ("voltage_clip", "hard", (1 / 850.0,)),
        ("electrode_rc", "one lag", (0.02,)),
        ("coulomb_friction", "Coulomb", (0.02,)),
    ],
    ids=lambda v: v if isinstance(v, str) else "",
)
def test_effects_of_every_port_are_named(nominal, name, form, values):
    found = pitp.diagnose(nominal, play(replace(nominal, effects=(effect(name, form, *values),))))
    assert found.effects[:1] == (name,) and found.verdict in ("explained", "partly")


@pytest.mark.slow
def test_two_effects_are_both_named(nominal):
    parts = effect("stiffening", "limited chain", 0.25), effect("electrode_rc", "one lag", 0.02)
    found = pitp.diagnose(nominal, play(replace(nominal, effects=parts)))
    assert set(found.effects) == {"stiffening", "electrode_rc"}
    assert found.gap.after < 0.2 * found.gap.before


@pytest.mark.slow
def test_a_load_and_creep_are_both_named(nominal):
    """Changed coefficients absorb most of both; beside them creep must be tried, and of them only the mass needed."""
    a = np.asarray(nominal.coefficients) * [1, 1, 1.25]
    planted = replace(
        nominal, coefficients=jnp.asarray(a, jnp.float32), effects=(effect("creep", "one branch", 0.18, 0.8),)
    )
    found = pitp.diagnose(nominal, play(planted), exclude=[n for n in FEW if n != "added_mass"])
    assert set(found.effects) == {"added_mass", "creep"} and found.verdict == "explained"
    np.testing.assert_allclose(found.shift, [1, 1, 1.25], rtol=0.01)


@pytest.mark.slow
def test_in_a_refit_the_nominal_is_found_beside_the_effect(nominal):
    """A nominal that was bent by the clip in its own records comes back to the true one, without being asked."""
    records = play(replace(nominal, effects=(effect("voltage_clip", "hard", 1 / 850.0),)))
    bent = pitp.identify(records, order=2).model
    found = pitp.diagnose(bent, records, exclude=FEW)
    assert found.effects == ("voltage_clip",) and found.refit == "automatic"
    np.testing.assert_allclose(found.model.physical_coefficients, nominal.physical_coefficients, rtol=0.02)


def test_hum_is_a_steady_tone_and_no_part_of_the_model(nominal, monkeypatch):
    monkeypatch.setattr(diagnosis, "build_case", None)  # no search
    found = pitp.diagnose(nominal, play(nominal, extra=4e-5))
    assert (found.verdict, found.effects, found.handed_back) == ("explained", ("steady_tone",), ())
    assert found.model.effects == () and found.gap.after < 0.2 * found.gap.before
    (part,) = found.parts
    amplitude, hz = part.parameters["amplitude"], part.parameters["frequency"]
    assert amplitude["value"] == pytest.approx(4e-5, rel=0.05) and amplitude["unit"] == "m"
    assert hz["ci95"][0] < 17.3 < hz["ci95"][1] and hz["ci95"][1] - hz["ci95"][0] < 0.05
    assert found.budget["effects"]["steady_tone"]["share"] > 0.9
    assert "oscillation" in str(found) and json.dumps(found.as_json())
    assert report(found).html()


def test_a_healthy_machine_needs_no_search(nominal, monkeypatch):
    """Also with a trained nominal, whose file holds its error in % of range in place of a misfit."""
    monkeypatch.setattr(diagnosis, "build_case", None)
    records = play(nominal, seed=7)
    spans = [r.span for r in records]
    noise = 100 * NOISE / float(np.exp(np.mean(np.log(spans))))
    for origin in (Origin(misfit=1.0), Origin(level=noise), Origin()):
        found = pitp.diagnose(Fitted(model_of(nominal), origin), records)
        assert (found.verdict, found.effects, found.handed_back) == ("no_gap", (), ())
        assert found.gap.closed_fraction is None and sum(found.where["records"].values()) == pytest.approx(1.0)
        assert json.dumps(found.as_json()) and str(found) and report(found).html()


@pytest.mark.slow
def test_a_heavier_load_is_added_mass(nominal, monkeypatch):
    """Of its candidates one closed -2085 % of a gap, with the interval of -100 % to 73 %: both end at -100 %."""
    monkeypatch.setattr(result, "closed", lambda before, after, low: -20.85)
    heavier = nominal.changed(np.array([1.0, 1.0, 1.2]))
    found = pitp.diagnose(nominal, play(heavier), exclude=[n for n in FEW if n != "added_mass"])
    assert found.effects == ("added_mass",)
    row = next(r for r in found.ranking if r.effect == "added_mass")
    assert (row.closed_fraction, row.form) == (-1.0, "refitted coefficients")


@pytest.mark.slow
def test_a_force_without_a_name_is_an_equation(nominal):
    """Damping that grows with the square of the displacement is no form of the catalogue."""
    found = pitp.diagnose(nominal, play(replace(nominal, effects=(TERM(0.0, 0.6, 0.0),))))
    assert found.verdict == "unknown" and found.effects == ()
    term = some(found.term)
    assert "x^2 x'" in term.equation and "term" in found.handed_back
    row = next(iter(term.parameters.values()))
    assert row["ci95"][0] < row["value"] < row["ci95"][1]
    assert found.gap.after < 0.2 * found.gap.before


@pytest.mark.slow
def test_excluded_names_are_not_said(nominal, hardened, monkeypatch):
    """Nor is the result lost by an interrupt while the certainty of its parts is searched."""
    list_parts, calls = diagnosis.parts_of, []

    def interrupted(*args):
        calls.append(args)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return list_parts(*args)

    monkeypatch.setattr(diagnosis, "parts_of", interrupted)
    planted = replace(nominal, effects=(effect("stiffening", "limited chain", 0.25),))
    found = pitp.diagnose(nominal, play(planted), exclude=[*FEW, "stiffening"])
    assert "stiffening" not in (*found.effects, *found.equivalent, *(r.effect for r in found.ranking))
    assert found.gap.after > hardened.gap.after
    assert found.interrupted and {p.effect for p in found.parts} >= {*found.handed_back} - {"parameters", "term"}


@pytest.mark.slow
def test_an_early_output_is_told_and_taken_out_and_names_nothing(nominal):
    """Three samples early: no effect is reported. With a clip beside it the clip is reported, and no shift."""
    late = 3 * DT

    def early(records):
        return [replace(r, displacement=np.interp(r.time + late, r.time, r.displacement)) for r in records[:4]]

    others = [n for n in FEW if n != "slew_limit"]
    found = pitp.diagnose(nominal, early(play(nominal, seed=4)), exclude=others)
    assert found.effects == ()
    assert found.clock_shift == pytest.approx(late, rel=0.03) and found.as_json()["clock_shift_s"] == found.clock_shift
    assert any("(3 samples) early" in note and "Check the clocks" in note for note in found.notes)
    clipped = replace(nominal, effects=(effect("voltage_clip", "hard", 1 / 850.0),))
    both = pitp.diagnose(nominal, early(play(clipped)), exclude=others)
    assert both.effects == ("voltage_clip",) and both.clock_shift == pytest.approx(late, rel=0.05)


@pytest.mark.slow
def test_an_input_behind_a_low_pass_is_told_and_taken_out(nominal):
    """Recorded by a monitor of 12 ms, SciPy's low pass, beside a clip: the clip is reported."""
    tau, model = 0.012, replace(nominal, effects=(effect("voltage_clip", "hard", 1 / 850.0),))
    records = [replace(r, voltage=lsim(([1.0], [tau, 1.0]), r.voltage, r.time - r.time[0])[1]) for r in play(model)]
    found = pitp.diagnose(nominal, records, exclude=FEW)
    assert found.effects == ("voltage_clip",)
    assert found.input_lag == pytest.approx(tau, rel=0.05) and found.as_json()["input_lag_s"] == found.input_lag
    assert any("low pass" in note for note in found.notes)


@pytest.mark.slow
def test_a_zero_of_a_plant_is_not_taken_for_a_fault_of_its_recordings():
    """SciPy's plant with a zero of 0.4 s, refitted: the zero is reported, and the recordings stay as they are."""
    tau, rng, time = 0.4, np.random.default_rng(7), np.arange(1500) / 50
    plant = ([tau, 1.0], [0.04, 0.12, 1.0])
    steps = np.repeat(rng.uniform(-1, 1, 25), 60)
    records = []
    for name, u in (("sweep", np.sin(2 * np.pi * (0.05 + 0.025 * time) * time)), ("steps", steps)):
        y = 1e-3 * lsim(plant, u, time)[1]
        records.append(pitp.Record(name, time, u, y + 2e-6 * rng.standard_normal(len(time))))
    model = pitp.identify(records, input_map="linear", order=2).model
    found = pitp.diagnose(model, records, refit_nominal=True, exclude=FEW)
    assert found.verdict == "unknown" and found.effects == () and found.input_lag == 0
    assert float(some(re.search(r"zero with a time constant of ([\d.]+) ms", found.reason))[1]) == pytest.approx(
        1e3 * tau, rel=0.05
    )
    assert all(p.certainty == "none" for p in found.parts)
    before, after = ([np.std((p.displacement - r.displacement)[p.scored]) for p, r in zip(pitp.predict(m, records),
                     records, strict=True)] for m in (model, found.model))  # fmt: skip
    assert np.all(np.array(after) <= 1.001 * np.array(before))


@pytest.mark.slow
def test_a_planted_feedthrough_is_named_with_its_number(nominal):
    form, size = "of the force", 0.08 / 900.0**2
    planted = replace(nominal, effects=(effect("feedthrough", form, size),))
    found = pitp.diagnose(nominal, play(planted), exclude=[n for n in FEW if n != "feedthrough"])
    assert found.effects == ("feedthrough",) and found.added[0].form == form
    assert found.added[0].parameters["d"]["value"] == pytest.approx(size * nominal.scales.state[0], rel=0.03)


@pytest.mark.slow
def test_a_lag_that_a_refit_adds_is_named(nominal):
    """It is fitted along with every effect, nothing improves the fit beside it, and the gap closed without a name."""
    planted = replace(nominal, effects=(effect("sensor_lag", "one lag", 0.01),))
    others = sorted({c.name for c in CATALOGUE} - {"sensor_lag", "drag"})
    found = pitp.diagnose(nominal, play(planted), refit_nominal=True, exclude=others)
    assert (found.verdict, found.effects) == ("explained", ("sensor_lag",))
    assert found.gap.closed_fraction is not None and found.gap.closed_fraction > 0.9
    (part,) = (p for p in found.parts if p.effect == "sensor_lag")
    assert part.parameters["tau"]["value"] == pytest.approx(0.01, rel=0.03)


@pytest.mark.slow
def test_out_of_time_the_best_so_far_is_told(nominal):
    planted = replace(nominal, effects=(effect("electrode_rc", "one lag", 0.02),))
    others = sorted({c.name for c in CATALOGUE} - {"electrode_rc", "delay"})
    found = pitp.diagnose(nominal, play(planted), exclude=others, seconds=1e-3)
    assert found.ranking and np.isfinite(found.gap.after) and found.gap.after <= found.gap.before
    assert any("The search stopped after 0.001 s" in note for note in found.notes)


@pytest.mark.slow
def test_a_name_whose_model_is_not_handed_back_is_not_said(nominal, monkeypatch):
    """The search is sure of the lag; in free runs of the package no model is better than another."""
    planted = replace(nominal, effects=(effect("electrode_rc", "one lag", 0.02),))
    others = sorted({c.name for c in CATALOGUE} - {"electrode_rc", "voltage_clip"})
    assert pitp.diagnose(nominal, play(planted), exclude=others).effects == ("electrode_rc",)
    with monkeypatch.context() as patch:  # nor one that closes nothing of the pooled error
        patch.setattr(diagnosis, "percent", lambda errors, ranges: 1.0)
        found = pitp.diagnose(nominal, play(planted), exclude=others)
        assert (found.verdict, found.effects) == ("unknown", ()) and "electrode_rc" in found.handed_back
        assert "some recordings" in found.reason
    monkeypatch.setattr(handing_back, "package_errors", lambda model, records: np.ones(len(records)))
    found = pitp.diagnose(nominal, play(planted), exclude=others)
    assert (found.verdict, found.effects, found.handed_back) == ("unknown", (), ())
    assert "free runs" in found.reason


@pytest.mark.slow
def test_friction_is_found_beside_a_mass_that_the_nominal_lacks(linear):
    """A nominal of order one, identified on a record of a gear with a mass and friction that grows with its load."""
    plant = nominal_of(partial(linear, damping=0.6))
    gear = replace(plant, effects=(effect("coulomb_friction", "loaded by the spring", 0.05, 0.3),))
    records = play(gear)[1:4]
    coarse = pitp.identify(records[:1], order=1).model
    found = pitp.diagnose(coarse, records, refit_nominal=True, exclude=FEW_BUT_FRICTION)
    assert found.effects == ("coulomb_friction",) and found.gap.after < 0.1 * found.gap.before
    assert found.model.order == 2


@pytest.mark.slow
def test_what_is_handed_back_leaves_what_the_report_says(linear):
    """Dry friction before the lag of a nominal of order three: in a core of that order it acted on what lags."""
    plant, lag = nominal_of(linear), effect("sensor_lag", "one lag", 0.012)
    nominal = pitp.identify(play(replace(plant, effects=(lag,))), order=3).model
    records = play(replace(plant, effects=(effect("coulomb_friction", "Coulomb", 0.05), lag)))
    found = pitp.diagnose(nominal, records, exclude=FEW_BUT_FRICTION)
    left = [
        np.std(p.displacement - r.displacement) / r.span
        for p, r in zip(pitp.predict(found.model, records), records, strict=True)
    ]
    assert nominal.order == 3 and found.effects == ("coulomb_friction",) and [p.effect for p in found.parts][1:] == []
    assert 100 * np.sqrt(np.mean(np.square(left))) < 1.2 * found.gap.after < 0.1 * found.gap.before


def test_a_model_that_harms_one_recording_is_not_handed_back(nominal):
    """Of three recordings two are of a stiffer machine and one of the nominal's: the stiffer model harms the third."""
    stiffer = nominal.changed(np.array([1.2, 1.0, 1.0]))
    mixed = [*play(stiffer)[2:4], play(nominal)[4]]
    before, after = (handing_back.package_errors(m, mixed) for m in (nominal, stiffer))
    assert handing_back.harms_none(before[:2], after[:2], mixed[:2])
    assert not handing_back.harms_none(before, after, mixed)


def test_a_model_that_runs_away_within_its_voltages_is_not_handed_back(nominal):
    """A spring that softens without end holds under the weak drive and gives way under the widest voltage."""
    softer = replace(nominal, effects=(effect("softening", "polynomial", 0.0, -0.6, 0.0),))
    sine, *_ = play(nominal)[2:]
    weak = replace(sine, name="weak", voltage=0.5 * sine.voltage)
    held, far = (np.isfinite(pitp.rollout(softer, r.voltage, r.dt, begins="rest")).all() for r in (weak, sine))
    assert held and not far
    assert handing_back.is_bounded(nominal, [weak, sine]) and not handing_back.is_bounded(softer, [weak, sine])
    assert not handing_back.is_bounded(softer, [weak])  # the nominal's own recordings had the wider drive
    narrow = replace(softer, domain=replace(softer.domain, voltage_range=(0.0, float(weak.voltage.max()))))
    assert handing_back.is_bounded(narrow, [weak])


@pytest.mark.slow
def test_a_model_takes_the_steps_that_its_effects_need(nominal):
    """A stop of a thousand springs in mid-motion: a mode of 160 Hz, of which a step of 4 ms makes four radians."""
    stiff = replace(nominal, effects=(effect("end_stop", "above", 1e3, 0.3),))
    records = play(replace(stiff, substeps=16))[2:4]
    assert stiff.substeps == 1 and not np.isfinite(handing_back.package_errors(stiff, records)).any()
    before = float(handing_back.package_errors(nominal, records).max())
    found, errors = handing_back.stable(stiff, records, before)
    assert found.substeps > 1 and errors.max() < 0.1 * before


@pytest.mark.slow
def test_of_two_machines_nothing_is_handed_back(nominal):
    """Springs of 1.4 and 0.7 in two records: what both share is nearer to them than the nominal, and is neither."""
    played = [play(nominal.changed(np.array([k, 1.0, 1.0])))[n] for n, k in enumerate((1.4, 0.7))]
    found = pitp.diagnose(nominal, played, exclude=FEW)
    assert (found.verdict, found.effects, found.handed_back) == ("unknown", (), ())
    assert "Separate linear models" in found.reason
    refitted = pitp.diagnose(nominal, played, refit_nominal=True, exclude=FEW)  # which an unknown verdict also tries
    assert f"With --refit-nominal: {verdict_lines(refitted)[0]} {result_line(refitted)}" in found.notes


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ends", "told"), [(ValueError, "failed (ValueError"), (KeyboardInterrupt, "(interrupted)"), (None, "")]
)
def test_a_refit_that_does_not_end_is_told_and_loses_nothing(nominal, monkeypatch, ends, told):
    played, refits = [play(nominal.changed(np.array([k, 1.0, 1.0])))[n] for n, k in enumerate((1.4, 0.7))], []

    def refitted(*args):
        refits.append(args)
        raise ends

    monkeypatch.setattr(diagnosis, "_if_refitted", refitted)
    found = pitp.diagnose(nominal, played, exclude=FEW, refit_nominal=None if ends else False)
    assert found.verdict == "unknown" and found.interrupted == (ends is KeyboardInterrupt)
    assert [told for note in found.notes if f"refit of the nominal model {told}" in note] == [told] * len(refits)
    assert len(refits) == (ends is not None)


def test_a_refit_that_ends_early_has_no_answer(nominal, monkeypatch):
    monkeypatch.setattr(diagnosis, "diagnose", lambda *args, **how: SimpleNamespace(interrupted=True))
    with pytest.raises(KeyboardInterrupt):
        diagnosis._if_refitted(nominal, [], (), Budget())


@pytest.mark.slow
def test_a_refit_that_runs_out_of_time_is_told(nominal, monkeypatch):
    def late(model, records, exclude, limit):
        limit.began -= limit.seconds
        return ("answered so far",)

    played = [play(nominal.changed(np.array([k, 1.0, 1.0])))[n] for n, k in enumerate((1.4, 0.7))]
    monkeypatch.setattr(diagnosis, "_if_refitted", late)
    notes = pitp.diagnose(nominal, played, exclude=FEW, seconds=1e6).notes
    assert "answered so far" in notes
    assert any("did not try: a refit of the nominal model to its end" in note for note in notes)


@pytest.mark.slow
def test_moved_damping_is_a_parameter_change(nominal):
    found = pitp.diagnose(nominal, play(nominal.changed(np.array([0.9, 1.3, 1.1]))), exclude=FEW)
    assert found.effects == ("parameter_change",)
    np.testing.assert_allclose(found.shift, [0.9, 1.3, 1.1], rtol=0.02)


@pytest.mark.slow
def test_what_has_not_moved_is_told_as_the_nominals(nominal):
    found = pitp.diagnose(nominal, play(nominal.changed(np.array([1.3, 1.0, 1.2]))), exclude=FEW)
    assert found.effects == ("parameter_change",)
    assert found.shift[1] == 1.0
    np.testing.assert_allclose(found.shift[[0, 2]], [1.3, 1.2], rtol=0.01)


@pytest.mark.slow
def test_a_clip_that_one_pulse_shows_is_named(nominal):
    """Four sines below the clip and a pulse above it: parts of the pulse predict each other."""
    inputs = {f"sine{hz}": 400 * (1 - np.cos(2 * np.pi * hz * TIME)) for hz in (0.5, 1.1, 2.2, 3.6)}
    inputs["pulse"] = 1100 * np.clip(TIME - 1.5, 0, 0.02) / 0.02 * np.clip(4.5 - TIME, 0, 0.02) / 0.02
    planted = replace(nominal, effects=(effect("voltage_clip", "hard", 1 / 850.0),))
    others = [*FEW, "creep", "drag", "second_mode", "voltage_offset"]
    found = pitp.diagnose(nominal, play(planted, inputs=inputs), exclude=others)
    assert found.effects == ("voltage_clip",) and found.handed_back == ("voltage_clip",)
    (level,) = found.added[0].parameters.values()
    assert 1 / level["value"] == pytest.approx(850.0, rel=0.01)
    assert any("parts of each were left out" in note for note in found.notes)

"""A diagnosis names what was planted, with its numbers; says no gap where there is none, and unknown where it must."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from played import FEW, nominal_of, play
from typed import some

import pitp_jax as pitp
from pitp_jax._effects import CATALOGUE, effect


@pytest.fixture(scope="module")
def nominal(linear):
    return nominal_of(linear)


@pytest.fixture(scope="module")
def hardened(nominal):
    """The nominal with a Gent-like spring of 1 / L = 0.25 per scaled unit, and its diagnosis."""
    planted = replace(nominal, effects=(effect("stiffening", form="limited chain", curvature=0.25),))
    return pitp.diagnose(nominal, play(planted))


def test_a_planted_spring_is_named_with_its_number(nominal, hardened):
    assert hardened.verdict == "explained" and hardened.effects == ("stiffening",)
    (added,) = hardened.added
    assert added.form == "limited chain"
    told = added.parameters["curvature"]
    assert told["unit"] == "1/m"
    assert abs(told["value"] - 0.25 / nominal.scales.state[0]) < 3 * told["stderr"] + 0.002 * told["value"]
    assert hardened.gap.closed_fraction > 0.97
    assert hardened.gap.noise_floor == pytest.approx(hardened.gap.after, rel=0.1)
    assert hardened.where["tone"] is None  # its lines are the drives', each its own


@pytest.mark.slow
def test_the_augmented_model_predicts_what_was_not_fitted(nominal, hardened):
    planted = replace(nominal, effects=(effect("stiffening", form="limited chain", curvature=0.25),))
    records = play(planted, noise=0.0, seed=4)
    assert hardened.model.domain.voltage_range[1] >= max(r.voltage.max() for r in records)
    for old, new, r in zip(pitp.predict(nominal, records), pitp.predict(hardened.model, records), records, strict=True):
        before, after = (pitp.e_rms_percent(p.displacement, r.displacement) for p in (old, new))
        assert after < 0.1 * before


@pytest.mark.slow
def test_the_interval_of_what_is_closed_holds_what_is_closed_without_noise(nominal, hardened):
    planted = replace(nominal, effects=(effect("stiffening", form="limited chain", curvature=0.25),))
    records = [r for r in play(planted, noise=0.0) if r.name in hardened.heldout]
    left = []
    for model in (nominal, hardened.model):
        found = pitp.predict(model, records)
        squares = [pitp.e_rms_percent(p.displacement, r.displacement) ** 2 for p, r in zip(found, records, strict=True)]
        left.append(np.sqrt(np.mean(squares)))
    low, high = hardened.gap.ci95
    assert low <= 1 - left[1] / left[0] <= high and high - low < 0.03


def test_shares_sum_to_one_and_the_loud_cells_are_the_large_motions(hardened):
    where = hardened.where
    for axis in ("frequency", "displacement", "velocity", "voltage", "time", "cells"):
        assert sum(row["share"] for row in where[axis]) == pytest.approx(1.0)
    assert sum(where["records"].values()) == pytest.approx(1.0)
    assert sum(where["harmonics"].values()) == pytest.approx(1.0)
    middle = np.mean([c["amplitude"][1] for c in where["cells"]])
    loudest = max(where["cells"], key=lambda c: c["share"])
    assert loudest["flagged"] and loudest["amplitude"][1] > middle


@pytest.mark.slow
def test_no_gap_where_there_is_none(nominal):
    found = pitp.diagnose(nominal, play(nominal, seed=7))
    assert found.verdict == "no_gap" and found.effects == () and found.equivalent == ()
    assert found.gap.closed_fraction is None and found.model.effects == ()


@pytest.mark.slow
def test_a_clip_that_only_held_out_drives_reach_is_found_on_the_other_split(nominal):
    """Fitted on the quiet sines nothing clips: the fit is done again on those that were held out."""
    planted = replace(nominal, effects=(effect("voltage_clip", inverse=1 / 1100),))
    found = pitp.diagnose(nominal, play(planted, louder=("sine1", "sine3", "multisine")), exclude=FEW)
    assert found.effects == ("voltage_clip",) and "sine1" in found.fitted
    assert some(found.gap.closed_fraction) > 0.95


@pytest.mark.slow
def test_a_clip_that_only_one_drive_reaches_is_judged_where_it_is(nominal):
    """Nothing else than the sweep comes near the limit: no gap on what is held out, and none either way round."""
    planted = replace(nominal, effects=(effect("voltage_clip", inverse=1 / 1340),))
    found = pitp.diagnose(nominal, play(planted, louder=("sweep",)), exclude=FEW)
    assert found.effects == ("voltage_clip",) and found.heldout == () and len(found.fitted) == 7
    assert found.added[0].parameters["inverse"]["value"] == pytest.approx(1 / 1340, rel=0.01)


@pytest.mark.slow
def test_a_clip_that_only_one_sine_reaches_is_found_with_nothing_held_out(nominal):
    """Either way round one side shows nothing: the fit never sees the clip, or no drive is left to judge it on."""
    planted = replace(nominal, effects=(effect("voltage_clip", inverse=1 / 1340),))
    others = {c.name for c in CATALOGUE} - {"voltage_clip", "drag"} | {"parameter_change"}
    found = pitp.diagnose(nominal, play(planted, louder=("sine1",)), exclude=sorted(others))
    assert found.effects == ("voltage_clip",) and found.heldout == ()
    assert some(found.gap.closed_fraction) > 0.95


@pytest.mark.slow
def test_two_effects_are_both_named(nominal):
    """A hard spring behind a slow electrode: no single effect comes near, and the strongest is named first."""
    parts = effect("stiffening", form="limited chain", curvature=0.25), effect("electrode_rc", tau=0.02)
    found = pitp.diagnose(nominal, play(replace(nominal, effects=parts)))
    assert found.verdict == "explained" and set(found.effects) == {"stiffening", "electrode_rc"}
    assert some(found.gap.closed_fraction) > 0.95 and found.gap.after < 0.5 * found.ranking[0].heldout


@pytest.mark.slow
def test_two_effects_are_both_named_beside_a_refit(nominal):
    """Where a gain's column, less the coefficients', is the whole error, every pair once had the gain for a half."""
    parts = effect("voltage_clip", inverse=1 / 850.0), effect("sensor_lag", tau=0.02)
    records = play(replace(nominal, effects=parts))
    bent = pitp.identify(records, order=2).model
    found = pitp.diagnose(bent, records, refit_nominal=True, exclude=FEW)
    assert found.verdict == "explained" and set(found.effects) == {"voltage_clip", "sensor_lag"}
    np.testing.assert_allclose(found.model.physical_coefficients, nominal.physical_coefficients, rtol=0.02)
    assert not {"sensor_gain", "added_mass"} & {r.effect for r in found.ranking}


@pytest.mark.slow
def test_effects_the_nominal_has_are_kept(nominal):
    """A model with three lags of its own: no gap on its own records, and a new effect stands beside them."""
    own = (
        effect("electrode_rc", tau=0.01),
        effect("delay", time=7e-3),
        effect("sensor_lag", tau=8e-3),
    )
    model = replace(nominal, effects=own)
    assert pitp.diagnose(model, play(model), exclude=FEW).verdict == "no_gap"
    stiffer = replace(model, effects=(*own, effect("stiffening", form="limited chain", curvature=0.25)))
    found = pitp.diagnose(model, play(stiffer), exclude=FEW)
    assert found.effects == ("stiffening",) and some(found.gap.closed_fraction) > 0.95
    assert [e.name for e in found.model.effects] == ["electrode_rc", "delay", "sensor_lag", "stiffening"]


@pytest.mark.slow
@pytest.mark.parametrize("exclude", [FEW, pytest.param((), marks=pytest.mark.exhaustive)], ids=("few", "all"))
def test_hum_is_unknown(nominal, exclude):
    told: list[str] = []
    found = pitp.diagnose(nominal, play(nominal, extra=4e-5), exclude=exclude, progress=told.append)
    assert not any(line.startswith("once more") for line in told)  # nothing that helps here would help the other way
    assert found.verdict == "unknown" and found.effects == ()
    assert found.where["tone"]["hz"] == pytest.approx(17.3, abs=0.2) and found.where["tone"]["records"] == 7
    assert found.where["summary"].startswith("A steady tone at 17")


@pytest.mark.exhaustive
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


@pytest.mark.slow
def test_an_excluded_effect_does_not_come_back_inside_another_form(nominal):
    """A slew limit with a lag, its limit out of reach, is the lag: left out with it."""
    records = play(replace(nominal, effects=(effect("electrode_rc", tau=0.02),)))
    others = sorted({c.name for c in CATALOGUE} - {"slew_limit", "electrode_rc"} | {"parameter_change"})
    assert pitp.diagnose(nominal, records, exclude=others).effects == ("electrode_rc",)
    found = pitp.diagnose(nominal, records, exclude=[*others, "electrode_rc"])
    assert found.effects == () and {r.form for r in found.ranking} == {"rate limit"}


def test_no_records_is_bad_input(nominal):
    with pytest.raises(pitp.BadInput, match="at least one record"):
        pitp.diagnose(nominal, [])

"""The withheld check: plants against scipy and diffrax, a generator for every name, seals, scores, one whole run."""

import dataclasses
import importlib
import json
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal
from typed import some

import pitp_jax as pitp

ROOT = Path(__file__).resolve().parents[1]
INSIDE = (
    "stiffening softening end_stop slack creep relaxation hysteresis coulomb_friction drag electrode_rc slew_limit "
    "voltage_clip voltage_offset delay charge_leak stretch_coupling dielectric_saturation added_mass second_mode "
    "dead_zone stiffness_drift sensor_gain sensor_lag parameter_change backlash charge_retention mullins "
    "sensor_nonlinearity bleeder force_lag"
).split()
OUTSIDE = ("hum", "wander", "pumping", "tremor", "impulses", "dropouts")


@pytest.fixture(scope="module")
def kit():
    """The modules of the check, by name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "experiments"))
        names = ("plant", "protocol", "case", "scale", "catalogue", "seal", "score", "cells")
        parts = {name: importlib.import_module(f"_withheld.{name}") for name in names}
        yield SimpleNamespace(**parts, script=importlib.import_module("withheld_effect"))


@pytest.fixture(scope="module")
def bench(kit):
    """One short sweep of one plant at the end of a session, and its healthy statistics."""
    rng = np.random.default_rng(3)
    plant = dataclasses.replace(kit.protocol.draw_plant(kit.protocol.KINDS["short"], rng), zeta=0.08)
    voltage = kit.protocol.draw_voltages(plant, rng)[:1]
    inputs = kit.case._inputs(plant, voltage, []) | {"clock": np.array([50.0])}
    return SimpleNamespace(
        plant=plant, inputs=inputs, base=kit.case._healthy(plant, voltage), stats=kit.case._stats(plant, voltage)
    )


def with_form(kit, bench, form, target=8.0):
    """Strength, constants, inputs and output of one form on the bench."""
    rng, one = np.random.default_rng(0), bench.inputs["u"][0]
    constants = {k: float(v) for k, v in form.draw(rng, bench.stats).items()}
    arrays = [form.arrays(rng, np.arange(len(one)) / 1e3, bench.stats)]
    inputs = kit.case._inputs(bench.plant, [one * bench.plant.kind.top], [arrays]) | {"clock": bench.inputs["clock"]}
    found = kit.scale.search(form, constants, bench.plant.constants, inputs, bench.base, target)
    return found[0], constants, inputs, found[1]


def test_healthy_plant_under_constant_voltage_is_the_step_response(kit, bench):
    constants, count = bench.plant.constants, 800
    u = np.full((1, count), 0.7)
    system = signal.lti([1.0], [1.0, 2 * bench.plant.zeta, 1.0])
    _, want = signal.step(system, T=constants["step"] * np.arange(count))
    inputs = {"u": u, "clock": np.zeros(1), "push": (), "gate": (), "add": ()}
    stepped = kit.plant.outputs((), np.zeros((1, 0)), (), constants, inputs)[0, 0]
    closed = kit.plant.healthy(u, constants["step"], bench.plant.zeta)[0, 0]
    np.testing.assert_allclose(closed, 0.49 * want, atol=1e-11)
    np.testing.assert_allclose(stepped, 0.49 * want, atol=1e-7)


def test_healthy_plant_is_linear_response_to_the_squared_voltage(kit, bench):
    u, constants, fine = bench.inputs["u"][0][:1500], bench.plant.constants, 20
    t = np.arange(len(u)) * constants["step"]
    dense = np.linspace(0, t[-1], (len(t) - 1) * fine + 1)
    _, want, _ = signal.lsim(([1.0], [1.0, 2 * bench.plant.zeta, 1.0]), np.interp(dense, t, u) ** 2, dense)
    np.testing.assert_allclose(bench.base[0][:1500], want[::fine], atol=1e-6)


def test_records_start_at_rest_and_are_rounded(kit):
    case = kit.case.make(kit.case.Spec((), "short", 0))
    floor = kit.protocol.noise_std(list(case.true.values()))
    assert [r.name for r in case.real] == list(kit.protocol.NAMES)
    for clean, real in zip(case.clean, case.real, strict=True):
        assert clean.time[0] == 0 and case.true[real.name][0] == 0 and real.voltage[0] > 0
        assert np.abs(real.displacement[:3]).max() < 6 * floor
        np.testing.assert_array_equal(np.round(real.voltage, 2), real.voltage)
    assert case.facts["gap_percent"] == 0 and case.facts["floor_percent"] == pytest.approx(0.3)
    assert np.all(np.diff([r.time[0] for r in case.real]) > 0)


def test_noise_keeps_its_level_when_coloured(kit):
    y = [np.sin(np.arange(40000) / 500)]
    for noise in ("white", "ar"):
        error = kit.protocol.measure(y, noise, np.random.default_rng(0))[0] - y[0]
        assert 100 * error.std() / 2 == pytest.approx(0.3, rel=0.1)
        assert np.corrcoef(error[1:], error[:-1])[0, 1] == pytest.approx(0.9 if noise == "ar" else 0.0, abs=0.02)


def test_every_name_of_the_catalogue_is_there(kit):
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    rows = [line.split("`")[1] for line in page.splitlines() if line.startswith("| `")]
    assert set(kit.catalogue.INSIDE) == set(INSIDE) and set(kit.catalogue.OUTSIDE) == set(OUTSIDE)
    # no actuator here has a position controller, and no sensor here sees the input
    assert set(rows) == {*INSIDE, "force_limit", "feedthrough"}
    assert all(set(pair) <= set(INSIDE) for pair in kit.catalogue.PAIRS)


@pytest.mark.parametrize("name", INSIDE)
def test_every_effect_makes_a_gap(kit, bench, name):
    _, _, inputs, y = with_form(kit, bench, kit.catalogue.FORMS[name][-1])
    assert 4 < kit.scale.gap(y, bench.base) < 16 and abs(y[0][0]) < 1e-12


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", [*INSIDE, *OUTSIDE])
def test_whole_cases_have_the_gap_they_claim(kit, name):
    case = kit.case.make(kit.case.Spec((name,), "cone", 0))
    errors = [r.displacement - case.true[r.name] for r in case.real]
    assert 2 < case.facts["gap_percent"] < 25
    assert max(np.abs(e).max() for e in errors) < 8 * kit.protocol.noise_std(list(case.true.values()))


STEEP = [("coulomb_friction", 1), ("end_stop", 0), ("slew_limit", 1), ("hysteresis", 1), ("slack", 0)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "which"), [("hysteresis", 0), *(pytest.param(*s, marks=pytest.mark.exhaustive) for s in STEEP)]
)
def test_fixed_steps_agree_with_diffrax(kit, bench, name, which):
    form, last = kit.catalogue.FORMS[name][which], 400
    short = bench.inputs["u"][:, -last:]
    p, c, _, _ = with_form(kit, bench, form)
    plant, inputs = (
        bench.plant.constants,
        {"u": short, "clock": np.zeros(1), **dict.fromkeys(("push", "gate", "add"), (None,))},
    )
    got = kit.plant.outputs((form,), [[p]], (c,), plant, inputs)[0, 0]
    with jax.enable_x64(True):
        grid, u = plant["step"] * jnp.arange(last), jnp.asarray(short[0])
        field = partial(kit.plant.rate, (form,), (p,), (c,), plant["zeta"])
        control = diffrax.PIDController(rtol=1e-9, atol=1e-10)
        control = diffrax.ClipStepSizeController(control, jump_ts=grid[1:-1])
        path = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, _: field(y, jnp.interp(t, grid, u), 0.0, t)), diffrax.Dopri8(), 0.0, grid[-1],
            None, jnp.zeros(2 + form.states), saveat=diffrax.SaveAt(ts=grid), stepsize_controller=control,
            max_steps=None,
        )  # fmt: skip
        want = np.asarray(some(path.ys)[:, 0])
    assert np.abs(got - want).max() < 1e-4 * np.ptp(want)


def test_largest_stretch_lasts_through_a_session(kit, bench):
    """After a recording under a large step the law is a constant spring, so the next one is a linear step response."""
    (form,), count = kit.catalogue.FORMS["mullins"], 6000
    u = np.array([np.full(count, level) for level in (0.9, 0.3)])
    plant, none = bench.plant.constants, dict.fromkeys(("push", "gate", "add"), (None,))
    p, r = 0.4, 0.5
    first, second = kit.plant.outputs(
        (form,), [[p]], ({"r": r},), plant, {"u": u, "clock": np.array([0.0, 50.0]), **none}
    )[0]
    spring = 1 - p * first.max() / (first.max() + r)
    system = signal.lti([1.0], [1.0, 2 * plant["zeta"], spring])
    _, want = signal.step(system, T=plant["step"] * np.arange(count))
    np.testing.assert_allclose(second, 0.3**2 * want, atol=2e-3 * want.max())


def test_sealed_labels_open_only_unchanged(kit):
    sealed = kit.seal.Sealed({"a": "creep", "b": "none"})
    assert sealed.digest != kit.seal.Sealed(sealed.labels).digest and "creep" not in repr(sealed)
    assert kit.seal.opened(sealed.labels, sealed.salt, sealed.digest) == sealed.labels
    with pytest.raises(ValueError, match="not the ones"):
        kit.seal.opened({"a": "drag", "b": "none"}, sealed.salt, sealed.digest)


def test_verdicts_against_truth(kit):
    def row(verdict, effects=(), equivalent=()):
        return {"verdict": verdict, "effects": list(effects), "equivalent": list(equivalent)}

    right = partial(kit.score.right, refit=False, left_out=False)
    assert right("none", row("no_gap")) and not right("none", row("explained", ["drag"]))
    assert right("hum", row("unknown")) and not right("hum", row("explained", ["drag"]))
    assert right("drag", row("explained", ["drag", "creep"])) and not right("drag", row("explained", ["creep", "drag"]))
    assert right("drag", row("explained", ["creep"], ["drag"]), ties=True)
    assert not right("drag", row("explained", ["creep"], ["a", "b", "c", "drag"]), ties=True)
    assert right("drag+creep", row("explained", ["creep", "drag"])) and not right(
        "drag+creep", row("explained", ["drag"])
    )
    assert kit.score.right("drag", row("unknown"), refit=False, left_out=True)
    assert kit.score.right("added_mass", row("no_gap"), refit=True, left_out=False)


def test_cells_follow_the_missing_force(kit):
    t = np.arange(4000) / 1e3
    size, hz = np.where(t < 2, 1e-3, 3e-3), np.where(t < 2, 2.0, 5.0)
    record = pitp.Record("a", t, np.sin(2 * np.pi * hz * t) + 1.0, size * np.sin(2 * np.pi * hz * t))
    facts, force = {"f0_hz": 7.0}, np.where(t < 2, 0.05, np.sin(2 * np.pi * 30 * t))
    case = SimpleNamespace(real=[record], true={"a": record.displacement}, missing={"a": force}, facts=facts)
    bands, sizes = ((0, 3), (3, 60)), ((0, 2e-3), (2e-3, 2.5e-3))
    cells = [{"band_hz": b, "amplitude": a, "flagged": b[0] > 0 and a[0] > 0} for b in bands for a in sizes]
    assert sum(b - a for a, b, _ in kit.cells.parts(record.voltage, 1e3, 7.0)) > 3300
    np.testing.assert_allclose(kit.cells.loudness(case, cells), [0.05, 0, 0, np.sqrt(0.5)], atol=0.06)
    assert kit.cells.f1(case, cells) == 1.0


@pytest.mark.slow
def test_a_whole_run_resumes_and_reports(kit, tmp_path, monkeypatch, capsys):
    calls = []

    def fake(nominal, records, *, refit_nominal=False):
        calls.append(len(records))
        said = {
            "verdict": "explained", "effects": ["added_mass"], "equivalent": [], "ranking": [],
            "gap": {"closed_fraction": 0.5, "ci95": [-1.0, 1.0]}, "where": {"cells": []},
            "records": {"fitted": [], "heldout": ["sine0", "steps"]},
        }  # fmt: skip
        number = {"d": {"value": 0.0, "unit": "1", "stderr": 0.1}}
        added = SimpleNamespace(effect="added_mass", form="share", parameters=number)
        return SimpleNamespace(model=nominal, added=(added,), as_json=lambda: said)

    monkeypatch.setitem(vars(pitp), "diagnose", fake)
    options = [
        "--cache",
        str(tmp_path / "cases"),
        "--results",
        str(tmp_path / "rows"),
        "--write",
        str(tmp_path / "csv"),
    ]
    first = kit.script.main(smoke=True, argv=options)
    again = kit.script.main(smoke=True, argv=options)
    printed = capsys.readouterr().out
    assert calls == [7] and first == again == [json.loads(p.read_text()) for p in (tmp_path / "rows").glob("*.json")]
    truth = json.loads(str(np.load(next((tmp_path / "cases").glob("*.npz")))["facts"]))["strengths"]
    assert first[0]["within"] == [truth[0] <= 0.196]
    assert first[0]["verdict"] == "explained" and first[0]["true_closed"] == 0.0 and first[0]["covered"]
    assert printed.count("labels sealed: sha256") == 2 and "added_mass" in printed.split("opened")[1]
    assert len(pitp.read(next((tmp_path / "csv").iterdir()) / "real")) == 7

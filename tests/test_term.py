"""A term found in the data: the planted sum and no other, nothing in noise, and an effect like any other."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from exported import Exported, truth
from played import FEW, KEPT, TIME, nominal_of, play
from scipy.integrate import solve_ivp
from typed import some

import pitp_jax as pitp
from pitp_jax._diagnose.batched_rollouts import Lanes
from pitp_jax._diagnose.case import build_case
from pitp_jax._diagnose.evaluation import judge
from pitp_jax._diagnose.fit import Candidate
from pitp_jax._diagnose.report import figures
from pitp_jax._diagnose.report.page import report
from pitp_jax._diagnose.term import Drawn, Term
from pitp_jax._diagnose.term_search import search
from pitp_jax._effects.found_term import KNEES, LIBRARY, NAMES, Values, sparse_term
from pitp_jax._effects.physical import in_scales
from pitp_jax._export import steps
from pitp_jax._export.c99 import export_c
from pitp_jax._simulate import ports
from pitp_jax._simulate.decoder import rest_state, rollout

FLOOR = 0.14  # %, of the records of `play`


def term(a=1.0, b=1.0, e=1.0, tau=1.0, d=1.0, **sums):
    return sparse_term([sums.get(name, 0.0) for name in NAMES] + [a, b, e, tau, d])


@pytest.fixture(scope="module")
def nominal(linear):
    return nominal_of(linear)


@pytest.fixture(scope="module")
def described(nominal):
    """Damping by the field and a spring that gives way, diagnosed without the springs' names."""
    planted = replace(nominal, effects=(term(**{"x' F": 0.3, "x^3": -0.05}),))
    keeping = {"stiffening", "delay"}
    return pitp.diagnose(nominal, play(planted), exclude=[*FEW, *(set(KEPT) - keeping), "parameter_change"])


def test_what_no_name_explains_is_an_equation_with_units_and_intervals(nominal, described):
    found = some(described.term)
    assert described.verdict == "unknown" and described.effects == ()
    assert found.equation == "missing force = c1 x^3 + c2 x' V^2"
    scale, force = nominal.scales.state, nominal.scales.force
    for name, unit, value in (("c1", "V^2/m^3", -0.05 * force / scale[0] ** 3), ("c2", "s/m", 0.3 / scale[1])):
        told = found.parameters[name]
        assert told["unit"] == unit and abs(told["value"] - value) < 3 * told["stderr"] + 0.02 * abs(value)
        assert told["ci95"][0] < told["value"] < told["ci95"][1]
    assert some(found.closed_fraction) > 0.95 and found.after < 1.2 * some(described.gap.noise_floor)
    assert set(json.loads(json.dumps(described.as_json()))["term"]) == {
        "equation",
        "parameters",
        "closed_fraction",
        "ci95",
    }


@pytest.mark.slow
def test_the_model_handed_back_carries_it(nominal, described, tmp_path):
    pitp.save(tmp_path / "m", described.model)
    model = pitp.load(tmp_path / "m")
    assert model.effects[0].spec.functions == ("x^3", "x' F")
    records = play(replace(nominal, effects=(term(**{"x' F": 0.3, "x^3": -0.05}),)), noise=0.0, seed=4)[:2]
    for old, new, r in zip(pitp.predict(nominal, records), pitp.predict(model, records), records, strict=True):
        before, after = (pitp.e_rms_percent(p.displacement, r.displacement) for p in (old, new))
        assert after < 0.1 * before


def test_the_page_and_its_figure_show_it(unknown):
    drawn = Drawn("velocity", np.linspace(-1, 1, 50), np.zeros(50), np.array([-1.0, 1.0]), np.array([-2.0, 2.0]))
    told = {"c1": {"value": 3.2, "unit": "s/m", "stderr": 0.1, "ci95": [3.0, 3.4]}}
    found = Term("missing force = c1 x' V^2", told, 0.93, (0.9, 0.95), 0.5, term(**{"x' F": 0.3}), drawn)
    described = replace(unknown, term=found)
    page = report(described)
    assert "missing force = c1 x&#x27; V^2" in page and "closes 93" in page and "term-" in page
    assert found.equation in str(described)
    ax = figures.found_force(described)
    assert len(ax.lines) == 2 and ax.get_ylabel() == "missing force (%)"


def test_nothing_is_found_in_noise(nominal):
    case = build_case(nominal, play(nominal))
    lanes = Lanes(case, [()])
    (base,) = judge(lanes, [Candidate((), (), (), np.ones(3), False)])
    assert search(case, base, FLOOR / 2) is None


def test_a_threshold_is_found_where_it_is(nominal):
    planted = replace(nominal, effects=(term(0.6, **{"max(x - a, 0) x'": 0.5}),))
    case = build_case(nominal, play(planted))
    (base,) = judge(Lanes(case, [()]), [Candidate((), (), (), np.ones(3), False)])
    found = sparse_term(some(search(case, base, FLOOR)).candidate.values[-1])
    assert found.spec.functions == ("max(x - a, 0) x'",) and float(found.knees[0]) == pytest.approx(0.6, abs=0.02)


def test_a_free_run_is_that_of_the_equation(nominal):
    """Against SciPy in physical units: products, a threshold, a memory and a mass that depends on the place."""
    sums = {"x x'": 0.2, "x' F": 0.1, "max(x - a, 0)": 0.4, "x - z": 0.3, "x x''": 0.05, "x U": -0.1}
    model = replace(nominal, effects=(term(0.5, tau=0.3, **sums),), substeps=4)
    scale, a = model.scales.state, np.asarray(model.coefficients, float)
    u = 600 + 300 * np.sin(2 * np.pi * 2.1 * TIME)

    def rate(t, y):
        x, v, z = y
        volts = np.interp(t, TIME, u)
        f = volts**2 / model.scales.force
        force = 0.2 * x * v + 0.1 * v * f + 0.4 * max(x - 0.5, 0) + 0.3 * (x - z) - 0.1 * x * np.sqrt(f)
        last = (f - a[0] * x - a[1] * v - force) / (a[2] + 0.05 * x)
        return v * scale[1] / scale[0], last * scale[2] / scale[1], (x - z) / 0.3

    wanted = solve_ivp(rate, (0, TIME[-1]), np.zeros(3), t_eval=TIME, rtol=1e-8, atol=1e-10, max_step=0.01).y[0]
    run = rollout(model, jnp.asarray(u, jnp.float32), float(TIME[1]), rest_state(model))[:, 0]
    assert np.abs(np.asarray(run) - wanted).max() < 1e-3 * np.ptp(wanted)


@pytest.fixture(scope="module")
def driven(nominal, bounded):
    sums = {"x' F": 0.2, "x U": 0.1, "F^2": 0.05, "x x'": 0.1}
    return replace(bounded(nominal, 0.0, 2000.0, 1e6), effects=(term(**sums),))


def test_the_inverse_solves_for_the_force_that_is_in_the_term(driven):
    row = jnp.asarray([0.5, -0.4, 0.2])
    force = ports.needed(driven, ports.split(driven, jnp.zeros(1)), row, row[:2])
    x, v, f = 0.5, -0.4, float(force)
    value = 0.2 * v * f + 0.1 * x * np.sqrt(f) + 0.05 * f**2 + 0.1 * x * v
    assert f == pytest.approx(float(driven.coefficients @ row) + value, rel=1e-5)


@pytest.mark.slow
def test_its_inverse_is_exported(driven, tmp_path):
    export_c(driven, tmp_path / "c")
    library, dt = Exported(tmp_path / "c", 2), driven.dt
    target = 1e-3 * np.stack([0.3 - 0.2 * np.cos(9 * TIME), 1.8 * np.sin(9 * TIME), 16.2 * np.cos(9 * TIME)], 1)[:200]
    with jax.enable_x64(True):
        states, after, out = truth(steps.inverse(driven, dt), target)
    found, drive = library.follow(True, states, target)
    assert np.abs(drive[:, 0] - out[:, 0]).max() < 1e-4 * np.abs(out[:, 0]).max()


def test_in_other_scales_it_is_the_same_force(nominal):
    old = (nominal.scales.state, float(nominal.scales.force))
    new = (nominal.scales.state * [2.0, 3.0, 5.0], 0.7 * old[1])
    effect = term(0.4, 0.3, 0.2, 0.1, **dict.fromkeys(NAMES, 0.1))
    twice = in_scales(in_scales(effect, old, new), new, old)
    assert twice.spec is effect.spec and np.allclose(twice.c, effect.c) and np.allclose(twice.knees, effect.knees)
    here, there = ({p.name: float(v) for p, v in e.numbers()} for e in (effect, in_scales(effect, old, new)))
    ratios = {"x": 1 / 2, "v": 1 / 3, "f": 1 / 0.7}
    for name in ("x^2 x'", "x' U", "x F^2", "max(F - e, 0)"):
        f, knees = LIBRARY[name], [[e[p.name] for p in KNEES] for e in (here, there)]
        first = here[name] * f.of(Values(0.8, 0.5, 0.9, 0.1, knees[0]))
        second = there[name] * f.of(Values(0.8 * ratios["x"], 0.5 * ratios["v"], 0.9 * ratios["f"], 0.05, knees[1]))
        assert float(second) == pytest.approx(float(first) / 0.7, rel=1e-4)

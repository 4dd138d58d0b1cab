"""Pages in a browser, at a desk and on a telephone: every cell of every table is visible, no text is under 11 px."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from browser import CHROMIUM, measured
from test_compare import machine

import pitp_jax as pitp
from pitp_jax.application.against.result import SimToReal
from pitp_jax.application.commands import outputs
from pitp_jax.application.commands.predict import score
from pitp_jax.application.compare.pairing import pair_records
from pitp_jax.application.pages.against import page as against_page
from pitp_jax.application.pages.bode_page import bode_page
from pitp_jax.application.pages.check import page as check_page
from pitp_jax.application.pages.compare import page as compare_page
from pitp_jax.application.pages.diagnosis.page import report
from pitp_jax.application.pages.fit_page import fit_page
from pitp_jax.application.pages.plan import page as plan_page
from pitp_jax.common.page import Page
from pitp_jax.method.diagnose.joint import Parameter

pytestmark = pytest.mark.browser

TIME = np.arange(1000) / 500


def many(count):
    """Recordings with long names, some with faults."""
    made = []
    for k in range(count):
        u = 1000 * (1 - np.cos(2 * np.pi * (1 + 0.2 * k) * TIME))
        x = 2e-10 * u**2 + 1e-7 * np.random.default_rng(k).standard_normal(len(TIME))
        x[100 : 100 + k] = np.nan
        name = f"a_rather_long_name_of_a_recording_{k:02d}_sine_{1 + 0.2 * k:.1f}Hz_2000V"
        made.append(pitp.Record(name, TIME + 10 * k, u, x, displacement_unit="um"))
    return made


def fit_or_compare(kind):
    simulated, robot = machine(), machine(late=0.02, gain=0.9)
    if kind == "compare":
        return compare_page(pitp.compare(simulated, robot, names=("simulator", "robot"))).html()
    model = pitp.identify(simulated, order=2, input_map="linear").model
    runs = pitp.predict(model, robot)
    scores = {r.name: score(r, p) for r, p in zip(robot, runs, strict=True)}
    return fit_page(model, robot, runs, scores, "model.pitp").html()


def against(explained):
    """A robot beside its simulator; what was found is made up, all the rest is drawn from recordings."""
    simulated, robot = machine(), machine(late=0.02, gain=0.9)
    names = ("joint frictionloss", "friction coefficient, static and dynamic", "joint dynamics friction")
    rows = [
        Parameter(
            f"friction {k}", "friction of the joint, speed reversed", 0.0, 0.7, 0.7 * k, 0.01, "N m", *names, k == 1
        )
        for k in range(3)
    ]
    rest = {k: {"share": 0.1} for k in ("nuisance", "parameters", "unnamed", "unexplainable")}
    budget = rest | {"effects": {"delay": {"share": 0.6}}}
    found: Any = SimToReal(
        explained,
        None,
        explained.model,
        0.1,
        pair_records(robot, simulated),
        tuple(rows),
        tuple(robot),
        tuple(0.1 * r.voltage for r in robot),
    )
    object.__setattr__(explained, "budget", budget)
    return against_page(found).html()


def index(folder):
    for k in range(12):
        (folder / f"a_rather_long_name_of_a_page_{k:02d}.html").write_text(
            Page("The gap is explained " * 3, "", []).html()
        )
    with outputs.staged(folder=folder) as stage:
        (stage / "report.html").write_text(Page("No gap", "", []).html())
    return (folder / "index.html").read_text()


def with_long_names(found):
    """Two effects of long names whose recordings have long names, too, in degrees."""
    names = {t.name: f"2026-11-25_a_rather_long_name_of_{k}" for k, t in enumerate(found.traces)}
    traces = tuple(replace(t, name=names[t.name]) for t in found.traces)
    where = found.where | {"records": {names[n]: v for n, v in found.where["records"].items()}}
    effects = ("electrode_rc", "dielectric_saturation")
    return replace(found, effects=effects, traces=traces, where=where, heldout=tuple(names.values()))


VERDICTS = ("explained", "tied", "no_gap", "unknown")
CELLS = {"index": (0, 10), "bode": (7, 7)}  # of its tables; every other page has more than ten
KINDS = ("compare", "fit", "bode", "check", "plan", "against", "index", "partly", "long_names", *VERDICTS)


@pytest.fixture
def drawn(request, name, tmp_path):
    """The page of a kind."""
    made = {
        "check": lambda: check_page(pitp.check(many(30))).html(),
        "plan": lambda: plan_page(pitp.plan(max_voltage=6000.0, band=(0.5, 10.0), max_displacement=2.5e-3)).html(),
        "against": lambda: against(request.getfixturevalue("explained")),
        "index": lambda: index(tmp_path),
        "partly": lambda: report(replace(request.getfixturevalue("tied"), verdict="partly")).html(),
        "long_names": lambda: report(with_long_names(request.getfixturevalue("explained"))).html(),
        "bode": lambda: bode_page(pitp.identify(machine(), order=2, input_map="linear"), "nominal.pitp").html(),
        **{verdict: lambda: report(request.getfixturevalue(name)).html() for verdict in VERDICTS},
    }
    return made.get(name, lambda: fit_or_compare(name))()


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_every_cell_is_seen_text_can_be_read_and_the_page_is_small(drawn, name, tmp_path):
    assert "http" not in drawn and "<script" not in drawn
    assert len(drawn) < 2e6 and "@media print" in drawn
    if CHROMIUM is None:
        pytest.skip("needs chromium")
    for width in (1280, 390):
        seen = measured(drawn, width, tmp_path)
        fewest, most = CELLS.get(name, (11, np.inf))
        assert fewest <= seen["cells"] <= most
        assert seen["bad"] == [], (width, seen["bad"])
        assert seen["smallest"] >= 11.0, (width, seen["least"])


@pytest.mark.exhaustive
def test_a_page_of_a_hundred_records_is_below_two_megabytes():
    assert len(check_page(pitp.check(many(100))).html()) < 2e6

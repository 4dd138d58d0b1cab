"""Pages in a browser, at a desk and on a telephone: every cell of every table is visible, no text is under 11 px."""

import numpy as np
import pytest
from browser import CHROMIUM, measured
from test_compare import machine

import pitp_jax as pitp
from pitp_jax._check.page import page as check_page
from pitp_jax._commands.fit_page import fit_page
from pitp_jax._commands.predict import score
from pitp_jax._compare.page import page as compare_page
from pitp_jax._plan.page import page as plan_page

pytestmark = [
    pytest.mark.browser, pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
]  # fmt: skip
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


def pages():
    simulated, robot = machine(), machine(late=0.02, gain=0.9)
    model = pitp.identify(simulated, order=2, input_map="linear").model
    runs = pitp.predict(model, robot)
    scores = {r.name: score(r, p) for r, p in zip(robot, runs, strict=True)}
    return {
        "compare": compare_page(pitp.compare(simulated, robot, names=("simulator", "robot"))),
        "check": check_page(pitp.check(many(30))),
        "plan": plan_page(pitp.plan(max_voltage=6000.0, band=(0.5, 10.0), max_displacement=2.5e-3)),
        "fit": fit_page(model, robot, runs, scores, "model.pitp"),
    }


@pytest.fixture(scope="module")
def drawn():
    return pages()


@pytest.mark.parametrize("name", ["compare", "check", "plan", "fit"])
@pytest.mark.parametrize("width", [1280, 390])
def test_every_cell_is_seen_and_text_can_be_read(drawn, name, width, tmp_path):
    seen = measured(drawn[name], width, tmp_path)
    assert seen["cells"] > 10
    assert seen["bad"] == []
    assert seen["smallest"] >= 11.0, seen["least"]


@pytest.mark.parametrize("name", ["compare", "check", "plan", "fit"])
def test_pages_load_nothing_and_are_small(drawn, name):
    assert "http" not in drawn[name] and "<script" not in drawn[name]
    assert len(drawn[name]) < 2e6 and "@media print" in drawn[name]


def test_a_page_of_a_hundred_records_is_below_two_megabytes():
    assert len(check_page(pitp.check(many(100)))) < 2e6

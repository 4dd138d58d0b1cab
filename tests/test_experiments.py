"""Every script of the paper's tables and figures runs, prints its table and leaves its figure."""

import importlib
from pathlib import Path

import pytest

EXPERIMENTS = Path(__file__).resolve().parents[1] / "experiments"
SCRIPTS = {
    "fig06_orders": "fig06_orders.png",
    "table1_prediction": "table1_prediction.png",
    "fig11_comparison": "fig11_comparison_roll.png",
    "table2_tracking": "table2_tracking.png",
    "fig14_pi": "fig14_pi_cone100.png",
    "fig15_loads": "fig15_loads.png",
    "fig17_long": "fig17_long_cone100.png",
    "fig18_complex": "fig18_complex.png",
    "fig19_ablations": "fig19_ablations_cone100.png",
}


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """One folder of fitted models for all scripts."""
    return tmp_path_factory.mktemp("fits")


def run(name, cache, tmp_path, monkeypatch, capsys):
    """The script's output, and its figure's size."""
    monkeypatch.syspath_prepend(str(EXPERIMENTS))
    importlib.import_module(name).main(smoke=True, argv=["--out", str(tmp_path), "--cache", str(cache)])
    return capsys.readouterr().out, (tmp_path / SCRIPTS[name]).stat().st_size


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", [n for n in SCRIPTS if n != "fig06_orders"])
def test_every_script_runs_in_smoke(name, cache, tmp_path, monkeypatch, capsys):
    printed, size = run(name, cache, tmp_path, monkeypatch, capsys)
    header = next(line for line in printed.splitlines() if line.startswith("cell"))
    assert "paper" in header and "ours" in header
    assert "held-out" in printed.lower() and size > 5000


@pytest.mark.slow
def test_the_cheapest_script_runs_in_smoke(cache, tmp_path, monkeypatch, capsys):
    printed, size = run("fig06_orders", cache, tmp_path, monkeypatch, capsys)
    assert "cone100, tokens (order + 1)" in printed and size > 5000


def test_the_papers_tables_as_transcribed(monkeypatch):
    monkeypatch.syspath_prepend(str(EXPERIMENTS))
    paper = importlib.import_module("_paper")
    assert set(paper.TABLE_1) == set(paper.TABLE_2) == set(paper.TOKENS) == set(paper.ACTUATORS)
    assert sum(map(len, paper.TABLE_1.values())) == 24 and sum(map(len, paper.TABLE_2.values())) == 16


def test_scripts_and_readme_name_each_other():
    readme = (EXPERIMENTS / "README.md").read_text()
    assert all(f"{name}.py" in readme for name in SCRIPTS)
    assert all((EXPERIMENTS / f"{name}.py").is_file() for name in SCRIPTS)

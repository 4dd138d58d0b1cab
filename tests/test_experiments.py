"""Scripts of the paper's tables and figures leave their table and figure; all others start, the short ones run."""

import importlib
import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from exported import COMPILERS

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


OTHERS = sorted({path.stem for path in EXPERIMENTS.glob("[a-z]*.py")} - set(SCRIPTS))
SHORT = (  # 2 to 11 s of CPU each
    "another_day", "beyond_the_recordings", "closed_loop", "coverage", "expected_errors", "fuzz_files", "hasel_gap",
    "identify_bank", "learned_delay", "planned_strokes", "planted_differences", "realtime_loop", "so101_prediction",
    "start_kinds", "worst_case",
)  # fmt: skip
LONG = [name for name in OTHERS if name not in SHORT]  # they train or diagnose
SMOKES = [pytest.param(n, marks=pytest.mark.slow if n in SHORT else pytest.mark.exhaustive) for n in OTHERS]


def start(name, option, monkeypatch):
    """Run a script with one option, as its own command line."""
    monkeypatch.syspath_prepend(str(EXPERIMENTS))
    monkeypatch.setattr(sys, "argv", [name, option])
    runpy.run_path(str(EXPERIMENTS / f"{name}.py"), run_name="__main__")


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
def test_every_long_script_starts(name, monkeypatch, capsys):
    """Its imports are there and its options are declared."""
    if name in ("mjcf_bank", "mujoco_bank"):
        pytest.importorskip("mujoco")
    with pytest.raises(SystemExit) as ended:
        start(name, "--help", monkeypatch)
    assert ended.value.code == 0 and "usage:" in capsys.readouterr().out


@pytest.mark.parametrize("name", SMOKES)
def test_every_other_script_runs_in_smoke(name, monkeypatch, capsys):
    """Or says which recordings are absent."""
    if name in ("closed_loop", "realtime_loop") and not COMPILERS:
        pytest.skip("no C compiler")
    if name in ("mjcf_bank", "mujoco_bank"):
        pytest.importorskip("mujoco")
    if name == "fuzz_files":  # its processes load the main module again
        command = [sys.executable, "-m", f"experiments.{name}", "--smoke"]
        printed = subprocess.run(command, cwd=EXPERIMENTS.parent, capture_output=True, text=True, check=True).stdout
    else:
        start(name, "--smoke", monkeypatch)
        printed = capsys.readouterr().out
    first = printed.strip().splitlines()[0]
    if "skipped" in first:
        pytest.skip(first)
    assert re.search(r"\d", printed)  # a figure


def test_the_papers_tables_as_transcribed(monkeypatch):
    monkeypatch.syspath_prepend(str(EXPERIMENTS))
    paper = importlib.import_module("_paper")
    assert set(paper.TABLE_1) == set(paper.TABLE_2) == set(paper.TOKENS) == set(paper.ACTUATORS)
    assert sum(map(len, paper.TABLE_1.values())) == 24 and sum(map(len, paper.TABLE_2.values())) == 16


def test_scripts_and_readme_name_each_other():
    readme = (EXPERIMENTS / "README.md").read_text()
    scripts = {path.name for path in EXPERIMENTS.glob("[a-z]*.py")}
    assert scripts == set(re.findall(r"^\| `(\w+\.py)", readme, re.M))


@pytest.mark.parametrize(
    ("effects", "equivalent", "verdict", "answer"),
    [
        (["creep"], [], "explained", "right"),
        (["relaxation"], [], "explained", "right"),
        (["drag"], ["creep"], "explained", "tied"),
        (["drag"], [], "explained", "wrong"),
        ([], [], "unknown", "unknown"),
        ([], [], "no_gap", "wrong"),
    ],
)
def test_the_guard_tells_right_from_wrong(tmp_path, monkeypatch, effects, equivalent, verdict, answer):
    monkeypatch.syspath_prepend(str(EXPERIMENTS))
    guard = importlib.import_module("diagnosis_guard")
    (tmp_path / "gap").mkdir()
    (tmp_path / "gap" / "truth.json").write_text(json.dumps({"cases": {"slow": {"effect": "creep"}}}))
    named = {name: {"equivalent": equivalent} for name in effects}
    found = {"verdict": verdict, "effects": effects, "equivalent": equivalent, "budget": {"effects": named}}
    assert guard.judged("gap/slow", found, tmp_path) == answer
    healthy = "right" if verdict == "no_gap" else "unknown" if verdict == "unknown" else "wrong"
    assert guard.judged("healthy/one", found, tmp_path) == healthy

"""The manual is true: blocks and examples run, links lead somewhere, every public name is described once."""

import importlib
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cli.cli_cases import DRIVES, TIME, motion, truth, write_record
from manual_blocks import ROOT, RUN, SHOWN, Block, blocks, commands, pages

import pitp_jax
from pitp_jax.application.commands.examples import EXAMPLES
from pitp_jax.application.commands.main import _parser, main
from pitp_jax.application.demo import joint
from pitp_jax.files.model_file import model_file
from pitp_jax.method.effects import CATALOGUE

TUTORIALS = ("start", "which_recordings", "my_rig_disagrees", "another_day", "research")
LONG = ("README.md", *(f"docs/{name}.md" for name in TUTORIALS))
HEAVY = (
    "demo",
    "fit",
    "diagnose",
    "plan",
    "check",
    "adapt",
    "export",
    "verify",
)  # their examples run with the tutorials


def named(page: Path) -> str:
    return str(page.relative_to(ROOT))


def runnable(page: Path) -> list[Block]:
    return [b for b in blocks(page) if b.kind in RUN]


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """What `pitp demo --quick` leaves, in little: a linear actuator's records, and its model under both names."""
    root = tmp_path_factory.mktemp("small")
    for folder, names in (("records", DRIVES), ("held_out", ("sine2", "triangle", "complex"))):
        (root / "demo" / folder).mkdir(parents=True)
        for name in names:
            write_record(root / "demo" / folder / f"{name}.csv", *motion(name if name in DRIVES else "sine4"))
    for name in ("nominal.pitp", "model.pitp"):
        model_file.save(root / "demo" / name, truth())
    wanted = 5e-4 * (1 - np.cos(2 * np.pi * TIME)) * (1 - np.exp(-(TIME**2)))
    rows = "".join(f"{t:.6f},{x:.9g}\n" for t, x in zip(TIME, wanted, strict=True))
    (root / "demo" / "target.csv").write_text(f"time_s,displacement_m\n{rows}")
    return root


@pytest.fixture(scope="session")
def demo(tmp_path_factory):
    """What `pitp demo --quick` leaves; and the names README gives to recordings."""
    root = tmp_path_factory.mktemp("quick")
    assert main(["demo", "--quick", "--out", str(root / "demo")]) == 0
    shutil.copytree(root / "demo" / "records", root / "sines", ignore=shutil.ignore_patterns("sweep*"))
    shutil.copytree(root / "demo" / "held_out", root / "held_out")
    shutil.copytree(root / "demo" / "held_out", root / "monday")
    for name in ("records/sweep.csv", "target.csv", "model.pitp"):
        shutil.copy(root / "demo" / name, root / Path(name).name)
    for folder in (root, root / "demo"):
        joint.write(folder, quick=True)
    return root


def follow(page, start, tmp_path, monkeypatch):
    """Run a page from top to bottom in a copy of a folder."""
    shutil.copytree(start, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for block in runnable(page):
        block.run(names)


SHORT = [p for p in pages() if runnable(p) and named(p) not in LONG]


@pytest.mark.slow
@pytest.mark.parametrize("page", SHORT, ids=named)
def test_a_page_runs(page, small, tmp_path, monkeypatch):
    follow(page, small, tmp_path, monkeypatch)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", LONG)
def test_a_tutorial_runs(name, demo, tmp_path, monkeypatch):
    if name == "docs/start.md":  # its first command has made this folder
        monkeypatch.setattr("manual_blocks.main", lambda argv: 0 if argv[0] == "demo" else main(argv))
    follow(ROOT / name, demo, tmp_path, monkeypatch)


def test_every_block_is_run():
    """100 % of the blocks tagged as Python or shell, by the two tests above."""
    every = {named(p): runnable(p) for p in pages()}
    run = {named(p) for p in SHORT} | set(LONG)
    count = sum(map(len, every.values()))
    share = sum(len(found) for name, found in every.items() if name in run) / count
    print(f"{count} blocks, {100 * share:.0f} % run")
    assert share == 1 and count >= 20
    assert {b.kind for p in pages() for b in blocks(p)} <= {*RUN, *SHOWN, ""}


def parsers() -> dict:
    (found,) = (a.choices for a in _parser()._actions if isinstance(a.choices, dict))
    return found


def every_command() -> list[str]:
    shown = [c for p in pages() for b in runnable(p) if b.kind == "sh" for c in commands(b.text)]
    return shown + [e for name in parsers() for e in EXAMPLES[name]]


@pytest.mark.parametrize("command", every_command())
def test_every_command_shown_is_understood(command):
    _parser().parse_args(shlex.split(command)[1:])


@pytest.mark.parametrize("name", parsers())
def test_help_ends_with_two_examples_and_a_page(name, capsys):
    assert main([name, "--help"]) == 0
    *_, first, second, _, more = capsys.readouterr().out.strip().splitlines()
    assert all(line.startswith(f"  pitp {name} ") for line in (first, second))
    assert (ROOT / more.removeprefix("more: ")).is_file()


def example(command, start, tmp_path, monkeypatch):
    shutil.copytree(start / "demo", tmp_path / "demo")
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(command)[1:]) == 0


@pytest.mark.parametrize("command", [e for name in parsers() if name not in HEAVY for e in EXAMPLES[name]])
def test_examples_run(command, small, tmp_path, monkeypatch):
    example(command, small, tmp_path, monkeypatch)


@pytest.mark.exhaustive
@pytest.mark.parametrize("command", [e for name in parsers() if name in HEAVY for e in EXAMPLES[name]])
def test_long_examples_run(command, demo, tmp_path, monkeypatch):
    if command == EXAMPLES["demo"][0]:
        pytest.skip("run by the fixture")
    if command in EXAMPLES["verify"]:
        pytest.importorskip("mujoco")
    example(command, demo, tmp_path, monkeypatch)


def test_every_public_name_is_described_once():
    told = [
        n
        for p in (ROOT / "docs" / "api").glob("*.md")
        for n in re.findall(r"^::: pitp_jax\.(\w+)$", p.read_text(), re.M)
    ]
    assert sorted(told) == sorted(dir(pitp_jax))
    (index,) = (p.read_text() for p in (ROOT / "docs" / "api").glob("README.md"))
    assert all(f"`{name}`" in index for name in dir(pitp_jax))


def anchors(page: Path) -> set[str]:
    titles = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", t.lower()).strip().replace(" ", "-") for t in titles}


@pytest.mark.parametrize("page", pages(), ids=named)
def test_links_lead_to_a_page_and_a_heading(page):
    lost = []
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        path, _, anchor = target.partition("#")
        if "://" in target:
            continue
        goal = (page.parent / path) if path else page
        if not goal.exists() or (anchor and anchor not in anchors(goal)):
            lost.append(target)
    assert lost == []


def test_the_readme_is_short():
    prose = re.sub(r"```.*?```", "", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.S)
    assert len(prose.split()) <= 330


def test_likeness_and_what_a_refit_takes_up(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    catalogue = importlib.import_module("catalogue")
    slopes = np.random.default_rng(0).standard_normal((4, 5, 300))
    d, own = np.tensordot([1.0, -2.0, 0.5], slopes[:3], 1), slopes[3]
    assert catalogue.absorbed(d, slopes[:3]) == pytest.approx(1)
    assert catalogue.absorbed(own, slopes[:3]) < 0.01
    own[3:] = d[3:]
    near, left = catalogue.resembles("a", {"a": d, "b": -0.5 * d, "c": own, "e": slopes[0]}, np.ones(5))
    assert near[0] == ("b", pytest.approx(1)) and near[1][0] == "c"
    assert max(left.values()) < 1e-9


def test_the_menu_has_every_effect_once_in_plain_words_by_its_place(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    groups = importlib.import_module("catalogue").groups()
    assert sorted(n for here in groups.values() for n in here) == sorted({form.name for form in CATALOGUE})
    titles = [title for here in groups.values() for title in here.values()]
    assert len(set(titles)) == len(titles) and "_" not in "".join(titles)
    assert "coulomb_friction" in groups["The dissipation"]


def test_links_out_of_docs_lead_into_the_site(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    moved, page = importlib.import_module("hooks").relinked, "how_to/p.md"
    text = "[a](../../benchmarks/CLUSTER.md) [b](records.md#x) [c](https://d.e/f) [g](../../CITATION.cff)"
    there = "[a](../project/cluster.md) [b](records.md#x) [c](https://d.e/f) g (`CITATION.cff`)"
    assert moved(text, "docs/" + page, page) == there
    assert moved("[a](../docs/figures.md)", "experiments/README.md", "project/experiments.md") == "[a](../figures.md)"


@pytest.mark.exhaustive
@pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="needs the extra [docs]")
def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("material")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(tmp_path / "site")]
    told = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=300,
        env={**os.environ, "PYTHONPATH": str(ROOT), "NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert (told.returncode, told.stdout, told.stderr) == (0, "", "")
    found = (tmp_path / "site" / "search" / "search_index.json").read_text(encoding="utf-8")
    assert all(word in found for word in ("creep", "delay", "kV"))
    assert (tmp_path / "site" / "catalogue" / "electrode_rc" / "index.html").is_file()

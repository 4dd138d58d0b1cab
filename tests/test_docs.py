"""The pages say what is there: every form is described, commands and options exist (links: test_manual)."""

import importlib
import re
from pathlib import Path

import pytest

import pitp_jax as pitp
from pitp_jax.application.commands.main import _parser
from pitp_jax.common.errors import BadInput
from pitp_jax.method.effects import CATALOGUE

ROOT = Path(__file__).resolve().parents[1]
SOURCES = [p for folder in ("pitp_jax", "benchmarks", "experiments", "tests") for p in (ROOT / folder).rglob("*.py")]


def test_pages_that_code_cites_exist():
    cited = {name for path in SOURCES for name in re.findall(r"docs/[\w/]+\.md", path.read_text(encoding="utf-8"))}
    assert {"docs/contract.md", "docs/readings.md"} <= cited
    assert [name for name in cited if not (ROOT / name).is_file()] == []


def test_every_form_is_described_in_its_effects_row():
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    rows = {line.split("`")[1]: line for line in page.splitlines() if line.startswith("| `")}
    assert set(rows) == {form.name for form in CATALOGUE} | {"parameter_change"}
    assert [f"{form.name}: {form.form}" for form in CATALOGUE if form.form not in rows[form.name]] == []
    assert [form.name for form in CATALOGUE if f"| {form.family} |" not in rows[form.name]] == []


def test_every_command_and_option_is_in_the_contract():
    page = (ROOT / "docs" / "contract.md").read_text(encoding="utf-8")
    usage = page.split("## Commands")[1].split("```")[1]
    (commands,) = (a.choices for a in _parser()._actions if isinstance(a.choices, dict))
    assert set(re.findall(r"^pitp (\w+)", usage, re.M)) == set(commands)
    for block in re.split(r"^pitp ", usage, flags=re.M)[1:]:
        actions = commands[block.split()[0]]._actions
        known = {s for a in actions for s in a.option_strings if s.startswith("--")} - {"--help"}
        assert set(re.findall(r"--[\w-]+", block)) <= known <= set(re.findall(r"--[\w-]+", page)), block


def test_the_readme_begins_with_its_two_commands():
    """Demo and tests, each to be pasted into a fresh clone; `.ci/run` takes the second."""
    blocks = re.findall(r"^```sh\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), re.M | re.S)
    demo, tests = [line for block in blocks for line in block.splitlines() if line.strip()][:2]
    assert demo.endswith("pitp demo --quick") and "-m pytest" in tests


def test_the_page_of_every_room_lists_its_files():
    """Each file of a room stands in the reading order of its README, and nothing else does."""
    package = ROOT / "pitp_jax"
    rooms = [p.parent for p in sorted(package.rglob("__init__.py")) if p.parent != package]
    assert len(rooms) > 20
    for room in rooms:
        text = (room / "README.md").read_text(encoding="utf-8")
        listed = re.findall(r"^- `(\w+)\.py`", text, re.M)
        assert sorted(listed) == sorted(p.stem for p in room.glob("*.py") if p.stem != "__init__"), room.name
        assert "**In:**" in text and "**Out:**" in text and "```" in text


def test_every_error_message_is_on_the_page_of_messages(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    text = importlib.import_module("messages").page()
    page = re.sub(r"\\(.)", r"\1", text.replace("**", ""))
    begin = re.compile(r'(?:BadInput|ComputationFailed|_Ask)\(\s*f?"([^"\n]+)"')
    raised = [
        m for path in SOURCES if "pitp_jax" in path.parts for m in begin.findall(path.read_text(encoding="utf-8"))
    ]
    fixed = {part for text in raised for part in re.split(r"\{[^{}]*\}", text) if len(part.split()) > 1}
    assert len(fixed) > 200
    assert [part for part in fixed if part.strip() not in page and not set(part) & set("{}\\")] == []
    # messages as a user gets them, each one line of the page with its values filled in
    lines = [line[2:] for line in page.splitlines() if line.startswith("- ") and len(line.split()) > 4]
    pieces = [[part for part in re.split(r"…|\([^()]* \| [^()]*\)", line) if part.strip()] for line in lines]
    bare, text_file = tmp_path / "bare.csv", tmp_path / "a.txt"
    bare.write_text("time_s,voltage,way\n" + "".join(f"{k / 100},{k % 7},{k % 5}\n" for k in range(99)))
    text_file.write_text("no table")
    for refused in (
        lambda: pitp.read(tmp_path / "none.csv"),
        lambda: pitp.read(text_file),
        lambda: pitp.read(bare),
        lambda: pitp.read(bare, input_unit="parsec"),
        lambda: pitp.read(),
        lambda: pitp.load(text_file),
        lambda: pitp.plan(max_voltage=-1.0, band=(1.0, 2.0)),
        lambda: pitp.load(tmp_path),
    ):
        with pytest.raises(BadInput) as caught:
            refused()
        told = str(caught.value)
        assert any(all(part in told for part in parts) for parts in pieces), told

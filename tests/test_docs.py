"""The pages say what is there: every form is described, commands and options exist (links: test_manual)."""

import re
from pathlib import Path

from pitp_jax._effects import CATALOGUE
from pitp_jax.cli import _parser

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
    rooms = [room for room in sorted((ROOT / "pitp_jax").glob("_*")) if (room / "__init__.py").is_file()]
    assert len(rooms) > 20
    for room in rooms:
        text = (room / "README.md").read_text(encoding="utf-8")
        listed = re.findall(r"^- `(\w+)\.py`", text, re.M)
        assert sorted(listed) == sorted(p.stem for p in room.glob("*.py") if p.stem != "__init__"), room.name
        assert "**In:**" in text and "**Out:**" in text and "```" in text

"""Fenced blocks of the manual's pages, and how one is run."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from pitp_jax.application.commands.main import main

ROOT = Path(__file__).resolve().parents[1]
RUN = ("python", "sh")
SHOWN = ("text", "c", "toml", "console", "py")  # output, an Arduino or C sketch, an installation, a fragment
_FENCE = re.compile(r"^```([\w-]*)\n(.*?)^```$", re.M | re.S)
# The README's first lines install into a new environment: `.ci/run` does so, and runs the tests there.
_INSTALLS = re.compile(r"python3 -m venv|\.venv/bin/pip |\.venv/bin/python -m pytest")


@dataclass(frozen=True)
class Block:
    """One fenced block."""

    kind: str
    text: str

    def run(self, names: dict) -> list[str]:
        """Run it here; the `pitp` commands among its lines, the others must be known."""
        if self.kind == "python":
            exec(compile(self.text, "manual", "exec"), names)  # noqa: S102
            return []
        done = commands(self.text)
        for command in done:
            code = main(shlex.split(command)[1:])
            assert code == 0, f"{command}: exit code {code}"
        return done


def blocks(page: Path) -> list[Block]:
    """All fenced blocks of a page, in order."""
    return [Block(*found) for found in _FENCE.findall(page.read_text(encoding="utf-8"))]


def commands(text: str) -> list[str]:
    """The `pitp` commands of a shell block, comments off; anything else but an installation is an error."""
    found = []
    for line in text.replace("\\\n", " ").splitlines():
        for part in shlex.join(shlex.split(line, comments=True)).split("'&&'"):
            part = part.strip().removeprefix(".venv/bin/")
            if not part or _INSTALLS.match(part) or _INSTALLS.match(f".venv/bin/{part}"):
                continue
            assert part.startswith("pitp "), f"not a command that can be run: {line}"
            found.append(part)
    return found


def pages() -> list[Path]:
    """README, the site's own pages and those it takes in."""
    beside = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "experiments/README.md", "benchmarks/README.md")
    return [*(ROOT / name for name in (*beside, "benchmarks/CLUSTER.md")), *sorted((ROOT / "docs").rglob("*.md"))]

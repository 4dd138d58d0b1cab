"""What every operation takes, beside a peer in the same run, as a table and as JSON.

    python -m benchmarks [--only NAME,...] [--seconds 10] [--smoke] [--json FILE]
    python -m benchmarks --write

Rows run one after another, each in a process of its own. With `--json FILE` the other figures of the file are kept.
`--write` runs nothing: it writes the figures of `figures.json` into the README and other pages (`blocks.py`).
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

from .blocks import pages, table
from .rows import ROWS
from .sizes import SMOKE


def run(name: str, seconds: float, smoke: bool = False) -> dict:
    """The row, or why there is none."""
    command = [sys.executable, "-m", "benchmarks.rows", name, str(seconds)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, env=os.environ | ({SMOKE: "1"} if smoke else {}))
    lines = done.stdout.splitlines()
    if done.returncode or not lines:
        return {"skipped": f"its process ended with code {done.returncode}"}
    return json.loads(lines[-1])


def arguments(argv):
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="rows by name, comma-separated: " + ", ".join(ROWS))
    parser.add_argument("--seconds", type=float, default=10.0, help="about how long the turns of one row take in all")
    parser.add_argument("--json", type=Path, help="where the rows are written, and kept from earlier runs")
    parser.add_argument("--smoke", action="store_true", help="small sizes: quick, and the figures mean nothing")
    parser.add_argument("--write", action="store_true", help="only write the figures of figures.json into the pages")
    return parser.parse_args(argv)


def main(argv=None):
    """Run, print and keep."""
    options = arguments(argv)
    if options.write:
        for file, text in pages().items():
            file.write_text(text, encoding="utf-8")
        return
    names = [n.strip() for n in options.only.split(",") if n.strip()] or list(ROWS)
    unknown = [n for n in names if n not in ROWS]
    if unknown:
        sys.exit(f"unknown row {', '.join(unknown)}: use {', '.join(ROWS)}")
    figures = json.loads(options.json.read_text()) if options.json and options.json.exists() else {}
    rows = figures.setdefault("rows", {})
    for name in names:
        print(f"{name} ...", file=sys.stderr, flush=True)
        rows[name] = run(name, options.seconds, options.smoke)
        if options.json:
            options.json.write_text(json.dumps(figures, indent=1) + "\n")
    print(table({name: rows[name] for name in ROWS if name in rows}))


if __name__ == "__main__":
    main()

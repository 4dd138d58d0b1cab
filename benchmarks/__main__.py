"""What every operation takes, beside a peer in the same run, as a table and as JSON.

    python -m benchmarks [--only NAME,...] [--seconds 10] [--smoke] [--json FILE] [--into benchmarks/README.md,...]

Rows run one after another, each in a process of its own. With `--json FILE` rows already there are kept. `--into`
writes the table between the lines `<!-- benchmarks -->` and `<!-- end -->` of a file.
"""

import argparse
import json
import os
import re
import subprocess
import sys
from pathlib import Path

from .rows import ROWS
from .sizes import SMOKE

_HEADER = ("row", "median", "p10", "p90", "compile", "peer", "its median", "ratio", "floor", "memory")


def run(name: str, seconds: float, smoke: bool = False) -> dict:
    """The row, or why there is none."""
    command = [sys.executable, "-m", "benchmarks.rows", name, str(seconds)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, env=os.environ | ({SMOKE: "1"} if smoke else {}))
    lines = done.stdout.splitlines()
    if done.returncode or not lines:
        return {"skipped": f"its process ended with code {done.returncode}"}
    return json.loads(lines[-1])


def duration(ms: float | None) -> str:
    """Three figures and a unit."""
    if ms is None:
        return "-"
    for unit, size in (("us", 1e-3), ("ms", 1.0), ("s", 1e3)):
        if ms < 1000 * size or unit == "s":
            return f"{ms / size:.3g} {unit}"
    return "-"


def cells(name: str, row: dict) -> tuple[str, ...]:
    """One line of the table."""
    if "skipped" in row:
        return name, "skipped", "", "", "", row["skipped"][:60], "", "", "", ""
    ratio = "-" if row["ratio"] is None else f"{row['ratio']:.3g}"
    share = f"{row['floor_ms'] / row['median_ms']:.0%}" if row.get("floor_ms") else "-"
    times = (duration(row[key]) for key in ("median_ms", "p10_ms", "p90_ms"))
    return (name, *times, duration(1e3 * row["compile_s"]), row["peer"] or row.get("peer_skipped") or "none",
            duration(row["peer_median_ms"]), ratio, share, f"{row['peak_mb']} MB")  # fmt: skip


def table(rows: dict[str, dict]) -> str:
    """Markdown, and below it what the times were taken on."""
    lines = [_HEADER, tuple("---" for _ in _HEADER), *(cells(name, row) for name, row in rows.items())]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text = [" | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)).rstrip() for line in lines]
    machines = [row["machine"] for row in rows.values() if "machine" in row]
    loads = sorted(m["load"] for m in machines)
    if machines:
        m = machines[-1]
        versions = ", ".join(f"{k} {m[k]}" for k in ("python", "jax", "diffrax", "scipy", "torch") if m[k])
        text.append(f"\n{m['processor']}, {m['cores']} cores, load {loads[0]:g} to {loads[-1]:g}; {versions}")
    return "\n".join(text)


def written(text: str, table: str, source: str) -> str:
    """The text with the table between its two marks."""
    marks = re.compile(r"(<!-- benchmarks -->\n).*?(<!-- end -->)", re.DOTALL)
    if not marks.search(text):
        sys.exit(f"{source}: no lines <!-- benchmarks --> and <!-- end --> to write between")
    return marks.sub(lambda m: f"{m[1]}{table}\n{m[2]}", text)


def arguments(argv):
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="rows by name, comma-separated: " + ", ".join(ROWS))
    parser.add_argument("--seconds", type=float, default=10.0, help="about how long the turns of one row take in all")
    parser.add_argument("--json", type=Path, help="where the rows are written, and kept from earlier runs")
    parser.add_argument("--smoke", action="store_true", help="small sizes: quick, and the figures mean nothing")
    parser.add_argument("--into", default="", help="files to write the table into, comma-separated")
    return parser.parse_args(argv)


def main(argv=None):
    """Run, print and keep."""
    options = arguments(argv)
    names = [n.strip() for n in options.only.split(",") if n.strip()] or list(ROWS)
    unknown = [n for n in names if n not in ROWS]
    if unknown:
        sys.exit(f"unknown row {', '.join(unknown)}: use {', '.join(ROWS)}")
    rows = json.loads(options.json.read_text()) if options.json and options.json.exists() else {}
    for name in names:
        print(f"{name} ...", file=sys.stderr, flush=True)
        rows[name] = run(name, options.seconds, options.smoke)
        if options.json:
            options.json.write_text(json.dumps(rows, indent=1))
    text = table({name: rows[name] for name in ROWS if name in rows})
    print(text)
    for file in map(Path, filter(None, options.into.split(","))):
        file.write_text(written(file.read_text(), text, str(file)))


if __name__ == "__main__":
    main()

"""The figures of the README and of two other pages, written from `figures.json` between two marks of each page.

<!-- NAME -->
text made from the figures
<!-- end -->
"""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "benchmarks" / "figures.json"
_HEADER = ("row", "median", "p10", "p90", "compile", "peer", "its median", "ratio", "floor", "memory")


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
    text = [_aligned(lines)]
    groups: dict[str, list[str]] = {}
    for name, row in rows.items():
        if m := row.get("machine"):
            versions = ", ".join(f"{k} {m[k]}" for k in ("python", "jax", "diffrax", "scipy") if m[k])
            groups.setdefault(f"{m['processor']}, {m['cores']} cores; {versions}", []).append(name)
    loads = [load for row in rows.values() if "machine" in row for load in np.atleast_1d(row["machine"]["load"])]
    if loads:
        text += [f"\n{machine} ({', '.join(names)})" for machine, names in groups.items()]
        text.append(f"\nLoad {min(loads):g} to {max(loads):g}.")
    return "\n".join(text)


def speed_table(figures: dict) -> str:
    """The rows of `python -m benchmarks`."""
    return table(figures["rows"])


def h200_table(figures: dict) -> str:
    """Public and inner functions beside PyTorch on one H200."""
    h200, keys = figures["h200"], ("public_ms", "inner_ms", "compiled_ms", "eager_ms")
    lines = [("row", "`inverse`, `free_run`", "inner function", "PyTorch compiled", "PyTorch eager"), ("---",) * 5]
    lines += [(name, *(duration(row[key]) for key in keys)) for name, row in h200["rows"].items()]
    return _aligned(lines) + f"\n\njax {h200['jax']}, torch {h200['torch']}, {h200['date']}"


def comparison(figures: dict) -> str:
    """The table of the README: accuracy, inversions, and an identification beside others."""
    accuracy, rows = figures["accuracy"], figures["rows"]
    cone, roll = (accuracy["held_out_percent"][plant] for plant in ("cone100", "roll"))
    default, inverse, identify = (rows[name] for name in ("inverse_default", "inverse_paper", "identify"))
    lines = [
        "| | pitp_jax | other |",
        "|---|---|---|",
        f"| conical actuator, median of {cone['records']} recordings | {cone['pitp_jax default']:.2f} % | "
        f"{cone['GRU']:.2f} % GRU; {cone['lumped']:.2f} % lumped model |",
        f"| roll actuator, median of {roll['records']} recordings | {roll['pitp_jax default']:.2f} % | "
        f"{roll['LSTM']:.2f} % LSTM; {roll['lumped + electrode']:.2f} % lumped model with electrode |",
        f"| 120,000 samples inverted, default network | {short(default['median_ms'])} | 28.9 ms paper, RTX 3090 |",
        f"| with the [paper](docs/paper.md)'s network | {short(inverse['median_ms'])} | "
        f"{short(inverse['peer_median_ms'])} PyTorch, compiled |",
        f"| one identification fit, from the same start | {short(identify['median_ms'])} | "
        f"{short(identify['peer_median_ms'])} SciPy `least_squares` |",
        "",
        f"Errors: {accuracy['date']}. Times: {inverse['machine']['cores']} CPU cores, {inverse['machine']['date']}.",
    ]
    return "\n".join(lines)


def inversions(figures: dict) -> str:
    """The times of one inversion beside the paper's."""
    rows, h200 = figures["rows"], figures["h200"]
    lines = [
        "| inversion of 120,000 samples | two CPU cores | one GPU |",
        "|---|---|---|",
        "| the paper | - | 28.9 ms (RTX 3090) |",
    ]
    for name, text in (("inverse_default", "default preset"), ("inverse_paper", "the paper's network at every sample")):
        alone = f" (without derivatives and memories {short(rows[name]['network_ms'])})"
        lines.append(
            f"| {text} | {short(rows[name]['median_ms'])}{alone} | {short(h200['rows'][name]['public_ms'])} (H200) |"
        )
    return "\n".join(lines)


def short(ms: float) -> str:
    """Milliseconds, with two digits below 10."""
    return f"{ms:.1f} ms" if ms < 10 else f"{ms:.0f} ms"


def _aligned(lines: list[tuple[str, ...]]) -> str:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(" | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)).rstrip() for line in lines)


BLOCKS: dict[str, dict[str, Callable[[dict], str]]] = {
    "README.md": {"comparison": comparison},
    "docs/figures.md": {"inversions": inversions},
    "benchmarks/README.md": {"benchmarks": speed_table, "h200": h200_table},
}


def written(text: str, name: str, block: str) -> str:
    """The text with the block between its two marks."""
    marks = re.compile(rf"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
    if not marks.search(text):
        raise ValueError(f"no lines <!-- {name} --> and <!-- end --> to write between")
    return marks.sub(lambda m: f"{m[1]}\n{block}\n\n{m[2]}", text)


def pages() -> dict[Path, str]:
    """The pages with their blocks as `figures.json` has them."""
    figures, pages = json.loads(FIGURES.read_text(encoding="utf-8")), {}
    for file, blocks in BLOCKS.items():
        text = (ROOT / file).read_text(encoding="utf-8")
        for name, make in blocks.items():
            text = written(text, name, make(figures))
        pages[ROOT / file] = text
    return pages

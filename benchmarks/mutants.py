"""Faults put into the numerics, one at a time, each against the tests that reach it: does the suite see them?

    python -m benchmarks.mutants [--count 100] [--seed 0] [--only FILE,...] [--jobs 1] [--limit 900] [--out DIR]
                                 [--again] [--list] [--table FILE]

A drawn fault is one operator on one node of a file's syntax tree: an operator at random, then one of its nodes.

    sign      a + b -> a - b,   a - b -> a + b,   -a -> a         constant  0.3 -> 0.6,  0.0 -> 1.0,  2 -> 3
    factor    a b -> 1.5 a b,   a / b -> 1.5 a / b                index     x[k] -> x[k + 1], a slice's ends likewise
    branch    a < b -> a >= b,  a == b -> a != b,  and -> or,  `if c` -> `if not c`,  where(c, x, y) -> where(c, y, x),
              maximum -> minimum

Before them come the faults of `mutants_by_hand.json`: texts of a file and what becomes of them, found by content (one
that does not occur exactly once ends the run). A mutant runs in a copy of package and tests: `pytest -x` on the test
files that name its module, those that name the fewest others first, then on those of its room (ROOMS). The outcome is
`caught` (and by which test), `survived`, `unfinished` (after the limit in s) or, where `mutants_equivalent.json` says
why nothing can see it, `equivalent`; a mutant's id is its file and a digest of the line before and after.

Every outcome is appended to DIR/mutants.jsonl; the same command goes on where it was stopped. `--again` runs anew what
was not caught (tests may have been added since), `--list` only says what was drawn, and `--table FILE` writes the table
of what has an outcome there. Not part of CI: 100 mutants take hours.
"""

import argparse
import ast
import copy
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from queue import Queue
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
BY_HAND = Path(__file__).with_name("mutants_by_hand.json")
EQUIVALENT = Path(__file__).with_name("mutants_equivalent.json")
OPERATORS = ("sign", "factor", "index", "branch", "constant")
COPIED = ("pitp_jax", "tests", "benchmarks", "experiments", "pyproject.toml", "README.md")
NOT_NUMERIC = {
    "method/train": {"training", "settings", "dataset", "ensemble"},
    "method/diagnose": {"next_experiment", "select_records"},
}
# test files of a room that reach all of its modules, quick ones first; FIRST: even before those that name the module
FIRST = {"method/effects": ("effect_equations",)}
ROOMS = {
    "method/numerics": (),
    "method/model": ("encoder", "rows", "decode", "file"),
    "method/effects": ("effect_equations", "names", "effects", "inverse_effects"),
    "method/simulate": ("decode", "rows", "rollout_fast", "effect_equations"),
    "method/invert": ("inverse", "limits", "trim", "inverse_effects"),
    "method/identify": ("explained", "poles", "remarks", "frequency_response", "rest", "identify"),
    "method/train": ("residual", "functional", "free_runs", "sensitivity", "slow", "refine", "train"),
    "method/diagnose": ("names", "evidence", "simulator", "fits", "usable", "diagnose"),
}


@dataclass(frozen=True)
class Mutant:
    """One fault.

    Attributes:
        id: file and digest of what changes.
        operator: one of OPERATORS, or "by hand".
        file: of the package, from the repository's root.
        line: where it changes first.
        before, after: what stood there and what stands there now.
        text: the whole file with the fault in it.
    """

    id: str
    operator: str
    file: str
    line: int
    before: str
    after: str
    text: str


def numerical_files() -> list[str]:
    """The files faults are drawn from."""
    found = []
    for room in ROOMS:
        for path in sorted((ROOT / "pitp_jax" / room).glob("*.py")):
            if path.stem != "__init__" and path.stem not in NOT_NUMERIC.get(room, ()):
                found.append(path.relative_to(ROOT).as_posix())
    return found


# ---- faults by operator ----

_OPPOSITE = {ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
_SWAPPED = {"maximum": "minimum", "minimum": "maximum", "max": "min", "min": "max"}


def _is_number(node: Any) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def _later(node: Any) -> Any:
    """An index or the end of a slice, one further."""
    if _is_number(node):
        return ast.Constant(node.value + 1)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and _is_number(node.operand):
        value = node.operand.value  # pyright: ignore
        return ast.UnaryOp(ast.USub(), ast.Constant(value - 1)) if value > 1 else ast.Constant(0)
    return None


def mutated(operator: str, node: Any) -> list[Any]:
    """What a node may become under an operator."""
    new: Any = copy.copy(node)  # what hangs on it is shared, and replaced where it changes
    match operator, new:
        case "sign", ast.BinOp(op=ast.Add() | ast.Sub()):
            new.op = ast.Sub() if isinstance(new.op, ast.Add) else ast.Add()
            return [new]
        case "sign", ast.UnaryOp(op=ast.USub()):
            return [new.operand]
        case "factor", ast.BinOp(op=ast.Mult() | ast.Div()):
            return [ast.BinOp(ast.Constant(1.5), ast.Mult(), new)]
        case "index", ast.Subscript(slice=ast.Slice()):
            part: Any = new.slice
            found = []
            for end in ("lower", "upper"):
                later = _later(getattr(part, end))
                if later is not None:
                    moved = copy.copy(part)
                    setattr(moved, end, later)
                    found.append(ast.Subscript(new.value, moved, new.ctx))
            return found
        case "index", ast.Subscript():
            later = _later(new.slice)
            return [] if later is None else [ast.Subscript(new.value, later, new.ctx)]
        case "branch", ast.Compare(ops=[op]) if type(op) in _OPPOSITE:
            new.ops = [_OPPOSITE[type(op)]()]
            return [new]
        case "branch", ast.BoolOp():
            new.op = ast.Or() if isinstance(new.op, ast.And) else ast.And()
            return [new]
        case "branch", ast.IfExp():
            return [ast.IfExp(ast.UnaryOp(ast.Not(), new.test), new.body, new.orelse)]
        case "branch", ast.Call(func=ast.Attribute(attr="where"), args=[c, x, y]):
            new.args = [c, y, x]
            return [new]
        case "branch", ast.Call(func=ast.Attribute(attr=name)) if name in _SWAPPED:
            new.func = ast.Attribute(new.func.value, _SWAPPED[name], new.func.ctx)  # pyright: ignore
            return [new]
        case "constant", ast.Constant(value=value) if _is_number(new):
            return [ast.Constant(value + 1 if type(value) is int else 2 * float(new.value) or 1.0)]  # pyright: ignore
    return []


def _nodes(tree: Any) -> Iterator[Any]:
    """Nodes of code that runs: no annotations, messages, decorators, f-strings, nor numbers within an index."""
    for field, value in ast.iter_fields(tree):
        if field in ("annotation", "returns", "decorator_list", "keywords" if isinstance(tree, ast.ClassDef) else ""):
            continue
        for node in value if isinstance(value, list) else [value]:
            if not isinstance(node, ast.AST) or isinstance(node, (ast.Raise, ast.JoinedStr)):
                continue
            if isinstance(tree, ast.Subscript) and field == "slice" and _later(node) is not None:
                continue
            yield node
            yield from _nodes(node)


def _replaced(text: str, node: Any, new: Any) -> str:
    """The text with a node's own characters replaced; positions count bytes."""
    lines = text.encode().splitlines(keepends=True)
    first = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
    last = sum(map(len, lines[: node.end_lineno - 1])) + node.end_col_offset
    whole = text.encode()
    written = ast.unparse(ast.fix_missing_locations(new))
    written = written if isinstance(new, (ast.Constant, ast.Call, ast.Subscript)) else f"({written})"
    return (whole[:first] + written.encode() + whole[last:]).decode()


def candidates(files: list[str]) -> dict[str, list[tuple[str, ast.AST, ast.AST]]]:
    """By operator: file, node and what it becomes."""
    found: dict[str, list] = {o: [] for o in OPERATORS}
    for file in files:
        for node in _nodes(ast.parse((ROOT / file).read_text(encoding="utf-8"))):
            for operator in OPERATORS:
                found[operator] += [(file, node, new) for new in mutated(operator, node)]
    return found


def draw(files: list[str], count: int, seed: int) -> list[Mutant]:
    """Faults at random, none twice: the operator first, then one of its nodes."""
    rng, found, left = random.Random(seed), {}, candidates(files)
    while len(found) < count and any(left.values()):
        operator = rng.choice([o for o in OPERATORS if left[o]])
        file, node, new = left[operator].pop(rng.randrange(len(left[operator])))
        before = (ROOT / file).read_text(encoding="utf-8")
        after = _replaced(before, node, new)
        mutant = mutant_of(operator, file, before, after)
        if ast.dump(ast.parse(before)) != ast.dump(ast.parse(after)):
            found[mutant.id] = mutant
    return list(found.values())


def mutant_of(operator: str, file: str, before: str, after: str) -> Mutant:
    """Named by its file and what changes in it, so that the name outlives changes elsewhere in the file."""
    was, now = before.splitlines(), after.splitlines()
    first = next(i for i, (a, b) in enumerate(zip(was, now, strict=False)) if a != b)
    tail = next(i for i, (a, b) in enumerate(zip(was[::-1], now[::-1], strict=False)) if a != b)
    old, new = ("\n".join(lines[first : len(lines) - tail]).strip() for lines in (was, now))
    digest = hashlib.sha256(f"{old}\n->\n{new}".encode()).hexdigest()[:8]
    again = before[: before.index(old)].count(old) if old else 0
    return Mutant(f"{file}:{digest}{again or ''}", operator, file, first + 1, old, new, after)


def by_hand(files: list[str] | None) -> list[Mutant]:
    """The faults written down; an error where one no longer fits the file."""
    found = []
    for row in json.loads(BY_HAND.read_text(encoding="utf-8")):
        before = after = (ROOT / row["file"]).read_text(encoding="utf-8")
        for old, new in row["edits"]:
            if after.count(old) != 1:
                raise SystemExit(f"{BY_HAND.name}: {row['name']}: {after.count(old)} times in {row['file']}: {old}")
            after = after.replace(old, new)
        if files is None or row["file"] in files:
            made = mutant_of("by hand", row["file"], before, after)
            found.append(Mutant(made.id, "by hand", row["file"], made.line, row["name"], "", after))
    return found


# ---- the tests that reach a file ----


@lru_cache
def _tests() -> tuple[tuple[str, str, int], ...]:
    """Every test file: its path, its text and how many modules it names."""
    found = [(p, p.read_text(encoding="utf-8")) for p in sorted((ROOT / "tests").glob("test_*.py"))]
    return tuple((f"tests/{p.name}", text, len(re.findall(r"^from pitp_jax", text, re.M))) for p, text in found)


def reach(file: str) -> list[str]:
    """Test files for a package file: those that name it, those of few names first, then its room's."""
    _, *rooms, name = Path(file).with_suffix("").parts
    room, dotted = "/".join(rooms), r"\.".join(rooms)
    text = (ROOT / file).read_text(encoding="utf-8")
    names = "|".join([name, *re.findall(r"^(?:def|class) ([A-Za-z]\w*)", text, re.M)])  # or what a door exports of it
    named = re.compile(
        rf"pitp_jax\.{dotted}\.{name}\b|^from pitp_jax(\.{dotted})? import (\([^)]*|[^\n]*)\b({names})\b", re.M
    )
    own = [path for path, text, _ in sorted(_tests(), key=lambda t: t[2]) if named.search(text)]
    first, last = ([f"tests/test_{t}.py" for t in of.get(room, ())] for of in (FIRST, ROOMS))
    return list(dict.fromkeys([*first, *own, *last]))


# ---- runs ----


def copied(folder: Path) -> Path:
    """A copy of what tests need."""
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        elif source.exists():
            shutil.copy(source, folder / name)
    return folder


def outcome(mutant: Mutant, folder: Path, limit: float) -> dict:
    """Run a mutant's tests in a copy, which is left as it was."""
    tests, place = reach(mutant.file), folder / mutant.file
    before = place.read_text(encoding="utf-8")
    place.write_text(mutant.text, encoding="utf-8")
    begin = time.monotonic()
    cache = os.environ.get("JAX_COMPILATION_CACHE_DIR", str(folder.parent / "compiled"))
    settings = {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1", "JAX_COMPILATION_CACHE_DIR": cache,
                "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2"}  # fmt: skip
    options = ("-x", "-q", "--durations=0", "-p", "no:cacheprovider", "-m", "not exhaustive")
    command = [sys.executable, "-m", "pytest", *options, *tests]
    try:
        run = subprocess.Popen(
            command, cwd=folder, env=os.environ | settings, text=True, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        try:
            told, _ = run.communicate(timeout=limit)
            if run.returncode in (4, 5):  # of pytest's own: nothing was run
                raise SystemExit(told)
            result = "caught" if run.returncode else "survived"
        except subprocess.TimeoutExpired:
            os.killpg(run.pid, signal.SIGKILL)
            told, result = run.communicate()[0], "unfinished"
    finally:
        place.write_text(before, encoding="utf-8")
    failed = re.search(r"^(?:FAILED|ERROR) ([^\s\[]+)", told or "", re.M)
    seconds = round(time.monotonic() - begin, 1)
    row = {k: v for k, v in asdict(mutant).items() if k != "text"}
    return row | {"outcome": result, "by": failed[1] if failed else "", "seconds": seconds, "tests": tests}


def run_all(mutants: list[Mutant], into: Path, jobs: int, limit: float, again: bool = False) -> None:
    """Every mutant that has no outcome yet (`again`: that was not caught), each worker in a copy of its own."""
    into.parent.mkdir(parents=True, exist_ok=True)
    done = {row["id"] for row in outcomes(into) if row["outcome"] == "caught" or not again or row["id"] in reasons()}
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(jobs) as pool:
        folders: Queue = Queue()
        for k in range(jobs):
            folders.put(copied(Path(scratch) / f"copy{k}"))

        def one(mutant: Mutant) -> dict:
            folder = folders.get()
            try:
                return outcome(mutant, folder, limit)
            finally:
                folders.put(folder)

        for run in as_completed([pool.submit(one, m) for m in mutants if m.id not in done]):
            row = run.result()
            with into.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
            print(f"{row['outcome']:10s} {row['seconds']:6.0f} s  {row['id']}  {row['by']}", flush=True)


def outcomes(file: Path) -> list[dict]:
    """The last outcome of every mutant."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return list({row["id"]: row for row in map(json.loads, lines)}.values())


# ---- the table ----


def reasons() -> dict[str, str]:
    """By id, why nothing can see a mutant."""
    return json.loads(EQUIVALENT.read_text(encoding="utf-8"))


def table(rows: list[dict], heading: str) -> str:
    """Counts by operator, then every mutant."""
    why_not = reasons()
    for row in rows:
        if row["outcome"] != "caught" and row["id"] in why_not:
            row["outcome"] = "equivalent"
    kinds = ("caught", "survived", "equivalent", "unfinished")
    lines = [f"# {heading}", "", f"| operator | {' | '.join(kinds)} |", "|---" * 5 + "|"]
    for operator in (*OPERATORS, "by hand", None):
        count = Counter(r["outcome"] for r in rows if operator in (None, r["operator"]))
        lines.append(f"| {operator or 'all'} | " + " | ".join(str(count[k]) for k in kinds) + " |")
    lines += ["", "| mutant | line | operator | outcome | what changes | by, or why |", "|---" * 6 + "|"]
    for r in sorted(rows, key=lambda r: (r["outcome"] == "caught", r["file"], r["line"])):
        what = r["before"] if r["operator"] == "by hand" else f"`{_flat(r['before'])}` -> `{_flat(r['after'])}`"
        why = why_not.get(r["id"], "") if r["outcome"] == "equivalent" else r["by"].split("[")[0].removeprefix("tests/")
        name = r["id"].removeprefix("pitp_jax/")
        lines.append(
            f"| {name} | {r['line']} | {r['operator']} | {r['outcome']} | {what} | {why} |".replace("||", "or")
        )
    return "\n".join(lines) + "\n"


def _flat(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("|", "\\|")[:150]


def main() -> None:
    """The command."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--count", type=int, default=100, help="faults drawn at random")
    ask.add_argument("--seed", type=int, default=0)
    ask.add_argument("--only", default="", help="files, with commas: pitp_jax/method/effects/coupling.py,...")
    ask.add_argument("--jobs", type=int, default=1, help="mutants at a time")
    ask.add_argument("--limit", type=float, default=900.0, help="seconds a mutant's tests may take")
    ask.add_argument("--out", type=Path, default=Path("mutants"), help="folder of mutants.jsonl")
    ask.add_argument("--heading", default="", help="what the table says beside its counts")
    ask.add_argument("--table", type=Path, help="write the table of all outcomes so far")
    ask.add_argument("--again", action="store_true", help="run anew what was not caught")
    ask.add_argument("--list", action="store_true", help="only say what was drawn")
    given = ask.parse_args()
    only = given.only.split(",") if given.only else None
    mutants = [*by_hand(only), *draw(only or numerical_files(), given.count, given.seed)]
    if given.list:
        for m in mutants:
            print(f"{m.id}:{m.line}  {m.operator}\n    {_flat(m.before)}\n    {_flat(m.after)}")
        return
    run_all(mutants, given.out / "mutants.jsonl", given.jobs, given.limit, given.again)
    if given.table:
        known = {m.id for m in mutants}
        rows = [row for row in outcomes(given.out / "mutants.jsonl") if row["id"] in known]
        drawn = sum(row["operator"] != "by hand" for row in rows)
        heading = f"Mutants: {drawn} drawn with seed {given.seed}, {len(rows) - drawn} by hand"
        given.table.write_text(table(rows, heading + given.heading), encoding="utf-8")


if __name__ == "__main__":
    main()

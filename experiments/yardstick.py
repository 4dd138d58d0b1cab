"""A yardstick for a change of the code: figures and CPU seconds of small parts of the other scripts, before and after.

    python -m experiments.yardstick --out before.json [--shared ../shared]    at most 25 minutes on two cores
    python -m experiments.yardstick --compare before.json after.json

It runs the scripts and the command line as a user would, two at a time, and uses nothing of the package itself: so one
file measures two layouts of the code. Seeds are fixed, and none of them is fresh. Programs are compiled anew in every
cell. A cell that is finished is not run again; delete its entry, or the file, when the code has changed.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

ROOT = next(p for p in Path(__file__).resolve().parents if (p / "pyproject.toml").is_file())
EXPERIMENTS = ROOT / "experiments"
WITHHELD = (
    ("end_stop", "roll"), ("electrode_rc", "roll"), ("coulomb_friction", "cone"), ("creep", "cone"),
    ("sensor_lag", "cone"), ("none", "cone"),
)  # fmt: skip
JOINTS = ("friction", "clip", "numbers")
SETS = ("cone100", "roll")  # simulated
RECORDED = ("hasel_peano", "so101/elbow", "so101/pitch")  # in the folder `shared`
SLOW = ("ninety_recordings",)
TIMES = ("seconds", "slowest")  # entries that are no figures: two runs of the same code differ in them
# a cell: arguments of the script, and what reads its figures from (its folder, its output)
Cell = tuple[list[str], Callable[[Path, str], Any]]


def script(name: str, *arguments: str) -> list[str]:
    """Return the command of a script, wherever it is below the folder of experiments."""
    path = next(iter(sorted(EXPERIMENTS.rglob(f"{name}.py"))))
    return ["-m", ".".join(path.relative_to(ROOT).with_suffix("").parts), *arguments]


def cells(shared: Path, smoke: bool) -> dict[str, Cell]:
    """Return every cell by its name, those that take longest first; `{}` stands for the cell's own folder."""
    starts: Cell = (script("start_kinds", "--sets", "10", "--seed", "0"), lambda _, said: said.strip().splitlines())
    if smoke:
        return {"start_kinds": (script("start_kinds", "--smoke"), starts[1])}
    found: dict[str, Cell] = {}
    for name, kind in WITHHELD:
        what = ("--none", "1") if name == "none" else ("--effects", name)
        options = (*what, "--kinds", kind, "--seeds", "153", "--results", "{}/cases")
        found[f"withheld_effect {name} {kind}"] = script("withheld_effect", *options), from_file("cases/*.json")
    for name in JOINTS:
        command = script("mujoco_bank", name, "--seed", "1", "--out", "{}/rows.jsonl")
        found[f"mujoco_bank {name}"] = command, from_file("rows.jsonl")
    for name in (*SETS, *(RECORDED if shared.is_dir() else ())):
        options = ("--sets", name, "--seed", "2764", "--data", str(shared), "--out", "{}")
        found[f"expected_errors {name}"] = script("expected_errors", *options), from_file("expected_errors.json")
    for kind, linear, nonlinear in (("linear", "7", "0"), ("nonlinear", "0", "3")):
        options = ("--seeds", "1", "--linear", linear, "--nonlinear", nonlinear, "--results", "{}/rows.jsonl")
        found[f"identify_bank {kind}"] = script("identify_bank", *options), from_file("rows.jsonl")
    found["start_kinds"] = starts
    files = script("fuzz_files", "--count", "400", "--models", "100", "--seed", "0", "--resume", "{}/batches.json")
    found["fuzz_files"] = files, from_file("batches.json")
    for case in sorted(p.parent.name for p in (shared / "cases").glob("*/case.json")):
        if case not in SLOW:
            command = [str(shared / "cases" / "score.py"), "--pitp", "{}/pitp", "--only", case, "--keep", "{}/kept"]
            found[f"cases {case}"] = command, scored
    return found


def from_file(pattern: str) -> Callable[[Path, str], Any]:
    """Return a reader of JSON values, one a file or one a line, without seconds."""

    def read(folder: Path, said: str) -> Any:
        first, *others = [path.read_text() for path in sorted(folder.glob(pattern))]
        rows = first.splitlines() if pattern.endswith(".jsonl") else [first, *others]
        return [timeless(json.loads(row)) for row in rows]

    return read


def timeless(value: Any) -> Any:
    """Return a JSON value without its entries of time."""
    if isinstance(value, dict):
        return {k: timeless(v) for k, v in value.items() if k not in TIMES}
    return [timeless(v) for v in value] if isinstance(value, list) else value


def scored(folder: Path, said: str) -> list[str]:
    """Return verdict and note of a case, without its CPU and wall seconds."""
    return [re.sub(r"[\d.]+ s of CPU|\s*\[\d+ s\]$", "", line) for line in said.splitlines()[:-1]]


def measured(command: list[str], figures: Callable[[Path, str], Any]) -> dict:
    """Run one cell in a folder of its own: its figures (or why there are none), and its CPU seconds."""
    folder = Path(tempfile.mkdtemp(prefix="yardstick_"))
    trees = [str(p) for p in (ROOT, ROOT / "src") if p.is_dir()]
    pitp = folder / "pitp"
    pitp.write_text(f'#!/bin/sh\nPYTHONPATH={":".join(trees)} exec {sys.executable} -m pitp_jax "$@"\n')
    pitp.chmod(0o755)
    environment = os.environ | {"JAX_PLATFORMS": "cpu", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    environment["PYTHONPATH"] = ":".join([*trees, str(EXPERIMENTS)])
    environment |= {  # of this cell alone, as on a new user's computer
        "JAX_COMPILATION_CACHE_DIR": str(folder / "programs"), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.1",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1", "JAX_COMPILATION_CACHE_MAX_SIZE": str(2**30),
    }  # fmt: skip
    words = [word.replace("{}", str(folder)) for word in command]
    with (folder / "said").open("w") as out, (folder / "told").open("w") as error:
        child = subprocess.Popen([sys.executable, *words], cwd=folder, env=environment, stdout=out, stderr=error)
        _, status, used = os.wait4(child.pid, 0)  # with the CPU seconds of the child's own children
        child.returncode = os.waitstatus_to_exitcode(status)
    row: dict[str, Any] = {"cpu_s": round(used.ru_utime + used.ru_stime, 1)}
    said, told = ((folder / name).read_text().replace(str(folder), "") for name in ("said", "told"))
    try:
        if child.returncode and "Traceback" in told:  # exit 1 alone: a file failed, which is a figure
            raise ValueError
        row["figures"] = figures(folder, said)
    except Exception:  # the other cells go on
        row["failed"] = f"exit {child.returncode}: {''.join(told.strip().splitlines()[-1:])}"
    shutil.rmtree(folder)
    return row


def numbers(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every figure with its place in a JSON value."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if inner is None:
        yield place, value
    for key, one in inner or ():
        yield from numbers(one, f"{place}/{key}")


def compare(one: dict, two: dict) -> None:
    """Print CPU seconds beside each other, and below each cell the figures that are not equal to the last digit."""
    spent = [0.0, 0.0]
    for name in dict.fromkeys([*one, *two]):
        if name not in one or name not in two:
            print(f"{name}: only in the {'first' if name in one else 'second'}")
            continue
        rows = one[name], two[name]
        first, second = (dict(numbers(row.get("figures", row.get("failed")))) for row in rows)
        apart = [k for k in dict.fromkeys([*first, *second]) if str(first.get(k)) != str(second.get(k))]
        spent = [s + row["cpu_s"] for s, row in zip(spent, rows, strict=True)]
        words = f"{len(apart)} of {len(first | second)} figures differ" if apart else f"{len(first)} figures equal"
        print(f"{name:42} {words:28} CPU {rows[0]['cpu_s']:7.1f} {rows[1]['cpu_s']:7.1f} s")
        for k in apart:
            print(f"    {k}: {first.get(k)} -> {second.get(k)}")
    print(f"{'together':71} CPU {spent[0]:7.1f} {spent[1]:7.1f} s")


def main() -> None:
    """Run the cells that --out does not hold yet, or compare two files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("yardstick.json"), help="results, cell by cell")
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared", help="recordings and cases")
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("A", "B"), help="run nothing, compare two results")
    parser.add_argument("--smoke", action="store_true", help="one cell, quick and meaningless")
    options = parser.parse_args()
    if options.compare:
        compare(*(json.loads(path.read_text()) for path in options.compare))
        return
    if options.smoke:
        options.out = Path(tempfile.mkdtemp()) / "yardstick.json"
    if not options.shared.is_dir():
        print(f"no folder {options.shared}: its recordings and cases are left out", flush=True)
    done = json.loads(options.out.read_text()) if options.out.is_file() else {}
    asked, lock = cells(options.shared.resolve(), options.smoke), threading.Lock()

    def run(name: str) -> None:
        row = measured(*asked[name])
        with lock:
            done[name] = row
            part = options.out.with_suffix(".part")
            part.write_text(json.dumps({k: done[k] for k in (*asked, *done) if k in done}, indent=1) + "\n")
            part.replace(options.out)
            told = row.get("failed", f"{len(dict(numbers(row.get('figures'))))} figures")
            print(f"{len(done)}/{len(asked)} {name}: {told}, {row['cpu_s']:.0f} CPU s", flush=True)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(run, [name for name in asked if "figures" not in done.get(name, {})]))


if __name__ == "__main__":
    main()

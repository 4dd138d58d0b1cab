"""What verbs cost over samples, records and order, as a table and a figure; a run resumes from its JSON.

    python -m benchmarks.growth [--json FILE] [--page docs/how_to/growth.md] [--most 10000000] [--only fit,diagnose]

A cell is a process of its own, ended after five minutes of CPU. Its figure is CPU time, all threads together, which
other load on the machine does not move: of a second call of `predict` and `check`, whose first one compiles; of the one
call of `fit` (default preset) and `diagnose` (one effect, an electrode that charges late), compilation included.
"""

import argparse
import json
import re
import resource
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

_LIMIT = 300  # s of CPU
SAMPLES = (10_000, 100_000, 1_000_000, 10_000_000)
ROWS = {
    **{f"`predict`, identified model, order {n}": ("predict", n, 1) for n in (1, 2, 3, 4, 5, 6)},
    "`check`, without a model": ("check", 2, 1),
    "`diagnose`, one record": ("diagnose", 2, 1),
    **{f"`fit`, one record, order {n}": ("fit", n, 1) for n in (1, 2, 3, 4, 5, 6)},
    "`fit`, records of 10,000": ("fit", 2, 10_000),
}
_DRAWN = {"`predict`, identified model, order 2", "`predict`, identified model, order 6", "`check`, without a model",
          "`diagnose`, one record", "`fit`, one record, order 2", "`fit`, records of 10,000"}  # fmt: skip


def cell(what: str, order: int, each: int, samples: int) -> float:
    """CPU seconds of one call on so many samples, in records of `each` (1: in one)."""
    from dataclasses import replace

    import jax
    import numpy as np

    import pitp_jax as pitp
    from pitp_jax.method.effects import effect

    from .subjects import DT, nominal, voltages

    model, size = nominal(order), samples if each == 1 else each
    late, rng = replace(model, effects=(effect("electrode_rc", tau=0.01),)), np.random.default_rng(0)
    drives = voltages(samples // size, size).astype(float) if each > 1 else _swept(size, DT)[None]
    bare = [pitp.Record(f"r{k}", np.arange(size) * DT, u, 0 * u) for k, u in enumerate(drives)]
    motion = [p.displacement + 1e-6 * rng.standard_normal(size) for p in pitp.predict(late, bare)]
    records = [replace(r, displacement=x) for r, x in zip(bare, motion, strict=True)]
    run = {
        "predict": lambda: pitp.predict(model, records),
        "check": lambda: pitp.check(records),
        "diagnose": lambda: pitp.diagnose(model, records),
        "fit": lambda: pitp.train(model, records, key=jax.random.key(0)),
    }[what]
    if what in ("predict", "check"):
        run()
    began = time.process_time()
    run()
    return time.process_time() - began


def _swept(samples: int, dt: float):
    """A voltage (V) whose frequency goes from 0.5 to 10 Hz and back every 40 s."""
    import numpy as np

    t = np.arange(samples) * dt
    hz = 5.25 - 4.75 * np.cos(2 * np.pi * t / 40)
    return 300 * (1 - np.cos(2 * np.pi * np.cumsum(hz) * dt))


def measured(what: str, order: int, each: int, samples: int) -> float | str:
    """The same in a process of its own; "over" the limit, or "failed"."""
    command = [sys.executable, "-m", "benchmarks.growth", "--cell", what, *map(str, (order, each, samples))]
    limit = partial(resource.setrlimit, resource.RLIMIT_CPU, (_LIMIT, _LIMIT))
    done = subprocess.run(command, capture_output=True, text=True, preexec_fn=limit)
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return "over"
    return float(done.stdout.splitlines()[-1]) if done.returncode == 0 else "failed"


def page(found: dict[str, float | str], figure: Path) -> str:
    """The table in Markdown, and the figure beside it."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = drawn.subplots()
    cells = {title: [found.get(" ".join(map(str, (*key, n)))) for n in SAMPLES] for title, key in ROWS.items()}
    columns = [k for k in range(len(SAMPLES)) if any(row[k] is not None for row in cells.values())]
    lines = ["| | " + " | ".join(f"{SAMPLES[k]:,}" for k in columns) + " |", "|---|" + "---|" * len(columns)]
    for title, whole in cells.items():
        row = [whole[k] for k in columns]
        if all(v is None for v in row):
            continue  # not measured
        told = [f"{v:.2g} s" if isinstance(v, float) else str(v or "-") for v in row]
        lines.append(f"| {title} | " + " | ".join(told) + " |")
        points = [(SAMPLES[k], v) for k, v in zip(columns, row, strict=True) if isinstance(v, float)]
        if points and title in _DRAWN:
            axes.loglog(*zip(*points, strict=True), marker="o", label=title.replace("`", ""))
    axes.set(xlabel="samples", ylabel="CPU time, s")
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))  # beside the lines, not over them
    drawn.savefig(figure, metadata={"Date": None})
    return "\n".join(lines)


def main() -> None:
    """Measure what is missing, and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.growth", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, default=Path("growth.json"), help="cells already there are kept")
    parser.add_argument(
        "--page", type=Path, help="page with <!-- growth --> and <!-- end -->; the figure goes beside it"
    )
    parser.add_argument("--most", type=int, default=SAMPLES[-1], help="samples of the largest cells")
    parser.add_argument("--only", default="predict,check,diagnose,fit", help="verbs, comma-separated")
    parser.add_argument("--cell", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.cell:
        print(cell(options.cell[0], *map(int, options.cell[1:])))
        return
    found = json.loads(options.json.read_text()) if options.json.exists() else {}
    for samples in (n for n in SAMPLES if n <= options.most):
        for cell_of in (key for key in ROWS.values() if key[0] in options.only.split(",")):
            key = " ".join(map(str, (*cell_of, samples)))
            if key not in found:
                found[key] = measured(*cell_of, samples)
                options.json.write_text(json.dumps(found, indent=1))
                print(key, found[key], flush=True)
    if options.page:
        table, text = page(found, options.page.with_suffix(".svg")), options.page.read_text(encoding="utf-8")
        marks = re.compile(r"(<!-- growth -->\n).*?(<!-- end -->)", re.DOTALL)
        options.page.write_text(marks.sub(lambda m: f"{m[1]}{table}\n{m[2]}", text), encoding="utf-8")


if __name__ == "__main__":
    main()

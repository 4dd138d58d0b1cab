"""What a free run and a check cost over samples and order, as a table and a figure; a run resumes from its JSON.

    python -m benchmarks.growth [--json FILE] [--page docs/how_to/growth.md] [--most 10000000]

A cell is a process of its own, ended after five minutes. Its figure is the CPU time of a second call, all threads
together, which other load on the machine does not move; the first call compiles.
"""

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path

_LIMIT = 300  # s
SAMPLES, ORDERS = (10_000, 100_000, 1_000_000, 10_000_000), (1, 2, 3, 4, 5, 6)
TITLES = {"predict": "`predict`, identified model", "check": "`check`, without a model"}


def cell(what: str, order: int, samples: int) -> float:
    """CPU seconds of one call that has been made before."""
    import numpy as np

    import pitp_jax as pitp

    from .subjects import DT, nominal, target, voltages

    model, u = nominal(order), voltages(1, samples)[0].astype(float)
    noise = 1e-6 * np.random.default_rng(0).standard_normal(samples)
    records = [pitp.Record("long", np.arange(samples) * DT, u, target(samples) + noise)]
    run = (lambda: pitp.predict(model, records)) if what == "predict" else (lambda: pitp.check(records))
    run()
    began = time.process_time()
    run()
    return time.process_time() - began


def measured(what: str, order: int, samples: int) -> float | str:
    """The same in a process of its own; "over" five minutes, or "failed"."""
    command = [sys.executable, "-m", "benchmarks.growth", "--cell", what, str(order), str(samples)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT)
    except subprocess.TimeoutExpired:
        return "over"
    return float(done.stdout.splitlines()[-1]) if done.returncode == 0 else "failed"


def page(found: dict[str, float | str], figure: Path) -> str:
    """The table in Markdown, and the figure beside it."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = drawn.subplots()
    lines = ["| | " + " | ".join(f"{n:,}" for n in SAMPLES) + " |", "|---|" + "---|" * len(SAMPLES)]
    for what, title in TITLES.items():
        for order in ORDERS if what == "predict" else (2,):
            row = [found.get(f"{what} {order} {n}") for n in SAMPLES]
            name = f"{title}, order {order}" if what == "predict" else title
            told = [f"{v:.2g} s" if isinstance(v, float) else str(v or "-") for v in row]
            lines.append(f"| {name} | " + " | ".join(told) + " |")
            points = [(n, v) for n, v in zip(SAMPLES, row, strict=True) if isinstance(v, float)]
            axes.loglog(*zip(*points, strict=True), marker="o", label=name.replace("`", "")) if points else None
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
    parser.add_argument("--cell", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.cell:
        print(cell(options.cell[0], *map(int, options.cell[1:])))
        return
    found = json.loads(options.json.read_text()) if options.json.exists() else {}
    for samples in (n for n in SAMPLES if n <= options.most):
        for what, order in [("check", 2), *(("predict", n) for n in ORDERS)]:
            key = f"{what} {order} {samples}"
            if key not in found:
                found[key] = measured(what, order, samples)
                options.json.write_text(json.dumps(found, indent=1))
                print(key, found[key], flush=True)
    if options.page:
        table, text = page(found, options.page.with_suffix(".svg")), options.page.read_text(encoding="utf-8")
        marks = re.compile(r"(<!-- growth -->\n).*?(<!-- end -->)", re.DOTALL)
        options.page.write_text(marks.sub(lambda m: f"{m[1]}{table}\n{m[2]}", text), encoding="utf-8")


if __name__ == "__main__":
    main()

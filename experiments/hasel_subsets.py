"""Every set of two and more records of a measured Peano-HASEL trains: beside the best of eight random starts.

    for each of the 26 subsets:  identify and train as `pitp fit` does (key 0);  eight first starts alone, keys 1 ... 8
    ratio = error of the first / least of the eight,      error: root mean square over records of e_rms, % of range

    python experiments/hasel_subsets.py [--data ../shared] [--subsets 3] [--starts 8] [--every 4]

`left out`: the error of the records that were not trained on. `--every 4` takes every fourth sample (500 Hz; the
resonance is near 9 Hz). Rows are added to `experiments/hasel_subsets.md` as they come; a subset that stands there
already is skipped.
"""

import argparse
import time
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import jax
import numpy as np

import pitp_jax as pitp

HEADER = (
    "trained on",
    "nominal",
    "trained",
    "left out",
    "worse than nominal",
    "best of others",
    "starts",
    "ratio",
    "s",
)


def thinned(record, every: int):
    """Every so many samples."""
    return replace(record, **{f: getattr(record, f)[::every] for f in ("time", "voltage", "displacement")})


def mean(errors) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))


def left_out(model, records) -> float:
    """Of free runs."""
    if not records:
        return float("nan")
    runs = pitp.predict(model, records)
    pairs = zip(runs, records, strict=True)
    return mean([pitp.e_rms_percent(p.displacement, r.displacement, p.scored) for p, r in pairs])


def row(chosen, records, starts: int, settings) -> tuple[str, ...]:
    """One line of the table."""
    began = time.monotonic()
    some, others = [records[k] for k in chosen], [r for k, r in enumerate(records) if k not in chosen]
    nominal = pitp.identify(some).model
    found = pitp.train(nominal, some, settings=settings, key=jax.random.key(0))
    seconds = time.monotonic() - began
    once = replace(settings, starts=1)
    ends = [pitp.train(nominal, some, settings=once, key=jax.random.key(k + 1)).errors for k in range(starts)]
    best = min((mean([e.trained for e in end]) for end in ends), default=float("nan"))
    trained = mean([e.trained for e in found.errors])
    figures = mean([e.nominal for e in found.errors]), trained, left_out(found.model, others)
    name = " ".join(r.name.replace("sine_", "") for r in some)
    worse = str(sum(e.worse for e in found.errors))
    beside = f"{best:.2f}", str(starts), f"{trained / best:.2f}", f"{seconds:.0f}"
    return (name, *(f"{v:.2f}" for v in figures), worse, *beside)


def main(argv=None):
    """Print and write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    parser.add_argument("--subsets", type=int, default=26, help="how many more")
    parser.add_argument("--starts", type=int, default=8, help="random ones to compare with")
    parser.add_argument("--every", type=int, default=1, help="take every so many samples")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="folder of the table")
    options = parser.parse_args(argv)
    settings, table = pitp.Settings(), options.out / "hasel_subsets.md"
    records = [thinned(r, options.every) for r in pitp.read(str(options.data / "data" / "hasel_peano"))]
    if not table.is_file():
        table.write_text(f"| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}\n")
    done = table.read_text()
    names = [r.name.replace("sine_", "") for r in records]
    subsets = [c for size in (2, 3, 4, 5) for c in combinations(range(len(records)), size)]
    left = [c for c in subsets if f"| {' '.join(names[k] for k in c)} |" not in done]
    for chosen in left[: options.subsets]:
        line = f"| {' | '.join(row(chosen, records, options.starts, settings))} |"
        print(line, flush=True)
        with table.open("a") as file:
            file.write(line + "\n")


if __name__ == "__main__":
    main()

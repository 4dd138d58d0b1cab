"""Peers on the same records, one table: fit time, inversion, free-run error with the noise floor taken out.

    python -m benchmarks.peers cone100 roll [--data ../shared/bench] [--only NAME,...] [--seconds 300] [--json FILE]

A bench is a folder with sweep/, train/ and test/. Rows already in FILE are kept, so a table may be made peer by peer;
`--smoke` fits for a few seconds on a few records. The recordings are not part of this project.
"""

import argparse
import json
import platform
import sys
import time
from pathlib import Path

import jax

import pitp_jax as pitp

from . import PEERS, Skipped
from .bench import load
from .table import measure, text


def tell(line: str) -> None:
    """Progress, on stderr."""
    print(line, file=sys.stderr, flush=True)


def machine() -> dict:
    """What the times were taken on."""
    return {"python": platform.python_version(), "jax": jax.__version__, "devices": [str(d) for d in jax.devices()],
            "pitp_jax": pitp.__version__, "processor": platform.machine()}  # fmt: skip


def run(folder: Path, chosen, seconds: float, smoke: bool, seed: int):
    """Rows of one bench, as (peer, row), each when it is done."""
    bench = load(folder, smoke)
    began = time.perf_counter()
    nominal = pitp.identify(bench.sweep, order=2 if smoke else "auto").model
    identified = time.perf_counter() - began
    tell(f"{bench.name}: identified in {identified:.0f} s (shared by all peers, not in their fit time)")
    for peer in chosen:
        tell(f"{bench.name}: {peer.name}")
        try:
            row = measure(peer, nominal, bench, seconds, jax.random.key(seed))
            yield peer.name, row | {"seconds": seconds, "identify_s": identified, "machine": machine()}
        except (Skipped, pitp.BadInput, pitp.ComputationFailed) as error:
            yield peer.name, {"skipped": str(error)}


def arguments(argv):
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers", description=__doc__.splitlines()[0])
    parser.add_argument("benches", nargs="*", default=["cone100", "roll"])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "bench")
    parser.add_argument(
        "--only", default="", help="peers by name, comma-separated: " + ", ".join(p.name for p in PEERS)
    )
    parser.add_argument("--seconds", type=float, default=300.0, help="time for each fit; presets end by themselves")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--smoke", action="store_true")
    parser.add_argument("--json", type=Path)
    return parser.parse_args(argv)


def main(argv=None):
    """Fit, score, print and keep."""
    options = arguments(argv)
    names = [n.strip() for n in options.only.split(",") if n.strip()] or [p.name for p in PEERS]
    unknown = set(names) - {p.name for p in PEERS}
    if unknown:
        sys.exit(f"unknown peer {', '.join(sorted(unknown))}: use {', '.join(p.name for p in PEERS)}")
    chosen = [p for p in PEERS if p.name in names]
    kept = json.loads(options.json.read_text()) if options.json and options.json.exists() else {}
    for name in options.benches:
        if not (options.data / name).is_dir():
            print(f"{name}: skipped, {options.data / name} is absent")
            continue
        rows, seconds = kept.setdefault(name, {}), 5.0 if options.smoke else options.seconds
        for peer, row in run(options.data / name, chosen, seconds, options.smoke, options.seed):
            rows[peer] = row
            if options.json:
                options.json.write_text(json.dumps(kept, indent=1))
        print(text(name, rows), flush=True)


if __name__ == "__main__":
    main()

"""How often the printed error to expect is within a factor of 2 of the true error of a held-out recording.

    set -> identify on one half -> expected and true e_rms of every covered recording of the other half

    python experiments/expected_errors.py [--data ../shared] [--sets cone100 roll ...] [--seed N] [--out DIR]

Every set is added to `expected_errors.json` when it is done; one that is in this file already is skipped. The models
are identified ones; those of `fit --cross-validate` take one training for each recording. `--seed N` draws the half of
the sines of cone100 and roll and their noise; without it every second sine is identified on.
"""

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import pitp_jax as pitp
from pitp_jax.application.demo.protocol import SEED, kind
from pitp_jax.method.model.expected_error import expected_error

HERE = Path(__file__).resolve().parent
SETS = ("cone100", "roll", "hasel_peano", "silverbox", "so101/elbow", "so101/pitch")


def virtual(name: str, seed: int | None, every: int) -> tuple[Sequence, Sequence]:
    """Return (half of the sines of the protocol, the other half and its test inputs) of a virtual actuator."""
    sines, tests = (
        [
            pitp.record(pitp.plant(name), e.name, e.time, e.voltage, seed=SEED if seed is None else seed)
            for e in pitp.excitation.protocol(kind(name), part)[::every]
        ]
        for part in ("train", "test")
    )
    if seed is not None:
        sines = [sines[k] for k in np.random.default_rng(seed).permutation(len(sines))]
    return sines[::2], [*sines[1::2], *tests]


def splits(name: str, data: Path, seed: int | None, every: int) -> Iterator[tuple[Sequence, Sequence]]:
    """Yield (recordings to identify on, held-out recordings)."""
    if name in ("cone100", "roll"):
        yield virtual(name, seed, every)
        return
    records = pitp.read(data / "data" / name)
    if name == "silverbox":
        fitted = [r for r in records if r.name == "multisine_train"]
        yield fitted, [r for r in records if r.name != "multisine_train"]
    elif name == "hasel_peano":
        for one in records:
            yield [r for r in records if r is not one], [one]
    else:
        yield records[::2], records[1::2]
        yield records[1::2], records[::2]


def rows(name: str, data: Path, seed: int | None, every: int = 1) -> list[dict]:
    """Return expected and true error of every held-out recording of a set, e_rms in % of range."""
    found = []
    for fitted, held_out in splits(name, data, seed, every):
        square = name in ("cone100", "roll", "hasel_peano")
        model = pitp.identify(fitted, input_map="square" if square else "linear").model
        for record, run in zip(held_out, pitp.predict(model, held_out), strict=True):
            expected = None if run.not_excited else expected_error(model, run.displacement, record.dt)
            row = {"record": record.name, "expected": expected and expected.percent, "covered": not run.not_excited}
            mean = np.nanmean(np.where(run.scored, run.displacement - record.displacement, np.nan))
            for key, offset in (("true", 0.0), ("zero_fitted", mean)):
                row[key] = float(pitp.e_rms_percent(run.displacement - offset, record.displacement, run.scored))
            found.append(row)
    return found


def main(argv=None):
    """Compute the missing sets, write each, and print how many figures are within a factor of 2."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=HERE.parents[1] / "shared")
    parser.add_argument("--sets", nargs="+", choices=SETS, default=SETS)
    parser.add_argument("--seed", type=int, help="of the sines of cone100 and roll")
    parser.add_argument("--out", type=Path, default=HERE, help="folder of the results")
    parser.add_argument("--smoke", action="store_true", help="quick and meaningless")
    options = parser.parse_args(argv)
    file = options.out / "expected_errors.json"
    if options.smoke:
        options.sets, file = ["cone100"], Path(tempfile.mkdtemp()) / file.name
    done = json.loads(file.read_text()) if file.is_file() else {}
    for name in options.sets:
        if name not in done:
            done[name] = rows(name, options.data, options.seed, 8 if options.smoke else 1)
            file.write_text(json.dumps(done, indent=1) + "\n")
        told = [r for r in done[name] if r["expected"]]
        print(f"{name}: {sum(not r['covered'] for r in done[name])} of {len(done[name])} not covered", flush=True)
        for key in ("true", "zero_fitted"):
            ratios = np.array([r[key] / r["expected"] for r in told])
            quartiles = ", ".join(f"{q:.2f}" for q in np.quantile(ratios, [0, 0.25, 0.5, 0.75, 1]))
            print(
                f"    {key} / expected {quartiles}: {((ratios >= 0.5) & (ratios <= 2)).sum()} of {len(told)} within 2"
            )


if __name__ == "__main__":
    main()

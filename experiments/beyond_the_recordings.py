"""Predictions of motions that were not recorded: linear, trained, diagnosed models and peers on the same recordings.

    hasel          1 and 11 Hz from steps, 3 and 7 Hz;     7 Hz from steps and 3 Hz        nrmse, % of std
    cone100, roll  upper half of the protocol's frequencies from the lower half            nrmse, % of std
    silverbox      the whole arrow from the multisine                                      rms, mV

    identified | encoder (`fit`) | physical (`diagnose --refit-nominal`) | both (`fit` from it) | GRU | lumped model

    python experiments/beyond_the_recordings.py [--data ../shared] [--cells 10] [--rows hasel7] [--every 4] [--order 2]

Every cell (row, model, seed) is added to `beyond_the_recordings.json` when it is done; one that is in this file already
is skipped. `--left-out` scores every training recording by models of the others instead. `--every 4` takes every fourth
sample of a HASEL, `--order 2` fixes the order of the nominal model.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

import pitp_jax as pitp
from pitp_jax.application.demo.protocol import kind, measure
from pitp_jax.method.identify.identification import trains_from_order_two

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
MODELS = ("identified", "encoder", "physical", "both", "gru", "lumped")
SEEDLESS = ("identified", "physical")
HASEL = {
    "hasel": (("steps", "sine_03Hz", "sine_07Hz"), ("sine_01Hz", "sine_11Hz")),
    "hasel7": (("steps", "sine_03Hz"), ("sine_07Hz",)),
}
ROWS = (*HASEL, "cone100", "roll", "silverbox")


def recordings(row: str, options) -> tuple[list, list]:
    """Return training and test recordings of a row."""
    if row in HASEL:
        read = {r.name: _thinned(r, options.every) for r in pitp.read(str(options.data / "data" / "hasel_peano"))}
        train, test = HASEL[row]
        return [read[n] for n in train], [read[n] for n in test]
    if row == "silverbox":
        read = {r.name: r for r in pitp.read(str(options.data / "data" / "silverbox"))}
        return [read["multisine_train"]], [read["arrow_full_test"]]
    sines = pitp.excitation.protocol(kind(row), "train")[:: 8 if options.smoke else 1]
    half = len(sines) // 2
    records = list(measure(pitp.plant(row), sines))  # ordered by frequency, then by amplitude
    return records[:half], records[half:]


def _thinned(record, every: int):
    return replace(record, **{f: getattr(record, f)[::every] for f in ("time", "voltage", "displacement")})


def fitted(model: str, records: Sequence, row: str, seed: int, options) -> tuple[Callable, dict]:
    """Fit one model; return its predictor (record -> displacement) and what is known of its structure."""
    input_map = "linear" if row == "silverbox" else "square"

    found = pitp.identify(records, input_map=input_map, order=options.order)
    if options.order == "auto" and trains_from_order_two(found):  # as `pitp fit`
        found = pitp.identify(records, input_map=input_map, order=2)
    nominal = found.model
    key = jax.random.key(seed)

    if model in ("gru", "lumped"):
        from benchmarks.peers import lumped, recurrent

        if model == "gru":
            return recurrent.fit(nominal, records, options.seconds, key, cell="gru"), {}
        return lumped.fit(nominal, records, options.seconds, key), {}
    known: dict = {"order": nominal.order}
    if model in ("physical", "both"):
        nominal = pitp.diagnose(nominal, records, refit_nominal=True).model
        known["effects"] = [e.name for e in nominal.effects]
    if model in ("encoder", "both"):
        nominal = pitp.train(nominal, records, key=key).model
    return lambda record: pitp.predict(nominal, [record])[0].displacement, known


def error(predicted, record, row: str) -> float:
    """Return the error of one recording: nrmse in %, or mV."""
    if row == "silverbox":
        return 1e3 * float(pitp.rmse(predicted, record.displacement))
    return float(pitp.nrmse_percent(predicted, record.displacement))


def cell(row: str, model: str, seed: int, options) -> dict:
    """Return the errors of one cell by recording, and the seconds it took."""
    train, test = recordings(row, options)
    began, errors, known = time.monotonic(), {}, {}
    if options.left_out:
        for k, record in enumerate(train):
            run, known = fitted(model, train[:k] + train[k + 1 :], row, seed, options)
            errors[record.name] = error(run(record), record, row)
    else:
        run, known = fitted(model, train, row, seed, options)
        errors = {record.name: error(run(record), record, row) for record in test}
    return {"errors": errors, "seconds": round(time.monotonic() - began), **known}


def table(done: dict) -> str:
    """Return the table: of a HASEL every recording, otherwise the median; of several seeds the median."""
    lines = ["| row | " + " | ".join(MODELS) + " |", "|---|" + "---|" * len(MODELS)]
    groups: dict[str, dict[str, list[float]]] = {}
    for name, found in done.items():
        row, model, _ = name.split("/")
        each = found["errors"] if row.startswith("hasel") else {"median": float(np.median([*found["errors"].values()]))}
        for recording, value in each.items():
            groups.setdefault(f"{row} {recording}", {}).setdefault(model, []).append(value)
    for name, models in groups.items():
        figures = (f"{np.median(models[m]):.3g}" if m in models else "" for m in MODELS)
        lines.append(f"| {name} | {' | '.join(figures)} |")
    return "\n".join(lines)


def main(argv=None):
    """Compute the missing cells, write each, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=HERE.parents[1] / "shared")
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=ROWS)
    parser.add_argument("--models", nargs="+", choices=MODELS, default=MODELS)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--cells", type=int, default=1000, help="how many more")
    parser.add_argument("--seconds", type=float, default=600.0, help="of a peer")
    parser.add_argument("--order", default="auto", type=lambda n: n if n == "auto" else int(n), help="of the nominal")
    parser.add_argument("--every", type=int, default=1, help="take every so many samples of a HASEL")
    parser.add_argument("--left-out", action="store_true", help="score training recordings by models of the others")
    parser.add_argument("--out", type=Path, default=HERE, help="folder of the results")
    parser.add_argument("--smoke", action="store_true", help="quick and meaningless")
    options = parser.parse_args(argv)
    if options.smoke:
        options.rows, options.models, options.out = ["cone100"], ["identified"], Path(tempfile.mkdtemp())
    file = options.out / f"beyond_the_recordings{'_left_out' if options.left_out else ''}.json"
    done = json.loads(file.read_text()) if file.is_file() else {}
    cells = [
        (row, model, seed)
        for seed in range(options.seeds)
        for row in options.rows
        for model in options.models
        if seed == 0 or model not in SEEDLESS
    ]
    missing = [c for c in cells if "/".join(map(str, c)) not in done]
    for row, model, seed in missing[: options.cells]:
        found = cell(row, model, seed, options)
        done[f"{row}/{model}/{seed}"] = found
        file.write_text(json.dumps(done, indent=1) + "\n")
        print(row, model, seed, found, flush=True)
    print(table(done))


if __name__ == "__main__":
    main()

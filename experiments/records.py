"""Five public data sets, by the product's own commands: the error of free runs on the official test recordings.

    train ─▶ identify ─▶ diagnose --refit-nominal ─▶ diagnose again ─▶ fit: five models
    settings: the models of the first 70 % of every training recording, judged on the rest; the best is made from all
    test: opened once, after the choice is in the JSON; the first samples give the initial state and do not count

    python experiments/records.py [SET ...] [--data ../shared] [--out records.json] [--smoke]

Every set has the same options; file names, the input map, and the length of the start differ. A finished set is not run
again. Errors: rms over the scored samples, no mean removed, in the file's unit and in % of their deviation (NRMSE).
The data is not part of the project.
"""

import argparse
import csv
import json
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

HERE = Path(__file__).resolve().parent
SPLIT = 0.7  # of every training recording, for the choice of the model
# name: (training files, test files, input map, samples of the start, (unit, factor), goal, best published)
SETS = {
    "silverbox": (
        ["multisine_train"], ["multisine_test", "arrow_full_test", "arrow_no_extrapolation_test"], "linear", 50,
        ("mV", 1e3), "0.24 / 0.26 / 0.24", "0.36 / 0.26 / 0.32 (nonlinear benchmark, identibench)",
    ),
    "emps": (["train"], ["test"], "linear", 20, ("mm", 1e3), "1.8", "2.64 (dynoNet)"),
    "tanks": (["train"], ["test"], "linear", 50, ("V", 1.0), "0.18", "0.191 (grey box)"),
    "bouc_wen": (
        ["train"], ["test_multisine", "test_sinesweep"], "linear", 50,
        ("1e-5 m", 1e5), "1.0 / 0.8", "1.3 to 1.9 / 1.2 (PNLSS)",
    ),
    "hasel_peano": (
        ["steps", "sine_03Hz", "sine_07Hz"], ["sine_01Hz", "sine_11Hz"], "square", 0,
        ("um", 1e6), "15 / 25 % NRMSE", "20 / 38 % NRMSE (GRU, experiments/beyond_the_recordings.py)",
    ),
}  # fmt: skip
WAYS = ("linear", "diagnosed", "diagnosed twice", "trained", "trained after diagnosed twice")


def pitp(*words) -> str:
    """Run a command of the product and return its output."""
    done = subprocess.run(
        [sys.executable, "-m", "pitp_jax", *map(str, words)], capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 3):
        raise RuntimeError(f"pitp {words[0]}: {done.stderr.strip()[-300:]}")
    return done.stdout


def cpu_seconds() -> float:
    """Return the CPU seconds of all finished commands."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def models(files, input_map: str, folder: Path, wanted, span=()) -> dict:
    """Make the models of `wanted` from these files; a model that a command cannot make is absent."""
    made = {"linear": folder / "linear"}
    print(pitp("identify", *files, *span, "--input-map", input_map, "--out", made["linear"])[-300:], file=sys.stderr)
    for way, nominal in (("diagnosed", "linear"), ("diagnosed twice", "diagnosed")):
        if nominal in made and any(way in w for w in wanted):
            out = folder / way.replace(" ", "_")
            pitp("diagnose", *files, *span, "--nominal", made[nominal], "--refit-nominal", "--out", out)
            found = sorted(out.glob("model_augmented*"))
            made |= {way: found[0]} if found else {}
    for way, nominal in (("trained", "linear"), ("trained after diagnosed twice", "diagnosed twice")):
        if nominal in made and way in wanted:
            pitp("fit", *files, *span, "--nominal", made[nominal], "--out", folder / way.replace(" ", "_"))
            made[way] = folder / way.replace(" ", "_")
    return {way: made[way] for way in wanted if way in made}


def free_runs(model: Path, files, start: int, span=()) -> dict:
    """Return the time, measurement, prediction and scored samples of each recording."""
    with tempfile.TemporaryDirectory() as folder:
        out, said = Path(folder) / "out", Path(folder) / "said.json"
        pitp("predict", model, *files, *span, "--out", out, "--json", said)
        rows = json.loads(said.read_text())["records"]
        found = {}
        for path in sorted(out.glob("*.csv")):
            with path.open() as file:
                head, *lines = csv.reader(file)
            table = np.array([[float(v) if v else np.nan for v in line] for line in lines])
            last = next(k for k, name in enumerate(head) if name.startswith("predicted"))
            begin = max(start, rows[path.stem].get("initial_samples") or 0)
            scored = np.isfinite(table[:, 2]) & (np.arange(len(table)) >= begin)
            found[path.stem] = table[:, 0], table[:, 2], table[:, last], scored
    return found


def errors(runs: dict) -> dict:
    """Return the rms error and the NRMSE (%) of each run; a diverged run is infinite."""
    found = {}
    for name, (_, y, p, scored) in runs.items():
        error = np.where(np.isfinite(p), p, np.inf)[scored] - y[scored]
        rms = float(np.sqrt(np.mean(error**2)))
        found[name] = {"rmse": rms, "nrmse": 100 * rms / float(y[scored].std()), "scored": int(scored.sum())}
    return found


def seconds_of(path: Path) -> float:
    """Return the length of a recording, from a training file's own clock."""
    time = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=0)
    return float(time[-1] - time[0])


def choose(files, input_map: str, start: int) -> dict:
    """Return the pooled NRMSE of each way on the last part of the training recordings."""
    split = SPLIT * min(map(seconds_of, files))
    with tempfile.TemporaryDirectory() as folder:
        made = models(files, input_map, Path(folder), WAYS, ("--to", split))
        judged = {way: errors(free_runs(m, files, start, ("--from", split))) for way, m in made.items()}
    return {way: float(np.sqrt(np.mean([r["nrmse"] ** 2 for r in rows.values()]))) for way, rows in judged.items()}


def run(name: str, data: Path, keep: Path, note) -> dict:
    """Choose, train on everything, and open the test files once."""
    train, test, input_map, start, *_ = SETS[name]
    files = [data / name / f"{f}.csv.gz" for f in train]
    began = cpu_seconds()
    folds = choose(files, input_map, start)
    chosen = min(folds, key=folds.__getitem__)
    note({"folds": folds, "chosen": chosen})  # before the test files are opened
    made = models(files, input_map, keep, (chosen,))
    trained = cpu_seconds() - began
    runs = free_runs(made[chosen], [data / name / f"{f}.csv.gz" for f in test], start)
    draw(name, runs)
    return {
        "folds": folds, "chosen": chosen, "test": errors(runs), "parts": pitp("info", made[chosen]).splitlines(),
        "cpu_s": {"training": round(trained, 1), "prediction": round(cpu_seconds() - began - trained, 1)},
        "version": re.sub(r"[^\d.]", "", pitp("--version")),
    }  # fmt: skip


def draw(name: str, runs: dict) -> None:
    """Draw measurement, prediction and error of each test recording."""
    figure = Figure(figsize=(9, 2.2 * len(runs)), layout="constrained")
    for ax, (record, (t, y, p, scored)) in zip(
        figure.subplots(len(runs), 1, squeeze=False)[:, 0], runs.items(), strict=True
    ):
        ax.plot(t[scored] - t[0], y[scored], color="0.2", lw=1.2, label="measured")
        ax.plot(t[scored] - t[0], p[scored], color="#0072B2", lw=0.8, label="predicted")
        ax.plot(t[scored] - t[0], (p - y)[scored], color="#D55E00", lw=0.8, label="error")
        ax.set_title(record, fontsize=8, loc="left")
        ax.set_xlabel("time (s)", fontsize=8)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False, fontsize=8)
    figure.savefig(HERE / "figures" / f"records_{name}.png", dpi=120)


def page(results: dict) -> str:
    """Return the page as Markdown."""
    lines = [
        "| data | error on the test | NRMSE (%) | goal | best published | model | CPU s, training |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, row in results.items():
        *_, (unit, factor), goal, published = SETS[name]
        rms = " / ".join(f"{factor * r['rmse']:.3g}" for r in row["test"].values())
        nrmse = " / ".join(f"{r['nrmse']:.2g}" for r in row["test"].values())
        lines.append(
            f"| {name} | {rms} {unit} | {nrmse} | {goal} | {published} | {row['chosen']} | {row['cpu_s']['training']} |"
        )
    return "\n".join(lines) + "\n"


def main(smoke: bool = False, argv=None):
    """Run the sets that are there, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="*", choices=[*SETS, []])
    parser.add_argument("--data", type=Path, default=HERE.parents[1] / "shared")
    parser.add_argument("--out", type=Path, help="results, set by set; a finished set is not run again")
    parser.add_argument("--smoke", action="store_true", help="print the sets")
    options = parser.parse_args([] if smoke and argv is None else argv)
    data = options.data / "data"
    names = [n for n in options.sets or SETS if (data / n).is_dir()]
    if smoke or options.smoke or not names:
        print(f"skipped: {data} is absent" if not names else f"{len(names)} sets")
        return
    results = json.loads(options.out.read_text()) if options.out and options.out.exists() else {}
    for name in names:
        if "test" not in results.get(name, {}):

            def note(partial, name=name):
                results[name] = partial
                if options.out:
                    options.out.write_text(json.dumps(results, indent=1))

            with tempfile.TemporaryDirectory() as keep:
                note(run(name, data, Path(keep), note))
        print(page({name: results[name]}), flush=True)


if __name__ == "__main__":
    main()

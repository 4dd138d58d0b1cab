"""Diagnosis of actuators whose effect is withheld: names, ties, unknowns, closed fraction, on forms of another hand.

    clean (healthy) -> identify -> nominal;    real (one, two, no or an outside effect) -> diagnose -> score

    python experiments/withheld_effect.py [--effects NAME,...] [--kinds cone,roll] [--seeds 100,101,102]
        [--strength 1.0] [--refit] [--noise NAME] [--pairs] [--outside] [--none N] [--leave-one-out]
        [--cache DIR] [--results DIR] [--write DIR] [--table] [--smoke]

The effects are written in `_withheld/`, apart from the diagnosis' own (nothing of `method.effects` is imported), and
labels are sealed by a printed sha256 until all diagnoses are done. Thresholds of the diagnosis are tuned on seeds 0 to
99 only; figures are reported on seeds from 100 on. With `--results` a case is one JSON, and an interrupted run resumes;
delete the folder when the diagnosis has changed. `--table` prints the gap of every case and diagnoses nothing.
"""

import argparse
import gzip
import json
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
from _show import show
from _withheld import cells, protocol, score
from _withheld.case import Case, Spec, load_or_make
from _withheld.catalogue import INSIDE, LOCATED, OUTSIDE, PAIRS
from _withheld.seal import Sealed, opened

import pitp_jax as pitp


def arguments(smoke: bool, argv):
    """The command line; lists are separated by commas."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--effects", type=_names, help="default: the whole catalogue, unless --pairs, --outside or --none"
    )
    parser.add_argument("--kinds", type=_names, default=["cone", "roll"], help=", ".join(protocol.KINDS))
    parser.add_argument("--seeds", type=lambda s: [int(k) for k in s.split(",")], default=[100, 101, 102])
    parser.add_argument("--strength", type=float, default=1.0, help="of the wanted gap; 0.4 is weak")
    parser.add_argument("--refit", action="store_true", help="the nominal is identified on the real records")
    parser.add_argument("--noise", choices=tuple(protocol.NOISES), default="white", help="ar: AR(0.9)")
    parser.add_argument("--pairs", action="store_true", help="two effects at once")
    parser.add_argument("--outside", action="store_true", help="disturbances outside the catalogue, all or --effects")
    parser.add_argument(
        "--none", type=int, default=0, metavar="N", help="healthy cases a kind, seeds from the first on"
    )
    parser.add_argument("--leave-one-out", action="store_true", help="diagnose without the true name: unknown is right")
    parser.add_argument("--cache", type=Path, help="keep generated cases here")
    parser.add_argument("--results", type=Path, help="one JSON a case; a run resumes from it")
    parser.add_argument("--write", type=Path, help="also write the records as CSV, one folder a case")
    parser.add_argument("--table", action="store_true", help="gaps only")
    parser.add_argument("--smoke", action="store_true", help="quick and meaningless")
    options = parser.parse_args(argv)
    unknown = set(options.effects or ()) - set(INSIDE) - set(OUTSIDE) | set(options.kinds) - set(protocol.KINDS)
    if unknown:
        parser.error(
            f"no {', '.join(unknown)}; effects: {', '.join(INSIDE | OUTSIDE)}; kinds: {', '.join(protocol.KINDS)}"
        )
    if smoke or options.smoke:
        options.effects, options.kinds, options.seeds = options.effects or ["added_mass"], ["short"], [0]
    return options


def _names(text: str) -> list[str]:
    return [name for name in text.split(",") if name]


def chosen(options) -> list[Spec]:
    """The cases asked for, in the order of their keys: it tells nothing."""
    only = options.pairs or options.outside or options.none
    names = [(n,) for n in (options.effects or ([] if only else INSIDE))]
    names += list(PAIRS) if options.pairs else []
    names += [(n,) for n in OUTSIDE] if options.outside and not options.effects else []
    grid = [(n, kind, seed) for n in names for kind in options.kinds for seed in options.seeds]
    grid += [((), kind, options.seeds[0] + k) for kind in options.kinds for k in range(options.none)]
    return sorted((Spec(*g, options.strength, options.noise) for g in grid), key=lambda s: s.key)


def diagnosed(spec: Spec, case: Case, options) -> dict:
    """One row: what the diagnosis said, beside the truth that needs the noise-free records."""
    began = time.perf_counter()
    how = {"exclude": tuple(n for n in spec.names if n in INSIDE)} if options.leave_one_out else {}
    try:
        nominal = pitp.identify(case.real if options.refit else case.clean, order=2, input_map="square").model
        began = time.perf_counter()
        result = pitp.diagnose(nominal, case.real, refit_nominal=options.refit, **how)
    except Exception as problem:  # a failed case is a result too: the others go on
        told = {"verdict": "failed", "effects": [], "equivalent": [], "closed_fraction": None, "true_closed": None}
        return told | {"key": spec.key, "seconds": time.perf_counter() - began, "error": repr(problem)}
    seconds, said = time.perf_counter() - began, result.as_json()
    gap, held = said["gap"], said["records"]["heldout"]
    truth = score.true_closed(result, nominal, case, held) if gap["closed_fraction"] is not None else None
    interval = gap.get("ci95")
    row = {k: said[k] for k in ("verdict", "effects", "equivalent", "gap")} | {
        "key": spec.key,
        "seconds": seconds,
        "closed_fraction": gap["closed_fraction"],
        "true_closed": truth,
        "unseen": bool(spec.names) and case.facts["gap_percent"] < 0.5 * case.facts["floor_percent"],
        "covered": bool(interval[0] <= truth <= interval[1]) if truth is not None and interval else None,
        "within": score.numbers_within(result.added, case, protocol.KINDS[spec.kind]),
        "ranking": [{k: r.get(k) for k in ("effect", "form", "heldout")} for r in said["ranking"][:6]],
    }
    if case.missing:
        row["f1"] = cells.f1(case, said["where"]["cells"])
    return row


def row_of(spec: Spec, options) -> dict:
    """A row from the results folder, or a fresh one left there."""
    mode = ("-refit" if options.refit else "") + ("-without" if options.leave_one_out else "")
    path = options.results / f"{spec.key}{mode}.json" if options.results else None
    if path and path.exists():
        return json.loads(path.read_text())
    case = load_or_make(spec, options.cache, locate=bool(set(spec.names) & set(LOCATED)))
    row = diagnosed(spec, case, options)
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_text(json.dumps(row))
        part.replace(path)
    return row


def write(case: Case, folder: Path) -> None:
    """Both sets as CSV, columns and digits as in shared/gap."""
    for name, rows in (("clean", case.clean), ("real", case.real)):
        (folder / name).mkdir(parents=True, exist_ok=True)
        for r in rows:
            with gzip.open(folder / name / f"{r.name}.csv.gz", "wt") as out:
                table = np.stack([r.time, r.voltage, 1e3 * r.displacement], axis=1)
                header = "time_s,voltage_V,displacement_mm"
                np.savetxt(out, table, fmt=("%.4f", "%.2f", "%.4f"), delimiter=",", header=header, comments="")


def table(specs: list[Spec], options) -> None:
    """Gap of every case, and what it is made of."""
    rows = []
    for spec in specs:
        began = time.perf_counter()
        facts = load_or_make(spec, options.cache).facts
        forms = "+".join(facts["forms"]) or "-"
        rows.append((spec.label, spec.kind, spec.seed, forms, facts["gap_percent"], facts["floor_percent"],
                     facts["zeta"], time.perf_counter() - began))  # fmt: skip
    show("gaps, noise-free", ("effect", "kind", "seed", "forms", "gap %", "floor %", "zeta", "seconds"), sorted(rows))


def main(smoke: bool = False, argv=None):
    """Make, seal, diagnose, open, score."""
    options = arguments(smoke, [] if smoke and argv is None else argv)
    specs = chosen(options)
    for spec in specs if options.write else ():
        write(load_or_make(spec, options.cache), options.write / spec.key)
    if options.table:
        table(specs, options)
        return None
    sealed = Sealed({s.key: s.label for s in specs})
    print(f"{len(specs)} cases, labels sealed: sha256 {sealed.digest}", flush=True)
    rows = []
    for k, spec in enumerate(specs):
        row = row_of(spec, options)
        rows.append(row)
        what = "+".join(row["effects"]) or row["verdict"]
        print(f"{k + 1}/{len(specs)} {spec.key} {what} ({row['seconds']:.0f} s) {row.get('error', '')}", flush=True)
    labels = opened(sealed.labels, sealed.salt, sealed.digest)
    print(f"\nopened, salt {sealed.salt}:")
    print(json.dumps({s.key: {"label": labels[s.key]} | asdict(s) for s in specs}))
    how = {"refit": options.refit, "left_out": options.leave_one_out}
    show("wrong", ("truth", "said", "times"), score.wrong_ones(labels, rows, **how))
    show("all", ("figure", "value"), score.summary(labels, rows, **how))
    return rows


if __name__ == "__main__":
    main()

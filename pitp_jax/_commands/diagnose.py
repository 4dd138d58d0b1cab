"""`pitp diagnose`: where a model and recordings disagree, which missing effect causes it, how far that shrinks."""

from pathlib import Path

import numpy as np

from .._diagnose.diagnosis import Diagnosis
from .._diagnose.diagnosis import diagnose as run_diagnosis
from .._diagnose.report.answers import NEXT_CSV
from .._diagnose.report.figures import FIGURES, figures
from .._diagnose.report.page import report
from .._errors import BadInput
from .._model_file.lineage import descended
from .._model_file.model_file import save
from .._record.writing import write_csv, write_text_atomic
from .._report.drawn import write_figure
from .against import against as diagnose_against
from .console import StatusLine, number, print_table, say
from .outputs import REPORT, check_outputs, staged, write_json
from .recordings import open_both, warn

MODEL, JSON = "model_augmented", "diagnosis.json"
FILES = (MODEL, REPORT, JSON, NEXT_CSV, *(f"figures/{name}.{kind}" for name in FIGURES for kind in ("png", "csv")))
_ROWS = 8  # of the ranking on standard output


def diagnose(
    records, nominal, refit_nominal, seconds, out, json_file, reading, against=None, position_gain=None
) -> None:
    """Diagnose, write what was asked for, and print the finding.

    Args:
        records: files and folders.
        nominal: model file, identified or trained; None with `against`.
        refit_nominal: whether its coefficients are fitted along with every effect.
        seconds: of computing, or None.
        out: folder for the augmented model, the report, its figures and the next experiment, or None.
        json_file: where to write the finding for machines, or None.
        reading: keyword arguments of `pitp.read`: columns, units, scales, rate.
        against: recordings of a simulator in the place of a model, or None.
        position_gain: of the simulator's controller, with `against`.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    if against is not None:
        if refit_nominal:
            raise BadInput("--refit-nominal is for --nominal: a simulator's recordings carry no effect of the robot")
        diagnose_against(records, against, position_gain, seconds, out, json_file, reading)
        return
    if position_gain is not None:
        raise BadInput("--position-gain is for --against: it is the simulator's")
    check_outputs(json_file, folder=out, names=FILES, inputs=[nominal, *records])
    model, read_in = open_both(nominal, records, reading)
    warn(read_in)
    say(f"diagnosing {nominal} on {len(read_in)} record{'' if len(read_in) == 1 else 's'}")
    status = StatusLine()
    limit = np.inf if seconds is None else seconds
    found = run_diagnosis(model, read_in, refit_nominal=refit_nominal, seconds=limit, progress=status.update)
    status.close()
    csv = str(Path(out) / NEXT_CSV) if out is not None and found.next_experiment is not None else None
    written: set[str] = set()
    with staged(folder=out, json_file=json_file, value=found.as_json(csv)) as stage:
        if out is not None:
            _write(found, stage)
            write_json(stage / JSON, found.as_json(csv))
            save(stage / MODEL, descended(found.model, "diagnose", read_in, model))
            written = {path.relative_to(stage).as_posix() for path in stage.rglob("*")}
    print(found)
    _print_ranking(found)
    if out is not None:
        for name in set(FILES) - written:  # of an earlier diagnosis: no part of this one
            (Path(out) / name).unlink(missing_ok=True)
        added = f"with {' and '.join(found.handed_back)}" if found.handed_back else "the nominal"
        print(f"wrote {Path(out) / REPORT}, its figures, and {Path(out) / MODEL} ({added})")
        if csv is not None and found.next_experiment is not None:
            print(f"next experiment, to tell {' from '.join(found.next_experiment.separates)}: {csv}")


def _write(found: Diagnosis, folder: Path) -> None:
    """The page, its figures and the next experiment into an existing folder."""
    write_text_atomic(folder / REPORT, report(found))
    for name, drawn in figures(found).items():
        write_figure(folder, name, drawn)
    experiment = found.next_experiment
    if experiment is not None:
        write_csv(folder / NEXT_CSV, {"time_s": experiment.time, "voltage_V": experiment.voltage})


def _print_ranking(found: Diagnosis) -> None:
    """The best candidates, the effects named marked *, those tied with the first =."""
    rows = []
    for r in found.ranking[:_ROWS]:
        mark = " *" if r.effect in found.effects else " =" if r.effect in found.equivalent else ""
        ci = "-" if r.ci95 is None else " to ".join(number(100 * end, 3) for end in r.ci95)
        closed = None if r.closed_fraction is None else 100 * r.closed_fraction
        rows.append((f"{r.effect}{mark}", r.form, number(r.train, 3), number(r.heldout, 3), number(closed, 3), ci))
    print_table(("effect", "form", "fitted (%)", "held out (%)", "closed (%)", "95 % interval"), rows)
    left = len(found.ranking) - len(rows)
    if left > 0:
        print(f"and {left} more, which --json and the report list")

"""`pitp diagnose ROBOT --against SIM`: what a simulator lacks, as numbers to type into it."""

from pathlib import Path

import numpy as np

from .._against import SimToReal
from .._against.entry import diagnose as run_diagnosis
from .._against.entry import with_lineage
from .._against.page import figures, page
from .._diagnose.report.page import report
from .._model_file.model_file import save
from .._record.writing import write_text_atomic
from .._report.drawn import write_figure
from .console import StatusLine, number, print_table, say
from .outputs import REPORT, check_outputs, staged, write_json
from .recordings import read_records, warn

MODEL, ROBOT, JSON = "model_augmented", "robot.html", "diagnosis.json"


def against(records, simulated, position_gain, seconds, out, json_file, reading) -> None:
    """Diagnose a robot's records against a simulator's, write what was asked for, and print the finding.

    Args:
        records: the robot's files and folders.
        simulated: the simulator's files and folders.
        position_gain: Kp of the simulator, or None.
        seconds: of computing, or None.
        out: folder for the augmented model, pages and figures, or None.
        json_file: where to write the finding for machines, or None.
        reading: keyword arguments of `pitp.read`: columns, units, scales, rate.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    check_outputs(json_file, folder=out, names=[MODEL, REPORT, ROBOT, JSON], inputs=[*records, *simulated])
    sets = [read_records(paths, reading, square=False) for paths in (records, simulated)]
    warn(sets[0])
    status = StatusLine()
    limit = np.inf if seconds is None else seconds
    found = run_diagnosis(
        sets[0], against=sets[1], position_gain=position_gain, seconds=limit, progress=status.update
    )  # fmt: skip
    status.close()
    with staged(folder=out, json_file=json_file, value=found.as_json()) as stage:
        if out is not None:
            _write(found, stage)
    _print(found)
    if out is not None:
        say(f"wrote {Path(out) / REPORT}, its figures, {JSON} and {MODEL}")


def _write(found: SimToReal, folder: Path) -> None:
    write_text_atomic(folder / REPORT, page(found))
    write_text_atomic(folder / ROBOT, report(found.robot))
    write_json(folder / JSON, found.as_json())
    save(folder / MODEL, with_lineage(found))
    for name, (drawn, columns, _) in figures(found).items():
        write_figure(folder, name, drawn, columns)


def _print(found: SimToReal) -> None:
    """The verdict, the parameters as a table, and clocks and partners."""
    print(found.robot)
    rows = [
        (p.words, number(p.simulator), number(p.robot), number(p.difference), number(p.stderr, 2), p.unit, p.mujoco)
        for p in found.parameters
    ]
    print_table(("quantity", "simulator", "robot", "difference", "+-", "unit", "MuJoCo"), rows)
    for line in found.pairs.remarks("robot", "simulator"):
        print(line)

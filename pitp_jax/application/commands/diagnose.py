"""`pitp diagnose`: reports where recordings and a model or simulator disagree, and which missing effect causes it."""

import os
import shlex
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from ...common.errors import refuse_if
from ...files.mjcf.document import read_document
from ...files.mjcf.joint import joint_of
from ...files.mjcf.write import identified_name
from ...files.model_file.model_file import save
from ...files.recordings.remarks import counted
from ...files.recordings.writing import write_signals, write_text_atomic
from ...method.diagnose.diagnosis import Diagnosis
from ...method.diagnose.words import NEXT_CSV, named
from ...method.model.lineage import descended
from ..against.entry import diagnose as run_diagnosis
from ..against.mjcf import write_mjcf
from ..against.result import SimToReal
from ..pages.against import page
from ..pages.diagnosis.figures import FIGURES, figures
from ..pages.diagnosis.page import ranking, report
from ..pages.drawing import write_page, write_picture
from .console import ProgressLine, print_table, say
from .ours import check_replaceable
from .outputs import MODEL, REPORT, check_outputs, staged, write_json
from .recordings import open_both, read_records, warn
from .verify import one_joint

JSON, ROBOT = "diagnosis.json", "robot.html"
FILES = (MODEL, REPORT, ROBOT, JSON, NEXT_CSV, *(f"figures/{n}.{kind}" for n in FIGURES for kind in ("png", "csv")))
T = TypeVar("T")


def diagnose(
    records, nominal, refit_nominal, seconds, out, json_file, reading, against=None, position_gain=None, mjcf=None,
    joint=None, actuator=None,
) -> None:  # fmt: skip
    """Diagnose recordings, write the requested files, and print the result.

    Args:
        records: files and folders.
        nominal: model file, identified or trained; None with `against`.
        refit_nominal: whether its coefficients are fitted with every effect; always if the nominal was made from these
            recordings.
        seconds: of computing, or None.
        out: folder for the augmented model, the report, its figures and the next experiment, or None.
        json_file: where to write the result as JSON, or None.
        reading: keyword arguments of `pitp.read`: columns, units, scales, rate.
        against: recordings of a simulator instead of a model, or None.
        position_gain: of the simulator's controller, with `against`.
        mjcf: MuJoCo file of the simulator, with `against`; a copy with the robot's parameters is written to `out`.
        joint: list with the name of the joint in that file.
        actuator: its actuator, if there are several.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    _check_options(refit_nominal, against, position_gain, mjcf, joint, actuator, out)
    if mjcf is not None:
        given = joint_of(read_document(mjcf), one_joint(joint), actuator)
        if given.position and position_gain is None:
            position_gain = given.torque_per_command
    _check_places(out, json_file, mjcf, [nominal, *records, *(against or ())])
    status = ProgressLine()
    options = {"seconds": seconds or np.inf, "progress": status.update}
    if against is None:
        model, read_in = open_both(nominal, records, reading)
        warn(read_in)
        say(f"diagnosing {nominal} on {counted(len(read_in), 'recording')}")
        diagnosis = run_diagnosis(model, read_in, refit_nominal=refit_nominal or None, **options)
        augmented = descended(diagnosis.model, "diagnose", read_in, model)
    else:
        read_in, simulated = (read_records(paths, reading, input_map="linear") for paths in (records, against))
        warn(read_in)
        diagnosis = run_diagnosis(read_in, against=simulated, position_gain=position_gain, **options)
        augmented = descended(diagnosis.model, "diagnose against a simulator", read_in, diagnosis.nominal)
    status.close()
    robot = diagnosis.robot if isinstance(diagnosis, SimToReal) else diagnosis
    csv = str(Path(out) / NEXT_CSV) if out is not None and robot.next_experiment is not None else None
    written = _write(diagnosis, robot, augmented, read_in[0].voltage_unit, out, json_file, csv)
    _attempt("the printed result", lambda: _print(diagnosis))
    if mjcf is not None and isinstance(diagnosis, SimToReal):
        _write_mjcf(diagnosis, records, mjcf, one_joint(joint), str(out), actuator)
    if out is not None:
        _say_written(robot, Path(out), written, csv)
    if robot.interrupted:
        place = out or json_file
        where = f"in {place}" if place else "above"
        raise KeyboardInterrupt(f"the best result so far is {where}")


def _check_options(refit_nominal, against, position_gain, mjcf, joint, actuator, out) -> None:
    """Refuse options that contradict each other."""
    refuse_if(
        (
            against is not None and refit_nominal,
            "--refit-nominal only works with --nominal: a simulator's recordings contain no effect of the robot",
        ),
        (
            against is None and position_gain is not None,
            "--position-gain only works with --against: it is the gain of the simulator's controller",
        ),
        (
            mjcf is not None and (against is None or out is None),
            "--mjcf only works with --against and --out DIR: the changed file is written there",
        ),
        (mjcf is None and (joint or actuator), "--joint and --actuator only work with --mjcf XML"),
    )


def _check_places(out: str | None, json_file: str | None, mjcf: str | None, inputs: list) -> None:
    """Refuse outputs that cannot be written, or that would replace the user's own files."""
    made = [] if mjcf is None else [identified_name(mjcf)]
    check_outputs(json_file, folder=out, names=[*FILES, *made], inputs=[*inputs, mjcf])
    if out is None:
        return
    for name in made:
        check_replaceable(Path(out) / name, Path(out) / name)
    if not _is_drive(csv := Path(out) / NEXT_CSV):  # recorded, and saved under the name of the input file
        check_replaceable(csv, csv)


def _write(
    diagnosis: Diagnosis | SimToReal, robot: Diagnosis, augmented, input_unit: str, out: str | None,
    json_file: str | None, csv: str | None,
) -> set[str]:  # fmt: skip
    """Write the result, then the pages; return the names of the files written into the folder.

    The result is written first, so a failure or interrupt in a figure or sentence cannot lose it.
    """
    written, value = set(), diagnosis.as_json(csv)
    with staged(folder=out, json_file=json_file, value=value) as stage:
        if out is not None:
            write_json(stage / JSON, value)
            save(stage / MODEL, augmented)
            if (planned := robot.next_experiment) is not None:
                unit = "V" if input_unit.endswith("V") else input_unit
                write_signals(stage / NEXT_CSV, planned.time, voltage=(planned.voltage, unit))
            written |= _files_in(stage)
    if out is not None:
        with staged(folder=out) as stage:
            _write_pages(diagnosis, robot, stage)
            written |= _files_in(stage)
    return written


def _say_written(robot: Diagnosis, out: Path, written: set[str], csv: str | None) -> None:
    """Remove files of an earlier diagnosis, and print the names of the written files."""
    _tidy(out, written)
    added = f"with {named(robot.handed_back)}" if robot.handed_back else "the nominal"
    files = [f"{out / REPORT} with its figures"] if REPORT in written else []
    print(f"wrote {named([*files, *([csv] if csv else []), f'{out / MODEL} ({added})'])}")


def _write_mjcf(diagnosis: SimToReal, records, mjcf: str, joint: str, out: str, actuator: str | None) -> None:
    """Write a changed MuJoCo file into the folder, and print the changes and the parameters that it cannot hold."""
    written = _attempt("the MuJoCo file", lambda: write_mjcf(diagnosis, mjcf, joint, out, actuator=actuator))
    if written is not None:
        write_json(Path(out) / "mjcf.json", written.as_json())
        for line in written.lines():
            print(line)
        words = ["pitp", "verify", *records, "--mjcf", str(written.file), "--before", mjcf, "--joint", joint]
        print(f"wrote {written.file}; to verify it in MuJoCo: {shlex.join(words)}")


def _files_in(stage: Path) -> set[str]:
    return {path.relative_to(stage).as_posix() for path in stage.rglob("*")}


def _attempt(what: str, make: Callable[[], T]) -> T | None:
    """Call `make`; if it fails, print a warning and return None, so that the rest of the result is still written."""
    try:
        return make()
    except Exception as error:
        if os.environ.get("PITP_TRACEBACK"):
            traceback.print_exc()
        reason = f"{type(error).__name__}: {error}"
        say(f"warning: {what} failed ({reason}); the rest of the result is complete")
        return None


def _is_drive(file: Path) -> bool:
    """Return whether pitp may overwrite a CSV file: it does not exist, or holds only time and input."""
    if not file.is_file():
        return True
    with open(file, encoding="utf-8", errors="replace") as stream:
        return stream.readline(200).count(",") == 1


def _tidy(folder: Path, written: set[str]) -> None:
    """Remove files that an earlier diagnosis wrote and this one did not, and print their names."""
    old = sorted(name for name in {*FILES} - written if (folder / name).is_file())
    for name in old:
        (folder / name).unlink()
    if old:
        print(f"removed from {folder}, of an earlier diagnosis: {', '.join(old)}")


def _write_pages(diagnosis: Diagnosis | SimToReal, robot: Diagnosis, folder: Path) -> None:
    """Write the pages and their figures into a folder; those that fail are reported and left out."""
    name = REPORT if robot is diagnosis else ROBOT
    drawn = _attempt("the figures", lambda: figures(robot)) or {}
    for picture in drawn.values():  # before the page, which may fail alone, and makes them small
        _attempt(f"the figure {picture.name}", lambda picture=picture: write_picture(folder, picture))
    _attempt(name, lambda: write_text_atomic(folder / name, report(robot, drawn).html()))
    if isinstance(diagnosis, SimToReal):
        _attempt(REPORT, lambda: write_page(folder / REPORT, page(diagnosis)))


def _print(diagnosis: Diagnosis | SimToReal) -> None:
    """Print the verdict, then the ranking of effects or the table of simulator and robot parameters."""
    if not isinstance(diagnosis, SimToReal):
        print(diagnosis)
        _print_ranking(diagnosis)
        return
    print(diagnosis.robot)
    rows = diagnosis.table()
    # the page has the other programs' names
    print_table(replace(rows, header=rows.header[:7], rows=[row[:7] for row in rows.rows]))
    for line in diagnosis.remarks():
        print(line)


def _print_ranking(diagnosis: Diagnosis) -> None:
    """Print the best candidate effects, without their parameters."""
    table, count = ranking(diagnosis), 8  # rows; --json and the report have all
    header, *rows = ([*row[:2], *row[3:]] for row in (table.header, *table.rows[:count]))
    print_table(replace(table, header=header, rows=rows, bold=table.bold[:count]), 3)
    more = len(table.rows) - count
    if more > 0:
        print(f"and {more} more, which --json and the report list")

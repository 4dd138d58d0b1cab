"""`pitp check`: reports what was read, how each record starts, and whether the records suffice."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ...common.units import base_unit
from ...files.containers.options import folder_file
from ...files.recordings.reading import read_each
from ...files.recordings.writing import write_signals, write_text_atomic
from ..check.check import Check, checked
from ..pages.check import page, table
from .console import print_table, say
from .outputs import check_outputs, csv_names, staged
from .recordings import recognised

PAGE, SOURCE = "check.html", "source.toml"


def check(records, out, json_file, reading) -> None:
    """Check recordings, write the requested files, and print the result.

    Args:
        records: files and folders.
        out: folder for the records as read and the page, or None.
        json_file: where to write the result as JSON, or None.
        reading: keyword arguments of `pitp.read`: columns, units, scales, rate.

    Raises:
        BadInput: nothing could be read; with nothing written.
    """
    check_outputs(json_file, folder=out, inputs=records)
    read_in, refused = read_each(records, reading)
    for line in recognised(read_in):
        say(line)
    for line in refused.values():
        say(f"warning: not read: {line}")
    result = checked(read_in, refused)
    files = csv_names(result.understood)
    check_outputs(json_file, folder=out, names=[*files, PAGE, SOURCE], inputs=records)
    with staged(folder=out, json_file=json_file, value=result.as_json()) as stage:
        if out is not None:
            _write(result, files, stage)
    _print(result)
    if out is not None:
        print(f"wrote {Path(out) / PAGE} and every recording as it was read")


def _write(result: Check, files: Sequence[str], folder: Path) -> None:
    for record, file in zip(result.understood, files, strict=True):
        voltage = record.voltage, base_unit(record.voltage_unit)
        displacement = record.displacement, base_unit(record.displacement_unit)
        write_signals(folder / file, record.time, voltage=voltage, displacement=displacement)
    write_text_atomic(folder / PAGE, page(result).html())
    said = {os.path.basename(r.source): r.recognised["options"] for r in result.understood if "options" in r.recognised}
    write_text_atomic(folder / SOURCE, folder_file(said))


def _print(result: Check) -> None:
    rows = table(result)
    # what a file was read as is printed above
    print_table(replace(rows, header=rows.header[:-1], rows=[row[:-1] for row in rows.rows]))
    for name, lines in result.problems.items():
        for line in lines:
            print(f"{name}: {line}")
    for line in result.advice:
        print(f"- {line}")

"""`pitp demo`: the paper's experiments on a virtual actuator."""

from dataclasses import asdict
from pathlib import Path

from .._demo import files
from .._demo.protocol import run, tables
from .._errors import BadInput
from .console import ProgressBar, number, print_table, say
from .outputs import check_files, check_folder, staged_folder, write_json


def demo(plant, out, quick, json_file=None) -> None:
    """Run the demo, write its files, and print its tables.

    Args:
        plant: name of the virtual actuator.
        out: folder to write to, created if missing.
        quick: fewer and shorter records.
        json_file: where to write the tables for machines, or None.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    check_folder(out, files.FILES)
    check_files(json_file)
    _check_recordings(Path(out), files.recordings(plant, quick))
    found = run(plant, quick=quick, say=say, progress=ProgressBar().update)
    with staged_folder(out) as stage:
        files.write(found, stage)
    made = tables(found)
    if json_file:
        write_json(json_file, {"tables": [asdict(table) for table in made]})
    for table in made:
        print(table.title)
        rows = [[cell if isinstance(cell, str) else number(cell, 3) for cell in row] for row in table.rows]
        print_table(table.header, rows)
        print()
    print(f"recordings, model, tables and figures are in {out}; the other commands run on them:")
    print(f"  pitp predict {out}/model.pitp {out}/held_out")


def _check_recordings(out: Path, names: set[str]) -> None:
    """Refuse a folder with recordings of another demo: a set of records is of one actuator."""
    for home in (files.RECORDS, files.HELD_OUT):
        if (out / home).is_dir():
            others = sorted(p.name for p in (out / home).iterdir() if f"{home}/{p.name}" not in names)
            if others:
                raise BadInput(f"{out / home}: {others[0]} is of another demo; choose another folder with --out")

"""`pitp demo`: the paper's experiments on a virtual actuator."""

from pathlib import Path

from .._demo import files
from .._demo.protocol import run, tables
from .._errors import BadInput
from .console import ProgressBar, number, print_table, say
from .outputs import check_folder, staged_folder


def demo(plant, out, quick) -> None:
    """Run the demo, write its files, and print its tables.

    Args:
        plant: name of the virtual actuator.
        out: folder to write to, created if missing.
        quick: fewer and shorter records.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    check_folder(out, files.FILES)
    _check_recordings(Path(out), files.recordings(plant, quick))
    found = run(plant, quick=quick, say=say, progress=ProgressBar().update)
    with staged_folder(out) as stage:
        files.write(found, stage)
    for table in tables(found):
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

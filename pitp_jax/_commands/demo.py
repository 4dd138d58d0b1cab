"""`pitp demo`: the paper's experiments on a virtual actuator."""

from .._demo import files
from .._demo.protocol import run, tables
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
    found = run(plant, quick=quick, say=say, progress=ProgressBar().update)
    with staged_folder(out) as stage:
        files.write(found, stage)
    for table in tables(found):
        print(table.title)
        rows = [[cell if isinstance(cell, str) else number(cell, 3) for cell in row] for row in table.rows]
        print_table(table.header, rows)
        print()
    print(f"model, tables and figures are in {out}")

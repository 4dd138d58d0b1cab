"""The numbers of a figure as a table: every line, point and bar of every axes."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from .._record.writing import write_text_atomic


def write_figure(folder: Path, name: str, drawn: Figure) -> None:
    """Write `NAME.png` and `NAME.csv` (axes, series, x, y) into a folder, which is made if it is missing.

    Raises:
        BadInput: a file cannot be written.
    """
    folder.mkdir(exist_ok=True)
    drawn.savefig(folder / f"{name}.png", dpi=150)
    rows = [",".join((*map(_quoted, row[:2]), *(f"{v:.9g}" for v in row[2:]))) for row in _rows(drawn)]
    write_text_atomic(folder / f"{name}.csv", "\n".join(["axes,series,x,y", *rows]) + "\n")


def _rows(drawn: Figure) -> Iterator[tuple[str, str, float, float]]:
    for k, ax in enumerate(drawn.axes):
        axes = ax.get_ylabel() or f"axes {k + 1}"
        for n, line in enumerate(ax.lines):
            label = str(line.get_label())
            series = f"line {n + 1}" if label.startswith("_") else label
            for x, y in zip(*(np.asarray(v, float) for v in line.get_data()), strict=True):
                yield axes, series, float(x), float(y)
        for patch in ax.patches:
            if isinstance(patch, Rectangle):
                yield axes, "bar", patch.get_x() + patch.get_width() / 2, patch.get_y() + patch.get_height()


def _quoted(text: str) -> str:
    return '"' + " ".join(text.replace('"', "'").split()) + '"'

"""Write a figure with its numbers as a table: every line, point and bar of all axes."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ...common.picture import Picture
from ...files.recordings.writing import write_csv, write_text_atomic

FIGURES = "figures"  # below the folder of a page: figures and their numbers, never beside recordings


def write_picture(folder: Path, picture: Picture) -> None:
    """Write `figures/NAME.png` and the numbers of the figure as `figures/NAME.csv` into a folder.

    Args:
        folder: where `figures/` is made if it is missing.
        picture: the figure; without columns the numbers are those of its axes (axes, series, x, y).

    Raises:
        BadInput: a file cannot be written.
    """
    file = folder / FIGURES / f"{picture.name}.png"
    file.parent.mkdir(parents=True, exist_ok=True)
    picture.drawn.savefig(file, dpi=150)
    table = file.with_name(f"{file.name.removesuffix('.png')}.csv")
    if picture.columns is not None:
        write_csv(table, picture.columns)
        return
    rows = [",".join((*map(_quoted, row[:2]), *(f"{v:.9g}" for v in row[2:]))) for row in _rows(picture.drawn)]
    write_text_atomic(table, "\n".join(["axes,series,x,y", *rows]) + "\n")


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

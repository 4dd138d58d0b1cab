"""Write a figure with its numbers as a table: every line, point and bar of all axes."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ...files.recordings.writing import write_csv, write_text_atomic

FIGURES = "figures"  # below the folder of a page: figures and their numbers, never beside recordings


def write_figure(folder: Path, name: str, drawn: Figure, columns: Mapping[str, np.ndarray] | None = None) -> None:
    """Write `figures/NAME.png` and the numbers of the figure as `figures/NAME.csv` into a folder.

    Args:
        folder: where `figures/` is made if it is missing.
        name: of the figure.
        drawn: the figure.
        columns: its numbers; None takes those of its axes (axes, series, x, y).

    Raises:
        BadInput: a file cannot be written.
    """
    home = folder / FIGURES
    write_picture(folder, name, drawn)
    if columns is not None:
        write_csv(home / f"{name}.csv", columns)
        return
    rows = [",".join((*map(_quoted, row[:2]), *(f"{v:.9g}" for v in row[2:]))) for row in _rows(drawn)]
    write_text_atomic(home / f"{name}.csv", "\n".join(["axes,series,x,y", *rows]) + "\n")


def write_picture(folder: Path, name: str, drawn: Figure) -> None:
    """Write a figure as `figures/NAME.png` into a folder."""
    file = folder / FIGURES / f"{name}.png"
    file.parent.mkdir(parents=True, exist_ok=True)
    drawn.savefig(file, dpi=150)


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

"""Draw signals over time, alone or beside a measurement with errors below; write pages with their figures.

The numbers of a figure are a table: every line, point and bar of all axes.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ...common.numbers import shown_unit
from ...common.page import Page, Section
from ...common.picture import Picture, figure_of, finish, new_axes, thin
from ...common.units import base_unit, from_base
from ...files.recordings.writing import write_csv, write_text_atomic

MEASURED, PREDICTED, ERROR, DRIVE = "#a6a6a6", "#0072b2", "#d55e00", "#009e73"  # grey; Okabe and Ito's palette
CYCLE = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")
FIGURES = "figures"  # below the folder of a page: figures and their numbers, never beside recordings
TIME = "time from the start (s)"
DRAWN = 12  # recordings on a page; more are too long to read


def line(ax: Axes, across: np.ndarray, values: np.ndarray, **style) -> None:
    """Draw a signal over another one, both (T,), with fewer samples if it is long."""
    kept = thin(values)
    ax.plot(across[kept], values[kept], **style)


def some_periods(values: np.ndarray) -> slice:
    """Return the part of a signal to draw: all of it, or 12 periods of the middle if more than 25 make a solid block.

    Args:
        values: signal, shape (T,); nan where missing.

    Returns:
        samples: all of a signal with few periods, and of one whose periods differ (a chirp).
    """
    y = np.nan_to_num(values - np.nanmean(values)) if np.isfinite(values).any() else np.zeros(len(values))
    sides = np.where(np.abs(y) > 0.1 * np.ptp(y), np.sign(y), 0.0)
    places = np.flatnonzero(sides)
    turns = places[1:][np.diff(sides[places]) != 0]
    if len(turns) <= 50:  # 25 periods
        return slice(None)
    # periods of a sine are equal, those of a chirp are not
    short, long = np.quantile(np.diff(turns), (0.1, 0.9))
    if long > 2 * short:
        return slice(None)
    first = len(turns) // 2 - 12
    return slice(int(turns[first]), int(turns[first + 24]) + 1)


def volts(voltage, unit: str = "V") -> tuple[np.ndarray, str]:
    """Convert an input from its base unit to the shown one (kV from 2 kV on); return it and the axis label."""
    voltage = np.asarray(voltage, dtype=np.float64)
    if base_unit(unit) != "V":
        return from_base(voltage, unit), f"input ({shown_unit(unit)})"
    if np.nanmax(np.abs(voltage), initial=0.0) >= 2e3:
        return voltage / 1e3, "voltage (kV)"
    return voltage, "voltage (V)"


def beside(
    time, measured, runs: Sequence[tuple[str, np.ndarray, str]], unit: str, words: Sequence[str] = ("output", "error"),
    part=slice(None),
) -> Figure:  # fmt: skip
    """Draw runs over a measured signal, and below them their errors; return the figure.

    Args:
        time: sample times (s), shape (T,); the axis counts from the first.
        measured: name and values (base unit), shape (T,), of the signal drawn wide and grey.
        runs: name, values (base unit) (T,) and colour of each run.
        unit: in which they are shown.
        words: for the two axes.
        part: samples to draw.
    """
    axes, name = new_axes(2, 3.2, (2.2, 1.0)), measured[0]
    across, reference = np.asarray(time - time[0])[part], from_base(measured[1], unit)[part]
    line(axes[0], across, reference, color=MEASURED, lw=2.4, label=name)
    for label, values, color in runs:
        shown = from_base(values, unit)[part]
        line(axes[0], across, shown, color=color, lw=1.0, label=label)
        line(axes[1], across, shown - reference, color=color if len(runs) > 1 else ERROR, lw=0.8)
    finish(axes, TIME, [f"{word} ({shown_unit(unit)})" for word in words])
    return figure_of(axes)


def signals(time, panels: Sequence[tuple[str, np.ndarray, str]], heights=None, part=slice(None)) -> Figure:
    """Draw each signal on axes of its own over one time axis; return the figure.

    Args:
        time: sample times (s), shape (T,); the axis counts from the first.
        panels: label of the axes, values (T,) and colour of each signal.
        heights: of the axes relative to each other.
        part: samples to draw.
    """
    axes = new_axes(len(panels), 0.8 + 0.9 * len(panels), heights)
    for ax, (_, values, color) in zip(axes, panels, strict=True):
        line(ax, np.asarray(time - time[0])[part], values[part], color=color, lw=0.9)
    finish(axes, TIME, [label for label, *_ in panels])
    return figure_of(axes)


def write_page(file: Path, page: Page) -> None:
    """Write a page, and its figures into `figures/` beside it.

    Raises:
        BadInput: a file cannot be written.
    """
    for picture in _pictures([*page.first, *page.rest]):
        write_picture(file.parent, picture)  # before the page, which makes it small
    write_text_atomic(file, page.html())


def _pictures(part) -> Iterator[Picture]:
    if isinstance(part, Picture):
        yield part
    elif isinstance(part, Section):
        yield from _pictures(list(part.parts))
    elif isinstance(part, list):
        for inner in part:
            yield from _pictures(inner)


def write_picture(folder: Path, picture: Picture) -> None:
    """Write `figures/NAME.png` and the numbers of the figure as `figures/NAME.csv` into a folder.

    Args:
        folder: where `figures/` is made if it is missing.
        picture: the figure; without columns the numbers are those of its axes (axes, series, x, y).

    Raises:
        BadInput: a file cannot be written.
    """
    file, table = (folder / FIGURES / f"{picture.name}.{kind}" for kind in ("png", "csv"))
    file.parent.mkdir(parents=True, exist_ok=True)
    picture.drawn.savefig(file, dpi=150)
    if picture.columns is not None:
        write_csv(table, picture.columns)
        return
    write_text_atomic(table, "\n".join(["axes,series,x,y", *_rows(picture.drawn)]) + "\n")


def _rows(drawn: Figure) -> Iterator[str]:
    for k, ax in enumerate(drawn.axes):
        axes = _quoted(ax.get_ylabel() or f"axes {k + 1}")
        for n, line in enumerate(ax.lines):
            label = str(line.get_label())
            series = _quoted(f"line {n + 1}" if label.startswith("_") else label)
            for x, y in zip(*(np.asarray(v, float) for v in line.get_data()), strict=True):
                yield f"{axes},{series},{x:.9g},{y:.9g}"
        for patch in ax.patches:
            if isinstance(patch, Rectangle):
                x, y = patch.get_x() + patch.get_width() / 2, patch.get_y() + patch.get_height()
                yield f'{axes},"bar",{x:.9g},{y:.9g}'


def _quoted(text: str) -> str:
    return '"' + " ".join(text.replace('"', "'").split()) + '"'

"""Draw signals, bars and maps for the pages, and write a figure as inline SVG that follows light and dark mode.

A line of more than 4 `BINS` samples is drawn by the smallest and largest sample of each bin, in their order: more than
a printed figure resolves, without losing a peak; 200,000 samples are drawn quickly.
"""

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import ClassVar, cast

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from ...common.numbers import shown_unit
from ...common.page import tag
from ...common.units import base_unit, from_base

MEASURED, PREDICTED, ERROR, DRIVE = "#a6a6a6", "#0072b2", "#d55e00", "#009e73"  # grey; Okabe and Ito's palette
CYCLE = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")
TIME = "time from the start (s)"
BINS = 1200
_PERIODS, _DRAWN_PERIODS = 25, 12  # of a sine: more than the first make a solid block; the second is then drawn
_SMALL, _WIDTH = 8.0, 5.0  # points: ticks and legends, labels are one point larger; inches
_INCHES, _POINT, _SAMPLES = 3.55, 8.5, 1200  # on a page: width, smallest text, samples per line
_LETTERS = 34  # of a label in a legend: more are wider than a narrow figure
_COLORS = {"#000000": "--ink", "#e6e6e6": "--grid", "#a6a6a6": "--seen", "#0072b2": "--model"}


@dataclass(frozen=True)
class Picture:
    """A figure with its name, caption and numbers.

    Attributes:
        name: unique on the page; also of its files.
        drawn: the figure.
        caption: one sentence.
        columns: its numbers by name; None takes those of its axes.
    """

    name: str
    drawn: Figure
    caption: str
    columns: Mapping[str, np.ndarray] | None = None
    group: ClassVar[str] = "figures"

    def html(self) -> str:
        """Write the figure as inline SVG, narrow enough for a telephone, in the colours of the page."""
        shrink(self.drawn)
        with rc_context({"svg.hashsalt": self.name, "svg.fonttype": "none"}):  # the same result gives the same page
            text = io.StringIO()
            self.drawn.savefig(text, format="svg", transparent=True, metadata={"Date": None})
        svg = text.getvalue()
        svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
        svg = re.sub(r"<!--.*?-->|\s+xmlns(:\w+)?=\"[^\"]*\"", "", svg, flags=re.DOTALL).replace("xlink:href", "href")
        svg = re.sub(r' d="[^"]*"', lambda d: re.sub(r"(\d\.\d)\d+", r"\1", d[0]), svg)  # tenths of a point suffice
        svg = re.sub(r'(\bid="|url\(#|href="#)', lambda m: m[1] + escape(self.name.replace(" ", "_")) + "-", svg)
        for color, role in _COLORS.items():
            svg = svg.replace(color, f"var({role})")
        svg = re.sub(r"<svg ", lambda _: f'<svg role="img" aria-label="{escape(self.caption)}" ', svg, count=1)
        return f"<figure>{svg}{tag('figcaption', self.caption)}</figure>"


def shrink(drawn: Figure) -> None:
    """Shrink a figure to the width of a page's column, with readable text, whole legends and fewer samples a line."""
    wide, high = drawn.get_size_inches()
    drawn.set_size_inches(_INCHES, max(high * (_INCHES / wide) ** 0.7, 1.4))  # lower, labels would fill the plot
    for ax in drawn.axes if len(drawn.axes) > 1 else ():
        ax.set_ylabel(ax.get_ylabel().replace(" (", "\n("))  # labels of two panels would overlap otherwise
    for axis in (a for ax in drawn.axes for a in (ax.xaxis, ax.yaxis) if a.get_scale() == "log"):
        axis.set_major_formatter(lambda value, _: f"{value:g}")  # a small exponent is unreadable
        axis.set_minor_formatter(lambda value, _: "")
    for text in drawn.findobj(Text):
        cast(Text, text).set_fontsize(max(float(cast(Text, text).get_fontsize()), _POINT))
    for shown in drawn.findobj(Line2D):
        across, upward = (np.asarray(values) for values in cast(Line2D, shown).get_data())
        if len(across) > _SAMPLES:
            kept = thin(upward.astype(float), _SAMPLES // 4)
            cast(Line2D, shown).set_data(across[kept], upward[kept])
    fit_legends(drawn, _POINT)


def fit_legends(drawn: Figure, size: float = _SMALL) -> None:
    """Give every legend as many columns as the figure is wide enough for."""
    for ax in drawn.axes:
        handles, labels = ax.get_legend_handles_labels()
        if ax.get_legend() is None:
            continue
        labels = [text if len(text) <= _LETTERS else f"{text[: _LETTERS - 1]}…" for text in labels]
        for columns in range(min(len(labels), 4), 0, -1):
            legend = ax.legend(
                handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, frameon=False,
                fontsize=size, borderaxespad=0.1, handlelength=1.4, columnspacing=1.2,
            )  # fmt: skip
            legend.set_in_layout(False)  # a legend that is too wide would leave no room for the axes
            drawn.draw_without_rendering()
            legend.set_in_layout(True)
            if legend.get_window_extent().x1 <= drawn.bbox.x1:
                break


def thin(values: np.ndarray, bins: int = BINS) -> np.ndarray:
    """Return the indices of the samples to draw: all of a short signal, otherwise both ends and the extremes.

    Args:
        values: signal, shape (T,); nan where missing, which is ignored.
        bins: number of stretches whose smallest and largest samples are taken.
    """
    if len(values) <= 4 * bins:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), bins + 1).astype(int)
    least, most = np.where(np.isnan(values), np.inf, values), np.where(np.isnan(values), -np.inf, values)
    pairs = list(zip(edges[:-1], edges[1:], strict=True))
    low, high = [a + np.argmin(least[a:b]) for a, b in pairs], [a + np.argmax(most[a:b]) for a, b in pairs]
    return np.unique(np.concatenate([[0, len(values) - 1], low, high]))


def line(ax: Axes, across: np.ndarray, values: np.ndarray, **style) -> None:
    """Draw a signal over another one, both (T,), with fewer samples if it is long."""
    kept = thin(values)
    ax.plot(across[kept], values[kept], **style)


def some_periods(values: np.ndarray) -> slice:
    """Return the part of a signal to draw: all of it, or some periods of the middle if more would fill a solid block.

    Args:
        values: signal, shape (T,); nan where missing.

    Returns:
        samples: all of a signal with few periods, and of one whose periods differ (a chirp).
    """
    y = np.nan_to_num(values - np.nanmean(values)) if np.isfinite(values).any() else np.zeros(len(values))
    sides = np.where(np.abs(y) > 0.1 * np.ptp(y), np.sign(y), 0.0)
    places = np.flatnonzero(sides)
    turns = places[1:][np.diff(sides[places]) != 0]
    if len(turns) <= 2 * _PERIODS:
        return slice(None)
    short, long = np.quantile(np.diff(turns), (0.1, 0.9))
    if long > 2 * short:
        return slice(None)
    first = len(turns) // 2 - _DRAWN_PERIODS
    return slice(int(turns[first]), int(turns[first + 2 * _DRAWN_PERIODS]) + 1)


def over(values: np.ndarray) -> dict:
    """Return the style of a line drawn over another: dashed, or transparent if it fills a band."""
    turns = np.count_nonzero(np.diff(np.diff(values) > 0))
    if turns < 25:
        return {"ls": "--"}
    return {"alpha": 0.6} if turns > 200 else {}


def volts(voltage, unit: str = "V") -> tuple[np.ndarray, str]:
    """Convert an input from its base unit to the shown one (kV from 2 kV on); return it and the axis label."""
    voltage = np.asarray(voltage, dtype=np.float64)
    if base_unit(unit) != "V":
        return from_base(voltage, unit), f"input ({shown_unit(unit)})"
    if np.nanmax(np.abs(voltage), initial=0.0) >= 2e3:
        return voltage / 1e3, "voltage (kV)"
    return voltage, "voltage (V)"


def beside(time, measured, runs: Sequence[tuple[str, np.ndarray, str]], labels: Sequence[str], part=slice(None)):
    """Draw runs over a measured signal, and below them their errors; return the figure.

    Args:
        time: sample times (s), shape (T,); the axis counts from the first.
        measured: name and values, shape (T,), of the signal drawn wide and grey.
        runs: name, values (T,) and colour of each run.
        labels: of the two axes.
        part: samples to draw.
    """
    axes, name = own_axes(None, 2, (_WIDTH, 3.2), (2.2, 1.0)), measured[0]
    across, reference = np.asarray(time - time[0])[part], measured[1][part]
    line(axes[0], across, reference, color=MEASURED, lw=2.4, label=name)
    for label, values, color in runs:
        line(axes[0], across, values[part], color=color, lw=1.0, label=label, **over(values[part]))
        line(axes[1], across, values[part] - reference, color=color if len(runs) > 1 else ERROR, lw=0.8)
    finish(axes, TIME, labels)
    return figure_of(axes)


def signals(time, panels: Sequence[tuple[str, np.ndarray, str]], heights=None, part=slice(None)) -> Figure:
    """Draw each signal on axes of its own over one time axis; return the figure.

    Args:
        time: sample times (s), shape (T,); the axis counts from the first.
        panels: label of the axes, values (T,) and colour of each signal.
        heights: of the axes relative to each other.
        part: samples to draw.
    """
    axes = own_axes(None, len(panels), (_WIDTH, 0.8 + 0.9 * len(panels)), heights)
    for ax, (_, values, color) in zip(axes, panels, strict=True):
        line(ax, np.asarray(time - time[0])[part], values[part], color=color, lw=0.9)
    finish(axes, TIME, [label for label, *_ in panels])
    return figure_of(axes)


def figure_of(axes) -> Figure:
    """Return the figure of axes."""
    return cast(Figure, np.ravel(axes)[0].figure)


def own_axes(axes, rows: int, size: tuple[float, float], heights=None) -> np.ndarray:
    """Return the caller's axes as an array (rows,), or those of a new figure of `size` inches with one time axis."""
    if axes is None:
        figure = Figure(figsize=size, layout="constrained")
        ratios = {"height_ratios": heights} if heights else {}
        axes = figure.subplots(rows, 1, sharex=True, squeeze=False, gridspec_kw=ratios)[:, 0]
        figure.align_ylabels(axes)
    axes = np.atleast_1d(np.asarray(axes, dtype=object)).ravel()
    if len(axes) != rows:
        raise ValueError(f"this figure needs {rows} axes, not {len(axes)}")
    return axes


def finish(axes: np.ndarray, across: str, upward: Sequence[str]) -> None:
    """Add labels, ticks, a light grid, and a legend above the first axes.

    Stacked axes share `across`: only the lowest shows its numbers.
    """
    for ax, label in zip(axes, upward, strict=True):
        ax.set_ylabel(label, fontsize=_SMALL + 1)
        ax.tick_params(labelsize=_SMALL)
        ax.grid(visible=True, color="0.9", lw=0.6)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelbottom=ax is axes[-1])
    axes[-1].set_xlabel(across, fontsize=_SMALL + 1)
    if axes[0].get_legend_handles_labels()[1]:
        axes[0].legend()
        fit_legends(axes[0].figure)

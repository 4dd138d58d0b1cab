"""Write a figure as inline SVG that follows light and dark mode, with axes of one look and legends that fit.

A line of more than 4 `BINS` samples is drawn by the smallest and largest sample of each bin, in their order: more than
a printed figure resolves, without losing a peak; 200,000 samples are drawn quickly.
"""

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import ClassVar, cast

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from .page import tag

BINS = 1200  # of a line, each with its two extremes
_SMALL = 8.0  # points: ticks and legends; labels are one point larger


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
        for color, role in (("000000", "ink"), ("e6e6e6", "grid"), ("a6a6a6", "seen"), ("0072b2", "model")):
            svg = svg.replace(f"#{color}", f"var(--{role})")
        svg = re.sub(r"<svg ", lambda _: f'<svg role="img" aria-label="{escape(self.caption)}" ', svg, count=1)
        return f"<figure>{svg}{tag('figcaption', self.caption)}</figure>"


def shrink(drawn: Figure) -> None:
    """Shrink a figure to the width of a page's column, with readable text, whole legends and fewer samples a line."""
    wide, high = drawn.get_size_inches()
    width, size, samples = 3.55, 8.5, 1200  # inches, points of the smallest text, samples of a line
    drawn.set_size_inches(width, max(high * (width / wide) ** 0.7, 1.4))  # lower, labels would fill the plot
    for ax in drawn.axes:
        ax.set_ylabel(ax.get_ylabel().replace(" (", "\n("))  # a label is longer than a low panel is high
    for axis in (a for ax in drawn.axes for a in (ax.xaxis, ax.yaxis) if a.get_scale() == "log"):
        axis.set_major_formatter(lambda value, _: f"{value:g}")  # a small exponent is unreadable
        axis.set_minor_formatter(lambda value, _: "")
    for text in drawn.findobj(Text):
        cast(Text, text).set_fontsize(max(float(cast(Text, text).get_fontsize()), size))
    for shown in drawn.findobj(Line2D):
        across, upward = (np.asarray(values) for values in cast(Line2D, shown).get_data())
        if len(across) > samples:
            kept = thin(upward.astype(float), samples // 4)
            cast(Line2D, shown).set_data(across[kept], upward[kept])
    fit_legends(drawn, size)


def fit_legends(drawn: Figure, size: float = _SMALL) -> None:
    """Give every legend as many columns as the figure is wide enough for."""
    for ax in drawn.axes:
        handles, labels = ax.get_legend_handles_labels()
        if ax.get_legend() is None:
            continue
        # more than 34 letters are wider than a narrow figure
        labels = [text if len(text) <= 34 else f"{text[:33]}…" for text in labels]
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
    pairs = list(pairwise(edges))
    low, high = [a + np.argmin(least[a:b]) for a, b in pairs], [a + np.argmax(most[a:b]) for a, b in pairs]
    return np.unique(np.concatenate([[0, len(values) - 1], low, high]))


def figure_of(axes) -> Figure:
    """Return the figure of axes."""
    return cast(Figure, np.ravel(axes)[0].figure)


def new_axes(rows: int, height: float, heights: Sequence[float] | None = None) -> np.ndarray:
    """Return axes (rows,) over one another in a new figure of `height` inches; `heights` are relative to each other."""
    drawn = Figure(figsize=(5.0, height), layout="constrained")
    axes = drawn.subplots(rows, 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    drawn.align_ylabels(axes)
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

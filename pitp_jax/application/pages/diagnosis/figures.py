"""Draw the figures of a diagnosis on axes that the caller may supply.

`Diagnosis.as_json` and the report's tables hold every number of the figures. Units are those of the user's files; no
pyplot, no global style; colours from Okabe and Ito (`application.pages.lines`).
"""

import os
from collections.abc import Callable
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ....common.numbers import figure as digits
from ....common.numbers import percent, shown_unit
from ....method.diagnose.diagnosis import Diagnosis
from ....method.model.units import units_of
from ..lines import DRIVE, ERROR, MEASURED, PREDICTED, finish, line, own_axes, volts
from .formatting import drive_unit
from .gap_figure import gap, output_unit

TIED = "#e69f00"
_HEAT = LinearSegmentedColormap.from_list("gap", ["#f3f6f9", "#e69f00", "#c03a00"])
_SMALL = 8.0
_ROWS, _LABEL = 12, 18  # effects in the ranking figure; letters of a record under its bar
_AXES = {
    "records": "record",
    "frequency": "frequency of the error (Hz)",
    "time": "part of a recording (%)",
    "displacement": "{output} ({unit})",
    "velocity": "{velocity} ({rate})",
    "voltage": "{input} ({command})",
}


def where_map(diagnosis: Diagnosis, ax: Axes | None = None) -> Axes:
    """Draw the fraction of the missing force by input frequency and amplitude; flagged cells are outlined.

    Args:
        diagnosis: the diagnosis.
        ax: where to draw; None makes a figure.

    Returns:
        The axes: one square per visited cell, with its fraction in it from 1 % on.
    """
    drawn: Axes = own_axes(ax, 1, (5.0, 3.2))[0]
    cells = diagnosis.where["cells"]
    scale, unit = output_unit(diagnosis)
    bands = sorted({tuple(c["band_hz"]) for c in cells})
    sizes = sorted({tuple(c["amplitude"]) for c in cells})
    loudest = max([c["share"] for c in cells], default=0.0) or 1.0
    for cell in cells:
        i, j = bands.index(tuple(cell["band_hz"])), sizes.index(tuple(cell["amplitude"]))
        drawn.add_patch(Rectangle((i, j), 1, 1, color=_HEAT(cell["share"] / loudest), lw=0))
        if cell["flagged"]:
            drawn.add_patch(Rectangle((i + 0.05, j + 0.06), 0.9, 0.88, fill=False, edgecolor="#1a1a1a", lw=1.4))
        if cell["share"] >= 0.01:
            drawn.text(
                i + 0.5, j + 0.5, percent(cell["share"]), ha="center", va="center", fontsize=7.5, color="#1a1a1a"
            )
    drawn.set(xlim=(0, max(len(bands), 1)), ylim=(0, max(len(sizes), 1)))
    finish(np.array([drawn]), "drive frequency (Hz)", [f"amplitude ({unit})"])
    drawn.grid(visible=False)
    _edges(drawn.set_xticks, bands, 1.0)
    _edges(drawn.set_yticks, sizes, scale)
    return drawn


def _edges(set_ticks, pairs, scale: float) -> None:
    """Label the edges of cells on an axis; where cells are missing in between, a label shows both edges."""
    if pairs:
        inner = [
            digits(scale * b[0], 2) if a[1] == b[0] else f"{digits(scale * a[1], 2)}|{digits(scale * b[0], 2)}"
            for a, b in zip(pairs[:-1], pairs[1:], strict=True)
        ]
        set_ticks(range(len(pairs) + 1), [digits(scale * pairs[0][0], 2), *inner, digits(scale * pairs[-1][1], 2)])


def ranking(diagnosis: Diagnosis, ax: Axes | None = None) -> Axes:
    """Draw the fraction of the held-out gap that each effect closes, with its 95 % interval.

    Args:
        diagnosis: the diagnosis.
        ax: where to draw; None makes a figure.

    Returns:
        The axes: one bar per effect, best first; reported effects blue, tied ones orange.
    """
    rows = _bars(diagnosis)
    drawn: Axes = own_axes(ax, 1, (5.0, 0.7 + 0.24 * max(len(rows), 2)))[0]
    for k, (name, share, ci, color) in enumerate(rows):
        drawn.barh(k, np.clip(share, 0, 1), color=color, height=0.68)
        if ci is not None:
            low, high = np.clip(ci, 0, 1)
            drawn.plot([low, high], [k, k], color="#000000", lw=1.0, marker="|", ms=5)
        tied = " (tied)" if name in diagnosis.equivalent else ""
        drawn.text(1.03, k, ("none" if share < 0.005 else percent(share)) + tied, va="center", fontsize=_SMALL)
    if not rows:
        drawn.text(0.5, 0.5, "no gap to close", ha="center", va="center", fontsize=_SMALL + 1)
    finish(np.array([drawn]), "fraction of the held-out gap closed", [""])
    drawn.set_yticks(range(len(rows)), [row[0] for row in rows])
    drawn.set_xticks([0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
    drawn.set(xlim=(0, 1.02), ylim=(max(len(rows), 1) - 0.4, -0.6))
    drawn.grid(visible=False, axis="y")
    return drawn


def _bars(diagnosis: Diagnosis) -> list[tuple]:
    """Return (label, fraction, interval, colour) of each bar; all reported effects together come first."""
    rows, g = [], diagnosis.gap
    if len(diagnosis.effects) > 1 and g.closed_fraction is not None:
        rows.append(("all named", g.closed_fraction, g.ci95, PREDICTED))
    best = {r.effect: r for r in reversed(diagnosis.ranking)}  # of two forms that share a name the better one
    for r in diagnosis.ranking:
        if r is not best[r.effect] or r.closed_fraction is None or not np.isfinite(r.closed_fraction):
            continue
        color = TIED if r.effect in diagnosis.equivalent else MEASURED
        color = PREDICTED if r.effect in diagnosis.effects else color
        rows.append((r.effect, r.closed_fraction, r.ci95, color))
    return rows[:_ROWS]


def shares(diagnosis: Diagnosis, axes=None, names=("records", "frequency", "time")) -> np.ndarray:
    """Draw the fractions of the error or of the missing force along some axes, as bars.

    Args:
        diagnosis: the diagnosis.
        axes: as many axes as names; None makes a figure.
        names: of "records", "frequency", "time" (fractions of the error), "displacement", "velocity" and "voltage"
            (fractions of the missing force).

    Returns:
        The axes, shape (len(names),).
    """
    if axes is None:
        axes = Figure(figsize=(5.0, 0.3 + 1.45 * len(names)), layout="constrained").subplots(
            len(names), 1, squeeze=False
        )
    axes = own_axes(axes, len(names), (5.0, 4.0))
    scale, unit = output_unit(diagnosis)
    units = units_of(diagnosis.model)
    factor, command = drive_unit(units.input.unit)
    words = {"output": units.output_word, "velocity": units.velocity_word, "input": units.input_word}
    words |= {"unit": unit, "rate": shown_unit(units.output.rate), "command": command}
    held = set(diagnosis.heldout)
    for ax, name in zip(axes, names, strict=True):
        table = diagnosis.where[name]
        if name == "records":
            labels, values = list(table), list(table.values())
            colors = [ERROR if label in held else TIED for label in labels]
        else:
            labels = _bin_edges(name, table, factor if name == "voltage" else scale)
            values = [row["share"] for row in table]
            colors = DRIVE if name in ("displacement", "velocity", "voltage") else ERROR
        ax.bar(range(len(values)), [100 * v for v in values], color=colors, width=0.75)
        finish(np.array([ax]), _AXES[name].format(**words), ["share (%)"])
        crowded = sum(map(len, labels)) > 60
        tilted = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"} if crowded else {}
        alike = len(os.path.commonprefix(labels)) if len(labels) > 1 else 0  # drop a common prefix, such as a date
        short = [label if len(label) <= _LABEL else f"…{label[alike:]}"[:_LABEL] for label in labels]
        size = 6.5 if crowded else 7.5
        between = 0.0 if name == "records" else 0.5  # a bin has its edges written, a record its name
        ax.set_xticks(
            np.arange(len(labels)) - between, short, fontsize=size, parse_math=False, **tilted
        )  # a name may contain a $
        ax.grid(visible=False, axis="x")
    return axes


def _bin_edges(name: str, table: list[dict], scale: float) -> list[str]:
    """Return the labels of the bin edges, one more than there are bins."""
    key, factor = {
        "frequency": ("band_hz", 1.0), "time": ("part", 100.0)
    }.get(name, ("range", scale))  # fmt: skip
    edges = factor * np.array([*(row[key][0] for row in table), table[-1][key][1]] if table else [])
    step = float(np.ptp(edges)) / max(len(edges) - 1, 1)
    # rounding residues of 0 are 0; every second label if they would touch
    texts = [digits(0.0 if abs(edge) < 0.02 * step else edge, 2) for edge in edges]
    return [text if k % 2 == 0 or sum(map(len, texts)) < 26 else "" for k, text in enumerate(texts)]


def excitation(diagnosis: Diagnosis, ax: Axes | None = None) -> Axes:
    """Draw the voltage (V or kV) of the proposed next experiment over time (s).

    Args:
        diagnosis: one that has a next experiment.
        ax: where to draw; None makes a figure.
    """
    if diagnosis.next_experiment is None:
        raise ValueError("this diagnosis proposes no further experiment")
    drawn: Axes = own_axes(ax, 1, (5.0, 1.9))[0]
    voltage, label = volts(diagnosis.next_experiment.voltage, diagnosis.model.origin.voltage_unit)
    line(drawn, diagnosis.next_experiment.time, voltage, color=DRIVE, lw=0.9)
    finish(np.array([drawn]), "time (s)", [label])
    return drawn


def figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """Draw all figures for which the diagnosis has data; return them by file name.

    A figure that cannot be drawn shows the reason instead, and does not affect the others.
    """
    wanted: dict[str, Callable[[], Axes]] = {"gap": lambda: gap(diagnosis)[0]}
    if diagnosis.verdict != "no_gap":
        wanted["where"] = lambda: where_map(diagnosis)
        wanted["shares"] = lambda: shares(diagnosis)[0]
        wanted["force"] = lambda: shares(diagnosis, names=("displacement", "velocity", "voltage"))[0]
        wanted["ranking"] = lambda: ranking(diagnosis)
    if diagnosis.next_experiment is not None:
        wanted["next_experiment"] = lambda: excitation(diagnosis)
    return {name: _drawn(draw) for name, draw in wanted.items()}


def _drawn(draw: Callable[[], Axes]) -> Figure:
    """Draw a figure that can be saved; if drawing fails, return a figure that shows the reason."""
    try:
        figure = cast(Figure, draw().figure)
        figure.draw_without_rendering()  # layout and text fail only here
        return figure
    except Exception as error:
        figure, reason = Figure(figsize=(5.0, 1.0)), " ".join(str(error).split())[:80]
        message = f"not drawn: {type(error).__name__}: {reason}".encode("ascii", "replace").decode()
        figure.text(0.02, 0.5, message, fontsize=_SMALL, parse_math=False)
        return figure


FIGURES = ("gap", "where", "shares", "force", "ranking", "next_experiment")

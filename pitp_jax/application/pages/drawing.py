"""Draw signals over time: some alone, some beside a measurement with their errors below."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...common.numbers import shown_unit
from ...common.picture import figure_of, finish, new_axes, thin
from ...common.units import base_unit, from_base

MEASURED, PREDICTED, ERROR, DRIVE = "#a6a6a6", "#0072b2", "#d55e00", "#009e73"  # grey; Okabe and Ito's palette
CYCLE = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")
TIME = "time from the start (s)"
_PERIODS, _DRAWN_PERIODS = 25, 12  # of a sine: more than the first make a solid block; the second is then drawn


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
    axes, name = new_axes(2, 3.2, (2.2, 1.0)), measured[0]
    across, reference = np.asarray(time - time[0])[part], measured[1][part]
    line(axes[0], across, reference, color=MEASURED, lw=2.4, label=name)
    for label, values, color in runs:
        line(axes[0], across, values[part], color=color, lw=1.0, label=label)
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
    axes = new_axes(len(panels), 0.8 + 0.9 * len(panels), heights)
    for ax, (_, values, color) in zip(axes, panels, strict=True):
        line(ax, np.asarray(time - time[0])[part], values[part], color=color, lw=0.9)
    finish(axes, TIME, [label for label, *_ in panels])
    return figure_of(axes)

"""Draw lines and axes, and convert units, for `paper_figures` and the pages.

A line of more than 4 `BINS` samples is drawn by the smallest and largest sample of each bin, in their order: more than
a printed figure resolves, without losing a peak; 200,000 samples are drawn quickly.
"""

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...common.numbers import shown_unit
from ...common.units import base_unit, from_base

MEASURED, PREDICTED, ERROR, DRIVE = "#a6a6a6", "#0072b2", "#d55e00", "#009e73"  # grey; Okabe and Ito's palette
CYCLE = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")
BINS = 1200
_PERIODS, _DRAWN_PERIODS = 25, 12  # of a sine: more than the first make a solid block; the second is then drawn
_SMALL = 8.0  # points: ticks and legends; labels are one point larger
_UNITS = {"m": (1e3, "displacement (mm)"), "V": (1.0, "output (V)")}
_ERRORS = {"m": ("error (mm)", "error (µm)"), "V": ("error (V)", "error (mV)")}


def extremes(values: np.ndarray, bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of the smallest and largest sample in each of `bins` equal parts of a signal.

    Args:
        values: signal, shape (T,); nan where missing, which is ignored.
        bins: number of stretches, fewer where T is smaller.

    Returns:
        Indices of the smallest and of the largest samples, shape (bins,) each.
    """
    edges = _edges(values, bins)
    return _least_and_most(values, edges[:-1], edges[1:])


def envelope(values: np.ndarray, bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of the smallest and largest sample in parts of whole oscillations, to draw an envelope.

    A stretch runs from the trough before its bin to the trough behind it. A trough half as deep as one of its
    neighbours is a ripple within an oscillation.
    """
    edges = _edges(values, bins)
    troughs, peaks = scipy.signal.find_peaks(-values, prominence=0)
    depth = peaks["prominences"]
    troughs = troughs[depth >= 0.5 * scipy.ndimage.maximum_filter1d(depth, 5)] if len(troughs) else troughs
    troughs = np.concatenate([[0], troughs, [len(values)]])
    first = troughs[np.searchsorted(troughs, edges[:-1], side="right") - 1]
    return _least_and_most(values, first, troughs[np.searchsorted(troughs, edges[1:])])


def _edges(values: np.ndarray, bins: int) -> np.ndarray:
    return np.linspace(0, len(values), min(bins, len(values)) + 1).astype(int)


def _least_and_most(values: np.ndarray, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    least, most = np.where(np.isnan(values), np.inf, values), np.where(np.isnan(values), -np.inf, values)
    pairs = list(zip(first, last, strict=True))
    low = np.array([a + np.argmin(least[a:b]) for a, b in pairs])
    return low, np.array([a + np.argmax(most[a:b]) for a, b in pairs])


def thin(values: np.ndarray, bins: int = BINS) -> np.ndarray:
    """Return the indices of the samples to draw: all of a short signal, otherwise both ends and the extremes."""
    if len(values) <= 4 * bins:
        return np.arange(len(values))
    low, high = extremes(values, bins)
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


def shown(unit: str, *signals) -> list[np.ndarray]:
    """Convert signals to the unit shown; refuse an unknown unit and unequal lengths."""
    if unit not in _UNITS:
        raise ValueError(f"unknown output unit {unit!r}; use one of {', '.join(_UNITS)}")
    arrays = [np.asarray(s, dtype=np.float64) * _UNITS[unit][0] for s in signals]
    same_length(*arrays)
    return arrays


def output_label(unit: str) -> str:
    """Return the axis label of the output for its unit."""
    return _UNITS[unit][1]


def error_shown(unit: str, error: np.ndarray) -> tuple[np.ndarray, str]:
    """Return an error (mm or V) in µm or mV if it stays below 0.05, otherwise unchanged, and the axis label."""
    small = np.nanmax(np.abs(error), initial=0.0) < 0.05
    return error * (1e3 if small else 1.0), _ERRORS[unit][int(small)]


def same_length(*arrays: np.ndarray) -> None:
    """Refuse signals that do not all have shape (T,) and the same length."""
    if len({a.shape for a in arrays}) > 1 or arrays[0].ndim != 1:
        raise ValueError(f"signals must have shape (T,) and one length, not {[a.shape for a in arrays]}")


def volts(voltage, unit: str = "V") -> tuple[np.ndarray, str]:
    """Convert an input from its base unit to the shown one (kV from 2 kV on); return it and the axis label."""
    voltage = np.asarray(voltage, dtype=np.float64)
    if base_unit(unit) != "V":
        return from_base(voltage, unit), f"input ({shown_unit(unit)})"
    if np.nanmax(np.abs(voltage), initial=0.0) >= 2e3:
        return voltage / 1e3, "voltage (kV)"
    return voltage, "voltage (V)"


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


def finish(axes: np.ndarray, across: str, upward, legend_columns: int = 2) -> None:
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
    if labels := axes[0].get_legend_handles_labels()[1]:
        fitting = max(48 // (max(map(len, labels)) + 6), 1)  # a line of a narrow page has about 48 letters
        axes[0].legend(
            loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=min(legend_columns, fitting), frameon=False,
            fontsize=_SMALL, borderaxespad=0.1,
        )  # fmt: skip

"""Draw the paper's figures, on the caller's axes or new ones: data in m, V and s, shown in mm, V or kV, and s.

Every function returns the axes it drew on and makes its own `Figure` if none were given (save it with
`ax.figure.savefig`, or `axes[0].figure.savefig`). No pyplot, no global style; colours from Okabe and Ito.
"""

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pitp_jax.application.pages.drawing import (
    CYCLE,
    DRIVE,
    ERROR,
    MEASURED,
    PREDICTED,
    line,
    volts,
)
from pitp_jax.common.picture import BINS, finish, thin

_UNITS = {"m": (1e3, "displacement (mm)"), "V": (1.0, "output (V)")}
_ERRORS = {"m": ("error (mm)", "error (µm)"), "V": ("error (V)", "error (mV)")}
_TIME = "time (s)"


def sweep_response(time, measured, predicted, ax: Axes | None = None, *, sweep_hz=None, unit: str = "m") -> Axes:
    """Draw a measured sweep with the envelope of the identified model (the paper's Fig. 6).

    Args:
        time: sample times in s, shape (T,).
        measured: output in `unit`, shape (T,); nan where missing.
        predicted: output of the model, shape (T,).
        ax: where to draw; None makes a figure.
        sweep_hz: first and last frequency of a linear sweep in Hz; given them, the axis shows the frequency.
        unit: `m`, or `V` for an electronic output.

    Returns:
        The axes: the measured line, then the largest and the smallest prediction in each of 300 stretches.
    """
    measured, predicted = shown(unit, measured, predicted)
    across, name = np.asarray(time, dtype=np.float64), _TIME
    same_length(across, measured)
    if sweep_hz is not None:
        first, last = sweep_hz
        across = first + (last - first) * (across - across[0]) / (across[-1] - across[0])
        name = "drive frequency (Hz)"
    axes = own_axes(ax, 1, (5.0, 2.4))
    line(axes[0], across, measured, color=MEASURED, lw=0.6, label="measured")
    low, high = envelope(predicted, BINS // 4)
    axes[0].plot(across[high], predicted[high], color=PREDICTED, lw=1.1, label="model, envelope")
    axes[0].plot(across[low], predicted[low], color=PREDICTED, lw=1.1)
    finish(axes, name, [output_label(unit)])
    return axes[0]


def prediction(time, measured, predicted, axes=None, *, unit: str = "m") -> np.ndarray:
    """Draw measured and predicted output, and the error below them (the paper's Fig. 8).

    Args:
        time: sample times in s, shape (T,).
        measured: output in `unit`, shape (T,); nan where missing.
        predicted: output of the model, shape (T,).
        axes: two axes; None makes a figure.
        unit: `m`, or `V` for an electronic output.

    Returns:
        The two axes, shape (2,): the output, and predicted less measured.
    """
    measured, predicted = shown(unit, measured, predicted)
    time = np.asarray(time, dtype=np.float64)
    same_length(time, measured)
    axes = own_axes(axes, 2, (5.0, 3.2), (2.4, 1.0))
    error, error_label = error_shown(unit, predicted - measured)
    line(axes[0], time, measured, color=MEASURED, lw=2.4, label="measured")
    line(axes[0], time, predicted, color=PREDICTED, lw=1.0, label="predicted", **over(predicted))
    line(axes[1], time, error, color=ERROR, lw=0.8)
    finish(axes, _TIME, [output_label(unit), error_label])
    return axes


def hysteresis_loops(voltage, measured, predicted, ax: Axes | None = None, *, label: str = "", unit: str = "m") -> Axes:
    """Draw output over voltage (the paper's Fig. 10); each further call on the same axes adds a frequency.

    Args:
        voltage: input voltage in V, shape (T,); best of one settled period.
        measured: output in `unit`, shape (T,).
        predicted: output of the model, shape (T,).
        ax: where to draw; None makes a figure.
        label: names the pair of loops, for instance "4 Hz".
        unit: `m`, or `V` for an electronic output.

    Returns:
        The axes, with one solid (measured) and one dashed line (predicted) more.
    """
    measured, predicted = shown(unit, measured, predicted)
    voltage, symbol = volts(voltage)
    same_length(voltage, measured)
    axes = own_axes(ax, 1, (3.6, 3.2))
    drawn = len(axes[0].lines) // 2
    color, kept = CYCLE[drawn % len(CYCLE)], thin(measured)
    axes[0].plot(voltage[kept], measured[kept], color=color, alpha=0.6, lw=1.8, label=label or "measured")
    kept, once = thin(predicted), "_again" if drawn else "predicted"  # one entry explains all dashed lines
    axes[0].plot(voltage[kept], predicted[kept], color=color, lw=1.0, ls="--", label=once)
    finish(axes, symbol, [output_label(unit)])
    return axes[0]


def tokens(time, tokens, names, axes=None) -> np.ndarray:
    """Draw a model's tokens (coefficients along the motion) over time (the paper's Fig. 7), each on its own axes.

    Args:
        time: sample times in s, shape (T,).
        tokens: tokens at each sample, shape (T, k), in any unit.
        names: labels of the k tokens, with units.
        axes: k axes; None makes a figure.

    Returns:
        The axes, shape (k,).
    """
    time, tokens = np.asarray(time, dtype=np.float64), np.asarray(tokens, dtype=np.float64)
    if tokens.shape != (len(time), len(names)):
        raise ValueError(f"tokens must be (T, k) = {(len(time), len(names))}, got {tokens.shape}")
    axes = own_axes(axes, len(names), (5.0, 0.6 + 1.1 * len(names)))
    for ax, values in zip(axes, tokens.T, strict=True):
        line(ax, time, values, color=PREDICTED, lw=1.0)
    finish(axes, _TIME, names)
    return axes


def tracking(time, target, achieved, voltage, axes=None, *, unit: str = "m") -> np.ndarray:
    """Draw how a wanted motion was tracked: motion, error, and voltage (the paper's Fig. 13).

    Args:
        time: sample times in s, shape (T,).
        target: wanted output in `unit`, shape (T,).
        achieved: measured output, shape (T,); nan where missing.
        voltage: the applied voltage in V, shape (T,).
        axes: three axes; None makes a figure.
        unit: `m`, or `V` for an electronic output.

    Returns:
        The three axes, shape (3,): the output, achieved less target, and the voltage.
    """
    target, achieved = shown(unit, target, achieved)
    time = np.asarray(time, dtype=np.float64)
    voltage, symbol = volts(voltage)
    same_length(time, target, voltage)
    axes = own_axes(axes, 3, (5.0, 4.2), (2.0, 1.0, 1.2))
    error, error_label = error_shown(unit, achieved - target)
    line(axes[0], time, target, color=MEASURED, lw=2.4, label="target")
    line(axes[0], time, achieved, color=PREDICTED, lw=1.0, label="achieved", **over(achieved))
    line(axes[1], time, error, color=ERROR, lw=0.8)
    line(axes[2], time, voltage, color=DRIVE, lw=1.0)
    finish(axes, _TIME, [output_label(unit), error_label, symbol])
    return axes


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


def over(values: np.ndarray) -> dict:
    """Return the style of a line drawn over another: dashed, or transparent if it fills a band."""
    turns = np.count_nonzero(np.diff(np.diff(values) > 0))
    if turns < 25:
        return {"ls": "--"}
    return {"alpha": 0.6} if turns > 200 else {}

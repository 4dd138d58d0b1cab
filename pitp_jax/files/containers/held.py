"""Hold an input constant between the rows in which it is written.

    u_k = 1 / (t_{k+1} - t_k) int_{t_k}^{t_{k+1}} u(s) ds        u(s): the value written last at or before s

A log has a row per message of any topic, or writes a value when it changes. The rows of the output remain. The mean
over a step represents the input wherever in the step it changed.
"""

import numpy as np


def mean_of_held(time: np.ndarray, values: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the mean of a held signal over each interval.

    Args:
        time: time of each value in s, increasing, shape (T,).
        values: shape (T,).
        ends: ends of the intervals in s, increasing, shape (K + 1,).

    Returns:
        shape (K,).
    """
    integral = np.append(0.0, np.cumsum(values[:-1] * np.diff(time)))
    # beyond the ends, the first and the last value are held
    at = np.interp(ends, time, integral) + values[-1] * np.maximum(ends - time[-1], 0.0)
    at -= values[0] * np.maximum(time[0] - ends, 0.0)
    return np.diff(at) / np.diff(ends)


def hold_sparse(loaded: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], np.ndarray | None, float]:
    """Return the rows in which the output is written, with a sparsely written input held constant between its values.

    Args:
        loaded: by quantity, nan where a cell is empty.

    Returns:
        the columns; their rows, or None if the input is not sparse; and the fraction of rows with an input.
    """
    time, voltage = loaded["time"], loaded["voltage"]
    output = loaded.get("displacement", np.zeros_like(voltage))
    if not len(time) == len(voltage) == len(output) or (written := np.isfinite(voltage) & np.isfinite(time)).all():
        return loaded, None, 1.0
    seen = np.isfinite(output) & np.isfinite(time)
    alone = min((written & ~seen).mean(), (seen & ~written).mean())
    missing = (seen & ~written).sum() / max(seen.sum(), 1)
    # most outputs have no input beside them, or many rows have only an input and many only an output
    if written.sum() < 2 or not (missing > 0.5 or alone >= 0.1) or np.isinf(voltage).any():
        return loaded, None, 1.0
    # the input is unknown before it is first written
    rows = np.flatnonzero(seen & np.logical_or.accumulate(written))
    held = loaded | {q: values[rows] for q, values in loaded.items()}
    if len(rows) > 1:
        held["voltage"] = _held(time[written], voltage[written], time[rows])
    return held, rows, float(written.mean())


def _held(written: np.ndarray, values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return the held input of every output row: its mean until the next row if both clocks increase."""
    if (np.diff(time) > 0).all() and (np.diff(written) > 0).all():
        ends = np.append(time, 2 * time[-1] - time[-2])
        return mean_of_held(written, values, ends)
    return values[np.maximum(np.searchsorted(written, time, side="right") - 1, 0)]

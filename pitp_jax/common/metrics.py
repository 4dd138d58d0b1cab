"""Measures of the error between a prediction and a measurement, each with its normaliser.

    rmse         = sqrt(mean (x_p - x_e)^2)
    e_rms  / %   = 100 rmse / (max x_e - min x_e)                                             (paper, eq. 15)
    nrmse  / %   = 100 rmse / std x_e
    e_rmhe / %   = 100 max over x_e of (max x_r(x_e) - min x_r(x_e)) / (max x_r - min x_r)    (paper, eq. 16)

Samples whose measurement is missing (nan) never count. A prediction that is not finite where the measurement
counts has diverged: its error is infinite, not left out.
"""

import numpy as np

from .errors import refuse_traced


def _counted(predicted, measured, mask, part: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    """Return the counted samples of a part of both series."""
    refuse_traced("an error of pitp", "its equation in jax.numpy", predicted, measured, mask)
    predicted, measured = (np.asarray(values, dtype=np.float64) for values in (predicted, measured))
    counted = np.isfinite(measured)
    if mask is not None:
        counted &= np.asarray(mask, dtype=bool)
    return predicted[part][counted[part]], measured[part][counted[part]]


def rms(values: np.typing.ArrayLike) -> float:
    """Compute the root-mean-square of values, in their unit; any shape."""
    return float(np.sqrt(np.mean(np.square(values))))


def rmse(predicted: np.ndarray, measured: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Compute the root-mean-square error of a prediction, in the unit of the data.

    Args:
        predicted: x_p, shape (T,).
        measured: x_e, shape (T,); nan where missing.
        mask: True where a sample counts, shape (T,); None for all.

    Returns:
        the error; inf if a counted prediction is not finite, nan if no sample counts.

    Raises:
        IndexError: shapes that differ.

    Examples:
        >>> pitp.rmse(np.array([1.0, 2.0]), np.array([1.0, 4.0]))
        1.4142135623730951
    """
    predicted, measured = _counted(predicted, measured, mask)
    if predicted.size == 0:
        return float("nan")
    if not np.all(np.isfinite(predicted)):
        return float("inf")
    error = predicted - measured
    scale = float(np.abs(error).max())  # avoids an overflow of the squares of a nearly diverged prediction
    return scale * rms(error / scale) if scale > 0 else 0.0


def e_rms_percent(predicted: np.ndarray, measured: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Compute the RMS error of a prediction in percent of the measured range (eq. 15).

    Normaliser: max x_e - min x_e over the counted samples. nan where that is zero. Arguments as for `rmse`.

    Args:
        predicted, measured, mask: as for `rmse`.

    Returns:
        the percentage.

    Raises:
        IndexError: shapes that differ.

    Examples:
        >>> pitp.e_rms_percent(np.array([1.0, 2.0]), np.array([0.0, 2.0]))  # 100 sqrt(1/2) / 2
        35.35533905932738
    """
    _, values = _counted(predicted, measured, mask)
    return _percent(rmse(predicted, measured, mask), float(np.ptp(values)) if values.size else 0.0)


def nrmse_percent(predicted: np.ndarray, measured: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Compute the RMS error of a prediction in percent of the measurement's standard deviation.

    Normaliser: population standard deviation (ddof = 0) of x_e over the counted samples, so predicting the
    mean scores 100. nan where that is zero. Arguments as for `rmse`.

    Args:
        predicted, measured, mask: as for `rmse`.

    Returns:
        the percentage; 100 is as good as predicting the mean.

    Raises:
        IndexError: shapes that differ.

    Examples:
        >>> pitp.nrmse_percent(np.zeros(4), np.array([1.0, -1.0, 1.0, -1.0]))
        100.0
    """
    _, values = _counted(predicted, measured, mask)
    # the deviation of equal numbers may be a rounding error instead of 0, which must not become the divisor
    return _percent(rmse(predicted, measured, mask), float(values.std()) if np.unique(values).size > 1 else 0.0)


def rmhe_percent(
    reference: np.ndarray,
    measured: np.ndarray,
    samples_per_cycle: int | None = None,
    mask: np.ndarray | None = None,
    levels: int = 512,
) -> float:
    """Compute the maximum hysteresis error in percent (eq. 16): the largest width of the loop in one cycle.

    The loop is the closed polygon of the points (x_e, x_r); at a level of x_e its width is the spread of x_r
    there, as eq. 16 has it. Normaliser: max x_r - min x_r over the cycle. For sines of lag phi it is 100 |sin
    phi|. Noise counts as width.

    Args:
        reference: x_r, shape (T,).
        measured: x_e, shape (T,); nan where missing.
        samples_per_cycle: the last whole cycle is taken; None where the arrays are one cycle already.
        mask: True where a sample counts, shape (T,).
        levels: number of levels of x_e between its extremes at which the width is taken.

    Returns:
        the percentage; nan where fewer than three samples count, the reference stands still or the
        measurement does.

    Raises:
        IndexError: shapes that differ.

    Examples:
        >>> phase = np.linspace(0, 2 * np.pi, 1000)
        >>> round(pitp.rmhe_percent(np.sin(phase), np.sin(phase - 0.1)), 1)  # 100 sin 0.1
        10.0
    """
    cycle = slice(None if samples_per_cycle is None else -int(samples_per_cycle), None)
    up, across = _counted(reference, measured, mask, cycle)
    if len(up) < 3 or np.ptp(up) == 0 or np.ptp(across) == 0:
        return float("nan")
    # edges of the polygon; the last one closes it
    start, end = across, np.roll(across, -1)
    bottom, top = up, np.roll(up, -1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    slope = (top - bottom) / np.where(end == start, 1.0, end - start)
    widest = 0.0
    # between the extremes: at these the loop turns, and has no width
    for level in np.linspace(across.min(), across.max(), levels + 2)[1:-1]:
        # edges that cross this level; a vertical one crosses it at no single place
        crossed = (low <= level) & (level <= high) & (start != end)
        at = bottom[crossed] + slope[crossed] * (level - start[crossed])
        widest = max(widest, float(np.ptp(at)) if at.size else 0.0)
    return _percent(widest, float(np.ptp(up)))


def _percent(error: float, normaliser: float) -> float:
    return 100.0 * error / normaliser if normaliser > 0 else float("nan")

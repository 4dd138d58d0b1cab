"""How a record begins: sensor noise, and whether the actuator is at rest at the first sample.

sigma ~ 1.4826 median |D^5 y| / sqrt(252)          (white noise, oversampled signal)
y(t) ~ c_0 + ... + c_4 t^4 over the first samples; rest when y(0) = offset and y'(0) = 0 within noise
"""

from collections.abc import Sequence

import numpy as np

from ._record.record import Record

INITIAL_SAMPLES = 50


def noise_std(displacement: np.ndarray) -> float:
    """Standard deviation of white sensor noise by the 5th difference (EFFECTS.md, step 0), output unit.

    An upper bound where the signal is not oversampled (then the 5th difference sees the motion too).
    """
    fifth = np.diff(displacement, 5)
    fifth = fifth[np.isfinite(fifth)]
    if len(fifth) == 0:
        return 0.0
    return float(min(1.4826 * np.median(np.abs(fifth)), fifth.std()) / np.sqrt(252.0))


def first_states(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Quartic least squares over the first 7, 12, 24 and 48 samples: (y(0), y'(0)) and their standard errors.

    A roll sampled at 5 kHz has turned by 2 rad in 12 samples, a cone at 1 kHz needs 24 to beat the noise, so every
    window over which the quartic leaves no more than the noise (or 0.1 % of range) gives its own estimate.

    Returns:
        values, standard errors: shape (windows, 2), at least one row; nan and inf where no window has the samples.
    """
    span = np.nanmax(record.displacement) - np.nanmin(record.displacement)
    noise = min(noise_std(record.displacement), 0.01 * span)
    values, errors = [], []
    for window in (7, 12, 24, 48):
        t, y = np.arange(window) / window, record.displacement[:window]
        keep = np.isfinite(y)
        if keep.sum() < 6:
            continue
        basis = np.vander(t[keep], 5, increasing=True)
        fit, *_ = np.linalg.lstsq(basis, y[keep], rcond=None)
        left = np.sqrt(np.sum((y[keep] - basis @ fit) ** 2) / max(keep.sum() - 5, 1))
        if left > max(1.15 * noise, 0.001 * span) and values:
            break
        unit = np.array([1.0, 1.0 / (window * record.dt)])
        values.append(fit[:2] * unit)
        errors.append(max(noise, left) * np.sqrt(np.diag(np.linalg.inv(basis.T @ basis)))[:2] * unit)
    return (np.array(values), np.array(errors)) if values else (np.full((1, 2), np.nan), np.full((1, 2), np.inf))


def _still(record: Record) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Per window: no velocity within 4 standard errors and 0.2 % of range a sample; value; its tolerance."""
    values, errors = first_states(record)
    span = np.nanmax(record.displacement) - np.nanmin(record.displacement)
    still = np.abs(values[:, 1]) <= 4 * errors[:, 1] + 0.002 * span / record.dt
    return still, values[:, 0], np.minimum(4 * errors[:, 0], 0.015 * span) + 0.002 * span


def starts_at_rest(record: Record, offset: float) -> bool:
    """True when some window finds the first displacement at `offset` (output unit) and the first velocity zero."""
    still, value, tolerance = _still(record)
    return bool((still & (np.abs(value - offset) <= tolerance)).any())


def initial_rest(records: Sequence[Record]) -> tuple[np.ndarray, float]:
    """Which records start at rest, and the sensor's offset: the value most still starts share.

    Among the records at rest the offset is averaged over their longest quiet beginnings (`_rest_level`). If no
    record is still it is the median first value: a start for the fit, not a measurement.

    Returns:
        rest: bool (records,); offset: output unit.
    """
    found = [_still(r) for r in records]
    value = np.array([v[s][-1] if s.any() else np.nan for s, v, _ in found])
    tolerance = np.array([t[s][-1] if s.any() else np.nan for s, _, t in found])
    if np.isnan(value).all():
        return np.zeros(len(records), bool), float(np.nanmedian([v[-1] for _, v, _ in found]))
    votes = [np.nansum(np.abs(value - c) <= tolerance) for c in value]
    near = np.flatnonzero(np.abs(value - value[int(np.argmax(votes))]) <= tolerance)
    levels, errors = zip(*[_rest_level(records[int(k)]) for k in near], strict=True)
    offset = float(np.average(levels, weights=1 / (np.array(errors) ** 2 + 1e-30)))
    return np.array([starts_at_rest(r, offset) for r in records]), offset


def _rest_level(record: Record) -> tuple[float, float]:
    """First value of a record known to start at rest, and its standard error.

    Least squares of c_0 + c_2 t^2 + c_3 t^3 + c_4 t^4 over the longest window, from 12 samples doubled as often as the
    fit leaves no more than the noise: a sweep's slow beginning gives thousands of samples.
    """
    noise, best = noise_std(record.displacement), (float(record.displacement[record.observed][0]), np.inf)
    window = 12
    while window <= record.samples:
        t, y = np.arange(window) / window, record.displacement[:window]
        keep = np.isfinite(y)
        if keep.sum() >= 8:
            basis = np.stack([t**0, t**2, t**3, t**4], -1)[keep]
            fit, *_ = np.linalg.lstsq(basis, y[keep], rcond=None)
            left = np.sqrt(np.sum((y[keep] - basis @ fit) ** 2) / (keep.sum() - 4))
            if np.isfinite(best[1]) and left > noise * (1 + 1.5 / np.sqrt(2 * keep.sum())):
                break
            error = max(left, noise) * np.sqrt(np.linalg.inv(basis.T @ basis)[0, 0])
            if error < best[1]:
                best = float(fit[0]), float(error)
        window *= 2
    return best

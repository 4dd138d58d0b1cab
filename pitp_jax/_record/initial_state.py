"""Estimate the initial state of records: sensor noise, first displacement and velocity, sensor offset at rest.

    sigma ~ 1.4826 median |D^5 y| / sqrt(252)          (white noise, oversampled signal)
    y(t) ~ a polynomial over the first samples: y(0) and y'(0) within noise
    measured = direction * displacement + offset       (both belong to a record, not to the actuator)

A still record is at rest, settled at a held input, or at a turning point. Only the motion that follows can show which:
`_identify.beginnings` and `_simulate.beginnings` decide it by likelihood.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.polynomial.legendre import legvander

from .._errors import BadInput
from .checks import MIN_SAMPLES
from .record import Record

Begins = Literal["rest", "held", "moving"]
INITIAL_SAMPLES = 50  # the fewest that the state of a moving start is estimated from
_STILL, _SMALL, _FAINT = 10.0, 0.2, 0.02
_SLOW = 0.01  # of omega times the range: a smaller velocity moves the mode by at most a hundredth of the range
_FLAT, _LEVEL, _FEWEST_FLAT = 1e-3, 0.02, 24  # of the input's range; of a noisy input's and the output's range; samples
_FEWEST, _WITHIN = 8, 48  # observed samples needed for a first state; samples within which they must lie
_K = np.arange(7.0)
_AT_START = np.stack([(-1) ** _K, -((-1) ** _K) * _K * (_K + 1) / 2])  # P_k(-1) and P_k'(-1)


@dataclass(frozen=True)
class Beginning:
    """The initial state of one record, and its sensor: measured = direction * displacement + zero.

    Attributes:
        begins: "rest" (x = 0, uncharged), "held" (settled at u(0)) or "moving".
        direction: +1 or -1.
        zero: sensor offset, output unit.
        stderr: of the offset.
        group: records of a set with the same number share one offset.
        free: whether the offset is fitted as well (`zero` is then its initial value).
    """

    begins: Begins
    direction: float
    zero: float
    stderr: float
    group: int = 0
    free: bool = False


def noise_std(displacement: np.ndarray) -> float:
    """Return the standard deviation of white sensor noise, estimated from fifth differences, output unit.

    It is an upper bound if the signal is not oversampled, because the 5th difference then contains motion too
    (docs/decisions/noise_floor.md).
    """
    # (1, 5, 10, 10, 5, 1): squares sum to 252
    fifth = np.diff(displacement, 5)
    fifth = fifth[np.isfinite(fifth)]
    if len(fifth) == 0:
        return 0.0
    noise = float(min(1.4826 * np.median(np.abs(fifth)), fifth.std()) / np.sqrt(252.0))
    # a sensor that mostly repeats its value: rounding to its steps
    return _rounding(displacement) if noise == 0.0 and fifth.any() else noise


def _rounding(displacement: np.ndarray) -> float:
    """Return the standard deviation of rounding to the sensor's smallest step, output unit; 0 if constant."""
    steps = np.abs(np.diff(displacement))
    return float(np.min(steps[steps > 0], initial=np.inf)) / np.sqrt(12.0) if (steps > 0).any() else 0.0


def in_motion(records: Sequence[Record]) -> tuple[list[Record], tuple[str, ...]]:
    """Return the records that move beyond their noise, and a sentence that names the others.

    Errors are relative to the range, which is only noise for an actuator at rest. In a diagnosis one such record had an
    error floor of 14 % and hid a gap of 3 % in three other sines.

    Raises:
        BadInput: none moves.
    """
    ranges = [r.span for r in records]
    # Under a constant input, which may carry a monitor's noise, only a motion as large as the others' counts, because
    # coloured noise has any range.
    drives = [float(np.std(r.voltage)) for r in records]
    moves = [
        w > 0 and (w > _SMALL * max(ranges) or (d > _FAINT * max(drives) and w > _STILL * noise_std(r.displacement)))
        for r, w, d in zip(records, ranges, drives, strict=True)
    ]
    if not any(moves):
        raise BadInput(
            f"{records[0].source or records[0].name}: no recording shows motion beyond its noise; record "
            "the actuator under a changing input"
        )
    still = [r.name for r, one in zip(records, moves, strict=True) if not one]
    moving = [r for r, one in zip(records, moves, strict=True) if one]
    return moving, (f"left out, because they show no motion beyond their noise: {', '.join(still)}",) if still else ()


def first_states(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the first displacement and velocity, with standard errors, over the first 8, 11, 16, 23, ... samples.

        y(s) ~ c_0 P_0(s) + ... + c_6 P_6(s),   s = -1 ... 1 over the window, P_k Legendre's polynomials
        y(-1) = sum_k<5 (-1)^k c_k,   y'(-1) = sum_k<5 (-1)^(k-1) k (k + 1) / 2 c_k;   the parts of c_5, c_6: their bias

    A roll sampled at 5 kHz advances by 2 rad in 12 samples; a cone at 10 kHz needs 200 samples to exceed the noise. So
    every window with a residual within the noise (or 0.1 % of range) gives its own estimate.

    Returns:
        values, standard errors: shape (windows, 2), at least one row; nan and inf if no window has enough samples.
    """
    span = record.span
    noise = min(noise_std(record.displacement), 0.01 * span)
    values, errors = [], []
    # windows grow by sqrt 2 up to a quarter of the record
    count = int(2 * np.log2(max(record.samples / 4 / _FEWEST, 1)))
    for window in np.unique(np.round(_FEWEST * np.sqrt(2.0) ** np.arange(count + 1)).astype(int)):
        y = record.displacement[:window]
        keep = np.isfinite(y)
        if keep.sum() < _FEWEST:
            continue
        # orthogonal over the window, so that the higher terms estimate the error of the lower ones
        basis = legvander(2 * np.arange(window)[keep] / window - 1, 6)
        fit, *_ = np.linalg.lstsq(basis, y[keep], rcond=None)
        free = max(keep.sum() - 7, 1)
        misfit = np.sqrt(np.sum((y[keep] - basis @ fit) ** 2) / free)
        if misfit > max(noise * (1 + 3 / np.sqrt(2 * free)), 0.001 * span) and values:
            break
        unit = np.array([1.0, 2.0 / (window * record.dt)])
        covariance = np.linalg.pinv(basis[:, :5].T @ basis[:, :5])
        white = max(noise, misfit) * np.sqrt(np.diag(_AT_START[:, :5] @ covariance @ _AT_START[:, :5].T))
        # Terms above the fourth power, hidden in the noise, bias the first velocity more than the noise does.
        bent = np.linalg.norm(_AT_START[:, 5:] * fit[5:], axis=1)
        values.append(_AT_START[:, :5] @ fit[:5] * unit)
        errors.append(np.hypot(white, bent / 2) * unit)
    return (np.array(values), np.array(errors)) if values else (np.full((1, 2), np.nan), np.full((1, 2), np.inf))


def is_still(record: Record, omega: float) -> bool:
    """Return whether the first sample was measured and its velocity is zero within the error.

    The tolerance is 4 standard errors plus 0.01 omega times the output's range.

    v / omega is the displacement that the velocity still causes in a mode of that frequency. One in 80 randomly cut
    motions is as slow, at any sampling rate.

    Args:
        record: in base units.
        omega: of the dominant mode, rad/s.
    """
    (_, v), (_, error), span = _sharpest(record)
    return first_known(record) == 0 and bool(abs(v) <= 4 * error + _SLOW * omega * span)


def starts_at_rest(record: Record, offset: float, omega: float) -> bool:
    """Return whether a record starts at the sensor offset with zero velocity, both within their errors.

    Args:
        record: in base units.
        offset: sensor offset, output unit.
        omega: of the dominant mode, rad/s.
    """
    (y, v), (y_error, v_error), span = _sharpest(record)
    near = min(4 * y_error, 0.015 * span) + 0.002 * span
    return bool(abs(v) <= 4 * v_error + _SLOW * omega * span and abs(y - offset) <= near)


def _sharpest(record: Record) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the most precise estimate of (y(0), y'(0)), its standard errors, and the output's range."""
    values, errors = first_states(record)
    best = int(np.argmin(errors[:, 1]))
    return values[best], errors[best], record.span


def beginning_of(record: Record, ahead: int, span: float) -> Record:
    """Return the first part of a record: until `ahead` samples after the input first changes.

    Args:
        record: in base units.
        ahead: samples.
        span: range of the inputs that the model was made with, V.
    """
    lost = first_known(record)
    size = lost + ahead
    # noise and level of the first samples alone, and of twice as many while the input stands
    while size < record.samples and standing_drive(_first(record, size), span)[0] == size:
        size *= 2
    stands = standing_drive(_first(record, size), span)[0] if size < record.samples else record.samples
    return _first(record, max(stands, lost) + ahead)


def _first(record: Record, samples: int) -> Record:
    if samples >= record.samples:
        return record
    parts = {name: getattr(record, name)[:samples] for name in ("time", "voltage", "displacement")}
    return replace(record, **parts)


def standing_drive(record: Record, span: float | None = None) -> tuple[int, float]:
    """Return how many first samples have a constant input, and that input's level (V; exactly 0 if within its noise).

    It is constant within 0.1 % of its range (or of `span`, V), or within six noise deviations (of a monitor), at most
    2 %.
    """
    noise, span = noise_std(record.voltage), float(np.ptp(record.voltage)) if span is None else span
    moved = np.abs(record.voltage - np.median(record.voltage[:8])) > np.clip(6 * noise, _FLAT * span, _LEVEL * span)
    count = int(np.argmax(moved)) if moved.any() else record.samples
    level = float(np.median(record.voltage[: max(count, 1)]))
    # noise of a mean over so many samples
    none = max(_FLAT * float(np.abs(record.voltage).max()), 4 * noise / np.sqrt(max(count, 1)))
    return count, 0.0 if abs(level) <= none else level


def settled_samples(record: Record, omega: float) -> int:
    """Return how many first samples stand still: a constant output under a constant input; 0 if none.

    This uses the data alone. For at least half a period, the means over quarters of a period differ by no more than
    noise, 2 % of the range, and a third of the response to a jump from 0 V to this input (rest under a jump rings).
    Then the record starts at rest at 0 V, or settled at a held input.

    Args:
        record: in base units.
        omega: of the dominant mode, rad/s.
    """
    count, level = standing_drive(record)
    quarter = 0.5 * np.pi / (omega * record.dt)
    if first_known(record) > 0 or count < max(2 * quarter, _FEWEST_FLAT):
        return 0
    blocks = np.array_split(record.displacement[:count], max(int(count / max(quarter, 6.0)), 2))
    means = np.array([np.mean(b[np.isfinite(b)]) for b in blocks if np.isfinite(b).any()])
    noise = noise_std(record.displacement) / np.sqrt(count / len(blocks))
    span = record.span
    # squared, as the force is; for a linear input this bound is smaller
    jump = (level / np.abs(record.voltage).max()) ** 2 if level else np.inf
    return count if np.ptp(means) <= 5 * noise + min(_LEVEL, jump / 3) * span else 0


def first_known(record: Record) -> int:
    """Return the index of the first sample at which a state can be estimated: 0 unless a long gap comes first."""
    seen = np.concatenate([[0], np.cumsum(record.observed)])
    ahead = seen[np.minimum(np.arange(record.samples) + _WITHIN, record.samples)] - seen[:-1]
    # enough samples observed within the next ones to fit a state
    enough = ahead >= _FEWEST
    return 0 if enough[0] else int(np.argmax(enough & record.observed))


def from_known(record: Record) -> Record:
    """Return the record without a long gap at its start."""
    first = min(first_known(record), record.samples - MIN_SAMPLES)
    if first <= 0:
        return record
    time, voltage, displacement = (a[first:] for a in (record.time, record.voltage, record.displacement))
    return replace(record, time=time, voltage=voltage, displacement=displacement)


def aligned(record: Record, beginning: Beginning, output) -> Record:
    """Return the record as a sensor with the model's offset and direction would have measured it.

    `output`: the model's, with `offset` and `polarity`.
    """
    if beginning.zero == output.offset and beginning.direction == output.polarity:
        return record
    return replace(record, displacement=output.to_rig(beginning.direction * (record.displacement - beginning.zero)))


def level_groups(records: Sequence[Record]) -> list[tuple[list[int], float, float]]:
    """Group records that start at rest by their sensor offset; return record indices, offset and standard error.

    The most common offset comes first.

    A level comes from the longest initial window whose misfit is within the noise (`rest_level`). This misfit can still
    shift the level by about a standard error (measured: rms 1 to 2), so errors are increased by half. Levels within 4
    of them and 0.2 % of the range are one offset.
    """
    levels = np.array([rest_level(r) for r in records]).reshape(-1, 2)
    spans = np.array([r.span for r in records])
    # four errors, but never a large part of the motion
    tolerance = np.minimum(4 * levels[:, 1], 0.015 * spans) + 0.002 * spans
    open_, groups = list(range(len(records))), []
    while open_:
        near = [
            [m for m in open_ if abs(levels[m, 0] - levels[k, 0]) <= max(tolerance[k], tolerance[m])] for k in open_
        ]
        # the most common offset first, then the next among the others
        members = max(near, key=len)
        value, weights = levels[members, 0], 1 / (levels[members, 1] ** 2 + 1e-30)
        zero = float(np.average(value, weights=weights))
        scatter = float(weights @ (value - zero) ** 2) / max(len(members) - 1, 1)
        groups.append((members, zero, float(1.5 * np.sqrt(max(scatter, 1.0) / weights.sum()))))
        open_ = [k for k in open_ if k not in members]
    return sorted(groups, key=lambda g: -len(g[0]))


def rest_level(record: Record, left: np.ndarray | None = None) -> tuple[float, float]:
    """Estimate the sensor reading at rest from the start of a record; return it and its standard error.

    Least squares of c_0 + c_2 t^2 + c_3 t^3 + c_4 t^4 over the longest window: 12 samples, doubled while the residual
    is within the noise. A sweep's slow beginning gives thousands of samples.

    Args:
        record: in base units.
        left: residual of a model, shape (T,), 0 where missing. Few samples do not show slow noise in their level, so
            the error is at least the rms level of such windows over `left`.
    """
    noise, best = noise_std(record.displacement), (float(record.displacement[record.observed][0]), np.inf)
    rounding = _rounding(record.displacement)
    window, weights = 12, np.ones(1)
    while window <= record.samples:
        t, y = np.arange(window) / window, record.displacement[:window]
        keep = np.isfinite(y)
        if keep.sum() >= 8:
            # no linear term, because the velocity is zero at rest
            basis = np.stack([t**0, t**2, t**3, t**4], -1)[keep]
            fit, *_ = np.linalg.lstsq(basis, y[keep], rcond=None)
            misfit = np.sqrt(np.sum((y[keep] - basis @ fit) ** 2) / (keep.sum() - 4))
            if np.isfinite(best[1]) and misfit > noise * (1 + 1.5 / np.sqrt(2 * keep.sum())):
                break
            inverse = np.linalg.inv(basis.T @ basis)
            error = max(misfit, noise) * np.sqrt(inverse[0, 0])
            if misfit < rounding:  # the rounding of constant readings does not average to 0
                error = max(error, rounding)
            if error < best[1]:
                best, weights = (float(fit[0]), float(error)), inverse[0] @ basis.T
        window *= 2
    if left is not None:
        best = best[0], max(best[1], float(np.sqrt(np.mean(np.convolve(left, weights[::-1], "valid") ** 2))))
    return best

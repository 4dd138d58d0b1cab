"""How records begin: sensor noise, the first state, and the zero of records at rest.

    sigma ~ 1.4826 median |D^5 y| / sqrt(252)          (white noise, oversampled signal)
    y(t) ~ c_0 + ... + c_4 t^4 over the first samples: y(0) and y'(0) within noise
    measured = direction * displacement + zero         (a zero and a direction belong to a record, not to the actuator)

Whether a still record is at rest, settled at a held drive or turning for a moment only the motion that follows can
tell: `_identify.beginnings` and `_simulate.beginnings` decide it by likelihood.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from .._errors import BadInput
from .checks import MIN_SAMPLES
from .record import Record

Begins = Literal["rest", "held", "moving"]
INITIAL_SAMPLES = 50  # the fewest that the state of a moving start is estimated from
_STILL, _SMALL = 10.0, 0.2
_WINDOWS, _FEWEST = (7, 12, 24, 48), 6  # samples a first state is fitted over; and how many of them must be observed


@dataclass(frozen=True)
class Beginning:
    """How one record begins: measured = direction * displacement + zero.

    Attributes:
        begins: "rest" (x = 0, uncharged), "held" (settled at u(0)) or "moving".
        direction: +1 or -1.
        zero: the sensor's, output unit.
        stderr: of the zero.
        group: records of a set with the same number share one zero.
        free: whether the zero is fitted with the rest (`zero` is then where the fit starts).
    """

    begins: Begins
    direction: float
    zero: float
    stderr: float
    group: int = 0
    free: bool = False


def noise_std(displacement: np.ndarray) -> float:
    """Standard deviation of white sensor noise by the 5th difference (docs/decisions/noise_floor.md), output unit.

    An upper bound where the signal is not oversampled (then the 5th difference sees the motion too).
    """
    fifth = np.diff(displacement, 5)
    fifth = fifth[np.isfinite(fifth)]
    if len(fifth) == 0:
        return 0.0
    noise = float(min(1.4826 * np.median(np.abs(fifth)), fifth.std()) / np.sqrt(252.0))
    if noise == 0.0 and fifth.any():  # a sensor that mostly repeats its value: that of its steps
        steps = np.abs(np.diff(displacement))
        return float(np.min(steps[steps > 0])) / np.sqrt(12.0)
    return noise


def in_motion(records: Sequence[Record]) -> tuple[list[Record], tuple[str, ...]]:
    """The records that move beyond their noise, and a line that names the others.

    Errors are counted in ranges, and that of an actuator at rest is its noise: in a diagnosis one such record had a
    floor of 14 % and hid a gap of 3 % in three sines beside it.

    Raises:
        BadInput: none moves.
    """
    ranges = [float(np.ptp(r.displacement[r.observed])) for r in records]
    # Under a constant drive only a motion as large as the others' counts: coloured noise has any range
    moves = [
        w > 0 and (w > _SMALL * max(ranges) or (np.ptp(r.voltage) > 0 and w > _STILL * noise_std(r.displacement)))
        for r, w in zip(records, ranges, strict=True)
    ]
    if not any(moves):
        raise BadInput(f"{records[0].source or records[0].name}: no record moves; record the actuator under a drive")
    still = [r.name for r, one in zip(records, moves, strict=True) if not one]
    moving = [r for r, one in zip(records, moves, strict=True) if one]
    return moving, (f"left out, since they do not move beyond their noise: {', '.join(still)}",) if still else ()


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
    for window in _WINDOWS:
        t, y = np.arange(window) / window, record.displacement[:window]
        keep = np.isfinite(y)
        if keep.sum() < _FEWEST:
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


def is_still(record: Record) -> bool:
    """True when some window finds no velocity at the first sample, and that sample is known."""
    return first_known(record) == 0 and bool(_still(record)[0].any())


def starts_at_rest(record: Record, offset: float) -> bool:
    """True when some window finds the first displacement at `offset` (output unit) and the first velocity zero."""
    still, value, tolerance = _still(record)
    return bool((still & (np.abs(value - offset) <= tolerance)).any())


def first_known(record: Record) -> int:
    """First sample from which a state can be estimated: 0, unless the record begins with a gap longer than that."""
    seen = np.concatenate([[0], np.cumsum(record.observed)])
    ahead = seen[np.minimum(np.arange(record.samples) + _WINDOWS[-1], record.samples)] - seen[:-1]
    enough = ahead >= _FEWEST
    return 0 if enough[0] else int(np.argmax(enough & record.observed))


def from_known(record: Record) -> Record:
    """The record from its first known state on."""
    first = min(first_known(record), record.samples - MIN_SAMPLES)
    if first <= 0:
        return record
    time, voltage, displacement = (a[first:] for a in (record.time, record.voltage, record.displacement))
    return replace(record, time=time, voltage=voltage, displacement=displacement)


def aligned(record: Record, beginning: Beginning, output) -> Record:
    """The record as the model's own sensor would have read it: its zero and direction taken out.

    `output`: the model's, with `offset` and `polarity`.
    """
    if beginning.zero == output.offset and beginning.direction == output.polarity:
        return record
    return replace(record, displacement=output.to_rig(beginning.direction * (record.displacement - beginning.zero)))


def level_groups(records: Sequence[Record]) -> list[tuple[list[int], float, float]]:
    """Records at rest grouped by the zero they share, most first: their places, the zero and its standard error.

    A level comes from the longest beginning whose misfit hides in the noise (`rest_level`). What hides can still bend
    the level by about a standard error (measured: rms 1 to 2, as the window happens to stop), so errors are widened by
    half; levels within 4 of them and 0.2 % of the range are one zero.
    """
    levels = np.array([rest_level(r) for r in records]).reshape(-1, 2)
    spans = np.array([np.nanmax(r.displacement) - np.nanmin(r.displacement) for r in records])
    tolerance = np.minimum(4 * levels[:, 1], 0.015 * spans) + 0.002 * spans
    left, groups = list(range(len(records))), []
    while left:
        near = [[m for m in left if abs(levels[m, 0] - levels[k, 0]) <= max(tolerance[k], tolerance[m])] for k in left]
        members = max(near, key=len)
        value, weights = levels[members, 0], 1 / (levels[members, 1] ** 2 + 1e-30)
        zero = float(np.average(value, weights=weights))
        scatter = float(weights @ (value - zero) ** 2) / max(len(members) - 1, 1)
        groups.append((members, zero, float(1.5 * np.sqrt(max(scatter, 1.0) / weights.sum()))))
        left = [k for k in left if k not in members]
    return sorted(groups, key=lambda g: -len(g[0]))


def rest_level(record: Record) -> tuple[float, float]:
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

"""Describe the initial state of records: sensor noise, constant input, sensor offset at rest.

    sigma ~ 1.4826 median |D^5 y| / sqrt(252)          (white noise, oversampled signal)
    measured = direction * displacement + offset       (both belong to a record, not to the actuator)

`start` decides how a record starts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ...common.errors import BadInput
from ...common.metrics import rms
from .checks import MIN_SAMPLES
from .record import Record, part_of

Begins = Literal["rest", "held", "moving"]
INITIAL_SAMPLES = 50  # the fewest that the state of a moving start is estimated from
_STILL, _SMALL, _FAINT = 10.0, 0.2, 0.02  # times the noise; of the largest motion, and of the largest input, of the set
_FLAT, _LEVEL = 1e-3, 0.02  # of the input's range, and of a noisy input's
_FEWEST, _WITHIN = 8, 48  # observed samples needed for a first state; samples within which they must lie


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
        certainty: probability of this start beside the others.
        level: first reading, output unit; nan if unknown.
    """

    begins: Begins
    direction: float
    zero: float
    stderr: float
    group: int = 0
    free: bool = False
    certainty: float = 1.0
    level: float = float("nan")


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


def noise_of(records: Sequence[Record]) -> np.ndarray:
    """Return the white sensor noise of every record, output unit, shape (records,)."""
    return np.array([noise_std(r.displacement) for r in records])


def _rounding(displacement: np.ndarray) -> float:
    """Return the standard deviation of rounding to the sensor's smallest step, output unit; 0 if constant."""
    steps = np.abs(np.diff(displacement))
    steps = steps[steps > 0]
    # rounding to steps q is uniform over q, with the deviation q / sqrt(12)
    return float(steps.min()) / np.sqrt(12.0) if len(steps) else 0.0


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


def standing_drive(record: Record, span: float | None = None) -> tuple[int, float]:
    """Return how many first samples have a constant input, and that input's level (V; exactly 0 if within its noise).

    It is constant within 0.1 % of its range (or of `span`, V), or within six noise deviations (of a monitor), at most
    2 %.
    """
    noise, span = noise_std(record.voltage), float(np.ptp(record.voltage)) if span is None else span
    moved = np.abs(record.voltage - np.median(record.voltage[:8])) > np.clip(6 * noise, _FLAT * span, _LEVEL * span)
    count = int(np.argmax(moved)) if moved.any() else record.samples
    constant = record.voltage[: max(count, 1)]
    level = float(np.median(constant))
    # noise of a mean over so many samples; the noise of a signal of steps would be its smallest step
    none = max(_FLAT * float(np.abs(record.voltage).max()), 4 * float(constant.std()) / np.sqrt(len(constant)))
    return count, 0.0 if abs(level) <= none else level


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
    return part_of(record, slice(first, None))


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
    return groups


def rest_level(record: Record, residual: np.ndarray | None = None) -> tuple[float, float]:
    """Estimate the sensor reading at rest from the start of a record; return it and its standard error.

    Least squares of c_0 + c_2 t^2 + c_3 t^3 + c_4 t^4 over the longest window: 12 samples, doubled while the residual
    is within the noise. A sweep's slow beginning gives thousands of samples.

    Args:
        record: in base units.
        residual: of a model, shape (T,), 0 where missing. Few samples do not show slow noise in their level, so
            the error is at least the rms level of such windows over `residual`.
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
    if residual is not None:
        best = best[0], max(best[1], rms(np.convolve(residual, weights[::-1], "valid")))
    return best

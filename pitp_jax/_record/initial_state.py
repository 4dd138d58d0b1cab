"""Rest: sensor noise, records in which nothing moves, and whether the actuator is at rest at the first sample.

sigma ~ 1.4826 median |D^5 y| / sqrt(252)          (white noise, oversampled signal)
still:  range <= 10 sigma  and  range <= a fifth of the largest one
y(t) ~ c_0 + ... + c_4 t^4 over the first samples; rest when y(0) = offset and y'(0) = 0 within noise
F = b + k(y - c) + a_1 y' + a_2 y'',    k(0) = 0        (whole records; c is the offset only if b = 0)

A turning point is as still as rest. What tells them apart is b, the force that holds the actuator still at c: none at
rest, a good part of the drive where it stood still for a moment or moved too slowly to see.
"""

from collections.abc import Sequence

import numpy as np

from .._errors import BadInput
from .preprocess import cutoff, force_band, preprocess
from .record import Record

INITIAL_SAMPLES = 50
_STILL, _SMALL = 10.0, 0.2
_WINDOWS, _FEWEST = (7, 12, 24, 48), 6  # samples a first state is fitted over; and how many of them must be observed


def noise_std(displacement: np.ndarray) -> float:
    """Standard deviation of white sensor noise by the 5th difference (docs/decisions/noise_floor.md), output unit.

    An upper bound where the signal is not oversampled (then the 5th difference sees the motion too).
    """
    fifth = np.diff(displacement, 5)
    fifth = fifth[np.isfinite(fifth)]
    if len(fifth) == 0:
        return 0.0
    return float(min(1.4826 * np.median(np.abs(fifth)), fifth.std()) / np.sqrt(252.0))


def in_motion(records: Sequence[Record]) -> tuple[list[Record], tuple[str, ...]]:
    """The records that move beyond their noise, and a line that names the others.

    Errors are counted in ranges, and that of an actuator at rest is its noise: in a diagnosis one such record had a
    floor of 14 % and hid a gap of 3 % in three sines beside it.

    Raises:
        BadInput: none moves.
    """
    ranges = [float(np.ptp(r.displacement[r.observed])) for r in records]
    moves = [
        w > 0 and (w > _SMALL * max(ranges) or w > _STILL * noise_std(r.displacement))
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


def initial_rest(records: Sequence[Record], input_map: str = "square") -> tuple[np.ndarray, float]:
    """Which records start at rest, and the sensor's offset: the value most still starts share.

    A vote counts less the more of a force would be needed to hold the actuator there (`_held`), and nothing where it
    is no rest at all. Among the records at rest the offset is averaged over their longest quiet beginnings
    (`rest_level`). If none is at rest it is the median first value: a start for the fit, not a measurement.

    Args:
        records: one that begins with a long gap (`first_known`) is never at rest: its first state is unknown.
        input_map: "square" (F = u^2) or "linear" (F = u).

    Returns:
        rest: bool (records,); offset: output unit.
    """
    found = [_still(r) for r in records]
    value = np.array([v[s][-1] if s.any() else np.nan for s, v, _ in found])
    tolerance = np.array([t[s][-1] if s.any() else np.nan for s, _, t in found])
    votes = np.array([np.sum(np.abs(value - c) <= tolerance) for c in value])
    support = votes * (1 - _held(records, input_map, value))
    if not (support > 0).any():
        middle = [np.nanmedian(r.displacement) for r in records]
        first = [v[-1] if np.isfinite(v[-1]) else m for m, (_, v, _) in zip(middle, found, strict=True)]
        return np.zeros(len(records), bool), float(np.median(first))
    near = np.flatnonzero(np.abs(value - value[int(np.argmax(support))]) <= tolerance)
    levels, errors = zip(*[rest_level(records[int(k)]) for k in near], strict=True)
    offset = float(np.average(levels, weights=1 / (np.array(errors) ** 2 + 1e-30)))
    return np.array([starts_at_rest(r, offset) for r in records]), offset


def _held(records: Sequence[Record], input_map: str, values: np.ndarray) -> np.ndarray:
    """How surely each value (output unit, nan for none) is not the sensor's offset: above 1 it cannot be.

    Least squares of the force balance, pooled over the records, with b and without. 1 is where b is 0.3 of the range
    of the force and without it three times as much is left; both are asked because a single tone far above the
    resonance leaves b open. A straight and a cubic k must agree, as a stiffening actuator bends a straight one's b.
    (So each of 330 bench records at rest, taken by itself, stays at rest.)
    """
    forces = [r.voltage ** (2 if input_map == "square" else 1) for r in records]
    span = max(np.nanmax(r.displacement) - np.nanmin(r.displacement) for r in records)
    cut = cutoff(force_band(forces, records[0].dt), records[0].dt)
    rows = []
    for r, f in zip(records, forces, strict=True):
        settled = max(cut, 15.0 / (r.samples * r.dt))  # leaves three quarters of a short record
        s = preprocess(r, 2, settled, f, displacement=r.displacement / span)
        keep = np.flatnonzero(s.valid)
        keep = keep[:: max(1, len(keep) * len(records) // 20_000)]
        rows.append(np.c_[s.states[keep], s.force[keep]])
    x, velocity, acceleration, force = np.concatenate(rows).T
    if len(force) < INITIAL_SAMPLES:
        return np.zeros(len(values))
    unit = np.maximum([np.abs(velocity).max(), np.abs(acceleration).max()], 1e-300)
    moving, force = np.stack([velocity, acceleration], -1) / unit, force / np.ptp(force)

    def held(c, degree):
        z = x - c / span
        balance = np.c_[np.stack([z**i for i in range(degree + 1)], -1), moving]
        free, *_ = np.linalg.lstsq(balance, force, rcond=None)
        rest, *_ = np.linalg.lstsq(balance[:, 1:], force, rcond=None)
        least = max(np.linalg.norm(force - balance @ free), 1e-9 * np.linalg.norm(force))
        return min(abs(free[0]) / 0.3, np.linalg.norm(force - balance[:, 1:] @ rest) / (3 * least))

    return np.array([min(held(c, 1), held(c, 3)) if np.isfinite(c) else 0.0 for c in values])


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

"""Remove a time shift between the columns of records, a fault of their clocks and not of the actuator.

    y(t) = x(t + T)    ->    x(t) = y(t - T)

A late output is a delay, which a machine can have. An early one answers an input that has not come yet.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from .._record.record import Record
from .._report.numbers import number


def put_back(records: Sequence[Record], early: float) -> tuple[Record, ...]:
    """Delay the output of every record by `early` seconds, and cut the first samples, which then have no output."""
    return tuple(_later(r, early) for r in records)


def _later(record: Record, early: float) -> Record:
    first = min(int(np.ceil(early / record.dt - 1e-6)), record.samples - 2)
    time, seen = record.time[first:], np.isfinite(record.displacement)
    at = time - early
    output = CubicSpline(record.time[seen], record.displacement[seen])(at)
    # missing where the nearest sample is
    nearest = np.clip(np.round((at - record.time[0]) / record.dt).astype(int), 0, record.samples - 1)
    output = np.where(seen[nearest], output, np.nan)
    return replace(record, time=time, voltage=record.voltage[first:], displacement=output)


def remark(early: float, dt: float) -> str:
    """Describe the removed time shift in one line, with a check for the user."""
    return (
        f"clock_shift: the output column is {number(1e3 * early, 3)} ms ({number(early / dt, 2)} samples) early beside "
        "the input column: it answers before the input changes. This is a fault of the recordings, not an effect; it "
        "was taken out of them before the diagnosis. Check the clocks and filters of both channels."
    )

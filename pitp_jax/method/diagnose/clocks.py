"""Correct records whose channels disagree in time: a fault of their clocks or filters and not of the actuator.

    y(t) = x(t + T)              ->   x(t) = y(t - T)         the output column is early
    tau u_r' = u - u_r           ->   u = u_r + tau u_r'      the input column u_r is behind a low pass

A late output is a delay, and a lag of the true input is an electrode's: a machine can have both. An early output or a
lag of the recorded input answers an input that has not come yet.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from ...common.numbers import number
from ..signal.record import Record

_SMOOTHED = 4  # the slope is taken over half of the time constant, which changes the gain at 1 / tau by 1 %


@dataclass(frozen=True)
class Fault:
    """The disagreement of two columns in time.

    Attributes:
        early: time (s) by which the output column is ahead of the input; negative beside a lag: behind it.
        lag: time constant (s) of the low pass behind which the input was recorded.
    """

    early: float = 0.0
    lag: float = 0.0

    def corrected(self, records: Sequence[Record]) -> tuple[Record, ...]:
        """Return the records without the fault; samples without a partner are cut off."""
        return tuple(_later(_ahead(r, self.lag), self.early) for r in records)

    def remarks(self, dt: float) -> list[str]:
        """Describe each removed fault in one line, with a check for the user; `dt`: sampling interval (s)."""
        lines = []
        if self.early and not self.lag:
            lines.append(
                f"clock_shift: the output column is {number(1e3 * self.early, 3)} ms ({number(self.early / dt, 2)} "
                "samples) early beside the input column: it answers before the input changes. This is a fault of the "
                "recordings, not an effect; it was taken out of them before the diagnosis. Check the clocks and "
                "filters of both channels."
            )
        if self.lag:
            slow = number(1e3 * (self.lag + self.early), 3)
            lines.append(
                "clock_shift: the input column lags behind the voltage that acts, like a low pass with a time constant "
                f"of {number(1e3 * self.lag, 3)} ms; slow changes appear {slow} ms late. This is a fault of the "
                "recordings, not an effect; it was taken out of them before the diagnosis. Check the filter of the "
                "voltage's monitor, or record the command."
            )
        return lines


def _ahead(record: Record, lag: float) -> Record:
    """Return a record with the voltage u + tau u' instead of u, tau = `lag` (s)."""
    if not lag:
        return record
    width = max(round(lag / record.dt / _SMOOTHED), 1)
    u = np.pad(record.voltage, width, mode="edge")
    slope = (u[2 * width :] - u[: -2 * width]) / (2 * width * record.dt)
    return replace(record, voltage=record.voltage + lag * slope)


def _later(record: Record, early: float) -> Record:
    """Return a record whose output is delayed by `early` seconds, without the samples that then have no output."""
    if not early:
        return record
    cut = min(int(np.ceil(abs(early) / record.dt - 1e-6)), record.samples - 2)
    inside = slice(cut, None) if early > 0 else slice(None, record.samples - cut)
    time, seen = record.time[inside], np.isfinite(record.displacement)
    at = time - early
    output = CubicSpline(record.time[seen], record.displacement[seen])(at)
    # missing where the nearest sample is
    nearest = np.clip(np.round((at - record.time[0]) / record.dt).astype(int), 0, record.samples - 1)
    output = np.where(seen[nearest], output, np.nan)
    return replace(record, time=time, voltage=record.voltage[inside], displacement=output)

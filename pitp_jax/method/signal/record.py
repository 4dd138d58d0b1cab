"""Define a record: one excitation of one actuator, sampled uniformly.

    t_i = t_0 + i dt,   u_i = voltage (V),   y_i = displacement (base unit: m, or V for an electronic output)

A missing output sample is nan in `displacement`; everything downstream masks it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...common.errors import BadInput, cleaned, refuse_traced
from ...common.shown import Shown
from ...common.units import INPUT_UNITS, from_base
from .checks import check_samples


def own_column(values: Any, what: str) -> np.ndarray:
    """Return values as a read-only float64 copy: time spans in s, masked samples nan.

    Raises:
        BadInput: they are not real numbers; `what` names them in the message.
    """
    if np.ma.isMaskedArray(values):
        values = np.ma.filled(values.astype(np.float64), np.nan)
    values = np.asarray(values)
    if values.dtype.kind == "m":
        values = values / np.timedelta64(1, "s")
    if values.dtype.kind == "c":
        raise BadInput(f"{what} holds complex numbers; give real ones")
    try:
        column = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadInput(f"{what} does not hold numbers; give an array of numbers") from None
    column.setflags(write=False)
    return column


def sampling_interval(time: np.ndarray) -> float:
    """Return the mean step of uniform sample times, s."""
    return float((time[-1] - time[0]) / (len(time) - 1))


class Timed(Shown):
    """A series of samples at a uniform rate."""

    time: np.ndarray

    @property
    def dt(self) -> float:
        """Return the sampling interval, s."""
        return sampling_interval(self.time)


def range_in(values: np.ndarray, unit: str) -> str:
    """Write the range of values (base unit, nan where missing) in their file's unit: `0 to 2.5 kV`."""
    low, high = (from_base(float(end(values)), unit) for end in (np.nanmin, np.nanmax))
    return f"{low:.4g} to {high:.4g} {unit}"


@dataclass(frozen=True, eq=False)
class Record(Timed):
    """A recording of one actuator under one excitation: time, voltage and displacement in base units.

    Attributes:
        name: the file name without its known suffix, or any label unique in the set.
        time: sample times in s, shape (T,), uniform to 1 % of a sample; the session clock.
        voltage: the input, shape (T,), in the base unit of its quantity (V, A, N m, rad, Pa ...); no missing samples.
        displacement: the output, shape (T,), in the base unit of its quantity (m, rad, N, V ...); nan where missing.
        voltage_unit: unit of the input in its file (`V`, `kV`, `N m` ...); results are written back in it.
        displacement_unit: unit of the output in its file (`m`, `mm`, `rad`, `deg` ...). Give `rad` for a joint: only an
            angle can have a weight on an arm, m g l sin(q).
        source: where it came from, for messages.
        recognised: properties and corrections of the file as read: `file`, `time`, `input`, `output` in words, counts
            `lost`, `outliers`, `clipped`, the `jitter` in samples, and `remarks` for the user (`findings` as values).

    Raises:
        BadInput: shapes differ, fewer than 64 samples, non-uniform time, missing input, no finite output.
    """

    name: str
    time: np.ndarray
    voltage: np.ndarray
    displacement: np.ndarray
    voltage_unit: str = "V"
    displacement_unit: str = "m"
    source: str = ""
    recognised: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self):
        """Refuse samples from which nothing can be computed (the readers name the file, column and sample as well)."""
        refuse_traced("Record", "free_run or residual with arrays", self.time, self.voltage, self.displacement)
        for name in ("time", "voltage", "displacement"):
            object.__setattr__(self, name, own_column(getattr(self, name), f"record {self.name!r}: {name}"))
        for unit in (self.voltage_unit, self.displacement_unit):
            if unit not in INPUT_UNITS:
                raise BadInput(f"record {self.name!r}: unknown unit {unit!r}; give one of {', '.join(INPUT_UNITS)}")
        source = cleaned(self.source) or f"record {self.name!r}"  # a path is stored unchanged, but printed cleaned
        check_samples(self.time, self.voltage, self.displacement, source)

    def __repr__(self) -> str:
        """Write the record in one line: length, sampling rate, ranges in the file's units."""
        ranges = range_in(self.voltage, self.voltage_unit), range_in(self.displacement, self.displacement_unit)
        lost = f", {self.missing} missing" if self.missing else ""
        return f"Record({self.name!r}: {self.samples} samples at {1 / self.dt:.6g} Hz, {', '.join(ranges)}{lost})"

    @property
    def samples(self) -> int:
        """Return the number of samples, T."""
        return len(self.time)

    @property
    def observed(self) -> np.ndarray:
        """Return True where the output was measured, shape (T,)."""
        return np.isfinite(self.displacement)

    @property
    def filled(self) -> np.ndarray:
        """Return the output with missing samples interpolated, base unit, shape (T,)."""
        return np.interp(self.time, self.time[self.observed], self.displacement[self.observed])

    @property
    def span(self) -> float:
        """Return the range of the output: largest minus smallest measured value, base unit."""
        return float(np.ptp(self.displacement[self.observed]))

    @property
    def missing(self) -> int:
        """Return the number of missing output samples."""
        return int(self.samples - self.observed.sum())


def part_of(record: Record, part: slice) -> Record:
    """Return the record with only this part of its samples."""
    time, voltage, displacement = (a[part] for a in (record.time, record.voltage, record.displacement))
    return replace(record, time=time, voltage=voltage, displacement=displacement)

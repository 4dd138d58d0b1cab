"""Read files that hold only a voltage, to be played to a model, by the rules of recordings."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...common.errors import BadInput
from ...method.signal.record import Timed, range_in
from ..containers.choice import choose_columns
from ..containers.columns import Loaded
from ..containers.options import OPTIONS, ReadOptions
from ..containers.refusal import together
from ..containers.table import Table
from .reading import attempted, clock_remarks, mended, options_of
from .selection import select_range


@dataclass(frozen=True, eq=False)
class Drive(Timed):
    """A voltage over time from a file, without a measured output.

    Attributes:
        name: the file name without its known suffix.
        time, voltage: in s and the base unit, uniform, shape (T,).
        voltage_unit: unit it had in its file.
        source: the file.
        remarks: what was recognised, filled in or ignored.
    """

    name: str
    time: np.ndarray
    voltage: np.ndarray
    voltage_unit: str = "V"
    source: str = ""
    remarks: tuple[str, ...] = ()

    def __repr__(self) -> str:
        span = range_in(self.voltage, self.voltage_unit)
        return f"Drive({self.name!r}: {len(self.time)} samples at {1 / self.dt:.6g} Hz, {span})"


def read_voltage(*paths: str | os.PathLike, **said: Any) -> tuple[Drive, ...]:
    """Read voltages over time from any mix of files and folders; a displacement column is ignored.

    Args:
        *paths: files and folders as for `read`; rates may differ.
        **said: `time_column`, `input_column`, units, `input_scale`, `rate` and the others as for `read`.

    Returns:
        the voltages, in the order given.

    Raises:
        BadInput: one line with all refused files.

    Examples:
        >>> drive = pitp.read_voltage(folder / "drive.csv")[0]
        >>> drive.name, drive.voltage_unit
        ('drive', 'V')
    """
    drives, refused, files = attempted(paths, options_of(said), ("time", "voltage"), _drives)
    if refused:
        raise together(refused, files)
    return tuple(drives)


def _drives(path: Path, label: str, one: Loaded) -> Sequence[Drive]:
    """Read one voltage from a file, or several if gaps are too long to fill."""
    one = select_range(one)
    _, put = mended(one)
    kinds = [f"{OPTIONS[q]} {one.words(q)}" for q in one.chosen]
    remarks = [f"{label}: {one.table.form}; {', '.join(kinds)}"]
    if (output := _output(one.table, one.options)) is not None:
        remarks.append(f"{label}: column {output!r} is a measurement and was ignored")
    remarks += [f"{label}: {remark}" for remark in clock_remarks(label, put)]
    unit = one.unit("voltage")
    return [
        Drive(name, p.time, p.voltage, unit, os.fspath(path), tuple(remarks) if p is put.pieces[0] else ())
        for name, p in zip(put.names(label), put.pieces, strict=True)
    ]


def _output(table: Table, options: ReadOptions) -> str | None:
    """Return the header of the output column that `pitp` would choose, or None."""
    try:
        return choose_columns(table, options, ("displacement",))["displacement"].name
    except BadInput:
        return None

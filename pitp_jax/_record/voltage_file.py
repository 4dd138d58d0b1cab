"""Files of a voltage alone, to be played to a model; read by the rules of records."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._errors import BadInput
from .._shown import Shown
from .._table import ReadOptions, load_columns, together
from .._table.choice import choose_columns
from .._table.options import OPTIONS
from .._table.table import Table
from .._table.units import base_unit, from_base
from .checks import TIME_TOLERANCE, check_samples
from .plausible import refuse_implausible
from .reading import files_of, gridded, names_of, options_of
from .remarks import Remark, counted


@dataclass(frozen=True, eq=False)
class Drive(Shown):
    """A voltage without a measurement.

    Attributes:
        name: the file name less its known suffix.
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
        ends = [from_base(float(f(self.voltage)), self.voltage_unit) for f in (np.min, np.max)]
        span = f"{ends[0]:.4g} to {ends[1]:.4g} {self.voltage_unit}"
        return f"Drive({self.name!r}: {len(self.time)} samples at {1 / self.dt:.6g} Hz, {span})"

    @property
    def dt(self) -> float:
        """Sampling interval in s."""
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1))


def read_voltage(*paths: str | os.PathLike, **said: Any) -> tuple[Drive, ...]:
    """Read any mix of files (and folders of them) of time and voltage; a displacement that is there is ignored.

    Args:
        *paths: files and folders as for `read`; rates may differ.
        **said: `time_column`, `input_column`, units, `input_scale`, `rate` and the others as for `read`.

    Returns:
        the drives, in the order given.

    Raises:
        BadInput: one line with all files that are refused.

    Examples:
        >>> drive = pitp.read_voltage(folder / "drive.csv")[0]
        >>> drive.name, drive.voltage_unit
        ('drive', 'V')
    """
    options, files = options_of(said), files_of(paths)
    drives: list[Drive] = []
    refusals: list[BadInput] = []
    for file, name in zip(files, names_of(files), strict=True):
        try:
            drives += _read_one(file, name, options)
        except BadInput as error:
            refusals.append(error)
    if refusals:
        raise BadInput(together(refusals, len(files), paths))
    return tuple(drives)


def _read_one(path: Path, name: str, options: ReadOptions) -> Sequence[Drive]:
    """One drive, or several where gaps are too long to fill."""
    drives = []
    for one in load_columns(path, options, ("time", "voltage")):
        time, voltage, unit = one.values["time"], one.values["voltage"], one.unit("voltage")
        label = f"{name}.{one.label}" if one.label else name
        columns, idle = (one.chosen["time"].name, one.chosen["voltage"].name, "displacement"), np.zeros(len(time))
        check_samples(time, voltage, idle, one.table.source, columns, one.place, uniform=False)
        refuse_implausible(voltage, idle, (base_unit(unit), "m"), one.table.source, columns[1:], one.place)
        put = gridded(one, idle)
        kinds = [f"{OPTIONS[q]} {one.words(q)}" for q in one.chosen]
        remarks = [f"{label}: {one.table.form}; {', '.join(kinds)}"]
        if (output := _output(one.table, one.options)) is not None:
            remarks.append(f"{label}: column {output!r} is a measurement and ignored")
        if put.jitter > TIME_TOLERANCE:
            remarks.append(f"{label}: {Remark('jitter', label, put.jitter)}")
        if lost := sum(piece.lost for piece in put.pieces):
            remarks.append(f"{label}: {counted(lost, 'lost sample')} of the voltage filled in")
        many = len(put.pieces) > 1
        drives += [
            Drive(
                f"{label}.{k}" if many else label,
                p.time,
                p.voltage,
                unit,
                os.fspath(path),
                tuple(remarks) if k == 1 else (),
            )
            for k, p in enumerate(put.pieces, 1)
        ]
    return drives


def _output(table: Table, options: ReadOptions) -> str | None:
    """The header of a displacement beside, if there is one."""
    try:
        return choose_columns(table, options, ("displacement",))["displacement"].name
    except BadInput:
        return None

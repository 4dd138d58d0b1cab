"""Files of a voltage alone, to be played to a model; read by the rules of records."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._errors import BadInput
from .checks import check_samples
from .choice import choose_columns
from .formats import open_table
from .grid import on_grid
from .options import OPTIONS, ReadOptions
from .plausible import refuse_implausible
from .reading import files_of, load_columns, names_of, scaled, together
from .table import Table


@dataclass(frozen=True)
class Drive:
    """A voltage without a measurement.

    Attributes:
        name: the file name less its known suffix.
        time, voltage: in s and V, uniform, shape (T,).
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

    @property
    def dt(self) -> float:
        """Sampling interval in s."""
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1))


def read_voltage(
    *paths: str | os.PathLike,
    time_column: str | None = None,
    input_column: str | None = None,
    time_unit: str | None = None,
    input_unit: str | None = None,
    input_scale: float | None = None,
    rate: float | None = None,
) -> tuple[Drive, ...]:
    """Read any mix of files (and folders of them) of time and voltage; a displacement that is there is ignored.

    Args:
        *paths: files and folders as for `read`; rates may differ.
        time_column: exact header of the time; it and the others as for `read`.
        input_column: of the voltage.
        time_unit: of the time.
        input_unit: of the voltage.
        input_scale: V per V of the input column.
        rate: samples per second, for files without time.

    Returns:
        the drives, in the order given.

    Raises:
        BadInput: one line with all files that are refused.

    Examples:
        >>> drive = pitp.read_voltage(folder / "drive.csv")[0]
        >>> drive.name, drive.voltage_unit
        ('drive', 'V')
    """
    options = ReadOptions(time_column, input_column, None, time_unit, input_unit, None, input_scale, None, rate)
    files = files_of(paths)
    drives: list[Drive] = []
    refusals: list[str] = []
    for file, name in zip(files, names_of(files), strict=True):
        try:
            drives += _read_one(file, name, options)
        except BadInput as error:
            refusals.append(str(error))
    if refusals:
        raise BadInput(together(refusals, len(files)))
    return tuple(drives)


def _read_one(path: Path, name: str, options: ReadOptions) -> Sequence[Drive]:
    """One drive, or several where gaps are too long to fill."""
    table = open_table(path)
    chosen = choose_columns(table, options, ("time", "voltage"))
    time, voltage = load_columns(table, chosen, options)
    columns, idle = (chosen["time"].name, chosen["voltage"].name, "displacement"), np.zeros(len(time))
    check_samples(time, voltage, idle, table.source, columns, table.place, uniform=False)
    refuse_implausible(voltage, idle, "m", table.source, columns[1:], table.place)
    found = on_grid(time, voltage, idle, table.source, columns[0], table.place)
    kinds = [f"{OPTIONS[q]} {c}{scaled(q, options)}" for q, c in chosen.items()]
    remarks = [f"{name}: {table.form}; {', '.join(kinds)}"]
    if (output := _output(table, options)) is not None:
        remarks.append(f"{name}: column {output!r} is a measurement and ignored")
    if lost := sum(piece.lost for piece in found.pieces):
        remarks.append(f"{name}: {lost} lost samples of the voltage filled in")
    many, unit = len(found.pieces) > 1, "V" if options.input_scale is not None else chosen["voltage"].unit
    return [
        Drive(f"{name}.{k}" if many else name, p.time, p.voltage, unit, table.source, tuple(remarks) if k == 1 else ())
        for k, p in enumerate(found.pieces, 1)
    ]


def _output(table: Table, options: ReadOptions) -> str | None:
    """The header of a displacement beside, if there is one."""
    try:
        return choose_columns(table, options, ("displacement",))["displacement"].name
    except BadInput:
        return None

"""Files and folders to records, in base units and checked.

    files -> table -> (time, input, output) columns -> base units -> check -> Record

The name of a record is its file name less exactly the known suffix; where names collide in one call the
parent folder goes in front (`clean/sine0`).
"""

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._errors import BadInput
from .checks import check_samples, check_wanted
from .choice import choose_column
from .formats import open_table, split_suffix
from .record import Record
from .sets import check_set
from .units import to_base


@dataclass(frozen=True)
class Target:
    """A wanted trajectory, for the inverse model.

    Attributes:
        time: sample times in s, shape (T,), uniform to 1 % of a sample.
        displacement: wanted output in m (or V), shape (T,), no missing samples.
        displacement_unit: unit it had in its file.
        source: the file, for messages.

    Raises:
        BadInput: shapes differ, fewer than two samples, non-uniform time, a sample missing or infinite.
    """

    time: np.ndarray
    displacement: np.ndarray
    displacement_unit: str = "m"
    source: str = ""

    def __post_init__(self):
        """Refuse what cannot be inverted (`read_target` gives the column and the line as well)."""
        for field in ("time", "displacement"):
            object.__setattr__(self, field, np.asarray(getattr(self, field), dtype=np.float64))
        check_wanted(self.time, self.displacement, self.source or "target")

    @property
    def dt(self) -> float:
        """Sampling interval in s."""
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1))


def read(
    *paths: str | os.PathLike, input_column: str | None = None, output_column: str | None = None
) -> tuple[Record, ...]:
    """Read any mix of record files and folders of them.

    Folders do not recurse; their files are taken in sorted order, files that are not records are ignored.

    Args:
        *paths: files (`.csv`, `.csv.gz`, `.mat`, `.npz`, `.h5`, `.hdf5`) and folders.
        input_column: name of the input column where it is not the exact `voltage_{V,kV,mV}`.
        output_column: name of the output column where it is not the exact `displacement_{m,mm,um,V,mV}`.

    Returns:
        the records, in the order given, in s, V and m (or V); missing output is nan.

    Raises:
        BadInput: nothing to read, or a file is refused (the line names file, column, sample and remedy).
    """
    files = _files(paths)
    names = _names(files)
    records = tuple(_read_one(file, names[k], input_column, output_column) for k, file in enumerate(files))
    check_set(records)
    return records


def read_target(path: str | os.PathLike, output_column: str | None = None) -> Target:
    """Read a wanted trajectory: time and displacement, whatever else the file holds.

    Args:
        path: one file of the known formats.
        output_column: name of the displacement column where it is not the exact
            `displacement_{m,mm,um,V,mV}`.

    Returns:
        the target in s and m (or V).

    Raises:
        BadInput: as for a record, and where a sample is missing.
    """
    path = _existing(path)
    if path.is_dir():
        raise BadInput(f"{path}: is a folder; give one target file")
    table = open_table(path)
    time_column, time_unit = choose_column(table, "time")
    column, unit = choose_column(table, "displacement", output_column)
    values = table.load((time_column, column))
    time = to_base(values[time_column], time_unit, "time")
    wanted = to_base(values[column], unit, "displacement")
    idle = np.zeros_like(time)
    check_samples(time, idle, wanted, table.source, (time_column, "voltage", column), table.place)
    check_wanted(time, wanted, table.source, (time_column, column), table.place)
    return Target(time, wanted, unit, table.source)


def _existing(path: str | os.PathLike) -> Path:
    path = Path(path)
    try:
        found = path.exists()
    except (OSError, ValueError) as error:
        raise BadInput(f"{str(path)!r}: not a usable path ({error}); check it") from None
    if not found:
        raise BadInput(f"{path}: no such file or folder; check the path")
    return path


def _files(paths: Sequence[str | os.PathLike]) -> list[Path]:
    """The record files behind files and folders, in order."""
    if not paths:
        raise BadInput("no records given; name at least one file or folder")
    files: list[Path] = []
    for path in map(_existing, paths):
        if not path.is_dir():
            files.append(path)
            continue
        try:
            inside = sorted(path.iterdir())
        except OSError as error:
            raise BadInput(f"{path}: cannot list the folder: {error.strerror or error}; check its rights") from None
        inside = [file for file in inside if _is_record(file)]
        if not inside:
            raise BadInput(f"{path}: no record files in this folder (folders do not recurse); name the one with files")
        files.extend(inside)
    return files


def _is_record(file: Path) -> bool:
    return file.is_file() and not file.name.startswith(".") and bool(split_suffix(file.name)[1])


def _names(files: Sequence[Path]) -> list[str]:
    """One unique name per file."""
    names = [split_suffix(file.name)[0] for file in files]
    count = Counter(names)
    full = [
        name if count[name] == 1 else f"{file.absolute().parent.resolve().name}/{name}"
        for file, name in zip(files, names, strict=True)
    ]
    first: dict[str, Path] = {}
    for file, name in zip(files, full, strict=True):
        if name in first:
            if file.resolve() == first[name].resolve():
                raise BadInput(f"{file}: given twice; name each record once")
            raise BadInput(f"{file}: has the same record name {name!r} as {first[name]}; rename one of the two")
        first[name] = file
    return full


def _read_one(path: Path, name: str, input_column: str | None, output_column: str | None) -> Record:
    table = open_table(path)
    time_column, time_unit = choose_column(table, "time")
    in_column, in_unit = choose_column(table, "voltage", input_column)
    out_column, out_unit = choose_column(table, "displacement", output_column)
    columns = (time_column, in_column, out_column)
    if len(set(columns)) < 3:
        raise BadInput(f"{table.source}: column {in_column!r}: chosen twice; choose different input and output columns")
    values = table.load(columns)
    time = to_base(values[time_column], time_unit, "time")
    voltage = to_base(values[in_column], in_unit, "voltage")
    displacement = to_base(values[out_column], out_unit, "displacement")
    check_samples(time, voltage, displacement, table.source, columns, table.place)
    return Record(name, time, voltage, displacement, in_unit, out_unit, table.source)

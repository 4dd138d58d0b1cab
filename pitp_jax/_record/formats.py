"""File formats: from a suffix to the function that opens such a file as a table.

.csv  .csv.gz    text with a header row
.mat             MATLAB v5 (SciPy) or v7.3 (an HDF5 file)
.npz             NumPy archive, never unpickled
.h5   .hdf5      HDF5, datasets at the root
"""

import warnings
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
import scipy.io

from .._errors import BadInput
from .csv_table import csv_gz_table, csv_table
from .table import Table, as_column, file_bytes


def _sample(index: int) -> str:
    return f"sample {index}"


def npz_table(path: Path) -> Table:
    """A `.npz` archive as a table; object arrays are refused, so nothing stored in it is ever executed.

    Raises:
        BadInput: unreadable or not a NumPy archive.
    """
    if not file_bytes(path, 4).startswith(b"PK"):
        raise BadInput(f"{path}: is not a NumPy archive as its suffix says; save it with numpy.savez")
    return _stored_table(path, _npz_names, _npz_values, "a NumPy archive")


def _npz_names(path: Path) -> list[str]:
    with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
        return list(archive.files)


def _npz_values(path: Path, wanted: Sequence[str]) -> dict:
    values = {}
    with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
        for name in wanted:
            try:
                values[name] = archive[name]
            except ValueError as error:
                if "allow_pickle" not in str(error):
                    raise
                values[name] = np.empty(0, dtype=object)  # refused as "not plain numbers"
    return values


def h5_table(path: Path) -> Table:
    """A `.h5` or `.hdf5` file as a table: the datasets at its root.

    Raises:
        BadInput: unreadable or not HDF5.
    """
    file_bytes(path, 1)
    return _stored_table(path, _h5_names, _h5_values, "an HDF5 file")


def _h5_names(path: Path) -> list[str]:
    with h5py.File(path, "r") as file:
        return [str(name) for name in file if isinstance(file.get(name), h5py.Dataset)]


def _h5_values(path: Path, wanted: Sequence[str]) -> dict:
    with h5py.File(path, "r") as file:
        return {name: _h5_value(file[name]) for name in wanted}


def _h5_value(dataset) -> np.ndarray:
    """A dataset as stored, minding that MATLAB v7.3 writes text as codes and empty arrays as their shape."""
    kind = dataset.attrs.get("MATLAB_class", b"")
    kind = kind.decode() if isinstance(kind, bytes) else str(kind)
    if kind == "char":
        return np.empty(0, dtype="S1")
    if kind in ("cell", "string", "table"):
        return np.empty(0, dtype=object)
    if dataset.attrs.get("MATLAB_empty", 0) or dataset.shape is None:
        return np.empty(0)
    return dataset[()]


def mat_table(path: Path) -> Table:
    """A `.mat` file, v5 or v7.3, as a table.

    Raises:
        BadInput: unreadable or not a MATLAB file.
    """
    if not file_bytes(path, 20).startswith(b"MATLAB"):
        if h5py.is_hdf5(path):
            return _stored_table(path, _h5_names, _h5_values, "a MATLAB file")
        raise BadInput(f"{path}: is not a MATLAB file as its suffix says; save it from MATLAB with -v7 or -v7.3")
    if h5py.is_hdf5(path):
        return _stored_table(path, _h5_names, _h5_values, "a MATLAB v7.3 file")
    return _stored_table(path, _mat5_names, _mat5_values, "a MATLAB file")


def _mat5_names(path: Path) -> list[str]:
    with open(path, "rb") as file:
        return [name for name, _, _ in scipy.io.whosmat(file)]


def _mat5_values(path: Path, wanted: Sequence[str]) -> dict:
    with open(path, "rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        stored = scipy.io.loadmat(file, variable_names=list(wanted))
    return {name: stored[name] for name in wanted}


def _stored_table(path: Path, list_names, load_values, kind: str) -> Table:
    """A table over a binary format; whatever its library raises on damaged bytes becomes BadInput."""

    def guarded(function, *arguments):
        try:
            return function(path, *arguments)
        except Exception as error:  # the libraries raise nearly anything on damaged files
            reason = " ".join(str(error).split()) or type(error).__name__
            raise BadInput(f"{path}: not readable as {kind} ({reason[:120]}); save or copy it again") from error

    def load(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        stored = guarded(load_values, wanted)
        return {name: as_column(stored[name], name, str(path)) for name in wanted}

    return Table(str(path), tuple(guarded(list_names)), load, _sample)


_FORMATS = {
    ".csv.gz": csv_gz_table,
    ".csv": csv_table,
    ".mat": mat_table,
    ".npz": npz_table,
    ".h5": h5_table,
    ".hdf5": h5_table,
}


def split_suffix(name: str) -> tuple[str, str]:
    """A file name as (stem, known suffix); the suffix is empty where it is not one of a record file.

    Capital suffixes (`.CSV`, `.MAT`) count too.
    """
    for suffix in _FORMATS:
        if name.lower().endswith(suffix) and len(name) > len(suffix):
            return name[: -len(suffix)], name[-len(suffix) :]
    return name, ""


def open_table(path: Path) -> Table:
    """The table in a file, by its suffix.

    Raises:
        BadInput: unknown suffix, or the file is not what its suffix says.
    """
    suffix = split_suffix(path.name)[1].lower()
    if not suffix:
        known = ", ".join(sorted(_FORMATS))
        raise BadInput(f"{path}: not a record file (known suffixes: {known}); convert or rename it")
    return _FORMATS[suffix](path)

"""File formats: from a suffix to the function that opens such a file as a table.

.csv .txt .dat .tsv .lvm   text, each also .gz
.xlsx  .tdms               spreadsheets, LabVIEW (extras)
.mat                       MATLAB v5 to v7 (SciPy) or v7.3 (an HDF5 file)
.npz                       NumPy archive, never unpickled
.h5 .hdf5                  HDF5, datasets at the root or in its groups
"""

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import h5py
import numpy as np

from .._errors import BadInput
from .array_table import mat_table, npz_table
from .hdf5_table import hdf5_table
from .sheet_table import tdms_table, xlsx_table
from .table import Table, cleaned, file_bytes
from .text_table import text_table

_TEXT = (".csv", ".txt", ".dat", ".tsv", ".lvm")


def _any_mat(path: Path, kind: str) -> Table:
    """A `.mat` file, v5 or v7.3."""
    if h5py.is_hdf5(path):
        return hdf5_table(path, f"{kind} v7.3")
    if not file_bytes(path, 20).startswith(b"MATLAB"):
        raise BadInput(
            f"{cleaned(path)}: is not a MATLAB file as its suffix says; save it from MATLAB with -v7 or -v7.3"
        )
    return mat_table(path, kind)


_STORED: dict[str, tuple[Callable[[Path, str], Table], str]] = {
    ".xlsx": (xlsx_table, "Excel workbook"),
    ".tdms": (tdms_table, "TDMS file"),
    ".mat": (_any_mat, "MATLAB file"),
    ".npz": (npz_table, "NumPy archive"),
    ".h5": (hdf5_table, "HDF5 file"),
    ".hdf5": (hdf5_table, "HDF5 file"),
}
SUFFIXES = (*(f"{suffix}.gz" for suffix in _TEXT), *_TEXT, *_STORED)


def split_suffix(name: str) -> tuple[str, str]:
    """A file name as (stem, known suffix); the suffix is empty where it is not one of a record file.

    Capital suffixes (`.CSV`, `.MAT`) count too.
    """
    for suffix in SUFFIXES:
        if name.lower().endswith(suffix) and len(name) > len(suffix):
            return name[: -len(suffix)], name[-len(suffix) :]
    return name, ""


def open_table(path: Path) -> Table:
    """The table in a file, by its suffix; whatever a library raises on damaged bytes becomes BadInput.

    Raises:
        BadInput: unknown suffix, or the file is not what its suffix says.
    """
    source, suffix = cleaned(path), split_suffix(path.name)[1].lower()
    if not suffix:
        raise BadInput(
            f"{source}: not a record file (known suffixes: {', '.join(sorted(SUFFIXES))}); convert or rename it"
        )
    if suffix not in _STORED:
        return text_table(path)
    file_bytes(path, 1)
    opens, kind = _STORED[suffix]
    table = _guarded(source, kind, opens, path, kind)

    def load(places: Sequence[int]) -> list[np.ndarray]:
        return _guarded(source, kind, table.load, places)

    return Table(source, table.columns, load, table.place, table.form)


def _guarded(source: str, kind: str, function, *arguments):
    try:
        with warnings.catch_warnings():  # theirs about the file; what matters here is told or refused
            warnings.simplefilter("ignore")
            return function(*arguments)
    except BadInput:
        raise
    except Exception as error:  # the libraries raise nearly anything on damaged files
        reason = cleaned(" ".join(str(error).split()) or type(error).__name__)
        raise BadInput(f"{source}: not readable as a {kind} ({reason[:120]}); save or copy it again") from error

"""Read arrays of NumPy archives (.npz); they are never unpickled."""

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..guard import check_archive
from ..options import ReadOptions
from ..table import Parts, Stored, array_table

kind, remedy = "a NumPy archive", "save it with numpy.savez"
suffixes = (".npz",)
begins = (b"PK",)


def tables(path: Path, options: ReadOptions) -> Parts:
    """Return the arrays of a NumPy archive; object arrays are refused, because they could execute code."""
    check_archive(path)
    with zipfile.ZipFile(path) as archive:
        members = [name for name in archive.namelist() if name.endswith(".npy")]
        arrays = {name.removesuffix(".npy"): _npy(archive, name) for name in members}
    stored = [Stored(n, v, fields=getattr(v, "dtype", np.dtype(int)).names or ()) for n, v in arrays.items()]
    return [[array_table(path, stored, "NumPy archive")]]


def _npy(archive: zipfile.ZipFile, name: str) -> np.ndarray | Callable[[], np.ndarray]:
    """Read one array of a NumPy archive; refuse a header that promises more data than the archive member holds.

    An error is reported only when the column is asked for.
    """
    try:
        data = io.BytesIO(archive.read(name))
        first = np.lib.format.read_magic(data) == (1, 0)
        read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(data)
        if dtype.hasobject:
            return np.empty(0, dtype=object)  # refused later as "not plain numbers"
        if int(np.prod(shape, dtype=object)) * dtype.itemsize > len(data.getbuffer()) - data.tell():
            raise ValueError(f"{name} ends too early")
        data.seek(0)
        return np.lib.format.read_array(data, allow_pickle=False)
    except Exception as error:  # zipfile and NumPy raise almost any error on damaged members
        damage = error

    def broken() -> np.ndarray:
        raise damage

    return broken

"""Arrays with names as tables: NumPy archives (.npz) and MATLAB files up to version 7 (.mat).

Nothing in them is unpickled; what is compressed is unfolded within limits, what is nested is counted first.
"""

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy

from .._errors import BadInput
from .table import Column, Table, as_column, check_columns, cleaned, file_bytes, sample
from .unfolding import check_archive, inflate

_COMPRESSED, _MATRIX, _CONTAINERS = 15, 14, (1, 2, 3)  # element types; classes cell, struct, object
_DEEPEST, _ELEMENTS = 4, 20_000


def npz_table(path: Path, kind: str) -> Table:
    """A `.npz` archive as a table; object arrays are refused, so nothing stored in it is ever executed.

    Raises:
        BadInput: not an archive, too many columns, unfolding to too much.
    """
    source = cleaned(path)
    if not file_bytes(path, 4).startswith(b"PK"):
        raise BadInput(f"{source}: is not a NumPy archive as its suffix says; save it with numpy.savez")
    check_archive(path)
    with zipfile.ZipFile(path) as archive:
        members = [name for name in archive.namelist() if name.endswith(".npy")]
    check_columns(len(members), source)
    columns = tuple(Column(cleaned(name.removesuffix(".npy"))) for name in members)

    def load(places: Sequence[int]) -> list[np.ndarray]:
        with zipfile.ZipFile(path) as archive:
            return [as_column(_npy(archive, members[k]), columns[k].name, source) for k in places]

    return Table(source, columns, load, sample, kind)


def _npy(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """One array of an archive, whose header may not promise more than the member holds."""
    with archive.open(name) as file:
        data = io.BytesIO(file.read())
    version = np.lib.format.read_magic(data)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(data)
    if dtype.hasobject:
        return np.empty(0, dtype=object)  # refused as "not plain numbers"
    if int(np.prod(shape, dtype=object)) * dtype.itemsize > len(data.getbuffer()) - data.tell():
        raise ValueError(f"{name} ends too early")
    data.seek(0)
    return np.lib.format.read_array(data, allow_pickle=False)


def mat_table(path: Path, kind: str) -> Table:
    """A MATLAB file of version 5 to 7 as a table: its variables, or the fields of its one struct.

    Raises:
        BadInput: nested deeper than a struct of vectors, too many columns, unfolding to too much.
    """
    source = cleaned(path)
    data = _flat(file_bytes(path), source)
    stored = scipy.io.loadmat(data, struct_as_record=True)
    variables = {name: value for name, value in stored.items() if not name.startswith("__")}
    structs = [value for value in variables.values() if value.dtype.names and value.size == 1]
    if len(structs) == 1:
        inside = structs[0].reshape(-1)[0]
        variables = {n: v for n, v in variables.items() if not v.dtype.names}
        variables |= {name: np.asarray(inside[name]) for name in structs[0].dtype.names}
        kind += ", fields of a struct"
    check_columns(len(variables), source)
    text = next((v for n, v in variables.items() if n.lower() in ("unit", "units", "einheiten")), None)
    vectors = [name for name, v in variables.items() if v.dtype.kind in "fiubc" and v.size > 1]
    said = (
        []
        if text is None or text.dtype.kind != "U"
        else re.split(r"[\s,;]+", " ".join(map(str, text.reshape(-1))).strip())
    )
    units = dict(zip(vectors, said, strict=True)) if len(said) == len(vectors) else {}
    names = list(variables)
    columns = tuple(Column(cleaned(name), units.get(name)) for name in names)

    def load(places: Sequence[int]) -> list[np.ndarray]:
        return [as_column(variables[names[k]], columns[k].name, source) for k in places]

    return Table(source, columns, load, sample, kind)


def _flat(data: bytes, source: str) -> io.BytesIO:
    """The file with its elements unfolded, none nested deeper than a struct of vectors."""
    order = "<" if data[126:128] == b"IM" else ">"
    pieces, at, unfolded, left = [data[:128]], 128, 0, [_ELEMENTS]
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if size > len(data) - at - 8:
            raise BadInput(f"{source}: the MATLAB file ends too early (truncated); copy the file again")
        element = data[at : at + 8 + size]
        at += 8 + size
        if kind == _COMPRESSED:
            try:
                element = inflate(element[8:], source, size=len(data), begun=unfolded)
            except zlib.error as error:
                raise BadInput(f"{source}: damaged MATLAB file ({error}); copy the file again") from None
            unfolded += len(element)
        _check_nesting(memoryview(element), order, source, left)
        pieces.append(element)
    return io.BytesIO(b"".join(pieces))


def _check_nesting(element: memoryview, order: str, source: str, left: list[int], depth: int = 0) -> None:
    """Refuse cells in structs in cells: scipy's reader calls itself for each and has no bottom."""
    left[0] -= 1
    if depth > _DEEPEST or left[0] < 0:
        raise BadInput(f"{source}: nested too deeply or in too many parts; store one vector per variable")
    if len(element) < 24 or struct.unpack_from(f"{order}I", element)[0] != _MATRIX:
        return
    if struct.unpack_from(f"{order}I", element, 16)[0] & 0xFF not in _CONTAINERS:
        return
    at = 8
    while at + 8 <= len(element):
        kind, size = struct.unpack_from(f"{order}II", element, at)
        if kind >> 16:  # a small element: size and data within eight bytes
            at += 8
            continue
        if kind == _MATRIX:
            _check_nesting(element[at : at + 8 + size], order, source, left, depth + 1)
        at += 8 + size + (-size) % 8

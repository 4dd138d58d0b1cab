"""Read MATLAB files: variables and fields of structs up to version 7 (SciPy), HDF5 from version 7.3.

SciPy's reader does not limit its recursion, so a file is first decompressed, and refused if it is nested deeply.
"""

import io
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import scipy

from ....common.errors import BadInput
from ....common.units import kind_of, spelt
from ..guard import file_bytes, inflate
from ..names import read_header
from ..options import ReadOptions
from ..table import Parts, Stored, Table, array_table
from . import hdf5

kind, remedy = "a MATLAB file", "save it from MATLAB with -v7 or -v7.3"
suffixes = (".mat",)
begins = (b"MATLAB", b"\x89HDF")
_MATRIX = 14  # type of an element


def tables(path: Path, options: ReadOptions) -> Parts:
    """Return the variables of a MATLAB file, and the fields of its structs that hold vectors."""
    if h5py.is_hdf5(path):
        return hdf5.tables(path, options, "MATLAB file v7.3")
    stored = {n: v for n, v in scipy.io.loadmat(_flat(file_bytes(path))).items() if not n.startswith("__")}
    # MathWorks does not publish how tables, strings and datetimes are stored
    objects = [n for n, v in stored.items() if type(v).__name__ == "MatlabOpaque"]
    plain = {n: v for n, v in stored.items() if not v.dtype.names and n not in objects}
    groups = {n: dict(_fields(v)) for n, v in stored.items() if v.dtype.names and n not in objects}
    groups = {n: fields for n, fields in groups.items() if _vectors(fields)}
    if objects and not groups and not _vectors(plain):
        raise BadInput(hdf5.objects(objects))
    if options.split_by == "group" and groups:
        return [[_variables(path, fields, ", fields of a struct", n)] for n, fields in groups.items()]
    # one struct is the recording; with several, the struct's name is part of the column's
    if len(groups) == 1:
        return [[_variables(path, plain | next(iter(groups.values())), ", fields of a struct")]]
    return [[_variables(path, plain | {f"{n}/{f}": v for n, fields in groups.items() for f, v in fields.items()}, "")]]


def _fields(structs: np.ndarray, place: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Yield the fields of structs by name; data of ControlDesk and Simulink by the name stored beside them."""
    for k, one in enumerate(structs.reshape(-1)):
        fields = {f: np.asarray(one[f]) for f in structs.dtype.names or ()}
        # X(k).Data beside X(k).Name and X(k).Unit: name and unit are values, not fields
        data = next((v for f, v in fields.items() if f.lower() in ("data", "values") and v.dtype.kind in "fiu"), None)
        words = {f.lower(): str(v.item()) for f, v in fields.items() if v.dtype.kind == "U" and v.size == 1}
        name = words.get("name", words.get("label"))
        if data is not None and name is not None:
            unit = f" ({words['unit']})" if words.get("unit") else ""
            yield (name or f"{place}[{k + 1}]") + unit, data
            continue
        for f, v in fields.items():
            cells = v.reshape(-1) if v.dtype.kind == "O" else [v]  # structs in a cell, one by one
            for inner in cells:
                name = f if structs.size == 1 and not place else f"{place}.{f}".lstrip(".")
                if isinstance(inner, np.ndarray) and inner.dtype.names:
                    yield from _fields(inner, name)
                elif len(cells) == 1 and isinstance(inner, np.ndarray):
                    yield name, inner


def _vectors(variables: dict[str, np.ndarray]) -> list[str]:
    return [name for name, v in variables.items() if v.dtype.kind in "fiubc" and v.size > 1]


def _variables(path: Path, variables: dict[str, np.ndarray], more: str, part: str = "") -> Table:
    """Return variables as a table, with the units of a `units` variable if each unit fits the variable's name."""
    text = next((v for n, v in variables.items() if n.lower() in ("unit", "units", "einheiten")), None)
    words = " ".join(map(str, text.reshape(-1))) if text is not None and text.dtype.kind == "U" else ""
    said = re.split(r"[\s,;]+", words.strip())
    names = _vectors(variables)
    fits = len(said) == len(names) and all(_fitting(n, unit) for n, unit in zip(names, said, strict=True))
    beside = dict(zip(names, said, strict=True)) if fits else {}
    return array_table(path, [Stored(n, v, beside.get(n)) for n, v in variables.items()], f"MATLAB file{more}", part)


def _fitting(name: str, unit: str) -> bool:
    """Return whether a unit fits a variable's name: units of time fit times only."""
    role, kind = read_header(name).role, kind_of(spelt(unit))
    return role is None or kind is None or (role == "time") == (kind == "time")


def _flat(data: bytes) -> io.BytesIO:
    """Decompress all elements of a MATLAB file; refuse variables nested deeper than a struct of vectors.

    Args:
        data: the whole file.

    Raises:
        BadInput: truncated, damaged, nested too deeply, or too large when unpacked.
    """
    # the mark MI in the byte order of the writer's machine
    order = "<" if data[126:128] == b"IM" else ">"
    pieces, at, unfolded, budget = [data[:128]], 128, 0, [20_000]
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if size > len(data) - at - 8:
            raise BadInput("the MATLAB file ends too early (truncated); copy the file again")
        element = data[at : at + 8 + size]
        at += 8 + size
        if kind == 15:  # a compressed element
            try:
                element = inflate(element[8:], size=len(data), begun=unfolded)
            except zlib.error as error:
                raise BadInput(f"damaged MATLAB file ({error}); copy the file again") from None
            unfolded += len(element)
        _check_nesting(memoryview(element), order, budget)
        pieces.append(element)
    return io.BytesIO(b"".join(pieces))


def _check_nesting(element: memoryview, order: str, budget: list[int], depth: int = 0) -> None:
    """Refuse deeply nested cells and structs, because SciPy's reader calls itself for each level."""
    budget[0] -= 1
    if depth > 4 or budget[0] < 0:
        raise BadInput("its variables are nested too deeply or have too many parts; store one vector per variable")
    if len(element) < 24 or struct.unpack_from(f"{order}I", element)[0] != _MATRIX:
        return
    if struct.unpack_from(f"{order}I", element, 16)[0] & 0xFF not in (1, 2, 3):  # cell, struct, object
        return
    at = 8
    while at + 8 <= len(element):
        kind, size = struct.unpack_from(f"{order}II", element, at)
        if kind >> 16:  # a small element: size and data within eight bytes
            at += 8
            continue
        if kind == _MATRIX:
            _check_nesting(element[at : at + 8 + size], order, budget, depth + 1)
        # elements are padded to eight bytes
        at += 8 + size + (-size) % 8

"""HDF5 files (.h5 .hdf5, and .mat of version 7.3) as tables: datasets at the root, or in its groups.

A link is followed only where it is a hard one: soft, external and virtual ones may lead out of the file.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from .._errors import BadInput
from .table import Column, Table, as_column, check_columns, check_unfolded, cleaned, sample

_TEXT = ("cell", "string", "table")


def hdf5_table(path: Path, kind: str) -> Table:
    """An HDF5 file as a table.

    Args:
        path: the file.
        kind: what it is called in messages.

    Raises:
        BadInput: unreadable, links out of it, more columns than reasonable, or unfolding to too much.
    """
    source = cleaned(path)
    with h5py.File(path, "r") as file:
        found = list(_datasets(file, source))
        columns = tuple(Column(cleaned(name), _unit(file[where])) for name, where in found)

    def load(places: Sequence[int]) -> list[np.ndarray]:
        with h5py.File(path, "r") as file:
            wanted: list[Any] = [file[found[k][1]] for k in places]
            check_unfolded(
                sum(d.size * d.dtype.itemsize for d in wanted if d.shape is not None), path.stat().st_size, source
            )
            return [as_column(_value(d), columns[k].name, source) for d, k in zip(wanted, places, strict=True)]

    return Table(source, columns, load, sample, kind)


def _datasets(file: Any, source: str) -> Iterator[tuple[str, str]]:
    """Name and path of every dataset at the root and in its groups; the group is named where several hold data."""
    check_columns(len(file), source)
    groups: dict[str, list[str]] = {"": []}
    for name in file:
        if name.startswith("#"):  # what MATLAB keeps for itself
            continue
        kind = _kind(file, name, source)
        if kind is h5py.Dataset:
            groups[""].append(name)
        elif kind is h5py.Group:
            check_columns(len(file[name]), source)
            groups[name] = [inner for inner in file[name] if _kind(file[name], inner, source) is h5py.Dataset]
    filled = [name for name, inside in groups.items() if inside]
    check_columns(sum(map(len, groups.values())), source)
    for group in filled:
        for name in groups[group]:
            full = f"{group}/{name}" if group else name
            yield (full if len(filled) > 1 else name), full


def _kind(group: Any, name: str, source: str):
    """Dataset or Group, of a hard link; refuses one that leads elsewhere."""
    link = group.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        raise BadInput(
            f"{source}: {cleaned(name)!r} is a link to {cleaned(getattr(link, 'filename', 'another place'))}, which is "
            "not followed; store the data themselves"
        )
    kind = group.get(name, getclass=True)
    if kind is h5py.Dataset and (group[name].external or group[name].is_virtual):
        raise BadInput(
            f"{source}: {cleaned(name)!r} keeps its data in another file, which is not read; store them here"
        )
    return kind


def _unit(dataset: Any) -> str | None:
    for name in ("unit", "units", "Unit", "Units"):
        value = dataset.attrs.get(name)
        if isinstance(value, bytes):
            return value.decode("utf-8", "replace")
        if isinstance(value, str):
            return value
    return None


def _value(dataset) -> np.ndarray:
    """A dataset as stored, minding that MATLAB v7.3 writes text as codes and empty arrays as their shape."""
    kind = dataset.attrs.get("MATLAB_class", b"")
    kind = kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)
    if kind == "char":
        return np.empty(0, dtype="S1")
    if kind in _TEXT or dataset.dtype.kind == "O":
        return np.empty(0, dtype=object)
    if dataset.attrs.get("MATLAB_empty", 0) or dataset.shape is None:
        return np.empty(0)
    return dataset[()]

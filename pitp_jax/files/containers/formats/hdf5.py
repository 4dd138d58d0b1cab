"""Read datasets of HDF5 files, at the root and in groups; only hard links are followed."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ....common.errors import BadInput, cleaned
from ..guard import check_columns, check_unfolded
from ..options import ReadOptions
from ..table import Parts, Stored, array_table

kind, remedy = "an HDF5 file", "save it again"
suffixes = (".h5", ".hdf5")
begins = (b"",)  # a block of the user's own may come first, and the library refuses other files


def tables(path: Path, options: ReadOptions, form: str = "HDF5 file") -> Parts:
    """Return the datasets of an HDF5 file, at the root and in groups; only hard links are followed."""
    with h5py.File(path, "r") as file:
        groups = _datasets(file)
        known = {where: _about(file[where]) for places in groups.values() for where in places}
        kinds = {where: _class_of(file[where]) for where in known}
    unread = [where for where, kind in kinds.items() if "." in kind or kind in ("timeseries", "timetable", "table")]
    signals = [w for w, k in kinds.items() if w not in unread and np.prod(known[w][1], dtype=float) > 1]
    if unread and len(signals) < 2:
        unread.sort(key=lambda where: "Dataset" not in kinds[where])
        raise BadInput(objects(unread, kinds[unread[0]]))
    split = options.split_by == "group" and len(groups) > 1
    parts = [{n: p} for n, p in groups.items()] if split else [groups]
    made = []
    for chosen in parts:
        full = len(chosen) > 1
        names = {where if full else where.rpartition("/")[2]: where for places in chosen.values() for where in places}
        stored = [Stored(name, partial(_dataset, path, where), *known[where]) for name, where in names.items()]
        made.append([array_table(path, stored, form, next(iter(chosen), "") if split else "")])
    return made


def _datasets(group: Any, above: str = "") -> dict[str, list[str]]:
    """Return the paths of all datasets in a group and its subgroups, by group."""
    check_columns(len(group))
    # by group, so that the same names in two groups stay apart
    groups: dict[str, list[str]] = {above: []}
    for name in group:
        if not above and name.startswith("#"):  # MATLAB's internal data
            continue
        kind, place = _kind(group, name), f"{above}/{name}".lstrip("/")
        if kind is h5py.Dataset:
            groups[above].append(place)
        elif kind is h5py.Group and above.count("/") < 2:  # a hard link may form a loop
            groups |= _datasets(group[name], place)
        # checked while walking, to stop at a hostile tree
        check_columns(sum(map(len, groups.values())))
    return {name: places for name, places in groups.items() if places}


def _kind(group: Any, name: str):
    """Return the class (Dataset or Group) behind a hard link; refuse a link that leads elsewhere."""
    link = group.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        raise BadInput(
            f"{cleaned(name)!r} is a link to {cleaned(getattr(link, 'filename', 'another place'))}, which "
            "is not followed; store the data in this file"
        )
    kind = group.get(name, getclass=True)
    if kind is h5py.Dataset and (group[name].external or group[name].is_virtual):
        raise BadInput(
            f"{cleaned(name)!r} keeps its data in another file, which is not read; store the data in this file"
        )
    return kind


def _class_of(dataset: Any) -> str:
    """Return MATLAB's class of a dataset; empty outside MATLAB files."""
    kind = dataset.attrs.get("MATLAB_class", b"")
    return kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)


def _about(dataset: Any) -> tuple[Any, tuple[int, ...], tuple[str, ...]]:
    """Return the unit, shape and field names of a dataset."""
    unit = next((dataset.attrs[n] for n in ("unit", "units", "Unit", "Units") if n in dataset.attrs), None)
    return unit, dataset.shape or (), dataset.dtype.names or ()


def _dataset(path: Path, where: str) -> np.ndarray:
    """Load a dataset; MATLAB v7.3's text and cells become an empty array, because they hold no numbers."""
    with h5py.File(path, "r") as file:
        dataset: Any = file[where]
        kind = _class_of(dataset)
        if kind == "char":
            return np.empty(0, dtype="S1")
        if kind in ("cell", "string", "table") or dataset.dtype.kind == "O":
            return np.empty(0, dtype=object)
        if dataset.attrs.get("MATLAB_empty", 0) or dataset.shape is None:
            return np.empty(0)
        check_unfolded(dataset.size * dataset.dtype.itemsize, path.stat().st_size)
        return dataset[()]


def objects(names: Sequence[str], kind: str = "") -> str:
    """Return what a MATLAB file of objects holds, and what to save instead."""
    named = ", ".join(cleaned(name) for name in names[:3] if name != "None") or "without a name"
    if "Simulink" in kind or "timeseries" in kind.lower():
        return (
            f"holds a Simulink data set ({named}), which only MATLAB can read; log as 'Structure with time', or save "
            f"vectors: d = {names[0]}; t = d{{1}}.Values.Time; u = d{{1}}.Values.Data; y = d{{2}}.Values.Data; "
            "save('run.mat', 't', 'u', 'y')"
        )
    return (
        f"holds a MATLAB object ({named}: string, table, timetable, datetime or a class), which only MATLAB can read; "
        "save vectors (of a table T: S = table2struct(T, 'ToScalar', true))"
    )

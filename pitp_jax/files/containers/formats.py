"""File formats: for each suffix, the function that opens a file as tables, one for each part (sheet, group).

.csv .txt .dat .tsv .lvm   text, each also .gz
.xlsx  .tdms               spreadsheets, LabVIEW (extras)
.mat                       MATLAB v5 to v7 (SciPy) or v7.3 (an HDF5 file)
.npz                       NumPy archive, never unpickled
.h5 .hdf5                  HDF5, datasets at the root or in its groups
.parquet .mcap             data frames and logs of robots (extra); a folder of rosbag2 is also one recording
"""

import io
import re
import zipfile
from collections.abc import Callable, Iterator, Sequence
from datetime import timedelta
from itertools import islice
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy

from ...common.errors import BadInput, cleaned
from ...common.units import kind_of, spelt
from .guard import check_archive, check_columns, check_unfolded, file_bytes, guarded
from .header import Rows, is_number, layouts
from .matlab import flat
from .names import read_header
from .options import ReadOptions
from .robot import bag, is_bag, parquet
from .table import Table, array_table
from .text import numbers_of, text_tables

_TEXT = (".csv", ".txt", ".dat", ".tsv", ".lvm")
_HEAD, _ROWS = 200, 1 << 20  # rows examined; the most a sheet has
_DEEPEST = 2  # groups below one of the root that are opened; a hard link may form a loop
Parts = list[list[Table]]  # of a file: every part, and every table that it may be


def _signed(path: Path, sign: bytes, what: str, remedy: str) -> None:
    """Refuse a file whose first bytes do not match its suffix."""
    if not file_bytes(path, max(len(sign), 4)).startswith(sign):
        raise BadInput(f"{cleaned(path)}: is not {what} as its suffix says; {remedy}")


def xlsx(path: Path, options: ReadOptions) -> Parts:
    """Return the sheets of an Excel workbook that hold a table of numbers."""
    _signed(path, b"PK", "an Excel workbook", "save it as .xlsx or CSV")
    check_archive(path)
    import openpyxl

    book = openpyxl.load_workbook(path, read_only=True, data_only=True, keep_links=False)
    parts, refusals = [], []
    try:
        titles = [cleaned(sheet.title) for sheet in book.worksheets]
        if options.sheet is not None and options.sheet not in titles:
            raise BadInput(f"{cleaned(path)}: has no sheet {options.sheet!r}; give --sheet one of {', '.join(titles)}")
        for sheet in book.worksheets:
            if options.sheet in (None, cleaned(sheet.title)):
                # the size that a sheet states is often wrong
                sheet.reset_dimensions()
                rows = list(enumerate(islice(sheet.iter_rows(values_only=True), _ROWS), 1))
                try:
                    parts.append(_sheet(path, rows, cleaned(sheet.title), options))
                except BadInput as error:
                    refusals.append(error)
    finally:
        book.close()
    if not parts:
        raise refusals[0] if refusals else BadInput(f"{cleaned(path)}: has no sheet; save it as CSV")
    return parts


def _sheet(path: Path, rows: list[tuple[int, tuple]], title: str, options: ReadOptions) -> list[Table]:
    """Return every way to read the numbered rows of one sheet as a table."""
    source, filled = cleaned(path), [(k, row) for k, row in rows if any(cell is not None for cell in row)]
    check_columns(max((len(row) for _, row in filled), default=0), source)
    width = max((len(row) for _, row in filled[:_HEAD]), default=0)
    decimal = options.decimal or ("," if _texts_with_commas(filled) else ".")
    cells = {k: [_shown(cell, decimal) for cell in (*row, *[None] * width)[:width]] for k, row in rows}
    numbers = [k for k, _ in filled[:_HEAD]]
    head = Rows([cells[k] for k in numbers], numbers, [False] * len(numbers))
    made = layouts(head, "\t", decimal, source, options.header_line, options.units_line)
    body = [k for k in cells if numbers[made[0].first] <= k <= filled[-1][0]]

    def place(sample: int) -> str:
        return f"sample {sample} (row {body[sample]})" if sample < len(body) else f"sample {sample}"

    def texts(k: int) -> np.ndarray:
        return np.array([cells[row][k] for row in body])

    def load(places: Sequence[int]) -> list[np.ndarray]:
        return [numbers_of(texts(k).tolist(), made[0], k, source, place) for k in places]

    return [
        Table(
            path, m.columns, load, place, ", ".join((f"Excel workbook, sheet {title!r}", *m.notes)), title, texts=texts
        )
        for m in made
    ]


def _shown(value: Any, decimal: str) -> str:
    """Return a cell as text; a time span as hours, minutes and seconds."""
    if isinstance(value, timedelta):
        minutes, seconds = divmod(value.total_seconds(), 60)
        return f"{minutes // 60:02.0f}:{minutes % 60:02.0f}:{seconds:09.6f}"
    if isinstance(value, float):
        return repr(value).replace(".", decimal)
    return "" if value is None else cleaned(value).strip()


def _texts_with_commas(rows: list[tuple[int, tuple]]) -> bool:
    """Return whether a sheet stores most numbers as texts with a decimal comma."""
    cells = [cell for _, row in rows[-_HEAD:] for cell in row if cell is not None]
    return 2 * sum(isinstance(c, str) and is_number(c.strip(), ",") for c in cells) > len(cells)


def tdms(path: Path, options: ReadOptions) -> Parts:
    """Return the channels of a LabVIEW TDMS file by group, each with its own clock if it is a waveform."""
    _signed(path, b"TDSm", "a TDMS file", "export it from LabVIEW again")
    from nptdms import TdmsFile

    groups = [group for group in TdmsFile.read(path).groups() if group.channels()]
    split, parts = options.split_by == "group" or len(groups) == 1, []
    check_columns(sum(len(group.channels()) for group in groups), cleaned(path))
    for chosen in [[group] for group in groups] if split else [groups]:
        named = {c.name if split else f"{c.group_name}/{c.name}": c for group in chosen for c in group.channels()}
        clocks = {name: _waveform(c.properties) for name, c in named.items() if c.properties.get("wf_increment")}
        beside = {name: str(c.properties.get("unit_string") or "") for name, c in named.items()}
        stored = {name: (lambda c=c: c[:]) for name, c in named.items()}
        parts.append([array_table(path, stored, "TDMS file", beside=beside, clocks=clocks, part=chosen[0].name)])
    return parts


def _waveform(properties: Any) -> tuple[float, float]:
    start = properties.get("wf_start_time")
    begin = 0.0 if start is None else float((np.datetime64(start) - np.datetime64(0, "s")) / np.timedelta64(1, "s"))
    return begin + float(properties.get("wf_start_offset") or 0), float(properties["wf_increment"])


def npz(path: Path, options: ReadOptions) -> Parts:
    """Return the arrays of a NumPy archive; object arrays are refused, because they could execute code."""
    _signed(path, b"PK", "a NumPy archive", "save it with numpy.savez")
    check_archive(path)
    with zipfile.ZipFile(path) as archive:
        members = [name for name in archive.namelist() if name.endswith(".npy")]
        stored = {name.removesuffix(".npy"): _npy(archive, name) for name in members}
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


def mat(path: Path, options: ReadOptions) -> Parts:
    """Return the variables of a MATLAB file, and the fields of its structs that hold vectors."""
    if h5py.is_hdf5(path):
        return hdf5(path, options, "MATLAB file v7.3")
    _signed(path, b"MATLAB", "a MATLAB file", "save it from MATLAB with -v7 or -v7.3")
    source = cleaned(path)
    stored = {n: v for n, v in scipy.io.loadmat(flat(file_bytes(path), source)).items() if not n.startswith("__")}
    # MathWorks does not publish how tables, strings and datetimes are stored
    objects = [n for n, v in stored.items() if type(v).__name__ == "MatlabOpaque"]
    plain = {n: v for n, v in stored.items() if not v.dtype.names and n not in objects}
    groups = {n: dict(_fields(v)) for n, v in stored.items() if v.dtype.names and n not in objects}
    groups = {n: fields for n, fields in groups.items() if _vectors(fields)}
    if objects and not groups and not _vectors(plain):
        raise BadInput(f"{source}: {_objects(objects)}")
    if options.split_by == "group" and groups:
        return [[_variables(path, fields, ", fields of a struct", n)] for n, fields in groups.items()]
    # one struct is the recording; with several, the struct's name is part of the column's
    if len(groups) == 1:
        return [[_variables(path, plain | next(iter(groups.values())), ", fields of a struct")]]
    return [[_variables(path, plain | {f"{n}/{f}": v for n, fields in groups.items() for f, v in fields.items()}, "")]]


def _objects(names: Sequence[str], kind: str = "") -> str:
    """Return what a MATLAB file of objects holds, and what to save instead."""
    named = ", ".join(map(cleaned, names[:3]))
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


def _fields(structs: np.ndarray, place: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Yield the fields of structs by name; data of ControlDesk and Simulink by the name stored beside them."""
    for k, one in enumerate(structs.reshape(-1)):
        fields = {f: np.asarray(one[f]) for f in structs.dtype.names or ()}
        # X(k).Data beside X(k).Name: the name is a value, not a field
        data = next((v for f, v in fields.items() if f.lower() in ("data", "values") and v.dtype.kind in "fiu"), None)
        names = [v for f, v in fields.items() if f.lower() in ("name", "label") and v.dtype.kind == "U" and v.size == 1]
        if data is not None and names:
            yield str(names[0].reshape(-1)[0]) or f"{place}[{k + 1}]", data
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
    return array_table(path, variables, f"MATLAB file{more}", beside=beside, part=part)


def _fitting(name: str, unit: str) -> bool:
    """Return whether a unit fits a variable's name: units of time fit times only."""
    role, kind = read_header(name).role, kind_of(spelt(unit))
    return role is None or kind is None or (role == "time") == (kind == "time")


def hdf5(path: Path, options: ReadOptions, kind: str = "HDF5 file") -> Parts:
    """Return the datasets of an HDF5 file, at the root and in groups; only hard links are followed."""
    source = cleaned(path)
    with h5py.File(path, "r") as file:
        groups = _datasets(file, source)
        known = {where: _about(file[where]) for places in groups.values() for where in places}
        kinds = {where: _class_of(file[where]) for where in known}
    objects = [where for where, kind in kinds.items() if "." in kind or kind in ("timeseries", "timetable", "table")]
    signals = [w for w, k in kinds.items() if w not in objects and np.prod(known[w][1], dtype=float) > 1]
    if objects and len(signals) < 2:
        objects.sort(key=lambda where: "Dataset" not in kinds[where])
        raise BadInput(f"{source}: {_objects(objects, kinds[objects[0]])}")
    split = options.split_by == "group" and len(groups) > 1
    parts = [{n: p} for n, p in groups.items()] if split else [groups]
    made = []
    for chosen in parts:
        full = len(chosen) > 1
        names = {where if full else where.rpartition("/")[2]: where for places in chosen.values() for where in places}
        stored, beside, shapes = {}, {}, {}
        for name, where in names.items():
            beside[name], shapes[name], fields = known[where]
            if fields:  # a table of PyTables or pandas: its fields are the columns
                stored |= {f: (lambda where=where, f=f: _dataset(path, where, source)[f]) for f in fields}
            else:
                stored[name] = lambda where=where: _dataset(path, where, source)
        part = next(iter(chosen), "") if split else ""
        made.append([array_table(path, stored, kind, beside=beside, shapes=shapes, part=part)])
    return made


def _datasets(group: Any, source: str, above: str = "") -> dict[str, list[str]]:
    """Return the paths of all datasets in a group and its subgroups, by group."""
    check_columns(len(group), source)
    # by group, so that the same names in two groups stay apart
    groups: dict[str, list[str]] = {above: []}
    for name in group:
        if not above and name.startswith("#"):  # MATLAB's internal data
            continue
        kind, place = _kind(group, name, source), f"{above}/{name}".lstrip("/")
        if kind is h5py.Dataset:
            groups[above].append(place)
        elif kind is h5py.Group and above.count("/") < _DEEPEST:
            groups |= _datasets(group[name], source, place)
        # checked while walking, to stop at a hostile tree
        check_columns(sum(map(len, groups.values())), source)
    return {name: places for name, places in groups.items() if places}


def _kind(group: Any, name: str, source: str):
    """Return the class (Dataset or Group) behind a hard link; refuse a link that leads elsewhere."""
    link = group.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        raise BadInput(
            f"{source}: {cleaned(name)!r} is a link to {cleaned(getattr(link, 'filename', 'another place'))}, which "
            "is not followed; store the data in this file"
        )
    kind = group.get(name, getclass=True)
    if kind is h5py.Dataset and (group[name].external or group[name].is_virtual):
        raise BadInput(
            f"{source}: {cleaned(name)!r} keeps its data in another file, which is not read; store the data in this "
            "file"
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


def _dataset(path: Path, where: str, source: str) -> np.ndarray:
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
        check_unfolded(dataset.size * dataset.dtype.itemsize, path.stat().st_size, source)
        return dataset[()]


_STORED: dict[str, tuple[Callable[[Path, ReadOptions], Parts], str]] = {
    ".xlsx": (xlsx, "Excel workbook"),
    ".tdms": (tdms, "TDMS file"),
    ".mat": (mat, "MATLAB file"),
    ".npz": (npz, "NumPy archive"),
    ".h5": (hdf5, "HDF5 file"),
    ".hdf5": (hdf5, "HDF5 file"),
    ".parquet": (parquet, "Parquet file"),
    ".mcap": (bag, "robot log"),
}
SUFFIXES = (*(f"{suffix}.gz" for suffix in _TEXT), *_TEXT, *_STORED)


def split_suffix(name: str) -> tuple[str, str]:
    """Split a file name into stem and suffix; the suffix is empty if it is not one of a recording file.

    Capital suffixes (`.CSV`, `.MAT`) count too.
    """
    for suffix in SUFFIXES:
        if name.lower().endswith(suffix) and len(name) > len(suffix):
            return name[: -len(suffix)], name[-len(suffix) :]
    return name, ""


_UNREAD = {  # suffix: what it is, and what to save instead
    (".pt", ".pth", ".ckpt"): "a file of torch.save, which may run code when it is opened; save its arrays with "
    "numpy.savez (.npz) or as CSV",
    (".pkl", ".pickle", ".joblib", ".npy"): "a file of Python or of one array; save named arrays with numpy.savez "
    "(.npz) or as CSV",
    (".xls", ".ods", ".numbers"): "a spreadsheet of another kind; save it as .xlsx or CSV",
    (".mf4", ".mdf", ".dxd", ".bag", ".db3", ".slx", ".m"): "not read; export its signals as CSV, MAT or MCAP",
}


def unread(name: str) -> str:
    """Return what a file is that is not read, by its suffix, and what to save instead."""
    said = next((text for ends, text in _UNREAD.items() if name.lower().endswith(ends)), None)
    return said or "not a recording file; convert or rename it"


def open_parts(path: Path, options: ReadOptions) -> Parts:
    """Open every part of a file as the tables that it may be; errors of file libraries become BadInput.

    Raises:
        BadInput: unknown suffix, or the file is not what its suffix says.
    """
    source, suffix = cleaned(path), ".mcap" if is_bag(path) else split_suffix(path.name)[1].lower()
    if not suffix:
        raise BadInput(f"{source}: {unread(path.name)} (known suffixes: {', '.join(sorted(SUFFIXES))})")
    if suffix not in _STORED:
        return [text_tables(path, options)]
    for file in path.iterdir() if path.is_dir() else [path]:
        file_bytes(file, 1)
    opens, kind = _STORED[suffix]
    return guarded(source, kind, opens, path, options)

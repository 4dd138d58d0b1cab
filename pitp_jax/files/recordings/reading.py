"""Read files and folders into checked records in base units.

    files -> (time, input, output) columns in base units -> faults masked -> uniform grid -> Record

The name of a record is its file name without the suffix; where names collide in one call the parent folders go in front
(`clean/sine0`). One message reports the missing information of all files.
"""

import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from glob import glob
from pathlib import Path
from typing import Any

import numpy as np

from ...common.errors import BadInput, cleaned
from ...common.units import base_unit, from_base
from ...method.signal.checks import MIN_SAMPLES, TIME_TOLERANCE, check_samples, check_wanted
from ...method.signal.record import Record
from ...method.signal.sets import RATE_TOLERANCE, check_set
from ...method.signal.target import Target
from ..containers.columns import Loaded, load_columns
from ..containers.formats import SUFFIXES, is_bag, split_suffix, unread
from ..containers.options import OPTIONS, ReadOptions, joined_in
from ..containers.refusal import Refused, about, together
from .grid import Gridded, on_grid
from .outliers import Masked, mask_faults
from .plausible import questions, refuse_implausible
from .remarks import Remark
from .selection import select_range
from .stamps import usable_rows
from .turns import unwrap

_NOTES = ("readme", "notes", "note", "license", "licence", "info")
_QUANTITIES = ("time", "voltage", "displacement")


def read(*paths: str | os.PathLike, **said: Any) -> tuple[Record, ...]:
    """Read recordings from any mix of files and folders.

    Folders do not recurse; their files are taken in sorted order, files that are not records are ignored. A record with
    a gap too long to fill is split there (`name.1`, `name.2`). These options take precedence over `pitp.toml` in the
    folder of a file, which takes precedence over recognised values.

    Args:
        *paths: files (text, `.xlsx`, `.mat`, `.npz`, `.h5`, `.tdms`, `.parquet`, `.mcap`), rosbag2 folders, and
            folders of them.
        **said: by name, all optional: the fields of `ReadOptions`, which are the options of the command line with `_`
            for `-` (`time_column`, `input_unit`, `output_scale`, `input_offset`, `rate`, `split_by`, `join`, ...);
            `from_s` and `to_s` are a range of time, `joint` is one of those that `each` in `pitp.toml` names.

    Returns:
        the records, in the order given, in base units (s, V, m, rad, ...); missing output is nan. `recognised`
            describes the reading.

    Raises:
        BadInput: nothing to read, or files are refused: one line with all of them (file, column, sample, remedy).

    Examples:
        >>> records = read("recordings/", input_scale=1000.0)  # doctest: +SKIP
    """
    records, refused, files = _attempted(paths, options_of(said))
    if refused:
        raise together(refused, files)
    check_set(records)
    return tuple(records)


def read_each(
    paths: Sequence[str | os.PathLike], reading: Mapping[str, Any]
) -> tuple[tuple[Record, ...], dict[str, str]]:
    """Read every readable file, whatever its rate and kind; return the records, and the refusals by record name.

    Args:
        paths: files and folders.
        reading: keyword arguments of `read`.

    Raises:
        BadInput: no such file or folder, options that no file could be read with, or nothing could be read.
    """
    records, refused, files = _attempted(paths, options_of(reading))
    if not records:
        raise together(refused, files)
    return tuple(records), {name: str(error) for name, error in refused.items()}


def options_of(said: Mapping[str, Any]) -> ReadOptions:
    """Convert keyword arguments of `read` to reading options.

    Raises:
        BadInput: an unknown name or value.
    """
    strange = [name for name in said if name not in ReadOptions.__dataclass_fields__]
    if strange:
        raise BadInput(
            f"{strange[0]!r} is not an option of reading; the options are {', '.join(ReadOptions.__dataclass_fields__)}"
        )
    files = said.get("join")
    if files is not None:
        names = [files] if isinstance(files, (str, os.PathLike)) else files
        said = {**said, "join": tuple(os.fspath(_existing(name)) for name in names)}
    return ReadOptions(**said)


def attempted(
    paths: Sequence[str | os.PathLike], options: ReadOptions, quantities: Sequence[str], make: Callable[..., Sequence]
) -> tuple[list, dict[str, Refused], int]:
    """Apply `make(path, label, columns)` to every part of every file; return results, refusals and number of files.

    Args:
        paths: files and folders.
        options: their options.
        quantities: of `time`, `voltage`, `displacement`.
        make: function from a file, the label of a part and its columns to a list.
    """
    # names first, because a record's label depends on all the others
    files = _without_joined(files_of(paths), options)
    made: list = []
    refused: dict[str, Refused] = {}
    for file, name in zip(files, names_of(files), strict=True):
        try:
            with about(file):
                parts = load_columns(file, options, quantities)
                labels = [f"{name}.{cleaned(one.label)}" if one.label else name for one in parts]
                made += [piece for label, one in zip(labels, parts, strict=True) for piece in make(file, label, one)]
        except Refused as error:
            refused[name] = error
    return made, refused, len(files)


def _without_joined(files: list[Path], options: ReadOptions) -> list[Path]:
    """Return the files without those that another file joins as its columns, unless none would remain."""
    joined = {os.path.realpath(other) for file in files for other in options.join or joined_in(file)}
    return [file for file in files if os.path.realpath(file) not in joined] or files


def _attempted(paths, options: ReadOptions) -> tuple[list[Record], dict[str, Refused], int]:
    """Read files; return records, refusals by name, and number of files. Uneven clocks are resampled at one rate."""
    sources: list[tuple[Path, str, Loaded]] = []

    def make(path: Path, name: str, one: Loaded) -> list[list[Record]]:
        made = _records(path, name, one)
        sources.append((path, name, one))
        return [made]

    groups, refused, files = attempted(paths, options, _QUANTITIES, make)
    uneven = [k for k, group in enumerate(groups) if group[0].recognised["uneven"]]
    if uneven and len(groups) > 1:
        even = [group[0].dt for group in groups if not group[0].recognised["uneven"]]
        dt = even[0] if even else float(np.median([groups[k][0].dt for k in uneven]))
        for k in uneven:
            groups[k] = _records(*sources[k], 1 / dt)
    # a slow motion may not show that its values stand, but another recording of the same log does
    slow = next((k for k, source in enumerate(sources) if source[2].stands > 1), None)
    if slow is not None:
        dt, stands = groups[slow][0].dt, sources[slow][2].stands
        for k, (_, _, one) in enumerate(sources):
            if one.stands == 1 and abs(groups[k][0].dt * stands / dt - 1) < RATE_TOLERANCE:
                groups[k] = _records(*sources[k], 1 / dt)
    return _unique([record for group in groups for record in group]), refused, files


def _unique(records: list[Record]) -> list[Record]:
    """Make the record names unique (a.csv split at its gap may collide with a.1.csv)."""
    taken: set[str] = set()
    kept = []
    for record in records:
        name = record.name
        # a mark that neither a suffix nor a split adds
        while name in taken:
            name += "'"
        taken.add(name)
        kept.append(record if name == record.name else replace(record, name=name))
    return kept


def read_target(path: str | os.PathLike, output_column: str | None = None, **said: Any) -> Target:
    """Read a wanted motion (time and displacement) from a file and ignore other columns.

    Args:
        path: one file of the known formats.
        output_column: exact header of the displacement.
        **said: `time_column`, units, `output_scale` and the others as for `read`.

    Returns:
        the target in base units.

    Raises:
        BadInput: as for a record, and if a sample is missing.

    Examples:
        >>> pitp.read_target(folder / "target.csv").displacement_unit
        'mm'
    """
    path, source = _existing(path), cleaned(path)
    options = options_of({**said, "output_column": output_column})
    with about(path):
        if path.is_dir():
            raise BadInput("is a folder; give one target file")
        loaded = load_columns(path, options, ("time", "displacement"))
        if len(loaded) > 1:
            raise BadInput(f"holds {len(loaded)} recordings; give one target file")
        one = select_range(loaded[0])
        time, wanted = one.values["time"], one.values["displacement"]
        columns = one.chosen["time"].name, one.chosen["displacement"].name
        _, wanted, _ = unwrap(np.zeros_like(time), wanted, ("V", base_unit(one.unit("displacement"))))
        # a target has no voltage: zeros replace it
        named = columns[0], "voltage", columns[1]
        check_samples(time, np.zeros_like(time), wanted, source, named, one.place, least=2)
        check_wanted(time, wanted, source, columns, one.place)
    return Target(time, wanted, one.unit("displacement"), os.fspath(path))


def _existing(path: str | os.PathLike) -> Path:
    try:
        made = Path(path)
    except TypeError:
        raise BadInput(
            f"{path!r}: a {type(path).__name__} is not a path; give files and folders one by one, as text"
        ) from None
    try:
        os.stat(made)
    except (OSError, ValueError) as error:
        if isinstance(error, FileNotFoundError):
            raise BadInput(f"{cleaned(made)}: no such file or folder; check the path") from None
        raise BadInput(f"{cleaned(made)!r}: not a usable path ({cleaned(error)}); correct it") from None
    return made


def _unfolded(paths: Sequence[str | os.PathLike]) -> Iterator[str | os.PathLike]:
    """Yield the paths with `*` and `?` expanded, which Windows shells leave to the program."""
    for path in paths:
        pattern = isinstance(path, (str, os.PathLike)) and not os.path.exists(path) and str(path)
        # a file with exactly that name wins over matches of its pattern
        matches = sorted(glob(pattern)) if pattern and set("*?") & set(pattern) else []
        yield from matches or [path]


def files_of(paths: Sequence[str | os.PathLike]) -> list[Path]:
    """Return the recording files among the given files and in the given folders, in order.

    Raises:
        BadInput: none given, one that does not exist, a folder without any.
    """
    if not paths:
        raise BadInput("no recordings given; give at least one file or folder")
    files: list[Path] = []
    for path in map(_existing, _unfolded(paths)):
        if not path.is_dir() or is_bag(path):
            files.append(path)
            continue
        try:
            inside = sorted(path.iterdir())
        except OSError as error:
            raise BadInput(
                f"{cleaned(path)}: cannot list the folder: {error.strerror or error}; check its access rights"
            ) from None
        # read-mes and pictures beside the recordings are not records
        inside = [file for file in inside if _is_record(file)]
        if not inside:
            other = next((file.name for file in sorted(path.iterdir()) if file.is_file()), "")
            here = f" Here lies {cleaned(other)}: {unread(other)}." if other else ""
            raise BadInput(
                f"{cleaned(path)}: no recording files in this folder (subfolders are not searched); give the folder "
                f"that holds the files ({', '.join(s for s in SUFFIXES if not s.endswith('.gz'))}).{here}"
            )
        files.extend(inside)
    return files


def _is_record(file: Path) -> bool:
    """Return whether a file of a folder is taken as a recording: it has a suffix and is not hidden or a read-me."""
    stem, suffix = split_suffix(file.name)
    note = suffix.lower() == ".txt" and stem.lower().replace("-", "").replace("_", "") in _NOTES
    return is_bag(file) or (
        os.path.isfile(file) and not file.name.startswith((".", "~$")) and bool(suffix) and not note
    )


def names_of(files: Sequence[Path]) -> list[str]:
    """Return one unique record name per file; names that collide get as many parent folders as necessary.

    Raises:
        BadInput: a file given twice, or two of one folder that differ only in their suffix.
    """
    # links and relative paths: the file itself counts
    real = [Path(os.path.realpath(file)) for file in files]
    stems, depth = [cleaned(split_suffix(file.name)[0]) for file in files], [0] * len(files)
    names = list(stems)
    while twice := [name for name, count in Counter(names).items() if count > 1]:
        for name in twice:
            same = [k for k, other in enumerate(names) if other == name]
            first, second = same[:2]
            if real[first] == real[second]:
                raise BadInput(f"{cleaned(files[second])}: given twice; give each recording once")
            if real[first].parent == real[second].parent:
                raise BadInput(
                    f"{cleaned(files[second])}: gives the same recording name {name!r} as {cleaned(files[first])}; "
                    "rename one of the two"
                )
            for k in same:
                # one folder more in front, until the names differ
                depth[k] += 1
                folders = [cleaned(part) for part in real[k].parent.parts[1:][-depth[k] :]]
                names[k] = "/".join((*folders, stems[k]))
    return names


def mended(one: Loaded, rate: float | None = None) -> tuple[Masked, Gridded]:
    """Check a file's columns, mask sensor faults and put the samples on a uniform grid; zeros replace a missing output.

    Args:
        one: the columns.
        rate: of the grid, Hz, if neither the user nor the clock gives one.

    Raises:
        BadInput: unusable samples, impossible values, time that decreases or repeats.
    """
    time, voltage, source = one.values["time"], one.values["voltage"], cleaned(one.table.path)
    output = one.values.get("displacement")
    displacement = np.zeros(len(time)) if output is None else output
    names = {q: choice.name for q, choice in one.chosen.items()}
    columns = names["time"], names["voltage"], names.get("displacement", "displacement")
    least = MIN_SAMPLES if output is not None else 2
    check_samples(time, voltage, displacement, source, columns, one.place, uniform=False, least=least)
    units = base_unit(one.unit("voltage")), "m" if output is None else base_unit(one.unit("displacement"))
    refuse_implausible(voltage, displacement, units, columns[1:], one.place)
    turns = 0, 0
    if output is not None:
        voltage, displacement, turns = unwrap(voltage, displacement, units)
    rate = one.options.rate if rate is None else rate
    rows = usable_rows(time, voltage, displacement, source, columns[0], one.place, rate)
    try:
        # before the grid, because interpolation would spread a spike
        masked = mask_faults(rows.displacement, rows.voltage) if output is not None else Masked(rows.displacement)
        masked = replace(masked, turns=turns)
        return masked, on_grid(replace(rows, displacement=masked.displacement), rate)
    except BadInput as error:
        remedy = {"--rate": "RATE"} if rate is None and "--rate" in str(error) else None
        raise Refused(f"column {columns[0]!r}: {error}", remedy) from None


def _records(path: Path, name: str, one: Loaded, rate: float | None = None) -> list[Record]:
    one = select_range(one)
    drive, unit = one.unit("voltage"), one.unit("displacement")
    masked, put = mended(one, rate)
    remarks = _remarks(name, masked, put, unit)
    seen = {
        "file": one.table.form,
        **{OPTIONS[quantity]: one.words(quantity) for quantity in _QUANTITIES},
        "jitter": put.jitter,
        "uneven": put.uneven and one.options.rate is None,
        "outliers": masked.outliers,
        "clipped": masked.clipped,
        **({"limit": masked.limit} if masked.clipped else {}),
        "remarks": [f"{remark.record}: {remark}" for remark in remarks],
        "findings": remarks,
        "options": _beside(one.options, path).said(),
    }
    records = []
    for label, piece in zip(put.names(name), put.pieces, strict=True):
        own = seen | {"lost": piece.lost}
        if records:  # the remarks are listed once
            own |= {"remarks": [], "findings": []}
        signals = (piece.time, piece.voltage, piece.displacement)
        records.append(Record(label, *signals, drive, unit, os.fspath(path), own))
    return records


def _beside(options: ReadOptions, path: Path) -> ReadOptions:
    """Return reading options for the `pitp.toml` beside a file, with joined files relative to that folder."""
    if options.join is None:
        return options
    return replace(options, join=tuple(os.path.relpath(other, path.parent) for other in options.join))


def _remarks(name: str, masked: Masked, put: Gridded, unit: str) -> list[Remark]:
    """List remarks on what was changed in a record while reading."""
    far, limit = (f"{from_base(value, unit):.4g} {unit}" for value in (masked.largest, masked.limit))
    notes = questions(put.rows.voltage, put.rows.displacement, base_unit(unit))
    if len(put.pieces) > 1:
        notes.append(f"split at its gaps into {len(put.pieces)} recordings")
    seen = [
        Remark("input_turns", name, masked.turns[0]),
        Remark("output_turns", name, masked.turns[1]),
        Remark("outliers", name, masked.outliers, f"such as {far}"),
        Remark("clipped", name, masked.clipped, limit),
        Remark("unseen", name, masked.unseen, limit),
        Remark("held", name, masked.held),
        *clock_remarks(name, put),
    ]
    return [remark for remark in seen if remark.value] + [Remark("note", name, detail=note) for note in notes]


def clock_remarks(name: str, put: Gridded) -> list[Remark]:
    """List remarks on what was changed in the time of a record while reading."""
    rows, count = put.rows, len(put.rows.time)
    jitter = put.jitter * (put.jitter > TIME_TOLERANCE and not put.packets)
    first = put.pieces[0].time
    rate = f"{(len(first) - 1) / np.ptp(first):.4g} Hz"
    steps = f"steps of {put.steps[0]:.3g} to {put.steps[1]:.3g} s, {rate}" if put.steps is not None else ""
    seen = [
        Remark("turns", name, rows.turns),
        Remark("sorted", name, rows.sorted),
        Remark("doubled", name, rows.doubled),
        Remark("averaged", name, rows.averaged),
        Remark("counted", name, count * rows.counted),
        Remark("packets", name, count * put.packets, rate),
        Remark("resampled" if put.uneven else "regridded", name, count * (put.steps is not None), steps),
        Remark("bridged", name, put.bridged),
        Remark("jitter", name, jitter),
        Remark("lost", name, sum(piece.lost for piece in put.pieces)),
        Remark("dropped", name, put.dropped),
    ]
    return [remark for remark in seen if remark.value]

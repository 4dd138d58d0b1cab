"""Files and folders to records, in base units and checked.

    files -> table -> (time, input, output) columns -> base units -> faults masked -> uniform grid -> Record

The name of a record is its file name less exactly the known suffix; where names collide in one call the
parent folder goes in front (`clean/sine0`). What every file lacks is told in one message.
"""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._errors import BadInput
from .checks import TIME_TOLERANCE, check_samples, check_wanted
from .choice import Choice, choose_columns
from .formats import open_table, split_suffix
from .grid import on_grid
from .options import OPTIONS, ReadOptions
from .outliers import Masked, mask_faults
from .plausible import doubts, refuse_implausible
from .record import Record
from .sets import check_set
from .table import Table, cleaned
from .units import base_unit, from_base, to_base

_NOTES = ("readme", "notes", "note", "license", "licence", "info")


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
    *paths: str | os.PathLike,
    time_column: str | None = None,
    input_column: str | None = None,
    output_column: str | None = None,
    time_unit: str | None = None,
    input_unit: str | None = None,
    output_unit: str | None = None,
    input_scale: float | None = None,
    output_scale: float | None = None,
    rate: float | None = None,
) -> tuple[Record, ...]:
    """Read any mix of record files and folders of them.

    Folders do not recurse; their files are taken in sorted order, files that are not records are ignored. A record with
    a gap too long to fill is split there (`name.1`, `name.2`).

    Args:
        *paths: files (text, `.xlsx`, `.mat`, `.npz`, `.h5`, `.tdms`) and folders.
        time_column: exact header of the time; the others likewise. By default names and units in the headers decide.
        input_column: of the voltage.
        output_column: of the displacement.
        time_unit: `s`, `ms`, `us`, `ns` or `min`, over what the file says.
        input_unit: `V`, `kV` or `mV`.
        output_unit: `m`, `mm`, `um`, `cm`, `nm`, `V` or `mV`.
        input_scale: V per V of the input column, for an amplifier's monitor (1 V per kV: 1000).
        output_scale: m per V of the output column, for a sensor's voltage (2 mm per V: 0.002).
        rate: samples per second, for files without time.

    Returns:
        the records, in the order given, in s, V and m (or V); missing output is nan. `recognised` says what was read.

    Raises:
        BadInput: nothing to read, or files are refused: one line with all of them (file, column, sample, remedy).

    Examples:
        >>> records = read("recordings/", input_scale=1000.0)  # doctest: +SKIP
    """
    options = ReadOptions(
        time_column, input_column, output_column, time_unit, input_unit, output_unit, input_scale, output_scale, rate
    )
    found, refused = _attempted(paths, options)
    if refused:
        raise BadInput(together(list(refused.values()), len(refused) + len(found)))
    records = [record for pieces in found.values() for record in pieces]
    check_set(records)
    return tuple(records)


def read_each(
    paths: Sequence[str | os.PathLike], reading: Mapping[str, Any]
) -> tuple[tuple[Record, ...], dict[str, str]]:
    """Whatever can be read, of any rates and kinds; and the refusal of every other file by its record's name.

    Args:
        paths: files and folders.
        reading: keyword arguments of `read`.

    Raises:
        BadInput: no such file or folder, two records of one name, or options that no file could be read with.
    """
    found, refused = _attempted(paths, ReadOptions(**reading))
    return tuple(record for pieces in found.values() for record in pieces), refused


def _attempted(paths, options: ReadOptions) -> tuple[dict[str, list[Record]], dict[str, str]]:
    """Records and refusals by name."""
    files = files_of(paths)
    found: dict[str, list[Record]] = {}
    refused: dict[str, str] = {}
    for file, name in zip(files, names_of(files), strict=True):
        try:
            found[name] = _read_one(file, name, options)
        except BadInput as error:
            refused[name] = str(error)
    return found, refused


def together(refusals: list[str], files: int) -> str:
    """All refusals in one line, alike ones once."""
    if len(refusals) == 1:
        return refusals[0]
    alike: dict[str, list[str]] = {}
    for refusal in refusals:
        source, _, why = refusal.partition(": ")
        alike.setdefault(why, []).append(source)
    lines = [f"{', '.join(sources)}: {why}" for why, sources in alike.items()]
    return f"{len(refusals)} of {files} files are refused: " + " | ".join(lines)


def read_target(
    path: str | os.PathLike,
    output_column: str | None = None,
    *,
    time_column: str | None = None,
    time_unit: str | None = None,
    output_unit: str | None = None,
    output_scale: float | None = None,
) -> Target:
    """Read a wanted trajectory: time and displacement, whatever else the file holds.

    Args:
        path: one file of the known formats.
        output_column: exact header of the displacement; it, time_column and units as for `read`.
        time_column: of the time.
        time_unit: of the time.
        output_unit: of the displacement.
        output_scale: m per V of the output column.

    Returns:
        the target in s and m (or V).

    Raises:
        BadInput: as for a record, and where a sample is missing.

    Examples:
        >>> pitp.read_target(folder / "target.csv").displacement_unit
        'mm'
    """
    path = _existing(path)
    if path.is_dir():
        raise BadInput(f"{cleaned(path)}: is a folder; give one target file")
    options = ReadOptions(time_column, None, output_column, time_unit, None, output_unit, None, output_scale)
    table = open_table(path)
    chosen = choose_columns(table, options, ("time", "displacement"))
    time, wanted = load_columns(table, chosen, options)
    columns = chosen["time"].name, chosen["displacement"].name
    idle = np.zeros_like(time)
    check_samples(time, idle, wanted, table.source, (columns[0], "voltage", columns[1]), table.place)
    check_wanted(time, wanted, table.source, columns, table.place)
    return Target(time, wanted, _shown_unit(chosen["displacement"], options), table.source)


def _existing(path: str | os.PathLike) -> Path:
    path = Path(path)
    try:
        os.stat(path)
    except (OSError, ValueError) as error:
        if isinstance(error, FileNotFoundError):
            raise BadInput(f"{cleaned(path)}: no such file or folder; check the path") from None
        raise BadInput(f"{cleaned(path)!r}: not a usable path ({cleaned(error)}); check it") from None
    return path


def files_of(paths: Sequence[str | os.PathLike]) -> list[Path]:
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
            raise BadInput(
                f"{cleaned(path)}: cannot list the folder: {error.strerror or error}; check its rights"
            ) from None
        inside = [file for file in inside if _is_record(file)]
        if not inside:
            raise BadInput(
                f"{cleaned(path)}: no record files in this folder (folders do not recurse); name the one with files"
            )
        files.extend(inside)
    return files


def _is_record(file: Path) -> bool:
    """Whether a file in a folder is taken: a known suffix, not hidden, no read-me beside the recordings."""
    stem, suffix = split_suffix(file.name)
    note = suffix.lower() == ".txt" and stem.lower().replace("-", "").replace("_", "") in _NOTES
    return os.path.isfile(file) and not file.name.startswith((".", "~$")) and bool(suffix) and not note


def names_of(files: Sequence[Path]) -> list[str]:
    """One unique name per file."""
    names = [cleaned(split_suffix(file.name)[0]) for file in files]
    count = Counter(names)
    full = [
        name if count[name] == 1 else f"{cleaned(os.path.basename(os.path.dirname(os.path.realpath(file))))}/{name}"
        for file, name in zip(files, names, strict=True)
    ]
    first: dict[str, Path] = {}
    for file, name in zip(files, full, strict=True):
        if name in first:
            if os.path.realpath(file) == os.path.realpath(first[name]):
                raise BadInput(f"{cleaned(file)}: given twice; name each record once")
            raise BadInput(
                f"{cleaned(file)}: has the same record name {name!r} as {cleaned(first[name])}; rename one of the two"
            )
        first[name] = file
    return full


def load_columns(table: Table, chosen: dict[str, Choice], options: ReadOptions) -> list[np.ndarray]:
    """The chosen columns in base units, scaled; a time of --rate where there is none."""
    places = [choice.place for choice in chosen.values() if choice.place is not None]
    values = dict(zip(places, table.load(places), strict=True))
    count = len(values[places[0]])
    loaded = []
    with np.errstate(over="ignore"):  # infinite values are refused after this
        for quantity, choice in chosen.items():
            if choice.place is None:
                assert options.rate is not None
                loaded.append(np.arange(count) / options.rate)
            else:
                base = to_base(values[choice.place], choice.unit, quantity)
                scale = options.scale(quantity)
                loaded.append(base if scale is None else base * scale)
    return loaded


def _shown_unit(choice: Choice, options: ReadOptions) -> str:
    """The unit an output is shown in: its own; mm where a sensor's volts became a length."""
    return "mm" if options.output_scale is not None and base_unit(choice.unit) == "V" else choice.unit


def _read_one(path: Path, name: str, options: ReadOptions) -> list[Record]:
    """The records of one file: one, or several where its gaps are too long."""
    table = open_table(path)
    chosen = choose_columns(table, options, ("time", "voltage", "displacement"))
    columns = chosen["time"].name, chosen["voltage"].name, chosen["displacement"].name
    time, voltage, displacement = load_columns(table, chosen, options)
    check_samples(time, voltage, displacement, table.source, columns, table.place, uniform=False)
    unit = _shown_unit(chosen["displacement"], options)
    refuse_implausible(voltage, displacement, base_unit(unit), table.source, columns[1:], table.place)
    _check_rate(time, chosen["time"], options, table.source)
    masked = mask_faults(displacement, voltage)
    found = on_grid(time, voltage, masked.displacement, table.source, columns[0], table.place)
    remarks = [f"{name}: {line}" for line in _faults(masked, unit) + doubts(masked.displacement, base_unit(unit))]
    lost = sum(piece.lost for piece in found.pieces)
    if found.jitter > TIME_TOLERANCE:
        remarks.append(f"{name}: time jitters by up to {found.jitter:.2g} of a sample, put on a uniform grid")
    if lost:
        remarks.append(f"{name}: {lost} lost sample{'s' if lost > 1 else ''} filled in, their output missing")
    if len(found.pieces) > 1 or found.dropped:
        short = f", {found.dropped} samples of shorter stretches left out" if found.dropped else ""
        remarks.append(f"{name}: split at its gaps into {len(found.pieces)}{short}")
    seen = {
        "file": table.form,
        **{OPTIONS[quantity]: str(choice) + scaled(quantity, options) for quantity, choice in chosen.items()},
        "jitter": found.jitter,
        "lost": lost,
        "outliers": masked.outliers,
        "clipped": masked.clipped,
        "remarks": remarks,
    }
    many = len(found.pieces) > 1
    return [
        Record(
            f"{name}.{k}" if many else name, piece.time, piece.voltage, piece.displacement,
            "V" if options.input_scale is not None else chosen["voltage"].unit, unit, table.source,
            {**seen, "lost": piece.lost, "remarks": remarks if k == 1 else []},
        )
        for k, piece in enumerate(found.pieces, 1)
    ]  # fmt: skip


def scaled(quantity: str, options: ReadOptions) -> str:
    scale = options.scale(quantity)
    return "" if scale is None else f" times {scale:g}"


def _faults(masked: Masked, unit: str) -> list[str]:
    """What was masked, in words."""
    lines = []
    if masked.outliers:
        far = from_base(masked.largest, unit, "displacement")
        lines.append(f"{masked.outliers} output samples far from their neighbours (such as {far:.4g} {unit}) masked")
    if masked.clipped:
        limit = from_base(masked.limit, unit, "displacement")
        lines.append(f"{masked.clipped} output samples stand at {limit:.4g} {unit} (clipped?), masked")
    return lines


def _check_rate(time: np.ndarray, choice: Choice, options: ReadOptions, source: str) -> None:
    """Refuse whole numbers without a unit (samples? milliseconds?), and a time that contradicts --rate."""
    if choice.place is None:
        return
    step = float(np.median(np.diff(time)))
    if choice.note.startswith("no unit") and step >= 1 and np.array_equal(time, np.round(time)):
        raise BadInput(
            f"{source}: column {choice.name!r} counts in whole numbers and has no unit; give --time-unit s|ms|us, or "
            "--rate HZ for a counter"
        )
    if options.rate is not None and abs(step * options.rate - 1.0) > 0.01:
        raise BadInput(
            f"{source}: column {choice.name!r} has a sample every {step:.6g} s, --rate {options.rate:g} says "
            f"{1 / options.rate:.6g} s; leave --rate to files without time"
        )

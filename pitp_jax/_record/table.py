"""A table: what every file format becomes before columns are chosen and units are read.

columns -> choose the wanted ones -> load(places) = values (T,) of each,    place(i) = words for sample i
"""

import os
import stat
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._errors import BadInput

MAX_COLUMNS = 4096
MAX_SAMPLES = 10_000_000
MAX_BYTES = 1 << 30
_MOST_UNFOLDED, _PLAIN = 200, 1 << 20  # times its size an archive may unfold to; below a mebibyte nobody is hurt
_MOST_BYTES = 256 << 20


@dataclass(frozen=True)
class Column:
    """One column of a file.

    Attributes:
        name: its exact header, cleaned.
        unit: what the file says beside the header (units row, attribute, comment), or None.
        stamps: whether it holds dates and hours; they are loaded as seconds.
    """

    name: str
    unit: str | None = None
    stamps: bool = False


@dataclass(frozen=True)
class Table:
    """The columns of one file, loaded when asked for.

    Attributes:
        source: the file, for messages.
        columns: those it has, in file order, repeats included.
        load: from places among them to float64 columns of shape (T,), nan where a cell is empty; raises BadInput.
        place: words for a sample index from 0 (`sample 7 (line 9)`).
        form: what was recognised, for the summary (`text, separated by ';', decimal comma`).
    """

    source: str
    columns: tuple[Column, ...]
    load: Callable[[Sequence[int]], list[np.ndarray]]
    place: Callable[[int], str]
    form: str


def sample(index: int) -> str:
    """Words for a sample of a file without lines."""
    return f"sample {index}"


def cleaned(text: object) -> str:
    """A name from outside without what a terminal or a page would obey: control and format characters become `_`."""
    return "".join("_" if unicodedata.category(c) in ("Cc", "Cf", "Cs", "Zl", "Zp") else c for c in str(text))


def check_columns(count: int, source: str) -> None:
    """Refuse a header of unreasonable size.

    Raises:
        BadInput: with the count.
    """
    if count > MAX_COLUMNS:
        raise BadInput(f"{source}: {count} columns, more than {MAX_COLUMNS}; keep those of one actuator")


def check_count(count: int, source: str) -> None:
    """Refuse more samples than anything here could use.

    Raises:
        BadInput: with the count.
    """
    if count > MAX_SAMPLES:
        raise BadInput(f"{source}: {count} samples, more than {MAX_SAMPLES}; split the record or sample it coarser")


def unfolding_limit(size: int) -> int:
    """Bytes an archive of this size may unfold to: 200 times its size, and 256 MiB (or 20 times) at most."""
    return min(max(_MOST_UNFOLDED * size, _PLAIN), max(_MOST_BYTES, 20 * size))


def check_unfolded(unfolded: int, size: int, source: str) -> None:
    """Refuse an archive that unfolds to more than it may.

    Raises:
        BadInput: with both sizes.
    """
    if unfolded > unfolding_limit(size):
        raise BadInput(
            f"{source}: unfolds from {size} to {unfolded} bytes or more; an archive may unfold to {_MOST_UNFOLDED} "
            f"times its size and {_MOST_BYTES >> 20} MiB: save it plain, or split the record"
        )


def file_bytes(path: Path, count: int = -1) -> bytes:
    """The content of a regular file, or its first `count` bytes.

    Raises:
        BadInput: it cannot be read, is a device or a pipe, is empty, or of unreasonable size.
    """
    source = cleaned(path)
    try:
        found = os.stat(path)
        if not stat.S_ISREG(found.st_mode):
            raise BadInput(f"{source}: is not a regular file; copy the record into one")
        if count < 0 and found.st_size > MAX_BYTES:
            raise BadInput(f"{source}: {found.st_size} bytes, more than {MAX_BYTES >> 30} GiB; split the record")
        with open(path, "rb") as file:
            data = file.read(count)
    except OSError as error:
        raise BadInput(f"{source}: cannot read: {error.strerror or error}; check the path and its rights") from None
    if not data:
        raise BadInput(f"{source}: the file is empty (0 bytes); record it again or leave it out")
    return data


def as_column(values, column: str, source: str) -> np.ndarray:
    """One stored variable as a float64 column; row and column vectors are both taken.

    Args:
        values: array as stored, shape (T,), (T, 1), (1, T) or any with one axis longer than 1.
        column: its name, for messages.
        source: the file, for messages.

    Raises:
        BadInput: text, objects or complex numbers where real numbers belong, a matrix, too many samples.
    """
    values = np.asarray(values)
    if values.dtype.kind not in "fiub":
        kind = {"c": "complex numbers", "S": "text", "U": "text"}.get(values.dtype.kind, "not plain numbers")
        raise BadInput(f"{source}: column {column!r}, sample 0: {kind} where real numbers belong; store it as float64")
    if values.ndim > 1 and values.size != max(values.shape):
        raise BadInput(
            f"{source}: column {column!r}, sample 0: a matrix of shape {values.shape} where a vector "
            "belongs; store one column per variable"
        )
    check_count(values.size, source)
    with np.errstate(over="ignore", invalid="ignore"):  # extended precision may overflow to infinity, refused later
        return values.astype(np.float64).reshape(-1)

"""Define a table: the common form of all file formats, before columns are chosen and units are read.

columns -> choose the wanted ones -> load(places) = values (T,) of each,    place(i) = words for sample i
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...common.errors import cleaned
from ...method.signal.checks import sample
from .guard import as_column, check_columns, guarded

_WIDEST = 63  # lines of a matrix that may be columns; a record has more samples


@dataclass(frozen=True)
class Column:
    """The header, unit and form of one column of a file; the values are loaded later.

    Attributes:
        name: its exact header, cleaned.
        beside: its unit in the file outside the header (units row, attribute), or None.
        spoken: its unit in a comment; used only if there is no other.
        form: "number", "stamp" (dates and hours, loaded as seconds) or "text".
    """

    name: str
    beside: str | None = None
    spoken: str | None = None
    form: str = "number"


@dataclass(frozen=True)
class Table:
    """The columns of one file, or of a part of it; values are loaded when asked for.

    Attributes:
        path: the file.
        columns: in file order, with repeats.
        load: function from their places to float64 columns of shape (T,), nan where a cell is empty; raises BadInput.
        place: words for a sample index from 0 (`sample 7 (line 9)`).
        form: recognised format, for the summary (`text, separated by ';', decimal comma`).
        part: the sheet or group that it is, or empty.
        hint: the rate given in the file outside the columns (`Delta_X 0.001`), or empty.
        blanks: function that counts the empty lines among the rows; without a clock each is a lost sample.
        texts: the values of a column as text, for splitting by it.
    """

    path: Path
    columns: tuple[Column, ...]
    load: Callable[[Sequence[int]], list[np.ndarray]]
    place: Callable[[int], str]
    form: str
    part: str = ""
    hint: str = ""
    blanks: Callable[[], int] = int
    texts: Callable[[int], np.ndarray] | None = None


Parts = list[list[Table]]  # of a file: every part, and every table that it may be


@dataclass(frozen=True)
class Stored:
    """A named array of a file.

    Attributes:
        name: as in the file.
        values: the array, or a function that reads it.
        unit: beside the data, as stored, or None.
        shape: of an array that is not read yet.
        fields: of its dtype, if it is a structured array.
    """

    name: str
    values: Any
    unit: Any = None
    shape: Sequence[int] = ()
    fields: Sequence[str] = ()

    def load(self) -> Any:
        """Return the array, read if it is not yet."""
        return self.values() if callable(self.values) else self.values


def array_table(path: Path, stored: Iterable[Stored], form: str, part: str = "") -> Table:
    """Make a table of named arrays; a matrix of samples gives a column for each of its lines, counted from 1.

    Args:
        path: the file.
        stored: the arrays.
        form: name of the file format.
        part: the group, if the file is split by groups.

    Raises:
        BadInput: more columns than reasonable.
    """
    arrays = [(line, load, one.unit) for one in stored for line, load in _lines(one)]
    check_columns(len(arrays))
    columns = tuple(Column(cleaned(name), _text(unit)) for name, _, unit in arrays)

    def load(places: Sequence[int]) -> list[np.ndarray]:
        return [guarded(f"a {form}", lambda k=k: as_column(arrays[k][1](), columns[k].name)) for k in places]

    return Table(path, columns, load, sample, form, part)


def _lines(one: Stored) -> list[tuple[str, Callable[[], Any]]]:
    """Return a vector; split a long matrix into `data[1]`, ..., and (time, environment, joint) into `data[1,1]`, ...

    The fields of a structured array are vectors by their own names.
    """
    if one.fields:
        return [(field, lambda field=field: one.load()[field]) for field in one.fields]
    shape = one.shape or getattr(one.values, "shape", ())
    # long in one dimension: an image or a map is long in both
    axis = int(np.argmax(shape)) if len(shape) else 0
    others = [size for k, size in enumerate(shape) if k != axis]
    if not (len(shape) == 2 and 1 < others[0] <= _WIDEST or len(shape) == 3) or not 1 < np.prod(others) < shape[axis]:
        return [(one.name, one.load)]

    def line(place: tuple[int, ...]) -> np.ndarray:
        return np.moveaxis(np.asarray(one.load()), axis, 0)[(slice(None), *place)]

    places = list(np.ndindex(*others))
    return [(f"{one.name}[{','.join(str(k + 1) for k in place)}]", lambda p=place: line(p)) for place in places]


def _text(value: Any) -> str | None:
    """Return a unit attribute as text, also if it is stored as bytes or an array of one string."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(-1)[0]
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    return value.strip() or None if isinstance(value, str) else None

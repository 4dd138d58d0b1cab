"""A table: what every file format becomes before columns are chosen and units are read.

names -> choose the wanted ones -> load(wanted) = {name: values (T,)},    place(i) = words for sample i
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._errors import BadInput


@dataclass(frozen=True)
class Table:
    """The columns of one file, loaded when asked for.

    Attributes:
        source: the file, for messages.
        names: the columns it has, in file order, repeats included.
        load: from wanted names to float64 columns of shape (T,), nan where a cell is empty; raises BadInput.
        place: words for a sample index from 0 (`sample 7 (line 9)`).
    """

    source: str
    names: tuple[str, ...]
    load: Callable[[Sequence[str]], dict[str, np.ndarray]]
    place: Callable[[int], str]


def file_bytes(path: Path, count: int = -1) -> bytes:
    """The content of a file, or its first `count` bytes.

    Raises:
        BadInput: it cannot be read, or is empty.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(count)
    except OSError as error:
        raise BadInput(f"{path}: cannot read: {error.strerror or error}; check the path and its rights") from None
    if not data:
        raise BadInput(f"{path}: the file is empty (0 bytes); record it again or leave it out")
    return data


def as_column(values, column: str, source: str) -> np.ndarray:
    """One stored variable as a float64 column; row and column vectors are both taken.

    Args:
        values: array as stored, shape (T,), (T, 1), (1, T) or any with one axis longer than 1.
        column: its name, for messages.
        source: the file, for messages.

    Raises:
        BadInput: text, objects or complex numbers where real numbers belong, or a matrix.
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
    return values.astype(np.float64).reshape(-1)

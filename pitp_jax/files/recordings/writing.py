"""Write files completely or not at all.

    bytes -> temporary file in the same folder -> flush to disk -> renamed over the target

An interrupted or failed write keeps the old file and leaves no temporary file.
"""

import gzip
import os
import secrets
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...common.errors import BadInput
from ...common.units import column_name, from_base


def write_bytes_atomic(path: str | os.PathLike, data: bytes) -> None:
    """Write a file completely or not at all.

    A link is followed; a pipe or device (`/dev/stdout`) is written to directly, it cannot be replaced.

    Args:
        path: the file; an existing one is replaced.
        data: its new content.

    Raises:
        BadInput: it cannot be written (no such folder, no rights, disk full).
    """
    target = Path(os.path.realpath(path))
    try:
        if is_stream(path):
            with open(path, "wb") as file:  # as given, because the real path of a pipe's link does not exist
                file.write(data)
        else:
            _replace(target, data)
    except OSError as error:
        raise BadInput(f"cannot write {path}: {error.strerror or error}; {_remedy(error)}") from None


def is_stream(path: str | os.PathLike) -> bool:
    """Return whether a path is a pipe or a device, which is written to directly."""
    return os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path)


def _replace(target: Path, data: bytes) -> None:
    temporary = target.parent / f".pitp-{secrets.token_hex(8)}.tmp"
    try:
        # in the same folder, because a rename does not cross file systems
        with open(temporary, "xb") as file:
            file.write(data)
            file.flush()
            # before the rename; otherwise a power cut leaves an empty file
            os.fsync(file.fileno())
        put_in_place(temporary, target)
    except BaseException:  # an interrupt must not leave the temporary file either
        temporary.unlink(missing_ok=True)
        raise


def put_in_place(stage: Path, target: Path) -> None:
    """Move a finished file to its place; the mode of a file that it replaces stays."""
    if target.exists():
        os.chmod(stage, target.stat().st_mode & 0o7777)
    os.replace(stage, target)


def _remedy(error: OSError) -> str:
    if isinstance(error, FileNotFoundError):
        return "create the folder first"
    if isinstance(error, PermissionError):
        return "choose a place where you may write"
    if isinstance(error, (IsADirectoryError, NotADirectoryError)):
        return "give a file name inside a folder"
    return "choose another place"


def write_text_atomic(path: str | os.PathLike, text: str) -> None:
    """Write UTF-8 text completely or not at all; see `write_bytes_atomic`.

    Args:
        path: the file.
        text: its new content.

    Raises:
        BadInput: it cannot be written.
    """
    write_bytes_atomic(path, text.encode("utf-8"))


def write_signals(path: Path, time: np.ndarray, more: Mapping[str, np.ndarray] | None = None, **signals) -> None:
    """Write signals over time (s) as CSV in their units; create the folder.

    Args:
        path: the file.
        time: s, shape (T,).
        more: further columns by name, in the units written.
        **signals: `voltage`, `displacement`: values in base units, and the unit to write.

    Raises:
        BadInput: it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = {column_name(quantity, unit): from_base(values, unit) for quantity, (values, unit) in signals.items()}
    write_csv(path, {"time_s": time, **columns, **(more or {})})


def write_csv(path: str | os.PathLike, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns as CSV (compressed if the name ends in `.gz`), completely or not at all.

    Times get nine decimals, so that uniform sampling stays uniform; other numbers nine digits; whole-number
    and boolean columns are written as such. Samples that are not finite become empty cells (missing).

    Args:
        path: the file.
        columns: name to values of shape (T,), in the order they are written, at least one.

    Raises:
        BadInput: it cannot be written.
        ValueError: the columns differ in length.
    """
    cells = [_cells(name, np.asarray(values)) for name, values in columns.items()]
    lines = [",".join(columns)]
    lines.extend(map(",".join, zip(*cells, strict=True)))
    data = ("\n".join(lines) + "\n").encode("utf-8")
    write_bytes_atomic(path, gzip.compress(data, 6, mtime=0) if str(path).lower().endswith(".gz") else data)


def _cells(name: str, values: np.ndarray) -> list[str]:
    if values.dtype.kind in "bui":
        return list(map(str, values.astype(np.int64).tolist()))
    form = "%.9f" if name.startswith("time") else "%.9g"
    values = values.astype(np.float64)
    cells = [form % value for value in values.tolist()]
    for k in np.flatnonzero(~np.isfinite(values)):
        cells[k] = ""
    return cells

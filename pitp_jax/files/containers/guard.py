"""Guard against hostile files: limit sizes before reading, and turn library errors into one line.

regular file of at most 1 GiB,    unfolded bytes <= min(200 size, max(256 MiB, 20 size)),    4096 columns, 1e7 rows
"""

import gzip
import io
import os
import stat
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ...common.errors import BadInput, cleaned

MAX_COLUMNS = 4096
MAX_ENTRIES = 256  # of a list that become columns; images and scans are longer
MAX_SAMPLES = 10_000_000  # 80 MB a column in float64
MAX_BYTES = 1 << 30  # 1 GiB, because a file is read into memory as a whole
_UNFOLDED, _PLAIN = 200, 1 << 20  # times its size that an archive may unfold to; a mebibyte is always harmless
_UNFOLDED_BYTES = 256 << 20  # 256 MiB, or 20 times the size of a large archive


def check_columns(count: int) -> None:
    """Refuse a file with more than 4096 columns.

    Raises:
        BadInput: with the count.
    """
    if count > MAX_COLUMNS:
        raise BadInput(f"{count} columns, more than {MAX_COLUMNS}; keep the columns of one actuator")


def check_count(count: int) -> None:
    """Refuse a file with more than 10 million samples.

    Raises:
        BadInput: with the count.
    """
    if count > MAX_SAMPLES:
        raise BadInput(f"{count} samples, more than {MAX_SAMPLES}; split the recording or average it to a lower rate")


def most_unfolded(size: int) -> int:
    """Return the largest number of bytes to which an archive of this size may unfold."""
    return min(max(_UNFOLDED * size, _PLAIN), max(_UNFOLDED_BYTES, 20 * size))


def check_unfolded(unfolded: int, size: int) -> None:
    """Refuse an archive whose unpacked size exceeds the limit.

    Raises:
        BadInput: with both sizes.
    """
    if unfolded > most_unfolded(size):
        raise BadInput(
            f"unpacks from {size} to {unfolded} bytes or more (limits: {_UNFOLDED} times its size and "
            f"{_UNFOLDED_BYTES >> 20} MiB); save it uncompressed, or split the recording"
        )


def file_bytes(path: Path, count: int = -1) -> bytes:
    """Read a regular file, or only its first `count` bytes.

    Raises:
        BadInput: it cannot be read, is a device or a pipe, is empty, or of unreasonable size.
    """
    try:
        # a pipe would block forever, a device would never end
        state = os.stat(path)
        if not stat.S_ISREG(state.st_mode):
            raise BadInput("is not a regular file (but a folder, a pipe or a device); give one")
        if count < 0 and state.st_size > MAX_BYTES:
            raise BadInput(f"{state.st_size} bytes, more than {MAX_BYTES >> 30} GiB; split it")
        with open(path, "rb") as file:
            data = file.read(count)
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror or error}; check the path and its access rights") from None
    if not data:
        raise BadInput("the file is empty (0 bytes); write it again or leave it out")
    return data


def as_column(values: Any, column: str) -> np.ndarray:
    """Convert one stored variable to a float64 column; row and column vectors are both accepted.

    Args:
        values: array as stored, shape (T,), (T, 1), (1, T) or any with one axis longer than 1.
        column: its name, for messages.

    Raises:
        BadInput: text, objects or complex numbers where real numbers belong, a matrix, too many samples.
    """
    values = np.asarray(values)
    if values.dtype.kind not in "fiub":
        kind = {"c": "complex numbers", "S": "text", "U": "text"}.get(values.dtype.kind, "not plain numbers")
        raise BadInput(f"column {column!r}, sample 0: {kind} instead of real numbers; store it as float64")
    # (T, 1) and (1, T) are vectors, as MATLAB writes them
    if values.ndim > 1 and values.size != max(values.shape):
        raise BadInput(
            f"column {column!r}, sample 0: a matrix of shape {values.shape} instead of a vector; store one "
            "column per variable"
        )
    check_count(values.size)
    with np.errstate(over="ignore", invalid="ignore"):  # extended precision may overflow to infinity (refused later)
        return values.astype(np.float64).reshape(-1)


def gunzip(data: bytes) -> bytes:
    """Decompress gzip data piece by piece.

    Raises:
        BadInput: damaged, truncated, or too large when unpacked.
    """
    pieces, total = [], 0
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
            while piece := file.read(_PLAIN):
                total += len(piece)
                check_unfolded(total, len(data))
                pieces.append(piece)
    except EOFError:
        raise BadInput("the gzip data end too early (truncated); copy the file again") from None
    except (OSError, zlib.error) as error:
        raise BadInput(f"damaged gzip data ({error}); copy the file again") from None
    return b"".join(pieces)


def inflate(data: bytes, *, size: int, begun: int) -> bytes:
    """Decompress one zlib stream, as an element of a MATLAB file.

    Args:
        data: the compressed bytes.
        size: of the whole file, which determines the limit.
        begun: bytes of this file already unpacked.

    Raises:
        BadInput: too large when unpacked.
        zlib.error: damaged or truncated.
    """
    engine = zlib.decompressobj()
    # one byte more than allowed, so that an excessive result is never in memory
    whole = engine.decompress(data, most_unfolded(size) + 1)
    check_unfolded(begun + len(whole), size)
    if not engine.eof:
        raise zlib.error("truncated")
    return whole


def check_archive(path: Path) -> None:
    """Refuse a zip archive (`.npz`, `.xlsx`) whose members declare too large a size.

    Raises:
        BadInput: with the sizes, or not a zip archive.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
    except Exception as error:  # zipfile raises almost any error on damaged directories
        raise BadInput(f"cannot be read as an archive ({type(error).__name__}); save or copy it again") from None
    check_unfolded(sum(member.file_size for member in members), path.stat().st_size)


def guarded(kind: str, function: Callable, *arguments):
    """Call a function that opens a file with a library, and turn any error into one line.

    Raises:
        BadInput: the library's reason, shortened.
    """
    try:
        with warnings.catch_warnings():  # warnings about the file; relevant ones are reported or refused here
            warnings.simplefilter("ignore")
            return function(*arguments)
    except BadInput:
        raise
    except ImportError as error:
        extra = {"openpyxl": "excel", "nptdms": "labview"}.get(error.name or "", "robot")
        raise BadInput(f"needs the package {error.name}; run `pip install 'pitp_jax[{extra}]'`") from None
    except Exception as error:
        reason = cleaned(" ".join(str(error).split()) or type(error).__name__)
        raise BadInput(f"cannot be read as {kind} ({reason[:120]}); save or copy it again") from error

"""Compressed data unfolded piece by piece, so that a small file cannot fill the memory.

unfolded bytes <= min(200 size, max(256 MiB, 20 size))
"""

import gzip
import io
import zipfile
import zlib
from pathlib import Path

from .._errors import BadInput
from .table import check_unfolded, cleaned

_PIECE = 1 << 20


def gunzip(data: bytes, source: str) -> bytes:
    """Decompress gzip data.

    Args:
        data: the whole file.
        source: its name, for messages.

    Raises:
        BadInput: damaged, truncated, or unfolding to too much.
    """
    pieces, total = [], 0
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
            while piece := file.read(_PIECE):
                total += len(piece)
                check_unfolded(total, len(data), source)
                pieces.append(piece)
    except EOFError:
        raise BadInput(f"{source}: the gzip data end too early (truncated); copy the file again") from None
    except (OSError, zlib.error) as error:
        raise BadInput(f"{source}: damaged gzip data ({error}); copy the file again") from None
    return b"".join(pieces)


def inflate(data: bytes, source: str, *, size: int, begun: int) -> bytes:
    """Decompress one zlib stream, an element of a MATLAB file.

    Args:
        data: the compressed bytes.
        source: the file, for messages.
        size: of the whole file, which the limit is counted from.
        begun: bytes of this file unfolded before.

    Raises:
        BadInput: unfolding to too much.
        zlib.error: damaged or truncated.
    """
    engine, pieces, total = zlib.decompressobj(), [], begun
    while not engine.eof:
        piece = engine.decompress(data, _PIECE)
        data = engine.unconsumed_tail
        if not piece and not data and not engine.eof:
            raise zlib.error("truncated")
        total += len(piece)
        check_unfolded(total, size, source)
        pieces.append(piece)
    return b"".join(pieces)


def check_archive(path: Path) -> None:
    """Refuse a zip archive (`.npz`, `.xlsx`) whose members unfold to too much.

    Reading a member stops at the size it declares, so the declared sizes bound what follows.

    Raises:
        BadInput: with the sizes, or not a zip archive.
    """
    source = cleaned(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
    except Exception as error:  # zipfile raises nearly anything on damaged directories
        raise BadInput(
            f"{source}: not readable as an archive ({type(error).__name__}); save or copy it again"
        ) from None
    check_unfolded(sum(member.file_size for member in members), path.stat().st_size, source)

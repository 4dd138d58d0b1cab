"""Flatten and check MATLAB files up to version 7 (.mat), because SciPy's reader does not limit its recursion."""

import io
import struct
import zlib

from ...common.errors import BadInput
from .guard import inflate

_COMPRESSED, _MATRIX, _CONTAINERS = 15, 14, (1, 2, 3)  # element types; classes cell, struct, object
_DEEPEST, _ELEMENTS = 4, 20_000


def flat(data: bytes, source: str) -> io.BytesIO:
    """Decompress all elements of a MATLAB file; refuse variables nested deeper than a struct of vectors.

    Args:
        data: the whole file.
        source: its name, for messages.

    Raises:
        BadInput: truncated, damaged, nested too deeply, or too large when unpacked.
    """
    # the mark MI in the byte order of the writer's machine
    order = "<" if data[126:128] == b"IM" else ">"
    pieces, at, unfolded, budget = [data[:128]], 128, 0, [_ELEMENTS]
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if size > len(data) - at - 8:
            raise BadInput(f"{source}: the MATLAB file ends too early (truncated); copy the file again")
        element = data[at : at + 8 + size]
        at += 8 + size
        if kind == _COMPRESSED:
            try:
                element = inflate(element[8:], source, size=len(data), begun=unfolded)
            except zlib.error as error:
                raise BadInput(f"{source}: damaged MATLAB file ({error}); copy the file again") from None
            unfolded += len(element)
        _check_nesting(memoryview(element), order, source, budget)
        pieces.append(element)
    return io.BytesIO(b"".join(pieces))


def _check_nesting(element: memoryview, order: str, source: str, budget: list[int], depth: int = 0) -> None:
    """Refuse deeply nested cells and structs, because SciPy's reader calls itself for each level."""
    budget[0] -= 1
    if depth > _DEEPEST or budget[0] < 0:
        raise BadInput(
            f"{source}: its variables are nested too deeply or have too many parts; store one vector per variable"
        )
    if len(element) < 24 or struct.unpack_from(f"{order}I", element)[0] != _MATRIX:
        return
    if struct.unpack_from(f"{order}I", element, 16)[0] & 0xFF not in _CONTAINERS:
        return
    at = 8
    while at + 8 <= len(element):
        kind, size = struct.unpack_from(f"{order}II", element, at)
        if kind >> 16:  # a small element: size and data within eight bytes
            at += 8
            continue
        if kind == _MATRIX:
            _check_nesting(element[at : at + 8 + size], order, source, budget, depth + 1)
        # elements are padded to eight bytes
        at += 8 + size + (-size) % 8

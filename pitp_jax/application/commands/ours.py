"""Decide which existing files an output may replace: only those that pitp wrote.

ours:    a model file,    JSON,    a CSV with columns that only pitp writes,    a MuJoCo file with our comment,
         files beside a page of ours
"""

import re
from collections.abc import Iterable
from contextvars import ContextVar
from pathlib import Path

from ...common.errors import BadInput

_FORCED: ContextVar[bool] = ContextVar("forced", default=False)
_HEAD = 4096  # bytes


def allow_overwriting(forced: bool) -> None:
    """Store whether the user gave `--force`, which allows replacing files that pitp did not write."""
    _FORCED.set(forced)


def check_replaceable(file: Path, shown: object) -> None:
    """Refuse to replace a file that pitp did not write.

    Args:
        file: the file to be replaced, if it exists.
        shown: its name for the message.

    Raises:
        BadInput: it was not written by pitp, and `--force` was not given.
    """
    if _FORCED.get() or not file.is_file():
        return
    with open(file, "rb") as stream:
        head = stream.read(_HEAD)
    ours = (
        head.startswith((b"pitp_jax model ", b'{\n  "written_by": "pitp_jax '))
        or re.match(rb"time_s,.*(predicted|target|infeasible|added_input)", head.partition(b"\n")[0])
        or b"<!-- pitp: numbers identified" in head  # a MuJoCo file
    )
    if head and not ours:
        raise BadInput(
            f"{shown}: exists and was not written by pitp; choose another name, or give --force to overwrite it"
        )


def check_folder_replaceable(folder: Path, names: Iterable[str], shown: object) -> None:
    """Refuse to replace a user's files in a folder that holds no page of pitp.

    Args:
        folder: to be written to.
        names: of the files.
        shown: the folder for the message.

    Raises:
        BadInput: with the first file that pitp did not write.
    """
    names = list(names)
    pages = [folder / name for name in names if name.endswith(".html")]
    if not pages or any(map(is_page, pages)):
        return
    for name in names:
        if name.endswith((".csv", ".html")):
            check_replaceable(folder / name, f"{shown}/{name}")


def is_page(file: Path) -> bool:
    """Return whether a file is an HTML page that pitp wrote."""
    return file.is_file() and b"--ink" in file.read_bytes()[:_HEAD]

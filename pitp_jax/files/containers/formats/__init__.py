"""The readers of files: one file a container, found by listing this folder.

A reader is a file with

    suffixes: tuple of str        of its files, in lower case
    kind, remedy: str             for the refusal of a file that is not what its suffix says
    begins: tuple of bytes        one of which such a file starts with; b"" if any may come first
    tables(path, options)         every part of the file (sheet, group), and every table that it may be

Of the readers of one suffix, the first with the fewest suffixes that accepts the first bytes opens the file.
"""

import pkgutil
from importlib import import_module
from pathlib import Path
from typing import Any

from ....common.errors import BadInput
from ..guard import file_bytes, guarded
from ..options import ReadOptions
from ..table import Parts

_FILES = [import_module(f".{module.name}", __name__) for module in pkgutil.iter_modules(__path__)]
READERS: tuple[Any, ...] = tuple(sorted((m for m in _FILES if hasattr(m, "suffixes")), key=lambda m: len(m.suffixes)))
SUFFIXES = tuple(dict.fromkeys(suffix for reader in reversed(READERS) for suffix in reader.suffixes))
_UNREAD = {  # suffix: what it is, and what to save instead
    (".pt", ".pth", ".ckpt"): "a file of torch.save, which may run code when it is opened; save its arrays with "
    "numpy.savez (.npz) or as CSV",
    (".pkl", ".pickle", ".joblib", ".npy"): "a file of Python or of one array; save named arrays with numpy.savez "
    "(.npz) or as CSV",
    (".xls", ".ods", ".numbers"): "a spreadsheet of another kind; save it as .xlsx or CSV",
    tuple(
        ".mf4 .mdf .dxd .bag .db3 .slx .m .json .jsonl .zip".split()
    ): "not read; export its signals as CSV, MAT or MCAP",
}


def unread(name: str) -> str:
    """Return what a file is that is not read, by its suffix, and what to save instead."""
    said = (text for ends, text in _UNREAD.items() if name.lower().endswith(ends))
    return next(said, "not a recording file; convert or rename it")


def is_bag(path: Path) -> bool:
    """Return whether a folder is a rosbag2 recording."""
    return path.is_dir() and (path / "metadata.yaml").is_file()


def split_suffix(name: str) -> tuple[str, str]:
    """Split a file name into stem and suffix; the suffix is empty if it is not one of a recording file.

    Capital suffixes (`.CSV`, `.MAT`) count too.
    """
    for suffix in sorted(SUFFIXES, key=len, reverse=True):
        if name.lower().endswith(suffix) and len(name) > len(suffix):
            return name[: -len(suffix)], name[-len(suffix) :]
    return name, ""


def open_parts(path: Path, options: ReadOptions) -> Parts:
    """Open every part of a file as the tables that it may be; errors of file libraries become BadInput.

    Raises:
        BadInput: unknown suffix, or the file is not what its suffix says.
    """
    suffix = ".mcap" if is_bag(path) else split_suffix(path.name)[1].lower()
    if not suffix:
        raise BadInput(f"{unread(path.name)} (known suffixes: {', '.join(sorted(SUFFIXES))})")
    readers = [reader for reader in READERS if suffix in reader.suffixes]
    first = file_bytes(next(path.iterdir()) if path.is_dir() else path, 1 << 10)
    reader = next((reader for reader in readers if first.startswith(reader.begins)), None)
    if reader is None:
        raise BadInput(f"is not {readers[0].kind} as its suffix says; {readers[0].remedy}")
    return guarded(reader.kind, reader.tables, path, options)

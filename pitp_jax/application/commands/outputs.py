"""Write the output files of a command completely or not at all, and check them before the computation.

check_outputs   before the computation: the place can be written to, and no input file is replaced
staged          hidden files beside the wanted ones -> renamed once every one is written; a page gets its index.html
write_json      never NaN or Infinity: null
"""

import json
import math
import os
import re
import secrets
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np

from ... import __version__
from ...common.errors import BadInput, refuse_if
from ...common.page import Link, Page
from ...files.recordings.writing import is_stream, put_in_place, write_text_atomic
from .ours import check_folder_replaceable, check_replaceable, is_page

MODEL, REPORT, INDEX = "model_augmented", "report.html", "index.html"  # a diagnosis's model, a page, the links to all


def check_outputs(
    *files: str | None,
    folder: str | None = None,
    names: Iterable[str] = (),
    inputs: Iterable[str | os.PathLike | None] = (),
) -> None:
    """Refuse outputs that cannot be written, or that would replace each other or an input.

    Args:
        *files: to be written; None is skipped.
        folder: to be created (with its parents) if missing, or None.
        names: of the files to be written in it.
        inputs: files and folders to be read; None is skipped.

    Raises:
        BadInput: with the path and the remedy.
    """
    taken = {Path(os.path.realpath(file)): path for path in inputs if path is not None for file in _files_of(path)}
    for path in files:
        if path is None or is_stream(path):
            continue
        target = Path(os.path.realpath(path))
        is_folder = target.is_dir() or not target.name or str(path).endswith(("/", os.sep))
        place = target if target.exists() else target.parent
        refuse_if(
            (is_folder, f"{path}: is a folder; give a file name inside a folder"),
            (not target.parent.is_dir(), f"{path}: there is no folder {target.parent}; create the folder first"),
            (not os.access(place, os.W_OK), f"{path}: no permission to write there; choose another place"),
            (target in taken, f"{path}: is also given as {taken.get(target)}; choose another name for the output"),
        )
        check_replaceable(target, path)
        taken[target] = path
    if folder is not None:
        _check_folder(folder, list(names), set(taken))


def csv_names(series: Iterable[Any]) -> list[str]:
    """Return a file name for each recording or input."""
    return [f"{one.name.lstrip('/')}.csv" for one in series]


def _files_of(path: str | os.PathLike) -> list[Path]:
    given = Path(path)
    return [given, *given.iterdir()] if given.is_dir() and os.access(given, os.R_OK | os.X_OK) else [given]


def _check_folder(folder: str, names: list[str], taken: set[Path]) -> None:
    target = Path(os.path.realpath(folder))
    existing = next(p for p in (target, *target.parents) if p.exists())
    # the folder, or the nearest existing one in which it is created
    closed = not os.access(existing, os.W_OK | os.X_OK)
    refuse_if(
        (not existing.is_dir(), f"{folder}: {existing} is a file, not a folder; choose another folder"),
        (closed, f"{folder}: no permission to write in {existing}; choose another place"),
    )
    for name in names:
        is_input = Path(os.path.realpath(target / name)) in taken
        refuse_if(
            (is_input, f"{folder}: {name} would overwrite an input file; choose another folder"),
            ((target / name).is_dir(), f"{folder}: {name} is a folder there; remove it or choose another folder"),
        )
    check_folder_replaceable(target, names, folder)


@contextmanager
def staged(
    *, file: str | None = None, folder: str | os.PathLike | None = None, json_file: str | None = None, value: Any = None
) -> Iterator[Path]:
    """Yield a hidden path for a command's output, which is renamed at the end; after a failure nothing appears.

    Args:
        file: wanted file, whose hidden name is yielded; a device is written to directly.
        folder: wanted folder in its place, whose hidden stage is yielded; its other files stay.
        json_file: where to write `value` as JSON, or None.
        value: dicts, lists and numbers.

    Raises:
        BadInput: a file or the folder cannot be written; the message has the wanted name.
    """
    with ExitStack() as stages:
        json_stage = stages.enter_context(_staged_file(json_file))
        write_json(json_stage, value)
        if folder is not None:
            yield stages.enter_context(_staged_folder(folder))
        else:
            yield Path(stages.enter_context(_staged_file(file)) or "")


@contextmanager
def _staged_file(path: str | None) -> Iterator[str | None]:
    if path is None or is_stream(path):
        yield path
        return
    target = Path(os.path.realpath(path))
    stage = target.parent / f".pitp-{secrets.token_hex(8)}-{target.name}"
    try:
        yield str(stage)
        if stage.exists():
            put_in_place(stage, target)
    except BadInput as error:
        raise BadInput(str(error).replace(str(stage), str(target))) from None
    finally:
        stage.unlink(missing_ok=True)


@contextmanager
def _staged_folder(folder: str | os.PathLike) -> Iterator[Path]:
    target = Path(os.path.realpath(folder))
    made = [path for path in (target, *target.parents) if not path.exists()]
    stage = target / f".pitp-{secrets.token_hex(8)}.tmp"  # inside, so that moving is renaming
    try:
        stage.mkdir(parents=True)
        yield stage
        write_index(target, stage)
        files = sorted(path.relative_to(stage) for path in stage.rglob("*") if path.is_file())
        for name in files:
            (target / name).parent.mkdir(parents=True, exist_ok=True)
        for name in files:
            os.replace(stage / name, target / name)  # after all folders exist: renaming alone cannot fail half way
        made = []
    except BadInput as error:
        raise BadInput(str(error).replace(str(stage), str(target))) from None
    except OSError as error:
        raise BadInput(f"cannot write to {folder}: {error.strerror or error}; choose another place") from None
    finally:
        shutil.rmtree(stage, ignore_errors=True)
        for path in made:  # the deepest first; only empty ones
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


def write_index(folder: Path, stage: Path) -> None:
    """Write `index.html` with links to the pages in a folder and its subfolders; a user's own index is kept.

    Args:
        folder: where the pages are to be.
        stage: where the new ones are, and where the index is written.

    Raises:
        BadInput: it cannot be written.
    """
    pages = {}
    for home in (folder, stage):
        for path in [*sorted(home.glob("*.html")), *sorted(home.glob("[!.]*/*.html"))]:
            if path.name != INDEX and is_page(path):
                pages[path.relative_to(home).as_posix()] = path
    index = folder / INDEX
    if pages and (not index.exists() or is_page(index)):
        titles = {
            name: re.search("<title>(.*?)</title>", path.read_text(encoding="utf-8")) for name, path in pages.items()
        }
        links = [Link(name, unescape(title[1]) if title else name) for name, title in sorted(titles.items())]
        write_text_atomic(stage / INDEX, Page("Pages", "Pages of this folder", links).html())


def write_json(path: str | os.PathLike | None, value: Mapping[str, Any] | None) -> None:
    """Write a result as JSON, completely or not at all; numbers that are not finite become null.

    Its first key, `written_by`, identifies files of pitp.

    Raises:
        BadInput: the file cannot be written.
    """
    if path is not None and value is not None:
        marked = {"written_by": f"pitp_jax {__version__}", **value}
        write_text_atomic(path, json.dumps(without_nan(marked), indent=2, allow_nan=False) + "\n")


def without_nan(value: Any) -> Any:
    """Convert values for JSON: NumPy values to Python's, nan and infinity to None."""
    if isinstance(value, dict):
        return {str(k): without_nan(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [without_nan(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value

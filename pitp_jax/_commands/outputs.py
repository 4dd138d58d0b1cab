"""Output files: checked before the work, written whole or not at all after it.

check_files, check_folder    before hours of work: is there a place to write to?
staged_files, staged_folder  hidden files beside the wanted ones -> renamed once every one is written
write_json                   never NaN or Infinity: null
"""

import json
import math
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from .._errors import BadInput
from .._record.writing import is_stream, write_text_atomic
from .ours import check_folder_replaceable, check_replaceable

REPORT = "report.html"  # the page beside what a command writes


def check_files(*outputs: str | None, inputs: Iterable[str | os.PathLike] = ()) -> None:
    """Refuse output files that could not be written, or would replace each other or an input.

    Args:
        *outputs: files to be written; None is skipped.
        inputs: files that are read.

    Raises:
        BadInput: with the file and the remedy.
    """
    taken = {Path(os.path.realpath(path)): path for path in inputs}
    for path in outputs:
        if path is None or is_stream(path):
            continue
        target = Path(os.path.realpath(path))
        if target.is_dir() or not target.name or str(path).endswith(("/", os.sep)):
            raise BadInput(f"{path}: is a folder; give a file name inside a folder")
        if not target.parent.is_dir():
            raise BadInput(f"{path}: there is no folder {target.parent}; create the folder first")
        if not os.access(target if target.exists() else target.parent, os.W_OK):
            raise BadInput(f"{path}: no right to write there; choose a place you may write to")
        if target in taken:
            raise BadInput(f"{path}: is already used as {taken[target]}; choose another name for the output")
        check_replaceable(target, path)
        if not target.exists() or target.is_file():  # /dev/stdout may be given twice
            taken[target] = path


def check_folder(folder: str, names: Iterable[str], inputs: Iterable[str | os.PathLike] = ()) -> None:
    """Refuse an output folder that could not be made or written to, or whose files would replace an input.

    Args:
        folder: to be created (with its parents) where it is missing.
        names: of the files to be written in it.
        inputs: files that are read.

    Raises:
        BadInput: with the path and the remedy.
    """
    target = Path(os.path.realpath(folder))
    existing = next(p for p in (target, *target.parents) if p.exists())
    if not existing.is_dir():
        raise BadInput(f"{folder}: {existing} is a file, not a folder; choose another folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise BadInput(f"{folder}: no right to write in {existing}; choose a place you may write to")
    taken = {Path(os.path.realpath(path)) for path in inputs}
    names = list(names)
    for name in names:
        file = target / name
        if Path(os.path.realpath(file)) in taken:
            raise BadInput(f"{folder}: {name} would replace a file that is read; choose another folder")
        if file.is_dir():
            raise BadInput(f"{folder}: {name} is a folder there; remove it or choose another folder")
    check_folder_replaceable(target, names, folder)


@contextmanager
def staged_files(*outputs: str | None) -> Iterator[list[str]]:
    """Hidden names beside the wanted ones: all are renamed on success, none is left on any failure.

    Args:
        *outputs: wanted files; the name yielded for None is empty, a device is written to directly.

    Raises:
        BadInput: a file cannot be written; the message has its wanted name.
    """
    stages: dict[str, Path] = {}
    names: list[str] = []
    for path in outputs:
        target = Path(os.path.realpath(path)) if path else None
        if path and target is not None and not is_stream(path):
            stage = str(target.parent / f".pitp-{secrets.token_hex(8)}-{target.name}")
            stages[stage] = target
            names.append(stage)
        else:
            names.append(path or "")
    try:
        yield names
        for stage, target in stages.items():
            if os.path.exists(stage):
                if target.exists():
                    os.chmod(stage, target.stat().st_mode & 0o7777)  # the mode stays
                os.replace(stage, target)
    except BadInput as error:
        text = str(error)
        for stage, target in stages.items():
            text = text.replace(stage, str(target))
        raise BadInput(text) from None
    finally:
        for stage in stages:
            Path(stage).unlink(missing_ok=True)


@contextmanager
def staged_folder(folder: str | os.PathLike) -> Iterator[Path]:
    """A hidden folder whose files move into `folder` on success; on any failure nothing is left.

    Args:
        folder: where the files belong; created if missing, its other files stay.

    Raises:
        BadInput: the folder cannot be made or a file cannot be moved there.
    """
    target = Path(os.path.realpath(folder))
    made = _missing_parents(target)
    stage = target / f".pitp-{secrets.token_hex(8)}.tmp"  # inside, so that moving is renaming
    try:
        stage.mkdir(parents=True)
        yield stage
        files = sorted(path.relative_to(stage) for path in stage.rglob("*") if path.is_file())
        for name in files:
            (target / name).parent.mkdir(parents=True, exist_ok=True)
        for name in files:
            os.replace(stage / name, target / name)
        made = []
    except OSError as error:
        raise BadInput(f"cannot write to {folder}: {error.strerror or error}; choose another place") from None
    finally:
        shutil.rmtree(stage, ignore_errors=True)
        for path in made:  # the deepest first; only what is still empty
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


@contextmanager
def staged_result(json_file: str | None, value: Any, out: str | os.PathLike | None) -> Iterator[Path | None]:
    """Write a result's JSON, and yield a hidden folder for its other files: all of them appear, or none.

    Args:
        json_file: where `value` goes for machines, or None.
        value: dicts, lists and numbers.
        out: where the other files belong, or None: then there is no folder to write to.

    Raises:
        BadInput: a file or the folder cannot be written.
    """
    with ExitStack() as stages:
        (json_stage,) = stages.enter_context(staged_files(json_file))
        if json_file:
            write_json(json_stage, value)
        yield None if out is None else stages.enter_context(staged_folder(out))


def _missing_parents(target: Path) -> list[Path]:
    return [path for path in (target, *target.parents) if not path.exists()]


def write_json(path: str, value: Any) -> None:
    """Write a result for machines, whole or not at all; what is not finite becomes null.

    Raises:
        BadInput: the file cannot be written.
    """
    write_text_atomic(path, json.dumps(without_nan(value), indent=2, allow_nan=False) + "\n")


def without_nan(value: Any) -> Any:
    """Values as JSON has them: NumPy's become Python's, nan and infinity None."""
    if isinstance(value, dict):
        return {str(k): without_nan(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [without_nan(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value

"""`pitp compare`: reports the differences between two models or two sets of recordings."""

from pathlib import Path

from ...files.model_file.model_file import is_model_file, load
from ...files.recordings.reading import read
from ..compare.comparison import compare as run_compare
from ..compare.result import Comparison
from ..pages.compare import page
from ..pages.drawing import write_page
from .console import print_table
from .outputs import MODEL, check_outputs, staged

PAGE = "compare.html"


def compare(a, b, out, json_file, reading) -> None:
    """Compare two inputs, write the requested files, and print the differences.

    Args:
        a, b: model files, or folders with one that `pitp diagnose --out` wrote; or records.
        out: folder for a page and its figures, or None.
        json_file: where to write the comparison as JSON, or None.
        reading: keyword arguments of `pitp.read`: columns, units, scales, rate.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    check_outputs(json_file, folder=out, names=[PAGE], inputs=[a, b])
    comparison = run_compare(_opened(a, reading), _opened(b, reading), names=_names(a, b))
    with staged(folder=out, json_file=json_file, value=comparison.as_json()) as stage:
        if out is not None:
            write_page(stage / PAGE, page(comparison))
    _print(comparison)
    if out is not None:
        print(f"wrote {Path(out) / PAGE}")


def _opened(path: str, reading: dict):
    """Open a path as a model, as the model of a diagnosis, or as records."""
    place = Path(path) / MODEL if (Path(path) / MODEL).is_file() else Path(path)
    return load(place) if place.is_file() and is_model_file(place) else read(path, **reading)


def _names(a: str, b: str) -> tuple[str, str]:
    """Return the ends of two paths, as short as tells them apart; file names if both are one file."""
    one, two = (Path(p).resolve().parts for p in (a, b))
    size = next((k for k in range(1, 1 + max(len(one), len(two))) if one[-k:] != two[-k:]), 1)
    return Path(*one[-size:]).as_posix(), Path(*two[-size:]).as_posix()


def _print(comparison: Comparison) -> None:
    print(comparison.headline())
    for line in comparison.remarks:
        print(line)
    print_table(comparison.table([r for r in comparison.rows if r.differs is not False]))

"""Read sheets of Excel workbooks (.xlsx, extra `excel`): rows of cells, laid out as a text table."""

from collections.abc import Sequence
from datetime import timedelta
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ....common.errors import BadInput, cleaned
from ..guard import check_archive, check_columns
from ..header import Rows, is_number, layouts
from ..options import ReadOptions
from ..table import Parts, Table
from .text import numbers_of

kind, remedy = "an Excel workbook", "save it as .xlsx or CSV"
suffixes = (".xlsx",)
begins = (b"PK",)
_HEAD, _ROWS = 200, 1 << 20  # rows examined; the most a sheet has


def tables(path: Path, options: ReadOptions) -> Parts:
    """Return the sheets of an Excel workbook that hold a table of numbers."""
    check_archive(path)
    import openpyxl

    book = openpyxl.load_workbook(path, read_only=True, data_only=True, keep_links=False)
    parts, refusals = [], []
    try:
        titles = [cleaned(sheet.title) for sheet in book.worksheets]
        if options.sheet is not None and options.sheet not in titles:
            raise BadInput(f"has no sheet {options.sheet!r}; give --sheet one of {', '.join(titles)}")
        for sheet in book.worksheets:
            if options.sheet in (None, cleaned(sheet.title)):
                # the size that a sheet states is often wrong
                sheet.reset_dimensions()
                rows = list(enumerate(islice(sheet.iter_rows(values_only=True), _ROWS), 1))
                try:
                    parts.append(_sheet(path, rows, cleaned(sheet.title), options))
                except BadInput as error:
                    refusals.append(error)
    finally:
        book.close()
    if not parts:
        raise refusals[0] if refusals else BadInput("has no sheet; save it as CSV")
    return parts


def _sheet(path: Path, rows: list[tuple[int, tuple]], title: str, options: ReadOptions) -> list[Table]:
    """Return every way to read the numbered rows of one sheet as a table."""
    filled = [(k, row) for k, row in rows if any(cell is not None for cell in row)]
    check_columns(max((len(row) for _, row in filled), default=0))
    width = max((len(row) for _, row in filled[:_HEAD]), default=0)
    last = [cell for _, row in filled[-_HEAD:] for cell in row if cell is not None]
    # most numbers are stored as texts with a decimal comma
    commas = 2 * sum(isinstance(c, str) and is_number(c.strip(), ",") for c in last) > len(last)
    decimal = options.decimal or ("," if commas else ".")
    cells = {k: [_shown(cell, decimal) for cell in (*row, *[None] * width)[:width]] for k, row in rows}
    numbers = [k for k, _ in filled[:_HEAD]]
    head = Rows([cells[k] for k in numbers], numbers, [False] * len(numbers))
    made = layouts(head, "\t", decimal, options.header_line, options.units_line)
    body = [k for k in cells if numbers[made[0].first] <= k <= filled[-1][0]]

    def place(sample: int) -> str:
        return f"sample {sample} (row {body[sample]})" if sample < len(body) else f"sample {sample}"

    def texts(k: int) -> np.ndarray:
        return np.array([cells[row][k] for row in body])

    def load(places: Sequence[int]) -> list[np.ndarray]:
        return [numbers_of(texts(k).tolist(), made[0], k, place) for k in places]

    return [
        Table(
            path, m.columns, load, place, ", ".join((f"Excel workbook, sheet {title!r}", *m.notes)), title, texts=texts
        )
        for m in made
    ]


def _shown(value: Any, decimal: str) -> str:
    """Return a cell as text; a time span as hours, minutes and seconds."""
    if isinstance(value, timedelta):
        minutes, seconds = divmod(value.total_seconds(), 60)
        return f"{minutes // 60:02.0f}:{minutes % 60:02.0f}:{seconds:09.6f}"
    if isinstance(value, float):
        return repr(value).replace(".", decimal)
    return "" if value is None else cleaned(value).strip()

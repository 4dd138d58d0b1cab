"""Read sheets of Excel workbooks (.xlsx, extra `excel`): rows of cells, laid out as a text table."""

from dataclasses import replace
from datetime import timedelta
from itertools import islice
from pathlib import Path
from typing import Any

from ....common.errors import BadInput, cleaned
from ..guard import check_archive, check_columns
from ..header import is_number
from ..options import ReadOptions
from ..refusal import unrefused
from ..table import Parts, Table
from .text import text_tables

kind, remedy = "an Excel workbook", "save it as .xlsx or CSV"
suffixes = (".xlsx",)
begins = (b"PK",)


def tables(path: Path, options: ReadOptions) -> Parts:
    """Return the sheets of an Excel workbook that hold a table of numbers."""
    check_archive(path)
    import openpyxl

    book = openpyxl.load_workbook(path, read_only=True, data_only=True, keep_links=False)

    def tables_of(sheet: Any) -> list[Table]:
        sheet.reset_dimensions()  # the size that a sheet states is often wrong
        rows = list(islice(sheet.iter_rows(values_only=True), 1 << 20))  # as many as a sheet has
        return _sheet(path, rows, cleaned(sheet.title), options)

    try:
        titles = [cleaned(sheet.title) for sheet in book.worksheets]
        if not titles:
            raise BadInput("has no sheet of cells; save it as CSV")
        if options.sheet is not None and options.sheet not in titles:
            raise BadInput(f"has no sheet {options.sheet!r}; give --sheet one of {', '.join(titles)}")
        sheets = [sheet for sheet, title in zip(book.worksheets, titles, strict=True) if options.sheet in (None, title)]
        return list(unrefused(tables_of, sheets))
    finally:
        book.close()


def _sheet(path: Path, rows: list[tuple], title: str, options: ReadOptions) -> list[Table]:
    """Return every way to read the rows of one sheet as a table: as those of a text separated by tabs."""
    filled = [row for row in rows if any(cell is not None for cell in row)]
    width = max(map(len, filled), default=0)
    check_columns(width)
    last = [cell for row in filled[-200:] for cell in row if cell is not None]
    # most numbers are stored as texts with a decimal comma
    commas = 2 * sum(isinstance(c, str) and is_number(c.strip(), ",") for c in last) > len(last)
    decimal = options.decimal or ("," if commas else ".")
    lines = ["\t".join(_shown(cell, decimal) for cell in (*row, *[None] * (width - len(row)))) for row in rows]
    data = "\n".join(line if line.strip() else "" for line in lines).rstrip("\n").encode()
    plain = replace(options, separator="\t", decimal=decimal, encoding="utf-8")
    return text_tables(path, lambda: data, plain, f"Excel workbook, sheet {title!r}", title)


def _shown(value: Any, decimal: str) -> str:
    """Return a cell as text without blanks that are wide; a time span as hours, minutes and seconds."""
    if isinstance(value, timedelta):
        minutes, seconds = divmod(value.total_seconds(), 60)
        return f"{minutes // 60:02.0f}:{minutes % 60:02.0f}:{seconds:09.6f}"
    if isinstance(value, float):
        return repr(value).replace(".", decimal)
    return "" if value is None else " ".join(cleaned(value).split())

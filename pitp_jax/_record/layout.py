"""Where a table of cells has its header, its units and its first row of numbers.

lines -> (separator, decimal mark) by which most cells are numbers -> preamble | header | units | rows

The same finds the header of a sheet, whose rows are cells already.
"""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from .._errors import BadInput
from .table import Column, check_columns, cleaned
from .units import spelt

COMMENTS = ("#", "%", "//", "!")
_SEPARATORS = ("\t", ";", ",", "|", " ")
_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")
_COMMA = re.compile(r"[+-]?(\d+,?\d*|,\d+)([eE][+-]?\d+)?$")
_WORDS = frozenset(("", "nan", "-nan", "inf", "-inf", "+inf", "infinity", "-infinity", "na", "n/a", "null", "none"))
_STAMP = re.compile(r"(\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[T ]+)?\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?(Z|[+-]\d\d:?\d\d)?$")
_PAIRS = re.compile(r"(\w+)\s*(?:\bin\b|[=:/]|[(\[])\s*([A-Za-zµμ]+)")


@dataclass(frozen=True)
class Layout:
    """How a table is written.

    Attributes:
        separator: between cells; a blank stands for any number of them.
        decimal: `.` or `,`.
        columns: the names in the header, with units of a units row or of comments.
        first: index of the first row of numbers among the rows given.
        width: cells of a row of numbers.
        notes: what else was recognised, in words.
    """

    separator: str
    decimal: str
    columns: tuple[Column, ...]
    first: int
    width: int
    notes: tuple[str, ...]


def cells_of(line: str, separator: str) -> list[str]:
    """A line as its cells, stripped."""
    if separator == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell is a number, or empty or nan."""
    return bool((_COMMA if decimal == "," else _POINT).match(cell)) or cell.lower() in _WORDS


def is_stamp(cell: str) -> bool:
    """Whether a cell is an hour, with or without its date."""
    return bool(_STAMP.match(cell))


def text_layout(lines: Sequence[str], source: str) -> Layout:
    """The layout of text.

    Args:
        lines: the first lines of the file that are not empty, comments included.
        source: the file, for messages.

    Raises:
        BadInput: no separator makes a table of numbers of it, or more columns than reasonable.
    """
    plain = [line for line in lines if not line.lstrip(' "').startswith(COMMENTS)]
    best: tuple[float, str, str] = (0.0, "", "")
    for separator in _SEPARATORS:
        try:
            rows = [cells_of(line, separator) for line in plain]
        except csv.Error:
            continue
        for decimal in ".,":
            score = _score(rows, decimal)
            if score > best[0] + 1e-9:
                best = (score, separator, decimal)
    if not best[1]:
        raise BadInput(f"{source}: holds no table of numbers (two columns, 64 rows at least); save it as plain CSV")
    _, separator, decimal = best
    rows, commented = [], []
    for line in lines:
        bare = line.strip().strip('"')
        mark = next((mark for mark in COMMENTS if bare.startswith(mark)), "")
        rows.append(cells_of(bare.lstrip("#%/! ") if mark else line, separator))
        commented.append(bool(mark))
    return find_header(rows, source, separator, decimal, commented)


def _score(rows: Sequence[Sequence[str]], decimal: str) -> float:
    """Share of rows of the usual length times share of their cells that are numbers; 0 where they are no table."""
    lengths = Counter(len(row) for row in rows if len(row) > 1)
    if not lengths:
        return 0.0
    width, many = lengths.most_common(1)[0]
    cells = [cell for row in rows if len(row) == width for cell in row if cell]
    good = sum(is_number(cell, decimal) or is_stamp(cell) for cell in cells)
    return good / max(len(cells), 1) * many / len(rows) if good >= 2 else 0.0


def find_header(
    rows: list[list[str]], source: str, separator: str, decimal: str, commented: Sequence[bool] = ()
) -> Layout:
    """Header, units and first row of numbers among rows of cells.

    Args:
        rows: the first rows.
        source: the file, for messages.
        separator: told on.
        decimal: `.` or `,`.
        commented: which of the rows were comments; such a row is a header only where it fits.

    Raises:
        BadInput: no row of numbers, no header that fits them, more columns than reasonable.
    """
    commented = commented or [False] * len(rows)
    check_columns(max(map(len, rows), default=0), source)
    live = [row for row, comment in zip(rows, commented, strict=True) if not comment and len(row) > 1]
    width = Counter(len(row) for row in live).most_common(1)[0][0] if live else 0
    block = [row for row in live if len(row) == width]
    numeric, stamps = [], []
    for k in range(width):
        filled = [row[k] for row in block if row[k]]
        if 2 * sum(is_number(cell, decimal) for cell in filled) >= len(filled):
            numeric.append(k)
        elif 2 * sum(is_stamp(cell) for cell in filled) > len(filled):
            stamps.append(k)

    def numbers(k: int) -> bool:
        row = rows[k]
        good = not commented[k] and len(row) == width and any(row[j] for j in numeric)
        return good and all(is_number(row[j], decimal) for j in numeric) and all(is_stamp(row[j]) for j in stamps)

    if len(numeric) + len(stamps) < 2:
        raise BadInput(f"{source}: holds no table of numbers (two columns, 64 rows at least); save it as plain CSV")
    first = next((k for k in range(len(rows)) if numbers(k)), None)
    if first is None:
        raise BadInput(f"{source}: no row in which every column has its number; correct the first rows")
    filled = [len(_trimmed(row)) for row in rows[first:] if len(row) == width]
    names, units, notes = _header(rows[:first], commented, range(max(filled), width + 1), source)
    spoken = _spoken(rows[:first], separator)
    columns = tuple(
        Column(cleaned(name), units[k] or spoken.get(name.lower()), k in stamps) for k, name in enumerate(names)
    )
    if spoken.keys() & {name.lower() for name in names}:
        notes.append("units in a comment")
    return Layout(separator, decimal, columns, first, width, tuple(notes))


def _header(rows: list[list[str]], commented, widths: range, source) -> tuple[list[str], list[str | None], list[str]]:
    """Names, units beside them, and what to tell of the rows above the numbers, which have so many cells filled."""
    width = widths[-1]
    units: list[str | None] = [None] * width
    notes, place = [], len(rows)
    labels = next((row for row in rows if row and row[0].lower() == "y_unit_label"), None)
    if labels is not None:  # LabVIEW: the first column is the time
        units = ["s", *(cell or None for cell in labels[1:width])]
        units += [None] * (width - len(units))
    for k in range(len(rows) - 1, -1, -1):
        row = [cell for cell in rows[k] if cell]
        known = [cell for cell in row if spelt(cell) or cell.strip("[]()") in ("", "-")]
        if len(row) > 1 and len(known) == len(row) and k > 0 and not commented[k]:
            units = [cell or None for cell in (*rows[k], *[""] * width)][:width]
            notes.append("units row")
            continue
        names = len(_trimmed(rows[k]))
        fits = len(row) > 1 and (names in widths or (not commented[k] and abs(names - width) == 1))
        if fits and not any(is_number(cell, ".") or is_number(cell, ",") for cell in row):
            place = k
            break
        if not commented[k] and k == len(rows) - 1 and len(rows[k]) == width and not fits:
            break
    if place == len(rows):
        if rows and len(rows[-1]) >= width and not commented[len(rows) - 1]:
            raise BadInput(
                f"{source}: the row above the numbers is no header ({', '.join(rows[-1])[:60]!r}); correct it"
            )
        return [str(k + 1) for k in range(width)], units, [*notes, "no header, columns counted from 1"]
    names = _trimmed(rows[place])
    if len(names) > width and names[-1].lower() == "comment":
        names = names[:-1]
    if len(names) > width:
        raise BadInput(f"{source}: {len(names)} names in the header over rows of {width} cells; make them agree")
    above = place - (1 if labels is not None else 0)
    if above > 0:
        notes.append(f"{above} line{'s' if above > 1 else ''} above the header")
    if commented[place]:
        notes.append("header in a comment")
    return [*names, *[""] * (width - len(names))], units, notes


def _trimmed(row: Sequence[str]) -> list[str]:
    """The row without empty cells at its end."""
    kept = list(row)
    while kept and not kept[-1]:
        kept.pop()
    return kept


def _spoken(rows: Sequence[Sequence[str]], separator: str) -> dict[str, str]:
    """Units said in the lines above the numbers: `t in s, u in V`."""
    text = "\n".join((separator if separator != " " else " ").join(row) for row in rows[:50])[:20_000]
    return {name.lower(): unit for name, unit in _PAIRS.findall(text) if spelt(unit)}

"""Find the column names, the units and the first row of numbers among the first rows of a table.

rows -> columns that are numbers or hours -> first of several rows of numbers -> units row, names above it

Every row above the numbers that could name the columns is one possible reading. The readings are compared by their
columns and units (`choice`).
"""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

from ...common.errors import BadInput, cleaned
from ...common.units import spelt
from .guard import check_columns
from .names import read_header
from .refusal import unrefused
from .stamps import is_stamp
from .table import Column

_NUMBER = {
    ".": re.compile(r"[+-]?(\d++\.?\d*+|\.\d++)([eEdD][+-]?\d++)?$"),
    ",": re.compile(r"[+-]?(\d++,?\d*+|,\d++)([eEdD][+-]?\d++)?$"),
}
MISSING = frozenset(("", "nan", "-nan", "na", "n/a", "null", "none"))
_WORDS = MISSING | {"inf", "-inf", "+inf", "infinity", "-infinity"}
_KEYS = (  # of rows that start with a key: `TraceName,CH1,CH2`, `UnitName=  kV  mm`
    re.compile(r"((trace|channel|signal|curve)[ _]?)?(name|title|label|channel)s?[:=]?", re.IGNORECASE),
    re.compile(r"((v|y|vertical|channel|signal)[ _]?)?units?[ _]?(name|label|string)?[:=]?", re.IGNORECASE),
)
_PAIR = re.compile(r"(?:unit of )?(\w[\w ]*?)\s*(?:\bin\b|[=:/]|[(\[])\s*([^\s\d)\]]+)\s*[)\]]?")


class NoTable(BadInput):
    """Error: a text file does not hold two columns of numbers."""

    def __init__(self):
        """Write the message for a file."""
        super().__init__(
            "holds no table of numbers (at least 2 columns and 64 rows); save it as plain CSV, give "
            "--separator and --header-line, or --join the files that hold the other columns"
        )


@dataclass(frozen=True)
class Rows:
    """The first rows of a text table, split into cells, with line numbers.

    Attributes:
        cells: of every row, stripped.
        numbers: of their lines, from 1.
        commented: which of them are comments.
    """

    cells: list[list[str]]
    numbers: list[int]
    commented: list[bool]


@dataclass(frozen=True)
class Layout:
    """The layout of a table in a text: separator, decimal mark, columns, first row of numbers.

    Attributes:
        separator: between cells; a blank stands for any number of them.
        decimal: `.` or `,`.
        columns: names and units.
        first: index of the first row of numbers among the rows given.
        width: cells of a row of numbers.
        notes: further recognised properties, in words.
        hint: about the rate, or empty.
    """

    separator: str
    decimal: str
    columns: tuple[Column, ...]
    first: int
    width: int
    notes: tuple[str, ...] = ()
    hint: str = ""


@lru_cache(1 << 12)  # every guess about the first rows asks it of the same cells
def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell holds a number, is empty or says nan."""
    return bool(_NUMBER[decimal].match(cell)) or cell.lower() in _WORDS


def layouts(rows: Rows, separator: str, decimal: str, header_line: int | None, units_line: str | None) -> list[Layout]:
    """Return every possible reading of the rows above the numbers (names, units), the likeliest first.

    Args:
        rows: the first rows.
        separator: passed on.
        decimal: `.` or `,`.
        header_line: the line that names the columns, if the user gives it.
        units_line: the line of units, or "none".

    Raises:
        BadInput: no row of numbers, no such line, names that do not fit the rows, more columns than reasonable.
    """
    check_columns(max(map(len, rows.cells), default=0))
    # numbers above a header that the user names are settings
    body = [k for k in range(len(rows.cells)) if not rows.commented[k] and rows.numbers[k] > (header_line or 0)]
    cells = [rows.cells[k] for k in body]
    # half of the cells are numbers: one or two columns may be words
    width = most_common(len(row) for row in cells if len(row) > 1 and 2 * _count(row, decimal) >= len(trimmed(row)))
    full = [row for row in cells if len(row) == width and _count(row, decimal)]
    forms = _forms(full[_settings(full) :], width, decimal)
    if sum(form != "text" for form in forms) < 2:
        raise NoTable()
    first = _first(rows, body, width, forms, decimal)
    if first is None:
        raise BadInput("no row has a number in every column; correct the first rows")
    # empty columns at the right need no name
    filled = [len(trimmed(row)) for row in rows.cells[first:] if len(row) == width]
    widths = range(max(filled, default=width), width + 1)
    bare = Layout(separator, decimal, tuple(Column("", form=form) for form in forms), first, width)
    units, above = _units_row(rows, first, widths, units_line)
    if header_line is not None:
        above = [_stated(rows, first, header_line, "--header-line")]
    plain_rows = [k for k in above if not rows.commented[k]]
    named = (plain_rows or above)[:4]  # a comment above a row of names is not a row of names
    readings = list(unrefused(lambda k: _named(bare, rows, k, units, widths, first), named))
    return readings or [_unnamed(bare, rows, units, first)]


def most_common(lengths: Iterable[int]) -> int:
    """Return the most common length; 0 without any."""
    return next((length for length, _ in Counter(lengths).most_common(1)), 0)


def _count(row: Sequence[str], decimal: str) -> int:
    return sum(bool(cell) and (is_number(cell, decimal) or is_stamp(cell)) for cell in row)


def _settings(block: Sequence[Sequence[str]]) -> int:
    """Return how many of the first rows are settings with a key and numbers (`BlockSize,400,400`)."""
    # settings have their key in the first cell, rows of numbers leave it empty
    keyed = next((k for k, row in enumerate(block) if not row[0]), 0)
    return keyed if keyed > 2 and not any(row[0] for row in block[keyed:]) else 0


def _forms(block: Sequence[Sequence[str]], width: int, decimal: str) -> list[str]:
    """Return the form of each column ("number", "stamp" or "text"), by most of its cells."""
    forms = []
    for k in range(width):
        filled = [row[k] for row in block if row[k]]
        numbers = sum(is_number(cell, decimal) for cell in filled)
        hours = sum(is_stamp(cell) for cell in filled)
        other = "stamp" if 2 * hours > len(filled) else "text"
        forms.append("number" if 2 * numbers >= len(filled) else other)
    return forms


def _first(rows: Rows, body: Sequence[int], width: int, forms: Sequence[str], decimal: str) -> int | None:
    """Return the index of the first row of numbers; a single row of numbers above names (`1000,,`) is a setting."""

    def holds(k: int) -> bool:
        row = rows.cells[k]
        fit = {
            "number": lambda c: is_number(c, decimal),
            "stamp": lambda c: is_stamp(c) or not c,
            "text": lambda c: True,
        }
        some = any(cell and form != "text" for cell, form in zip(row, forms, strict=False))
        return len(row) == width and some and all(fit[form](cell) for cell, form in zip(row, forms, strict=True))

    good = [k for k in body if holds(k)]
    # single numbers above a row of names are settings
    full = next((k for k in good if _count(rows.cells[k], decimal) > 1), 0)
    between = [rows.cells[k] for k in body if good[:1] < [k] < [full]]
    if any(len(trimmed(row)) > 1 and not _numeric(row) for row in between):
        good = [k for k in good if k >= full]
    # two rows of numbers in sequence start the data
    pairs = [k for k, after in pairwise(good) if body.index(after) == body.index(k) + 1]
    return next(iter(pairs or good), None)


def _units_row(rows: Rows, first: int, widths: range, units_line: str | None) -> tuple[list[str], list[int]]:
    """Return the units of the columns, and the indices of rows that may hold the column names, the nearest first."""
    fits = [k for k in range(first) if _fits(rows, k, widths)]
    if units_line == "none":
        return [], [k for k in fits[::-1] if not _numeric(rows.cells[k])]
    if units_line is not None:
        stated = _stated(rows, first, int(units_line), "--units-line")
        return rows.cells[stated], [k for k in fits[::-1] if k != stated]
    named, united = ([k for k in fits if key.fullmatch(rows.cells[k][0])] for key in _KEYS)
    if named and united and _is_units(rows.cells[united[-1]][1:]):
        if not any(row[0] for row in rows.cells[first:] if row):  # a key without a column of its own
            rows.cells[named[-1]][0] = ""
        return ["", *rows.cells[united[-1]][1:]], named[-1:]
    united = [k for k in fits[::-1] if _is_units(rows.cells[k][: widths[0]])][:1]
    names = [k for k in fits[::-1] if k not in united and not _numeric(rows.cells[k])]
    if not united:
        return [], names
    # units are below the names, or in a row above them; channels may be numbered (`X,1,2`)
    above = [k for k in names if k < united[0]][:1]
    counted = [k for k in fits[::-1] if k < united[0]][:1]
    return rows.cells[united[0]], above or names or counted or united


def _stated(rows: Rows, first: int, line: int, option: str) -> int:
    """Return the index of the row that the user states by its line."""
    if line not in rows.numbers[:first]:
        raise BadInput(f"line {line} is empty or not above the numbers; give another {option}")
    return rows.numbers.index(line)


def _fits(rows: Rows, k: int, widths: range) -> bool:
    """Return whether row k can name the columns: it has one cell for each (R omits the name of the first column)."""
    row, below = rows.cells[k], rows.cells[k + 1]
    count = len(trimmed(row))
    if count < 2 or (rows.commented[k] and row[0].endswith((":", "="))):  # `# rows: 400` is a setting
        return False
    if count in widths or (count == widths[0] - 1 and not rows.commented[k]):
        return True
    # Beyond the columns there may be settings (`X,CH1,CH2,Start,Increment`), their values here or in the row below.
    return count > widths[-1] and (_extra(row, widths[-1]) or _numeric(below[widths[-1] :]))


def _extra(row: Sequence[str], width: int) -> bool:
    """Return whether the cells to the right of the columns are settings: after an empty cell, or numbers."""
    return not all(trimmed(row)[: width + 1]) or any(_numeric([cell]) for cell in row[width:] if cell)


def _numeric(row: Sequence[str]) -> bool:
    """Return whether a row holds numbers or times of day, so that it cannot hold names."""
    return any(cell and (is_number(cell, ".") or is_number(cell, ",") or is_stamp(cell)) for cell in row)


def _is_units(row: Sequence[str]) -> bool:
    """Return whether a row holds units: most cells are units, the others are short, and none is a number except 1."""
    if _numeric([cell for cell in row if cell != "1"]):
        return False
    cells = [_of_unit(cell) for cell in row if cell.strip("[]()- ") and cell != "1"]
    # a channel in dB or without a unit beside them is allowed; `Millimeters` is a unit, a sentence is not
    known = sum(spelt(cell) is not None for cell in cells)
    return known > 0 and 2 * known >= len(cells) and all(len(cell) <= 12 for cell in cells)


def _of_unit(cell: str) -> str:
    """Remove the key of a cell in a units row: `kV` of `Unit: kV`."""
    return re.sub(r"^units?\s*[:=]\s*", "", cell.strip(), flags=re.IGNORECASE)


def _named(bare: Layout, rows: Rows, k: int, units: Sequence[str], widths: range, first: int) -> Layout:
    """Return the layout in which row k holds the column names."""
    names, width, notes = trimmed(rows.cells[k]), bare.width, []
    if len(names) > width:
        names, notes = names[: widths[0]], [f"{len(names) - widths[0]} cells to the right of the header ignored"]
    if len(rows.cells[k]) == widths[0] - 1:  # an empty last cell names nothing, and shifts nothing
        names = ["row", *names]
        notes.append("row names before the first column")
        counts = [row[0] for row in rows.cells[first:] if len(row) == width]
        # R counts its rows from 1, pandas from 0
        start = next((int(c) for c in counts if c.isdecimal()), -1)
        if any(c != str(start + i) for i, c in enumerate(counts)):
            raise BadInput(
                f"line {rows.numbers[k]}: {len(names) - 1} column names, but {widths[0]} cells in the rows "
                "below; make them agree, or give --header-line"
            )
    names += [""] * (width - len(names))
    empty = [
        m for m in range(width) if "=" in names[m] and not any(row[m : m + 1] != [""] for row in rows.cells[first:])
    ]
    hint = ", ".join(names[m] for m in empty)  # `tInc = 0.001` over no numbers is a setting
    named = _with_names(bare, ["" if m in empty else name for m, name in enumerate(names)], units, rows, first)
    above = sum(1 for m in range(k) if any(rows.cells[m]))
    if units and list(units) != rows.cells[k]:
        notes.append("units row")
    if above:
        notes.append(f"{above} line{'s' if above > 1 else ''} above the header")
    if rows.commented[k]:
        notes.append("header in a comment")
    return replace(named, notes=tuple(notes), hint=hint)


def _unnamed(bare: Layout, rows: Rows, units: Sequence[str], first: int) -> Layout:
    """Return the layout with columns numbered from 1; refuse it if the row above the numbers looks like a header."""
    last = [k for k in range(first) if not rows.commented[k]][-1:]
    if last and len(trimmed(rows.cells[last[0]])) > 2 and _count(rows.cells[last[0]], bare.decimal) == 0:
        count = len(trimmed(rows.cells[last[0]]))
        raise BadInput(
            f"line {rows.numbers[last[0]]}: {count} names in the header, but {bare.width} cells in the rows "
            "below; make them agree, or give --header-line"
        )
    names = [str(k + 1) for k in range(bare.width)]
    return replace(_with_names(bare, names, units, rows, first), notes=("no header, columns counted from 1",))


def _with_names(bare: Layout, names: Sequence[str], units: Sequence[str], rows: Rows, first: int) -> Layout:
    spoken = _spoken(rows, first)
    beside = [_of_unit(unit) if unit.strip("[]()- ") else None for unit in (*units, *[""] * bare.width)]
    columns = tuple(
        Column(cleaned(name), beside[k], spoken.get(_stem(name)), bare.columns[k].form) for k, name in enumerate(names)
    )
    return replace(bare, columns=columns)


def _stem(name: str) -> str:
    return read_header(name).stem.lower()


def trimmed(row: Sequence[str]) -> list[str]:
    """Drop the empty cells at the end of a row."""
    kept = list(row)
    while kept and not kept[-1]:
        kept.pop()
    return kept


def _spoken(rows: Rows, first: int) -> dict[str, str]:
    """Return units by column name from comments that consist only of pairs: `t in s, u in V`."""
    said = {}
    for cells, commented in zip(rows.cells[:first], rows.commented, strict=False):
        for between in (",", " "):  # cells were cut at commas or at blanks
            parts = [p.strip() for p in re.split(r"[,;]|\s{2,}", between.join(cells)) if p.strip()]
            # only whole parts: a sentence that contains "min" states no unit
            pairs = [_PAIR.fullmatch(part) for part in parts]
            if commented and pairs and all(pair and spelt(pair[2]) for pair in pairs):
                said |= {_stem(pair[1]): pair[2] for pair in pairs if pair}
    return said

"""Text tables (.csv .txt .dat .tsv .lvm, also .gz) through pandas' C parser.

bytes -> UTF-8 -> layout of the first lines -> rows of numbers: wanted columns only, about 2e6 rows per second

Only where that fails is the text read row by row, to name the first bad line and column.
"""

import csv
import io
from collections.abc import Callable, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from .._errors import BadInput
from .layout import COMMENTS, Layout, is_number, text_layout
from .table import Table, check_count, cleaned, file_bytes
from .timestamps import seconds
from .unfolding import gunzip

_GZIP_MAGIC = b"\x1f\x8b"
_CONTROL = bytes(set(range(32)) - {9, 10, 12, 13})
_HEAD, _LINES, _LONGEST = 1 << 18, 200, 1 << 16  # bytes, lines looked at; bytes of one line
_MARKS = tuple(mark.encode() for mark in COMMENTS)
_NAMES = {"\t": "tabs", " ": "blanks"}


def text_table(path: Path) -> Table:
    """A text file as a table.

    Raises:
        BadInput: unreadable, compressed or not as its suffix says, binary, no table of numbers.
    """
    source = cleaned(path)
    data, encoding = _text(path, source)
    spans = _first_lines(data, source)
    layout = text_layout([data[a:b].decode(encoding, "replace") for a, b in spans], source)
    start = spans[layout.first][0]
    above, body = data[:start].count(b"\n"), _rows_only(data[start:], layout)
    del data
    check_count(body.count(b"\n"), source)

    def place(sample: int) -> str:
        return f"sample {sample} (line {_line_of(path, sample, above, layout.separator)})"

    def load(places: Sequence[int]) -> list[np.ndarray]:
        values = _parse(body, layout, places, encoding)
        return values if values is not None else _rows(body, layout, places, encoding, source, place)

    parts = [f"text separated by {_NAMES.get(layout.separator, repr(layout.separator))}"]
    parts += ["decimal comma"] if layout.decimal == "," else []
    parts += [encoding] if encoding not in ("utf-8", "ascii") else []
    return Table(source, layout.columns, load, place, ", ".join((*parts, *layout.notes)))


def _text(path: Path, source: str) -> tuple[bytes, str]:
    """The unfolded text with plain line ends, and how to decode it."""
    data, wide = file_bytes(path), None
    zipped = data.startswith(_GZIP_MAGIC)
    if path.name.lower().endswith(".gz"):
        if not zipped:
            raise BadInput(f"{source}: is not gzip as its suffix says; drop .gz from its name if it is plain text")
        data = gunzip(data, source)
    elif zipped:
        raise BadInput(f"{source}: is gzip, not text as its suffix says; rename it to end in .gz")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        wide = "utf-16"
    elif data[1:400:2].count(0) > 0.9 * len(data[1:400:2]) > 3:
        wide = "utf-16-le"
    elif data[0:400:2].count(0) > 0.9 * len(data[0:400:2]) > 3:
        wide = "utf-16-be"
    if wide:
        try:
            data = data.decode(wide).encode("utf-8")
        except UnicodeError as error:
            raise BadInput(f"{source}: damaged UTF-16 text ({error}); save it as UTF-8") from None
    data = data.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    plain = data.translate(None, _CONTROL)
    if len(plain) != len(data):
        bad = next(k for k, line in enumerate(data.split(b"\n"), 1) if line.translate(None, _CONTROL) != line)
        raise BadInput(f"{source}: line {bad}: not UTF-8 text as its suffix says (control characters); save it as CSV")
    try:
        data[:_HEAD].decode("utf-8")
    except UnicodeDecodeError as error:
        if error.start < len(data[:_HEAD]) - 4:  # not merely cut in the middle of a character
            return data, "latin-1"
    return data, "utf-8"


def _first_lines(data: bytes, source: str) -> list[tuple[int, int]]:
    """Where the first lines that are not empty begin and end."""
    spans, begin, end = [], 0, min(len(data), _HEAD)
    while begin < end and len(spans) < _LINES:
        stop = data.find(b"\n", begin, begin + _LONGEST)
        if stop < 0:
            if len(data) - begin > _LONGEST:
                line = data.count(b"\n", 0, begin) + 1
                raise BadInput(f"{source}: line {line}: a line of unreasonable length; save it as plain CSV")
            stop = len(data)
        if data[begin:stop].strip():
            spans.append((begin, stop))
        begin = stop + 1
    if not spans:
        raise BadInput(f"{source}: the file is empty (blank lines only); record it again or leave it out")
    return spans


def _line_of(path: Path, sample: int, above: int, separator: str) -> int:
    """The line a sample stands in, counted from 1; the file is read again for it."""
    data, _ = _text(path, cleaned(path))
    lines = enumerate(data.split(b"\n")[above:], above + 1)
    filled = (number for number, line in lines if _is_row(line, separator))
    return next(islice(filled, sample, None), above + 1 + sample)


def _is_row(line: bytes, separator: str) -> bool:
    """Whether a line is a row of cells: no comment, not empty, not separators alone."""
    return bool(line.strip(separator.encode() + b" \t\f")) and not line.startswith(_MARKS)


def _rows_only(body: bytes, layout: Layout) -> bytes:
    """The text without comment lines and rows without a filled cell."""
    body, empty = body.strip(b"\n"), layout.separator.encode() * (layout.width - 1)
    last = body.rpartition(b"\n")[2]
    if (
        b"\n\n" in body
        or (layout.separator != " " and b"\n" + empty in body)
        or any(b"\n" + mark in body for mark in _MARKS)
        or not _is_row(last, layout.separator)
    ):
        body = b"\n".join(line for line in body.split(b"\n") if _is_row(line, layout.separator))
    return body


def _parse(body: bytes, layout: Layout, places: Sequence[int], encoding: str) -> list[np.ndarray] | None:
    """Wanted columns by the C parser, or None where the text needs a closer look."""
    import pandas as pd

    if b'"' in body or not _rectangular(body, layout):
        return None
    stamps = [k for k in places if layout.columns[k].stamps]
    try:
        frame = pd.read_csv(
            io.BytesIO(body), header=None, names=range(layout.width), usecols=sorted(set(places)), engine="c",
            sep=r"\s+" if layout.separator == " " else layout.separator, decimal=layout.decimal, encoding=encoding,
            dtype={k: str if k in stamps else np.float64 for k in places}, skipinitialspace=True,
            low_memory=False, index_col=False,
        )  # fmt: skip
        columns = [frame[k] for k in places]
        return [
            seconds(list(c)) if k in stamps else c.to_numpy(np.float64) for k, c in zip(places, columns, strict=True)
        ]
    except (ValueError, OverflowError, pd.errors.ParserError):
        return None


def _rectangular(body: bytes, layout: Layout) -> bool:
    """True where every row has the usual number of cells."""
    codes = np.frombuffer(body, dtype=np.uint8)
    ends = np.append(np.flatnonzero(codes == ord("\n")), len(codes))
    if layout.separator == " ":
        blank = np.isin(codes, (9, 10, 32))
        marks, each = np.flatnonzero(~blank & np.append(True, blank[:-1])), layout.width
    else:
        marks, each = np.flatnonzero(codes == ord(layout.separator)), layout.width - 1
    if len(marks) != len(ends) * each:
        return False
    marks = marks.reshape(-1, each)
    return bool(np.all(marks[:, -1] < ends) and np.all(marks[1:, 0] > ends[:-1]))


def _rows(body, layout: Layout, places, encoding, source, place: Callable[[int], str]) -> list[np.ndarray]:
    """Wanted columns row by row; refuses the first bad row with its line and column."""
    values, lines = [], body.decode(encoding, errors="replace").split("\n")
    blanks = layout.separator == " "
    reader = csv.reader(lines, delimiter=layout.separator, skipinitialspace=True)
    width = layout.width
    try:
        for row in (line.split() for line in lines) if blanks else reader:
            while len(row) > width and not row[-1].strip():
                row.pop()
            if len(row) != width and not (len(row) == width - 1 and not layout.columns[-1].name):
                short = layout.columns[len(row)].name if len(row) < width else layout.columns[-1].name
                raise BadInput(
                    f"{source}: column {short!r}, {place(len(values))}: {len(row)} cells where the others have "
                    f"{width}; fix or delete the line"
                )
            values.append([row[k].strip() for k in places])
    except csv.Error as error:
        raise BadInput(f"{source}: sample {len(values)}: not readable as CSV ({error}); save it as plain CSV") from None
    columns = list(zip(*values, strict=True)) or [()] * len(places)
    return [_column(cells, layout, k, source, place) for cells, k in zip(columns, places, strict=True)]


def _column(cells: Sequence[str], layout: Layout, k: int, source: str, place) -> np.ndarray:
    """One column of cells as numbers."""
    column = layout.columns[k]
    if column.stamps:
        try:
            return seconds(cells)
        except (ValueError, OverflowError):
            raise BadInput(f"{source}: column {column.name!r}: not readable as dates and hours; give seconds") from None
    for sample, cell in enumerate(cells):
        if not is_number(cell, layout.decimal):
            shown = cleaned(cell if len(cell) <= 20 else cell[:20] + "...")
            raise BadInput(
                f"{source}: column {column.name!r}, {place(sample)}: text {shown!r} where a number belongs; write a "
                "number (leave a missing output empty)"
            )
    point = (cell.replace(",", ".") if layout.decimal == "," else cell for cell in cells)
    missing = ("", "na", "n/a", "null", "none")
    return np.array([float("nan") if cell.lower() in missing else float(cell) for cell in point])

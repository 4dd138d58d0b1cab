"""Read text tables (.csv .txt .dat .tsv .lvm, also .gz) through pandas' C parser.

bytes -> possible encodings -> separator and decimal mark -> layouts (a signature decides) -> rows of numbers

Only where the parser fails is the text read row by row, to name the first bad line and column.
"""

import codecs
import csv
import io
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from ....common.errors import BadInput, cleaned
from ....common.units import spelt
from ..guard import check_count, file_bytes, gunzip
from ..header import MISSING, Layout, NoTable, Rows, is_number, layouts, most_common, trimmed
from ..names import read_header
from ..options import ReadOptions
from ..refusal import Refused, shortened, unrefused
from ..stamps import is_stamp, seconds
from ..table import Column, Parts, Table
from .signatures import SIGNATURES

kind, remedy = "a text", "save it as CSV"
suffixes = tuple(f"{name}{end}" for end in (".gz", "") for name in (".csv", ".txt", ".dat", ".tsv", ".lvm"))
begins = (b"",)  # any bytes may be a text, until it is read
COMMENTS = ("#", "%", "//", "!")
_ENCODINGS = ("cp1252", "cp932", "gb18030", "cp1251", "euc_kr", "big5", "cp1253", "latin-1")
_SEPARATORS = {"\t": "tabs", ";": "';'", ",": "','", "|": "'|'", " ": "blanks"}
_HEAD, _LINES, _LONGEST = 1 << 18, 200, 1 << 16  # bytes, lines that are not comments; bytes of one line
_Body = tuple[bytes, int]  # a text, and where its rows of numbers start
_MARKS = tuple(mark.encode() for mark in COMMENTS)
_QUOTED_MARK = re.compile(r'\s*"[#%!/]+"\s*[,;\t|]')  # a cell of its own: the name of a counter
_NO_ROW = b"\n " + b"".join(mark[:1] for mark in _MARKS)  # a line that starts with one may be none
# a cell that is a list of numbers
_LIST = re.compile(rb'(?<![^\s,;|"])"?\[(\s*+[-+\d.][-+\d.eE,\s]{0,65536}+)\]"?(?![^\s,;|])')
_ITEMS = re.compile(rb"[^\s,]+")
_ARROW = re.compile(rb"\d\d:\d\d:\d\d\.\d+ -> ")
_BROKEN = 50  # lines searched for names with line breaks in quotes
_KEY = re.compile(r"(units?|columns?|names?|fields?|header)\s*[:=]\s*", re.IGNORECASE)
_CUTS = tuple(map(re.compile, (r"\s{2,}|\t", r"[,;]", r"(?<=[\])}])\s+", r"\s+")))
_DECIMAL = re.compile(rb"(?<!\d)0+,\d|\d,\d{1,2}(?!\d)|\d,\d{4}")  # not a comma between thousands
_DATE = re.compile(rb"(?<![\d.])\d{1,4}([-./])\d{1,2}\1\d{2,4}(?![\d.])")
_DURATION = re.compile(r"[+-]?[\d.,]++(?:[eE][+-]?\d++)?\s+(\S+)$")


def tables(path: Path, options: ReadOptions) -> Parts:
    """Return every table that a text file may hold, the likeliest first.

    Raises:
        BadInput: unreadable, compressed or not as its suffix says, binary, no table of numbers.
    """
    return [text_tables(path, partial(plain_text, path), options)]


def text_tables(path: Path, read: Callable[[], bytes], options: ReadOptions, form: str = "", part: str = "") -> list:
    """Return every table that a text may be, the likeliest first.

    Args:
        path: the file.
        read: function that returns the text.
        options: of reading.
        form: what the text is, for the summary; otherwise its separator is named.
        part: the sheet that it is, or empty.

    Raises:
        BadInput: no table of numbers.
    """
    data = read()
    spans = _first_lines(data)

    def read_as(encoding: str) -> list[Table]:
        lines, made = [data[a:b].decode(encoding) for a, b, _ in spans], []
        for layout in _layouts(lines, [n for _, _, n in spans], options):
            start = spans[layout.first][0]
            body = _body((data, start), layout)
            if options.decimal is None:
                layout = _with_decimal(body, layout)
            table = _table(path, read, data[:start], body, layout, encoding, form)
            made.append(replace(table, part=part))
        return made

    encodings = _encodings(b"\n".join(data[a:b] for a, b, _ in spans), options)
    return [table for made in unrefused(read_as, encodings) for table in made]


def single_column(path: Path) -> Table:
    """Return a text of one number per line as a table, named by its first line or the file."""
    data = plain_text(path)
    spans = (span[:2] for span in _first_lines(data) if not data[span[0] : span[1]].startswith(_MARKS))
    begin, end = next(spans, (0, 0))
    name, first = path.name.partition(".")[0], data[begin:end].decode("utf-8", "replace").strip(' "')
    if not is_number(first, ".") and not is_number(first, ","):
        name, begin = first, end + 1
    layout = Layout("\t", ".", (Column(cleaned(name)),), 0, 1)
    body = _body((data, begin), layout)
    layout = _with_decimal(body, layout)
    return _table(path, partial(plain_text, path), data[:begin], body, layout, "utf-8", "text of one column")


def _with_decimal(body: _Body, layout: Layout) -> Layout:
    """Return the layout with the decimal mark that the rows of numbers show.

    Raises:
        Refused: every comma may separate thousands.
    """
    if layout.separator == "," or not _has(body, b","):
        return layout
    if layout.decimal == ".":
        comma = _DECIMAL.search(*body) and not re.compile(rb"\d\.\d").search(*body)
        return replace(layout, decimal=",") if comma else layout
    if not _DECIMAL.search(*body):
        raise Refused(
            "every comma has three digits after it, so it may be a decimal or a thousands separator",
            {"--decimal": ","},
        )
    return layout


def _table(path: Path, read, head: bytes, body: _Body, layout: Layout, encoding: str, form: str) -> Table:
    above = head.count(b"\n")
    check_count(int(np.count_nonzero(_codes(body) == ord("\n"))))

    def place(sample: int) -> str:
        return f"sample {sample} (line {_line_of(read(), sample, above)})"

    def load(places: Sequence[int]) -> list[np.ndarray]:
        rows, values = body, _parse(body, layout, places, encoding)
        if values is None and (rows := _filled(body)) is not body:
            values = _parse(rows, layout, places, encoding)
        return values if values is not None else _rows(rows, layout, places, encoding, place)

    def texts(k: int) -> np.ndarray:
        return np.array([row[k] if k < len(row) else "" for row in _split(_filled(body), layout, encoding)])

    def blanks() -> int:
        return read()[len(head) :].strip(b"\n").count(b"\n\n")

    parts = [form or f"text separated by {_SEPARATORS.get(layout.separator, repr(layout.separator))}"]
    parts += ["decimal comma"] if layout.decimal == "," else []
    parts += [encoding] if encoding not in ("utf-8", "ascii") else []
    parts += ["a date above the table ignored"] if _DATE.search(head) else []
    words = ", ".join((*parts, *layout.notes))
    return Table(path, layout.columns, load, place, words, hint=layout.hint, blanks=blanks, texts=texts)


def plain_text(path: Path) -> bytes:
    """Read a text file: decompressed, with plain line ends, UTF-16 converted to UTF-8."""
    data, wide = file_bytes(path), None
    if data.startswith(b"\x1f\x8b"):  # whatever its suffix is, because downloads lose or gain `.gz`
        data = gunzip(data)
    for order, half in (("utf-16-le", data[1:400:2]), ("utf-16-be", data[0:400:2])):
        # every second byte is zero: UTF-16 of plain text without its mark
        wide = order if half.count(0) > 0.9 * len(half) > 3 else wide
    wide = "utf-16" if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else wide
    if wide:
        try:
            data = data.decode(wide).encode("utf-8")
        except UnicodeError as error:
            raise BadInput(f"damaged UTF-16 text ({error}); save it as UTF-8") from None
    data = data.removeprefix(codecs.BOM_UTF8)
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    data = _unbroken(data.rstrip(b"\x1a\x00"))  # the end of a DOS file
    if b"[" in data and _LIST.search(data[:_HEAD]):
        data = _unlisted(data)
    if _ARROW.match(data):  # a serial monitor's prefix of every line
        data = data.replace(b" -> ", b",")
    # below a tab, a vertical tab, or 14 to 31, because differences wrap around
    codes = np.frombuffer(data, dtype=np.uint8)
    if codes.min(initial=9) < 9 or b"\v" in data or (codes - 14).min(initial=18) < 18:
        bad = next(re.finditer(rb"[^\t\n\f -\xff]", data)).start()
        line = 1 + data.count(b"\n", 0, bad)
        raise BadInput(f"line {line}: control characters in a text file; save it as CSV")
    return data


def _unlisted(data: bytes) -> bytes:
    """Write lists in cells (`"[0.1, 0.2]"`, `[0.1 0.2]`) as cells of their own, named `name[1]`, `name[2]`, ..."""
    head, _, body = data.partition(b"\n")
    first = _LIST.sub(lambda match: b"\x1a" * len(_ITEMS.findall(match[1])), body.partition(b"\n")[0])
    separator = next((mark for mark in (b"\t", b";", b"|", b",") if mark in first), b",")
    cells = [cell.count(b"\x1a") for cell in first.split(separator)]
    names = [name.strip(b' "') for name in head.split(separator)]
    if len(names) == len(cells):
        wide = [
            [name] if not n else [b"%s[%d]" % (name, k + 1) for k in range(n)]
            for name, n in zip(names, cells, strict=True)
        ]
        head = separator.join(name for some in wide for name in some)
    return head + b"\n" + _LIST.sub(lambda match: separator.join(_ITEMS.findall(match[1])), body)


def _unbroken(data: bytes) -> bytes:
    """Replace line breaks inside quoted names by blanks; line numbers below stay valid."""
    begin = 0
    for _ in range(_BROKEN):
        end = data.find(b"\n", begin)
        if end < 0 or end - begin > _LONGEST:
            break
        if data.count(b'"', begin, end) % 2:
            close = data.find(b'"\n', end)
            row = data[begin : close + 1]
            if not 0 < close - begin < _LONGEST or row.count(b"\n") > _BROKEN or row.count(b'"') % 2:
                break  # a single quote is an inch
            data = data[:begin] + row.replace(b"\n", b" ") + b"\n" * row.count(b"\n") + data[close + 1 :]
            end = begin + len(row)
        begin = end + 1
    return data


def _encodings(head: bytes, options: ReadOptions) -> list[str]:
    """Return possible encodings of the first lines: UTF-8 if it fits, otherwise all others that fit."""

    def fits(encoding: str) -> bool:
        with suppress(UnicodeError):
            return head.decode(encoding) is not None
        return False

    if options.encoding is not None:
        if not fits(options.encoding):
            raise BadInput(f"is not encoded as {options.encoding}; give another --encoding")
        return [options.encoding]
    fitting = ["utf-8"] if fits("utf-8") else list(filter(fits, _ENCODINGS))
    return fitting[:-1] or fitting  # Latin-1 accepts any bytes


def _first_lines(data: bytes) -> list[tuple[int, int, int]]:
    """Return start, end and line number of the first lines that are not empty; comments do not count to the limit."""
    spans, begin, number, plain = [], 0, 0, 0
    while begin < len(data) and plain < _LINES and (begin < _HEAD or not plain):
        # bounded, so that a binary file without line ends costs nothing
        stop, number = data.find(b"\n", begin, begin + _LONGEST), number + 1
        if stop < 0:
            if len(data) - begin > _LONGEST:
                raise BadInput(f"line {number}: the line is too long; save the file as plain CSV")
            stop = len(data)
        if data[begin:stop].strip():
            spans.append((begin, stop, number))
            plain += not data[begin:stop].lstrip(b' "').startswith(_MARKS)
        begin = stop + 1
    if not spans:
        raise BadInput("the file is empty (blank lines only); record it again or leave it out")
    return spans


def _layouts(lines: list[str], numbers: list[int], options: ReadOptions) -> list[Layout]:
    """Return possible layouts of a text: that of a known program, otherwise all that the rows allow."""
    stated = (options.header_line, options.units_line, options.separator, options.decimal)
    if stated == (None,) * 4:
        for signature in SIGNATURES:
            layout = signature(lines)
            if layout is not None:
                return [layout]
    commented = [line.lstrip(' "').startswith(COMMENTS) and not _QUOTED_MARK.match(line) for line in lines]
    plain = [line for line, comment in zip(lines, commented, strict=True) if not comment]
    separator, decimal = _dialect(plain, options)
    bare = [
        line.strip().strip('"').lstrip("#%/! \t") if comment else line
        for line, comment in zip(lines, commented, strict=True)
    ]
    cells = [cells_of(line, separator) for line in bare]
    cells = _recut(bare, cells, commented, separator, decimal)
    marked = _durations(cells)
    rows = Rows(cells, numbers, commented)
    made = layouts(rows, separator, decimal, options.header_line, options.units_line)
    return [_with_durations(layout, marked) for layout in made]


def _recut(
    lines: Sequence[str], cells: list[list[str]], commented: Sequence[bool], separator: str, decimal: str
) -> list[list[str]]:
    """Split rows of names differently if that gives as many cells as the rows of numbers have.

    Names between blanks may hold single blanks. A comment may have other separators, or none behind brackets.
    """
    filled = [trimmed(row) for row in cells]  # a separator may end each row of numbers
    # as many cells as most rows of numbers have
    usual = most_common(
        len(row) for row in filled if len(row) > 1 and all(is_number(c, decimal) or is_stamp(c) for c in row)
    )

    def recut(line: str, row: list[str], comment: bool) -> list[str]:
        if len(row) == usual or not (comment or separator == " "):
            return row
        for cut in _CUTS if comment else _CUTS[:1]:
            parts = [part.strip() for part in cut.split(_KEY.sub("", line.strip()))]
            named = sum(header.role is not None or header.unit is not None for header in map(read_header, parts))
            if len(parts) == usual and (cut is _CUTS[0] or 2 * named > usual):
                return parts
        return row

    return list(map(recut, lines, cells, commented))


def _durations(cells: list[list[str]]) -> dict[int, str]:
    """Remove units from columns whose numbers carry one (`0.001 sec`); return the units by column index."""
    marked = {}
    for k in range(max(map(len, cells), default=0)):
        column = [row[k] for row in cells if k < len(row)]
        units = [m[1] for m in map(_DURATION.match, column) if m and spelt(m[1])]
        # most cells have the same one; otherwise it is text
        if 2 * len(units) > len(column) and len(set(units)) == 1:
            marked[k] = units[0]
            for row in cells:
                if k < len(row) and _DURATION.match(row[k]):
                    row[k] = row[k].removesuffix(units[0]).strip()
    return marked


def _with_durations(layout: Layout, marked: dict[int, str]) -> Layout:
    columns = list(layout.columns)
    for k, unit in marked.items():
        columns[k] = replace(columns[k], beside=unit, form="duration")
    return replace(layout, columns=tuple(columns))


def cells_of(line: str, separator: str) -> list[str]:
    """Split a line into cells, without blanks around them."""
    if separator == " ":
        line = line.strip().replace("\t", " ")
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]


def _dialect(plain: list[str], options: ReadOptions) -> tuple[str, str]:
    """Return the separator and decimal mark with which most cells are numbers.

    Raises:
        BadInput: none gives a table.
    """
    best, dialect, text = 0.0, None, "\n".join(plain)
    likely = [mark for mark in _SEPARATORS if mark in text or mark == " "]
    for separator in (options.separator,) if options.separator else likely:
        try:
            rows = [cells_of(line, separator) for line in plain]
        except csv.Error:
            continue
        # the point first, because it is the default if a file has only whole numbers
        for decimal in (options.decimal,) if options.decimal else ".,":
            score = _score(rows, decimal)
            # equal scores keep the separator tried first
            if score > best + 1e-9:
                best, dialect = score, (separator, decimal)
    if dialect is None:
        raise NoTable()
    return dialect


def _score(rows: Sequence[Sequence[str]], decimal: str) -> float:
    """Score a split into cells: fraction of rows of the usual length, times the fraction of cells that are numbers."""
    widths: dict[int, list[int]] = {}
    for row in rows:
        filled = trimmed(row)
        # a word among numbers (a flag, a name) does not disqualify a row
        good = sum(bool(c) and (is_number(c, decimal) or is_stamp(c) or bool(_DURATION.match(c))) for c in filled)
        if good >= 2 or (good and len(filled) == 2):
            counts = widths.setdefault(len(row), [0, 0, 0])
            counts[0] += 1
            counts[1] += good
            counts[2] += sum(map(bool, filled))
    if not widths:
        return 0.0
    # the usual length is that of most rows; headers and settings have others
    many, good, filled = max(widths.values())
    return good / filled * many / len(rows)


def _line_of(data: bytes, sample: int, above: int) -> int:
    """Return the line number of a sample, counted from 1."""
    lines = enumerate(data.split(b"\n")[above:], above + 1)
    filled = (number for number, line in lines if _is_row(line))
    return next(islice(filled, sample, None), above + 1 + sample)


def _is_row(line: bytes) -> bool:
    """Return whether a line holds cells: it is neither empty nor a comment."""
    return bool(line.strip()) and not line.startswith(_MARKS)


def _has(body: _Body, marks: bytes) -> bool:
    """Return whether one of these characters occurs."""
    return any(body[0].find(mark, body[1]) >= 0 for mark in marks)


def _codes(body: _Body) -> np.ndarray:
    """Return the characters of a body as bytes without the last line end, shape (N,); nothing is copied."""
    text, start = body
    return np.frombuffer(text, dtype=np.uint8)[start : len(text) - text.endswith(b"\n")]


def _filled(body: _Body) -> _Body:
    """Drop comment lines and blank lines."""
    codes = _codes(body)
    if np.isin(codes[np.flatnonzero(codes[:-1] == ord("\n")) + 1], list(_NO_ROW)).any():
        return b"\n".join(line for line in codes.tobytes().split(b"\n") if _is_row(line)), 0
    return body


def _body(body: _Body, layout: Layout) -> _Body:
    """Return the rows of numbers without comment lines and without empty rows at their end; blank lines may remain."""
    if _has(body, _NO_ROW[2:]):
        body = _filled(body)
    (text, start), empty = body, b"\n \t\f" + layout.separator.encode()
    if text[text.rfind(b"\n", 0, -1) + 1 :].strip(empty):
        return body
    # rows of separators alone, which a spreadsheet leaves below its data
    return text[: text.find(b"\n", len(text.rstrip(empty)))], start  # an empty last cell belongs to its row


def _parse(body: _Body, layout: Layout, places: Sequence[int], encoding: str) -> list[np.ndarray] | None:
    """Load columns with the C parser; return None if only row-by-row reading can explain or read the text."""
    import pandas as pd

    # quotes around numbers only slow the parser down
    if _has(body, b'"'):
        body = _codes(body).tobytes().replace(b'"', b""), 0
    forms = {k: layout.columns[k].form for k in places}
    if "duration" in forms.values():
        return None
    stream = io.BytesIO(body[0])  # shares the text
    stream.seek(body[1])
    try:
        frame = pd.read_csv(
            stream, header=None, names=range(layout.width), usecols=sorted(set(places)), engine="c",
            sep=r"\s+" if layout.separator == " " else layout.separator, decimal=layout.decimal, encoding=encoding,
            dtype={k: str if form == "stamp" else np.float64 for k, form in forms.items()}, index_col=False,
            skip_blank_lines=False, skipinitialspace=_has(body, b" \t"),
        )  # fmt: skip
        last = frame.get(layout.width - 1)
        # the C parser fills short rows silently: none is short where the last column is whole
        marks = np.count_nonzero(_codes(body) == ord(layout.separator)) == len(frame) * (layout.width - 1)
        if not (last is not None and marks and last.notna().all()) and not _rectangular(body, layout):
            return None
        return [seconds(list(frame[k])) if forms[k] == "stamp" else frame[k].to_numpy(np.float64) for k in places]
    except (ValueError, OverflowError, pd.errors.ParserError):
        return None


def _rectangular(body: _Body, layout: Layout) -> bool:
    """Return whether every row has the same number of cells as the layout."""
    # counted in bytes, because the C parser fills short rows silently
    codes = _codes(body)
    ends = np.append(np.flatnonzero(codes == ord("\n")), len(codes))
    if layout.separator == " ":
        blank = np.isin(codes, (9, 10, 32))
        marks, each = np.flatnonzero(~blank & np.append(True, blank[:-1])), layout.width
    else:
        marks, each = np.flatnonzero(codes == ord(layout.separator)), layout.width - 1
    # the marks of row k lie between the ends of rows k - 1 and k
    return len(marks) == len(ends) * each and bool(
        not each or np.all(marks[each - 1 :: each] < ends) and np.all(marks[each::each] > ends[:-1])
    )


def _split(body: _Body, layout: Layout, encoding: str) -> Iterator[list[str]]:
    lines = _codes(body).tobytes().decode(encoding, errors="replace").split("\n")
    return (cells_of(line, layout.separator) for line in lines)


def _rows(body, layout: Layout, places, encoding, place: Callable[[int], str]) -> list[np.ndarray]:
    """Load columns row by row; refuse the first bad row with its line and column."""
    values, width = [], layout.width
    try:
        for row in _split(body, layout, encoding):
            # separators at the end of a row
            while len(row) > width and not row[-1].strip():
                row.pop()
            if len(row) != width and not (len(row) == width - 1 and not layout.columns[-1].name):
                short = layout.columns[len(row)].name if len(row) < width else layout.columns[-1].name
                raise BadInput(
                    f"column {short!r}, {place(len(values))}: {len(row)} cells, but {width} in the other "
                    "rows; correct the line or --separator"
                )
            values.append([row[k].strip() if k < len(row) else "" for k in places])
    except csv.Error as error:
        raise BadInput(f"sample {len(values)}: cannot be read as CSV ({error}); save it as plain CSV") from None
    columns = list(zip(*values, strict=True)) or [()] * len(places)
    return [numbers_of(cells, layout, k, place) for cells, k in zip(columns, places, strict=True)]


def numbers_of(cells: Sequence[str], layout: Layout, k: int, place: Callable[[int], str]) -> np.ndarray:
    """Convert the cells of column k to numbers; dates and times of day become seconds.

    Raises:
        BadInput: with the first cell that is not a number.
    """
    column = layout.columns[k]
    if column.form == "stamp":
        try:
            return seconds(cells)
        except (ValueError, OverflowError) as error:
            raise BadInput(
                f"column {column.name!r}: cannot be read as dates and hours ({cleaned(error)[:60]}); write "
                "seconds, or give --rate HZ"
            ) from None
    if column.form == "duration" and column.beside:
        cells = [cell.removesuffix(column.beside).strip() for cell in cells]
    for sample, cell in enumerate(cells):
        if not is_number(cell, layout.decimal):
            shown = cleaned(shortened(cell, 20))
            raise BadInput(
                f"column {column.name!r}, {place(sample)}: text {shown!r} instead of a number; write a "
                "number (leave a missing output empty)"
            )
    plain = str.maketrans("Dd" + layout.decimal, "Ee.")  # Fortran's 1.0D-3
    point = (cell.translate(plain) for cell in cells)
    return np.array([float("nan") if cell.lower() in MISSING else float(cell) for cell in point])

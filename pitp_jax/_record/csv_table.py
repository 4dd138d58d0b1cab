"""Comma-separated text: a header row, then one row per sample.

    row i:  cell_1 , cell_2 , ... , cell_C        an empty cell is nan

The usual file goes through NumPy's C parser, wanted columns only (about 1.2e6 rows per second here). Only
when that fails is the text read row by row, to name the first bad line and column.
"""

import csv
import gzip
import io
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .._errors import BadInput
from .table import Table, file_bytes

_GZIP_MAGIC = b"\x1f\x8b"
_CONTROL = bytes(set(range(32)) - {9, 10, 12, 13})


def csv_table(path: Path) -> Table:
    """A `.csv` file as a table.

    Raises:
        BadInput: unreadable, compressed, binary, or without a header.
    """
    data = file_bytes(path)
    if data.startswith(_GZIP_MAGIC):
        raise BadInput(f"{path}: is gzip, not text as its suffix says; rename it to end in .csv.gz")
    return _text_table(str(path), data)


def csv_gz_table(path: Path) -> Table:
    """A `.csv.gz` file as a table.

    Raises:
        BadInput: unreadable, not gzip, truncated, damaged, binary, or without a header.
    """
    data = file_bytes(path)
    if not data.startswith(_GZIP_MAGIC):
        raise BadInput(f"{path}: is not gzip as its suffix says; rename it to end in .csv if it is plain text")
    try:
        text = gzip.decompress(data)
    except EOFError:
        raise BadInput(f"{path}: the gzip data end too early (truncated); copy the file again") from None
    except (OSError, zlib.error) as error:
        raise BadInput(f"{path}: damaged gzip data ({error}); copy the file again") from None
    return _text_table(str(path), text)


def _text_table(source: str, data: bytes) -> Table:
    """Header and body of decoded text; the body is parsed when columns are asked for."""
    data = data.removeprefix(b"\xef\xbb\xbf")
    head = data[:4096]
    if len(head.translate(None, _CONTROL)) != len(head):
        raise BadInput(f"{source}: line 1: not UTF-8 text as its suffix says (binary or UTF-16); save it as UTF-8 CSV")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    start = len(data) - len(data.lstrip(b"\n \t"))
    header, _, body = data[start:].partition(b"\n")
    above = data[:start].count(b"\n") + 1
    try:
        cells = next(csv.reader([header.decode("utf-8", errors="replace")], skipinitialspace=True), [])
    except csv.Error as error:
        raise BadInput(f"{source}: line {above}: header not readable ({error}); save it as plain CSV") from None
    names = tuple(name.strip() for name in cells)

    def line_of(sample: int) -> int:
        filled = (number for number, line in enumerate(body.split(b"\n"), start=above + 1) if line.strip())
        return next((number for i, number in enumerate(filled) if i == sample), above + 1 + sample)

    def place(sample: int) -> str:
        return f"sample {sample} (line {line_of(sample)})"

    def load(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        indices = [names.index(name) for name in wanted]
        values = _parse_fast(body, len(names), indices)
        if values is None:
            values = _parse_rows(body, names, indices, source, above)
        return {name: np.ascontiguousarray(values[:, k]) for k, name in enumerate(wanted)}

    return Table(source, names, load, place)


def _parse_fast(body: bytes, columns: int, indices: list[int]) -> np.ndarray | None:
    """Wanted columns (T, len(indices)) by the C parser, or None where the text needs a closer look."""
    body = body.rstrip(b"\n \t").lstrip(b"\n")
    if not body:
        return np.empty((0, len(indices)))
    if b"\n\n" in body:
        body = b"\n".join(line for line in body.split(b"\n") if line)
    if b'"' in body or columns < 2 or not _rectangular(body, columns):
        return None
    text = body
    if b",\n" in body or b"\n," in body or b",," in body or body[:1] == b"," or body[-1:] == b",":
        text = b"\n" + body + b"\n"
        for bare, filled in ((b",,", b",nan,"), (b",,", b",nan,"), (b",\n", b",nan\n"), (b"\n,", b"\nnan,")):
            text = text.replace(bare, filled)
        text = text[1:]
    try:
        return np.loadtxt(io.StringIO(text.decode("latin-1")), delimiter=",", usecols=indices, comments=None, ndmin=2)
    except ValueError:
        return None


def _rectangular(body: bytes, columns: int) -> bool:
    """True where every row has columns - 1 commas."""
    codes = np.frombuffer(body, dtype=np.uint8)
    ends = np.flatnonzero(codes == ord("\n"))
    commas = np.flatnonzero(codes == ord(","))
    if len(commas) != (len(ends) + 1) * (columns - 1):
        return False
    commas = commas.reshape(-1, columns - 1)
    return bool(np.all(commas[:-1, -1] < ends) and np.all(commas[1:, 0] > ends))


def _parse_rows(body, names, indices, source, above) -> np.ndarray:
    """Wanted columns (T, len(indices)) row by row; refuses the first bad row with its line and column."""
    values, lines = [], body.decode("utf-8", errors="replace").split("\n")
    reader = csv.reader(lines, skipinitialspace=True)
    try:
        for row in reader:
            if not row or (len(row) == 1 and not row[0].strip()):
                continue
            line = above + reader.line_num
            if len(row) != len(names):
                missing = names[len(row)] if len(row) < len(names) else names[-1]
                raise BadInput(
                    f"{source}: line {line}, sample {len(values)}, column {missing!r}: {len(row)} cells "
                    f"where the header has {len(names)}; fix or delete the line"
                )
            values.append([_number(row[k], names[k], source, len(values), line) for k in indices])
    except csv.Error as error:
        where = f"line {above + reader.line_num}, sample {len(values)}"
        raise BadInput(f"{source}: {where}: not readable as CSV ({error}); save it as plain CSV") from None
    return np.array(values, dtype=np.float64).reshape(-1, len(indices))


def _number(cell: str, column: str, source: str, sample: int, line: int) -> float:
    cell = cell.strip()
    try:
        if "_" in cell:  # Python takes 1_000 for a number; a recording does not
            raise ValueError
        return float(cell) if cell else float("nan")
    except ValueError:
        shown = cell if len(cell) <= 20 else cell[:20] + "..."
        raise BadInput(
            f"{source}: column {column!r}, sample {sample} (line {line}): text {shown!r} where a number "
            "belongs; write a number (leave a missing output empty)"
        ) from None

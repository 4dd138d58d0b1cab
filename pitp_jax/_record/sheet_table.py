"""Spreadsheets (.xlsx) and LabVIEW's measurement files (.tdms) as tables; each needs its extra."""

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from .._errors import BadInput
from .layout import Layout, find_header
from .table import Column, Table, as_column, check_columns, cleaned, file_bytes
from .unfolding import check_archive

_HEAD, _ROWS = 100, 1 << 20  # rows looked at; the most a sheet has


def xlsx_table(path: Path, kind: str) -> Table:
    """The first sheet of a workbook that holds a table of numbers.

    Raises:
        BadInput: openpyxl is missing, no such sheet, unfolding to too much.
    """
    source = cleaned(path)
    if not file_bytes(path, 4).startswith(b"PK"):
        raise BadInput(f"{source}: is not an Excel workbook as its suffix says; save it as .xlsx or CSV")
    check_archive(path)
    try:
        import openpyxl
    except ImportError:
        raise BadInput(f"{source}: needs openpyxl; `pip install 'pitp_jax[excel]'` or save it as CSV") from None
    book = openpyxl.load_workbook(path, read_only=True, data_only=True, keep_links=False)
    try:
        refusals = []
        for sheet in book.worksheets:
            sheet.reset_dimensions()
            rows = [(k, row) for k, row in enumerate(islice(sheet.iter_rows(values_only=True), _ROWS), 1) if any(
                cell is not None for cell in row)]  # fmt: skip
            try:
                return _sheet(rows, source, f"{kind}, sheet {cleaned(sheet.title)!r}")
            except BadInput as error:
                refusals.append(str(error))
    finally:
        book.close()
    raise BadInput(refusals[0] if refusals else f"{source}: has no sheet; save it as CSV")


def _sheet(rows: list[tuple[int, tuple]], source: str, kind: str) -> Table:
    """Numbered rows of one sheet as a table."""
    head = [[_cell(cell) for cell in row] for _, row in rows[:_HEAD]]
    width = max(map(len, head), default=0)
    check_columns(width, source)
    layout: Layout = find_header([row + [""] * (width - len(row)) for row in head], source, "\t", ".")
    body = rows[layout.first :]

    def place(sample: int) -> str:
        return f"sample {sample} (row {body[sample][0]})" if sample < len(body) else f"sample {sample}"

    def load(places: Sequence[int]) -> list[np.ndarray]:
        return [_numbers(body, k, layout.columns[k], source, place) for k in places]

    return Table(source, layout.columns, load, place, ", ".join((kind, *layout.notes)))


def _cell(value) -> str:
    """A cell as text for the search of the header."""
    return "" if value is None else cleaned(value).strip()


def _numbers(body, k: int, column: Column, source: str, place) -> np.ndarray:
    """One column of a sheet; dates become seconds."""
    from datetime import datetime, time

    values = np.full(len(body), np.nan)
    for sample, (_, row) in enumerate(body):
        cell = row[k] if k < len(row) else None
        if cell is None or (isinstance(cell, str) and cell.strip().lower() in ("", "nan", "na", "n/a")):
            continue
        if isinstance(cell, datetime):
            cell = (cell.replace(tzinfo=None) - datetime(1970, 1, 1)).total_seconds()
        elif isinstance(cell, time):
            cell = cell.hour * 3600 + cell.minute * 60 + cell.second + cell.microsecond * 1e-6
        try:
            values[sample] = float(cell)
        except (TypeError, ValueError, OverflowError):
            raise BadInput(
                f"{source}: column {column.name!r}, {place(sample)}: text {cleaned(cell)[:20]!r} where a number "
                "belongs; write a number (leave a missing output empty)"
            ) from None
    return values


def tdms_table(path: Path, kind: str) -> Table:
    """A `.tdms` file: the channels of its groups, with the clock of their waveforms where there is one.

    Raises:
        BadInput: npTDMS is missing, too many channels.
    """
    source = cleaned(path)
    if not file_bytes(path, 4).startswith(b"TDSm"):
        raise BadInput(f"{source}: is not a TDMS file as its suffix says; export it from LabVIEW again")
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise BadInput(f"{source}: needs npTDMS; `pip install 'pitp_jax[labview]'` or export it as text") from None
    file = TdmsFile.read(path)
    groups = [group for group in file.groups() if group.channels()]
    channels = [channel for group in groups for channel in group.channels()]
    check_columns(len(channels), source)
    columns, arrays = [], []
    for channel in channels:
        name = channel.name if len(groups) == 1 else f"{channel.group_name}/{channel.name}"
        columns.append(Column(cleaned(name), str(channel.properties.get("unit_string") or "") or None))
        arrays.append(channel)
    step = next((float(c.properties.get("wf_increment") or 0) for c in channels if len(c)), 0.0)
    if step > 0 and not any(column.name.lower().startswith(("time", "zeit")) for column in columns):
        columns.append(Column("time_s"))
        begin = float(channels[0].properties.get("wf_start_offset") or 0)
        arrays.append(begin + step * np.arange(max(map(len, channels))))

    def load(places: Sequence[int]) -> list[np.ndarray]:
        return [as_column(arrays[k][:], columns[k].name, source) for k in places]

    return Table(source, tuple(columns), load, lambda k: f"sample {k}", kind)

"""Join files that hold time, input and output separately.

one length, one clock at most, or clocks that agree:  rows side by side
a clock in every file:                                rows in turn by their times, cells of the other files empty
"""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...common.errors import BadInput, cleaned
from ...common.units import from_base, to_base
from ...method.signal.checks import sample
from .choice import agree, choose_columns
from .formats import open_parts, split_suffix
from .formats.text import single_column
from .header import NoTable
from .names import read_header
from .options import ReadOptions
from .refusal import Refused, about, unrefused
from .table import Column, Parts, Table


def joined_parts(path: Path, options: ReadOptions) -> Parts:
    """Open every part of a file, and add the columns of the files that the option `join` names.

    Raises:
        BadInput: a file cannot be read, or rows do not belong together.
    """
    if not options.join:
        return [[_each_clock(table, options) for table in tables] for tables in open_parts(path, options)]
    beside = [_opened(Path(other), options)[0][0] for other in options.join]
    # of the readings of a file, those count that belong to the other files
    return [list(unrefused(lambda one: _joined([one, *beside], options), t)) for t in _opened(path, options)]


def _each_clock(table: Table, options: ReadOptions) -> Table:
    """Join the blocks of a table in which every channel has its own clock before it (`t u t y`)."""
    names = [column.name for column in table.columns]
    starts = [place for place, name in enumerate(names) if name == names[0]]
    each = 1 < len(starts) == 1 + len(names) - len(set(names))  # otherwise one clock, or several recordings
    if not each or options.time_column or options.rate or read_header(names[0]).role != "time":
        return table
    blocks = [
        replace(table, columns=table.columns[a:b], load=lambda places, a=a: table.load([a + p for p in places]))
        for a, b in pairwise([*starts, len(names)])
    ]
    return _joined(blocks, options)


def _opened(path: Path, options: ReadOptions) -> Parts:
    """Open every part of a file; a file may also hold a single column of numbers."""
    with about(path):
        try:
            return open_parts(path, replace(options, sheet=None, split_by=None))
        except NoTable:
            column = single_column(path)
            if not _rows(column):
                raise
            return [[column]]


def _joined(tables: Sequence[Table], options: ReadOptions) -> Table:
    """Join tables: their rows side by side, or sorted by time if every table has its own clock.

    Raises:
        BadInput: the rows do not belong together.
    """
    clocks = [_clock(table, options) for table in tables]
    first = next((clock for clock in clocks if clock is not None), None)
    same = [clock is None or first is None or agree(clock[1], first[1], 0.1) for clock in clocks]
    sizes = [_rows(table) for table in tables]
    if all(same) and len(set(sizes)) == 1:
        # one clock is enough
        dropped = {k: clock[0] for k, clock in enumerate(clocks) if clock is not None and clock is not first}
        return _side_by_side(tables, dropped)
    if any(clock is None for clock in clocks):
        rows = ", ".join(f"{table.path.name} ({size} rows)" for table, size in zip(tables, sizes, strict=True))
        raise BadInput(f"cannot join {cleaned(rows)}; give files of the same length, or with a time column each")
    return _in_turn(tables, [clock for clock in clocks if clock is not None], options)


def _rows(table: Table) -> int:
    """Return the number of rows of a table, counted in its first column of numbers; 0 if it has none."""
    for place in range(len(table.columns)):
        with suppress(BadInput):
            return len(table.load([place])[0])
    return 0


def _clock(table: Table, options: ReadOptions) -> tuple[int, np.ndarray] | None:
    """Return the index of a table's time column and its values in s, or None."""
    try:
        choice = choose_columns(table, options, ("time",))["time"]
    except Refused as ask:
        if ask.options == {"--time-unit": "UNIT"}:  # a clock without a unit is a clock
            raise
        return None
    if choice.place is None:
        return None
    return choice.place, to_base(table.load([choice.place])[0], choice.unit)


def _side_by_side(tables: Sequence[Table], dropped: dict[int, int]) -> Table:
    columns, owners = _columns(tables, dropped)

    def load(places: Sequence[int]) -> list[np.ndarray]:
        return [owners[place][0].load([owners[place][1]])[0] for place in places]

    first = tables[0]
    return Table(first.path, columns, load, first.place, _form(tables), first.part, first.hint, first.blanks)


def _in_turn(tables: Sequence[Table], clocks: Sequence[tuple[int, np.ndarray]], options: ReadOptions) -> Table:
    """Merge the rows of all tables in order of time; cells are empty where a table has no row at that time."""
    unit = options.time_unit or "s"  # the stated unit is applied to the merged clock again
    columns, owners = _columns(tables, {k: place for k, (place, _) in enumerate(clocks)})
    time = np.concatenate([values for _, values in clocks])
    order = np.argsort(time, kind="stable")
    own = np.repeat(np.arange(len(tables)), [len(values) for _, values in clocks])[order]

    def load(places: Sequence[int]) -> list[np.ndarray]:
        return [from_base(time[order], unit) if place == len(owners) else spread(place) for place in places]

    def spread(place: int) -> np.ndarray:
        table, inner = owners[place]
        values = np.full(len(time), np.nan)
        values[own == tables.index(table)] = table.load([inner])[0]
        return values

    first = tables[0]
    return Table(
        first.path,
        (*columns, Column(options.time_column or f"time_{unit}", unit)),
        load,
        sample,
        f"{_form(tables)}, rows by their times",
        first.part,
    )


def _form(tables: Sequence[Table]) -> str:
    others = [table.path.name for table in tables if table.path != tables[0].path]
    return tables[0].form + f", joined with {cleaned(', '.join(others))}" * bool(others)


def _columns(tables: Sequence[Table], dropped: dict[int, int]) -> tuple[tuple[Column, ...], list[tuple[Table, int]]]:
    """List the columns of all joined tables, and the table of each; repeated names get the file's name as a prefix.

    Args:
        tables: to be joined.
        dropped: the place of an omitted clock, by table.
    """
    twice = Counter(c.name for k, t in enumerate(tables) for p, c in enumerate(t.columns) if dropped.get(k) != p)
    columns: list[Column] = []
    owners: list[tuple[Table, int]] = []
    for k, table in enumerate(tables):
        for place, column in enumerate(table.columns):
            if dropped.get(k) == place:
                column = Column("", form="text")
            elif column.name and (twice[column.name] > 1 or column.name.isdecimal()):
                column = replace(column, name=f"{cleaned(split_suffix(table.path.name)[0])}/{column.name}")
            columns.append(column)
            owners.append((table, place))
    return tuple(columns), owners

"""Read Parquet files (extra `robot`): data frames, also with dates and with lists in their cells."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..guard import MAX_ENTRIES, check_count, check_unfolded
from ..options import ReadOptions
from ..table import Parts, Stored, array_table

if TYPE_CHECKING:
    import pandas as pd

kind, remedy = "a Parquet file", "write it again"
suffixes = (".parquet",)
begins = (b"PAR1",)


def tables(path: Path, options: ReadOptions) -> Parts:
    """Return the columns of a Parquet file: dates in seconds, lists as `name[1]`, ..., units from the metadata."""
    import pandas as pd  # imported here, because `pitp info` reads no table
    import pyarrow.parquet

    with pyarrow.parquet.ParquetFile(path) as file:
        schema, about = file.schema_arrow, file.metadata
    check_count(about.num_rows)
    # the footer states the decompressed size of the columns
    unfolded = sum(about.row_group(k).total_byte_size for k in range(about.num_row_groups))
    check_unfolded(unfolded, path.stat().st_size)

    def column(name: str):
        return pd.Series(pd.read_parquet(path, columns=[name])[name])

    beside = {f.name: (f.metadata or {}).get(b"unit") for f in schema}
    beside |= {f.name: b"s" for f in schema if str(f.type).startswith(("timestamp", "duration"))}
    stored, origin = [], []
    for field in schema:
        count = _entries(field, column)
        for k in range(max(count, 1)):
            name = f"{field.name}[{k + 1}]" if count else field.name
            entry = k if count else None
            stored.append(Stored(name, lambda f=field.name, k=entry: _plain(column(f), k), beside[field.name]))
            origin.append(field.name)
    table = array_table(path, stored, "Parquet file")
    return [[replace(table, texts=lambda k: column(origin[k]).astype(str).to_numpy())]]


def _entries(field: Any, column: Callable[[str], "pd.Series"]) -> int:
    """Return how many numbers each cell of a list column holds; 0 if it holds none or too many."""
    from pyarrow import types

    listed = types.is_list(field.type) or types.is_large_list(field.type) or types.is_fixed_size_list(field.type)
    if not listed or not (types.is_integer(field.type.value_type) or types.is_floating(field.type.value_type)):
        return 0
    count = max((len(row) for row in column(field.name) if row is not None), default=0)
    return count if count <= MAX_ENTRIES else 0


def _plain(column: "pd.Series", entry: int | None = None) -> np.ndarray:
    """Return the numbers of a column, or of one list entry; nan where empty, dates and time spans in seconds."""
    import pandas as pd

    if entry is not None:
        return np.array([np.nan if row is None or len(row) <= entry else row[entry] for row in column], np.float64)
    if column.dtype.kind in "mM":
        unzoned = column.dt.tz_convert(None) if getattr(column.dt, "tz", None) else column
        begin = pd.Timestamp(0) if column.dtype.kind == "M" else pd.Timedelta(0)
        return ((unzoned - begin) / pd.Timedelta(1, "s")).to_numpy()
    return column.to_numpy(np.float64, na_value=np.nan) if pd.api.types.is_numeric_dtype(column) else column.to_numpy()

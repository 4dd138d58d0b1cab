"""Convert dates and times of day to seconds.

t = date + hour in s since 1970 if there is a date; otherwise s since midnight, plus 86400 s at every midnight passed
"""

import re
from collections.abc import Sequence
from datetime import date
from functools import lru_cache

import dateutil.parser
import numpy as np

_DAY = 86400.0
_DATE = r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}|\d{1,2}[- ][A-Za-z]{3,9}[- ]\d{4}|[A-Za-z]{3,9} \d{1,2},? \d{4}"
_STAMP = re.compile(rf"(({_DATE})[T ]+)?\d{{1,2}}:\d{{2}}(:\d{{2}}([.,]\d+)?)?( ?([AP]M|Z|UTC|GMT|[+-]\d\d:?\d\d))?$")


@lru_cache(1 << 12)
def is_stamp(cell: str) -> bool:
    """Return whether a cell holds a time of day, with or without a date."""
    return bool(_STAMP.match(cell))


def seconds(stamps: Sequence[str]) -> np.ndarray:
    """Convert time stamps to seconds, shape (T,); nan where a cell is empty.

    Args:
        stamps: `2026-11-23 10:00:00.123`, `23.11.2026 10:00:00,123` or `10:00:00.123`.

    Raises:
        ValueError: not readable as such, or readable in two ways (`10:01` as minutes or hours, day or month first).
    """
    import pandas as pd

    series = pd.Series(stamps, dtype=str).str.strip().str.replace(r"(?<=\d),(?=\d)", ".", regex=True)
    first = next((text for text in series if isinstance(text, str) and text), "")
    dated = re.match(_DATE, first)
    if not dated:
        return _hours(series)
    # every order of day, month and year that the numbers allow
    read = [values for order in ("dmy", "mdy", "ymd") if (values := _dates(series, order)) is not None]
    if not read:
        raise ValueError("no dates and hours")
    # at midnight a wrong order jumps by a month or a year
    read = [values for values in read if np.nanmax(np.abs(np.diff(values)), initial=0.0) < _DAY] or read
    # points separate dates in which the day comes first; within a day the order changes no step
    if "." in dated[0] or all(np.array_equal(np.diff(read[0]), np.diff(v), equal_nan=True) for v in read):
        return read[0]
    raise ValueError("day and month cannot be told apart")


def _dates(series, order: str) -> np.ndarray | None:
    """Convert dates to seconds; return None if a date does not fit this order of day, month and year."""
    import pandas as pd

    parts = series.str.extract(rf"^({_DATE})(.*)$")
    days = {text: _iso(text, order) for text in parts[0].dropna().unique()}
    if not all(days.values()):
        return None
    whole = parts[0].map(days) + parts[1]
    dates = pd.to_datetime(whole, format="mixed", utc=True)  # a zone may change in between
    return (dates.dt.tz_localize(None) - pd.Timestamp(0)).dt.total_seconds().to_numpy(np.float64)


def _iso(text: str, order: str) -> str:
    """Write a date as 2026-11-23; empty if it does not fit this order of day, month and year."""
    try:
        if re.search("[A-Za-z]", text):  # 23-Nov-2026
            return str(dateutil.parser.parse(text).date())
        numbers = re.split("[-./]", text)
        year = numbers[order.index("y")]
        # a year has two or four digits; no other part has four
        if len(year) not in (2, 4) or max(map(len, numbers)) > len(year):
            return ""
        return str(date(int(year) + 2000 * (len(year) == 2), *(int(numbers[order.index(part)]) for part in "md")))
    except ValueError:
        return ""


def _hours(series) -> np.ndarray:
    """Convert times of day to seconds, continued over midnight; refuse `10:01`, which may be minutes and seconds."""
    import pandas as pd

    parts = series.str.extract(r"^([\d:.]+) ?(.)?")  # P of 10:00:00 PM
    # hours above 24 are spans of time and continue
    values = pd.to_timedelta(parts[0]).dt.total_seconds().to_numpy()
    half = parts[1].map({"A": 0.0, "P": _DAY / 2})
    values = np.where(half.isna(), values, values % (_DAY / 2) + half)
    return values + _DAY * np.cumsum(np.diff(values, prepend=values[:1]) < -_DAY / 2)

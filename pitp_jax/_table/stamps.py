"""Dates and hours as seconds.

t = date + hour in s since 1970 where there is a date; else s since midnight, plus 86400 s at every midnight passed
"""

import re
import warnings
from collections.abc import Sequence

import numpy as np

_DAY = 86400.0
_STAMP = re.compile(
    r"(\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[T ]+)?\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?( ?([AP]M|Z|UTC|GMT|[+-]\d\d:?\d\d))?$"
)


def is_stamp(cell: str) -> bool:
    """Whether a cell is an hour, with or without its date."""
    return bool(_STAMP.match(cell))


def seconds(stamps: Sequence[str]) -> np.ndarray:
    """Times in s, shape (T,), nan where a stamp is empty.

    Args:
        stamps: `2026-11-23 10:00:00.123`, `23.11.2026 10:00:00,123` or `10:00:00.123`.

    Raises:
        ValueError: not readable as such, or readable in two ways (`10:01` as minutes or hours, day or month first).
    """
    import pandas as pd

    series = pd.Series(stamps, dtype=str).str.strip().str.replace(",", ".", regex=False)
    first = next((text for text in series if isinstance(text, str) and text), "")
    dated = re.match(r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}", first)
    if not dated:
        return _hours(series)
    if re.match(r"\d{4}", first):
        iso = _dates(series, False)
        assert iso is not None  # no part of a date that begins with its year is taken for a month
        return iso
    # both readings, unless a number above 12 can only be a day
    orders = [values for dayfirst in (True, False) if (values := _dates(series, dayfirst)) is not None]
    if not orders:
        raise ValueError("no dates and hours")
    # points are written where the day comes first; within a day the order changes no step
    if len(orders) == 1 or "." in dated[0] or np.array_equal(np.diff(orders[0]), np.diff(orders[1]), equal_nan=True):
        return orders[0]
    smooth = [values for values in orders if np.nanmax(np.abs(np.diff(values))) < _DAY]
    if len(smooth) == 1:  # at midnight the other order jumps by a month
        return smooth[0]
    raise ValueError("the day or the month may come first")


def _dates(series, dayfirst: bool) -> np.ndarray | None:
    """Dates in s; None where what would be the month is more than 12."""
    import pandas as pd

    parts = series.str.extract(r"^(\d{1,2})[-./](\d{1,2})[-./]").dropna().astype(int)
    if (parts[1 if dayfirst else 0] > 12).any():
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            dates = pd.to_datetime(series, dayfirst=dayfirst)
        except ValueError:  # whole seconds among fractions
            dates = pd.to_datetime(series, format="mixed", dayfirst=dayfirst)
    dates = dates.dt.tz_localize(None) if dates.dt.tz is not None else dates
    return (dates - pd.Timestamp(0)).dt.total_seconds().to_numpy(np.float64)


def _hours(series) -> np.ndarray:
    """Hours of a day, on over midnight; `10:01` in steps of one may as well be minutes and seconds."""
    # hours above 24 are spans of time and go on
    parts = series.str.split(":", expand=True).astype(np.float64).to_numpy()
    if parts.shape[1] == 2:
        raise ValueError("hours and minutes, or minutes and seconds")
    return over_midnight(parts @ np.array([3600.0, 60.0, 1.0]))


def over_midnight(values: np.ndarray) -> np.ndarray:
    """Seconds of the day that go on after midnight."""
    return values + _DAY * np.cumsum(np.diff(values, prepend=values[:1]) < -_DAY / 2)

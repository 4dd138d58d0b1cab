"""Dates and hours as seconds.

t = date + hour in s since 1970 where there is a date; else s since midnight, plus 86400 s at every midnight passed
"""

import warnings
from collections.abc import Sequence

import numpy as np

_DAY = 86400.0


def seconds(stamps: Sequence[str]) -> np.ndarray:
    """Times in s, shape (T,), nan where a stamp is empty.

    Args:
        stamps: `2026-11-23 10:00:00.123`, `23.11.2026 10:00:00,123` or `10:00:00.123`.

    Raises:
        ValueError: not readable as such.
    """
    import pandas as pd

    series = pd.Series(stamps, dtype=str).str.strip().str.replace(",", ".", regex=False)
    first = next((text for text in series if isinstance(text, str) and text), "")
    if any(mark in first.split(":")[0] for mark in "-./"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                found = pd.to_datetime(series, dayfirst="." in first.split(":")[0])
            except ValueError:  # whole seconds among fractions
                found = pd.to_datetime(series, format="mixed", dayfirst="." in first.split(":")[0])
        found = found.dt.tz_localize(None) if found.dt.tz is not None else found
        values = (found - pd.Timestamp(0)).dt.total_seconds().to_numpy(np.float64)
    else:
        parts = series.str.split(":", expand=True).astype(np.float64).to_numpy()
        values = parts @ np.array([3600.0, 60.0, 1.0])[: parts.shape[1]]
        values += _DAY * np.cumsum(np.diff(values, prepend=values[:1]) < -_DAY / 2)
    return values

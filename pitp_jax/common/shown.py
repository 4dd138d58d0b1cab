"""Show a result: a text of at most ten lines, a table, and HTML for a notebook."""

from collections.abc import Sequence
from dataclasses import fields
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd


def data_frame(rows: Sequence[dict] | dict) -> "pd.DataFrame":
    """Build a DataFrame from arrays by name, or from dicts; nested dicts make columns such as `zero_value`."""
    import pandas as pd  # imported here, because it takes half a second

    if isinstance(rows, dict):
        return pd.DataFrame(rows)
    return pd.json_normalize(list(rows), sep="_")


class Shown:
    """A frozen dataclass that a terminal and a notebook can show; `_rows` gives its table.

    `@dataclass(repr=False)` inherits this repr: one line per field, arrays by their size and range.
    """

    def _rows(self) -> Any:
        """Return the table as dicts (one per row), or as arrays of one length by name (by default the fields)."""
        arrays = {f.name: v for f in fields(self) if np.ndim(v := getattr(self, f.name)) == 1 and hasattr(v, "dtype")}  # pyright: ignore[reportArgumentType]
        longest = max(map(len, arrays.values()), default=0)  # series over time, not a few coefficients
        return {name: v for name, v in arrays.items() if len(v) == longest}

    def frame(self) -> "pd.DataFrame":
        """Return the table as a pandas DataFrame."""
        return data_frame(self._rows())

    def __repr__(self) -> str:
        name = type(self).__name__
        lines = [f"  {f.name}: {_brief(getattr(self, f.name))}" for f in fields(self)]  # pyright: ignore[reportArgumentType]
        return "\n".join([name, *lines[:9]])

    def _repr_html_(self) -> str:
        """Return the text of the result, and the first rows of its table, as HTML."""
        table = self.frame().head(25)
        drawn = table.to_html(index=False, border=0, float_format="{:.5g}".format) if table.size else ""
        return f"<pre>{escape(repr(self))}</pre>{drawn}"


def _brief(value) -> str:
    """Describe the value of a field in one short line."""
    width = 100  # characters
    if hasattr(value, "dtype") and np.ndim(value):
        numbers = np.asarray(value, float)
        seen = numbers[np.isfinite(numbers)]
        span = f", {seen.min():.4g} to {seen.max():.4g}" if seen.size else ""
        return f"{'x'.join(map(str, numbers.shape))} values{span}"
    if isinstance(value, (float, np.floating)):
        return f"{value:.4g}"
    if isinstance(value, (tuple, list, dict)) and len(str(value)) > width:
        return f"{len(value)} entries"
    text = " ".join(str(value).split())
    return text if len(text) <= width else f"{text[: width - 1]}…"

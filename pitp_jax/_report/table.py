"""Results as tables for a notebook."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


def data_frame(rows: Sequence[dict] | dict) -> "pd.DataFrame":
    """A DataFrame of arrays by name, or of dicts; nested ones make columns like `zero_value`."""
    import pandas as pd  # takes half a second to import: only where a table is asked for

    if isinstance(rows, dict):
        return pd.DataFrame(rows)
    return pd.json_normalize(list(rows), sep="_")

"""Results as tables for a notebook."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


def data_frame(rows: Sequence[dict]) -> "pd.DataFrame":
    """A pandas DataFrame of dicts that may be nested: {"zero": {"value": 1}} has the column `zero_value`."""
    import pandas as pd  # takes half a second to import: only where a table is asked for

    return pd.json_normalize(list(rows), sep="_")

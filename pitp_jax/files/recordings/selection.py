"""Select a time range of a recording, as `--from S --to S` states it.

from_s <= t_i - t_0 <= to_s        t_0: the first row; a counter that overflows is continued first
"""

from dataclasses import replace

import numpy as np

from ...common.errors import BadInput
from ..containers.columns import Loaded
from .stamps import continued


def select_range(one: Loaded) -> Loaded:
    """Return the rows within the time range that the user states; all rows without one.

    Args:
        one: the columns of a recording as they were read.

    Raises:
        BadInput: no row lies in the range.
    """
    first, last = one.options.from_s, one.options.to_s
    if (first is None and last is None) or len({len(v) for v in one.values.values()}) > 1:
        return one
    time = continued(one.values["time"])[0]
    if one.options.rate is not None and not (np.diff(time) >= 0).all():
        time = np.arange(len(time)) / one.options.rate
    time = time - time[np.isfinite(time)][0] if np.isfinite(time).any() else time
    # times such as 0.1 s are not exact
    slack = 1e-3 * float(np.nanmedian(np.abs(np.diff(time)))) if len(time) > 1 else 0.0
    begin, end = -np.inf if first is None else first, last or np.inf
    within = np.flatnonzero((time >= begin - slack) & (time <= end + slack))
    outside = np.flatnonzero((time < begin - slack) | (time > end + slack))
    # a row without a time stays, and is refused as in a file cut by hand
    inside = np.setdiff1d(np.arange(within[0], within[-1] + 1), outside) if len(within) else within
    words = f"{first or 0.0:.6g} s to {'its end' if last is None else f'{last:.6g} s'}"
    if not len(inside):
        raise BadInput(
            f"no row from {words}, because its rows last {np.nanmax(time):.6g} s; give --from and "
            "--to in seconds after its first row"
        )
    clock = one.chosen["time"].noted(f"from {words} after its first row")
    return replace(one.at(inside), chosen=one.chosen | {"time": clock})

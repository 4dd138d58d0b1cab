"""All of `identify` for order 2 on the same sweep: how it begins, starts, holds, a delay, blocks left out, errors."""

import pitp_jax as pitp

from ..clock import row, take_turns
from .identify import sweep


def measure(seconds: float) -> dict:
    """No peer searches the same; one fit of SciPy stands in the row `identify`."""
    record = sweep()
    found = take_turns({"pitp_jax": lambda: pitp.identify([record], order=2)}, seconds)
    return row(found, "pitp_jax", None, samples=record.samples)

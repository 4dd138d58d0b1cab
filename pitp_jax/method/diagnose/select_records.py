"""Select the recordings that a diagnosis can use: those with motion; a note names the others."""

from collections import Counter
from collections.abc import Sequence

from ...common.errors import BadInput
from ..signal.initial_state import in_motion
from ..signal.record import Record
from ..signal.sets import check_set


def usable(records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Return the records that move, and notes on the records left out.

    Raises:
        BadInput: no records, of several rates or kinds of output, two of one name, or none that moves.
    """
    check_set(records)
    name, times = Counter(r.name for r in records).most_common(1)[0]
    if times > 1:
        raise BadInput(f"{times} records are named {name!r}; give each its own name (dataclasses.replace(r, name=...))")
    moving, notes = in_motion(records)
    return tuple(moving), notes

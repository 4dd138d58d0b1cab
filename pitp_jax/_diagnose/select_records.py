"""Which recordings a diagnosis can use, how much of each, and what it has to tell about the others.

left out   what does not move beyond its noise (`in_motion`)
cut        to 240,000 samples in all, the longest first
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from .._errors import BadInput
from .._record.initial_state import in_motion
from .._record.record import Record
from .._record.sets import check_set

BUDGET = 240_000  # samples in all
_FEWEST = 4000  # samples that every record keeps


def usable(records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """The records to diagnose, and one line for whatever was left out or cut.

    Raises:
        BadInput: no records, of several rates or kinds of output, two of one name, or none that moves.
    """
    check_set(records)
    name, times = Counter(r.name for r in records).most_common(1)[0]
    if times > 1:
        raise BadInput(f"{times} records are named {name!r}: give each its own name (dataclasses.replace(r, name=...))")
    moving, notes = in_motion(records)
    kept, most = _cut(moving)
    if most is not None:
        count, seconds = sum(r.samples == most for r in kept), most * records[0].dt
        notes += (f"{count} of {len(kept)} recordings count with their first {seconds:.3g} s alone: more than "
                  f"{BUDGET:,} samples in all are not diagnosed, give fewer or shorter ones",)  # fmt: skip
    return kept, notes


def _cut(records: Sequence[Record]) -> tuple[tuple[Record, ...], int | None]:
    """The records, and to how many samples the longest were cut (None: none was)."""
    most = max(BUDGET // len(records), _FEWEST)
    spare = sum(max(most - r.samples, 0) for r in records)
    most += spare // max(sum(r.samples > most for r in records), 1)
    short = tuple(_first(r, most) for r in records)
    return short, most if any(a is not b for a, b in zip(records, short, strict=True)) else None


def _first(r: Record, most: int) -> Record:
    """Its first samples; the whole record where its output begins later than that."""
    if r.samples <= most or not r.observed[:most].any():
        return r
    return replace(r, time=r.time[:most], voltage=r.voltage[:most], displacement=r.displacement[:most])

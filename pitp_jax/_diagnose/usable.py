"""Which recordings a diagnosis can use, how much of each, and what it has to tell about the others.

left out   range <= 10 sigma_white  and  range <= a fifth of the largest one     (errors are counted in ranges)
cut        to 240,000 samples in all, the longest first

A recording of an actuator at rest has noise for a range: it alone had a floor of 14 %, and hid a gap of 3 % in three
sines beside it.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .._errors import BadInput
from .._record.record import Record
from .._record.sets import check_set
from .._rest import noise_std

BUDGET = 240_000  # samples in all
_FEWEST = 4000  # samples that every record keeps
_STILL, _SMALL = 10.0, 0.2


def usable(records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """The records to diagnose, and one line for whatever was left out or cut.

    Raises:
        BadInput: no records, of several rates or kinds of output, two of one name, or none that moves.
    """
    check_set(records)
    name, times = Counter(r.name for r in records).most_common(1)[0]
    if times > 1:
        raise BadInput(f"{times} records are named {name!r}: give each its own name (dataclasses.replace(r, name=...))")
    ranges = [float(np.ptp(r.displacement[r.observed])) for r in records]
    moving = [w > 0 and (w > _SMALL * max(ranges) or w > _STILL * noise_std(r.displacement))
              for w, r in zip(ranges, records, strict=True)]  # fmt: skip
    if not any(moving):
        raise BadInput(f"{records[0].source or records[0].name}: no record moves; record the actuator under a drive")
    still = [r.name for r, moves in zip(records, moving, strict=True) if not moves]
    notes = (f"left out, since they do not move beyond their noise: {', '.join(still)}",) if still else ()
    kept, most = _cut([r for r, moves in zip(records, moving, strict=True) if moves])
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

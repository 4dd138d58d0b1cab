"""Collect remarks on what was done to records while reading, and write them as sentences at the end.

kind, record, count -> one sentence for a record, one line of a set for every kind: `9 records: 1 lost sample each, ...`
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_COUNTED = {  # kind: unit counted, and what was done
    "input_turns": ("turn", "of the input unwrapped, because the output takes the short way"),
    "output_turns": ("turn", "of the output unwrapped, because its motion continues across the step"),
    "outliers": ("output sample", "masked as spikes or dropouts"),
    "clipped": ("output sample", "masked at the sensor's limit"),
    "unseen": ("output sample", "off scale; kept, because they are the majority. Is the sensor in range?"),
    "held": (
        "output sample",
        "of one value while the input moves; kept. Did the sensor drop out, or does the joint stick?",
    ),
    "lost": ("lost sample", "inserted, with a missing output"),
    "doubled": ("row", "equal to the row before, removed"),
    "turns": ("overflow", "of the clock's counter, made continuous"),
    "sorted": ("row", "not in the order of time, sorted"),
    "averaged": ("row", "with the time of the row before, averaged with it"),
    "packets": ("row", "stamped in packets, put on an even grid"),
    "resampled": ("row", "of an uneven clock resampled: the input is held, the output interpolated"),
    "regridded": ("row", "resampled as --rate asks: the input is held, the output interpolated"),
    "bridged": ("output sample", "between rows too far apart to interpolate, masked"),
    "counted": ("row", "timed by --rate instead of the clock"),
    "dropped": ("sample", "of pieces that are too short or have no output, left out"),
}
_MEASURED = {"jitter": "time jitters by up to {:.2g} of a sample, put on a uniform grid"}


@dataclass(frozen=True)
class Remark:
    """One remark on what was done to a record while reading.

    Attributes:
        kind: one of those above, or "note", which is `detail` alone.
        record: its name.
        value: a number or an amount.
        detail: an example, for the sentence on this record alone.
    """

    kind: str
    record: str
    value: float = np.nan
    detail: str = ""

    def __str__(self) -> str:
        """Return the remark as a sentence without the record's name."""
        if self.kind in _MEASURED:
            return _MEASURED[self.kind].format(self.value)
        if self.kind not in _COUNTED:
            return self.detail
        what, how = _COUNTED[self.kind]
        return f"{counted(int(self.value), what)} {how}{f' ({self.detail})' if self.detail else ''}"


def counted(count: int, what: str) -> str:
    """Write a count with its noun, singular or plural."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def by_kind(remarks: Sequence[Remark]) -> list[str]:
    """Write one line for every kind of remark, in order of appearance, and one for each note."""
    lines = []
    for kind in dict.fromkeys(remark.kind for remark in remarks):
        same = [remark for remark in remarks if remark.kind == kind]
        if len(same) == 1 or kind not in (*_COUNTED, *_MEASURED):
            lines += [f"{remark.record}: {remark}" for remark in same]
            continue
        # one line a kind: "9 records: 1 to 3 lost samples each"
        low, high = (float(f([remark.value for remark in same])) for f in (min, max))
        names = ", ".join(remark.record for remark in same[:3]) + (", ..." if len(same) > 3 else "")
        if kind in _MEASURED:
            lines.append(f"{len(same)} recordings: {_MEASURED[kind].format(high)} ({names})")
        else:
            what, how = _COUNTED[kind]
            each = counted(int(high), what) if low == high else f"{low:.0f} to {high:.0f} {what}s"
            lines.append(f"{len(same)} recordings: {each} each, {how} ({names})")
    return lines

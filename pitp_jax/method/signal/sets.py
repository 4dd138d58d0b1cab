"""Check the rate and units of several records, find the start of the session clock, and group records by length."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from os import PathLike

import numpy as np

from ...common.errors import BadInput
from ...common.units import base_unit
from .record import Record

RATE_TOLERANCE = 1e-3  # relative difference of dt within one set
ABSOLUTE = 1e6  # s, eleven days: a clock that shows more did not start with the session


def check_records(records: object) -> None:
    """Refuse any argument that is not a list of records.

    Raises:
        BadInput: naming the given and the accepted types.
    """
    if isinstance(records, Record):
        raise BadInput(f"{_place(records)}: give a list of records, even for a single one")
    if isinstance(records, (str, PathLike)):
        raise BadInput(f"{str(records)!r} is not a list of records; give pitp.read({str(records)!r})")
    if not isinstance(records, Sequence):
        raise BadInput(f"a {type(records).__name__} is not a list of records; give the result of pitp.read")
    for record in records:
        if not isinstance(record, Record):
            raise BadInput(f"a {type(record).__name__} among the records is not a record; give the result of pitp.read")
    if not records:
        raise BadInput("the list holds no records; give at least one")


def check_set(records: Sequence[Record] | Record) -> None:
    """Refuse records that differ in sampling rate or in the kind of input or output.

    Raises:
        BadInput: with the record that does not fit.
    """
    check_records(records)
    assert not isinstance(records, Record)
    first, *others = records
    for record in others:
        if abs(record.dt / first.dt - 1.0) > RATE_TOLERANCE:
            raise BadInput(
                f"{_place(record)}: time column: sampled every {record.dt:.6g} s, but {_place(first)} every "
                f"{first.dt:.6g} s; resample one or give them in separate calls"
            )
        for stem, field in (("input", "voltage_unit"), ("output", "displacement_unit")):
            unit, own = getattr(record, field), getattr(first, field)
            if base_unit(unit) != base_unit(own):
                raise BadInput(
                    f"{_place(record)}: {stem} in {unit}, but {_place(first)} in {own}; choose the same kind with "
                    f"--{stem}-column"
                )


def _place(record: Record) -> str:
    return record.source or f"record {record.name!r}"


def clock_start(records: Sequence[Record]) -> float:
    """Return the absolute time (epoch, s) of the first record; 0 for a clock that started with the session."""
    first = min(float(r.time[0]) for r in records)
    return first if abs(first) > ABSOLUTE else 0.0


def session_clock(records: Sequence[Record]) -> bool:
    """Return whether the records share one session clock: no two overlap in time (True for a single one).

    Args:
        records: the records of a set, in any order.
    """
    # in sequence: half a sample of overlap is rounding
    spans = sorted((record.time[0], record.time[-1], record.dt) for record in records)
    return all(later[0] > span[1] - 0.5 * span[2] for span, later in pairwise(spans))


def alike(records: Sequence, length: Callable[..., int] = lambda record: record.samples) -> list[list[int]]:
    """Group indices of records of similar length, to be padded to one length.

    There is one group unless padding doubles the samples.

    One long record would lengthen all short ones in its group. In a group none is shorter than half the longest.
    """
    lengths = [length(r) for r in records]
    if max(lengths) * len(lengths) <= 2 * sum(lengths):
        return [list(range(len(lengths)))]
    sets: list[list[int]] = []
    # the longest first, grouped with all at least half as long
    for k in np.argsort(lengths)[::-1].tolist():
        if not sets or lengths[k] < lengths[sets[-1][0]] / 2:
            sets.append([])
        sets[-1].append(k)
    return [sorted(places) for places in sets]

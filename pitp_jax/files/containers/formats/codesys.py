"""Read traces of CODESYS and ctrlX: a head of `key; value`, then a block of times and values for each variable."""

import re
from pathlib import Path

import numpy as np

from ....common.errors import BadInput
from ..options import ReadOptions
from ..table import Parts, Stored, array_table
from .text import plain_text

kind, remedy = "a trace of a PLC", "export it as text again"
suffixes = (".csv", ".txt")
begins = (b"[key]", b"\xef\xbb\xbf[key]")
_VARIABLE = re.compile(r"^(\d+)\.Variable;[ \t]*(\S.*?)[ \t]*$", re.MULTILINE)
_BLOCK = re.compile(r"^(\d+)\.Data(;.*(?:\n;.*)*)", re.MULTILINE)


def tables(path: Path, options: ReadOptions) -> Parts:
    """Return the variables of a trace; a clock that differs from the one before stands before its variable.

    Raises:
        BadInput: no block of values.
    """
    text = plain_text(path).decode("utf-8", "replace")
    names, stored, clock = dict(_VARIABLE.findall(text)), [], np.zeros(0)
    for number, block in _BLOCK.findall(text):
        rows = np.array([line.split(";")[1:3] for line in block.split("\n") if line.strip()], dtype=np.float64)
        if not np.array_equal(clock, rows[:, 0]):
            clock = rows[:, 0]
            stored.append(Stored("time", clock))
        stored.append(Stored(names.get(number, number), rows[:, 1]))
    if not stored:
        raise BadInput("a trace of a PLC without a block of values; export the trace with its values")
    return [[array_table(path, stored, "trace of a PLC")]]

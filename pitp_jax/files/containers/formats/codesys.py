"""Read traces of CODESYS and ctrlX: a head of `key; value`, then a block of times and values for each variable."""

import re
from pathlib import Path

import numpy as np

from ....common.errors import BadInput, cleaned
from ..options import ReadOptions
from ..table import Parts, array_table
from .text import plain_text

kind, remedy = "a trace of a PLC", "export it as text again"
suffixes = (".csv", ".txt")
begins = (b"[key]", b"\xef\xbb\xbf[key]")
_VARIABLE = re.compile(r"^(\d+)\.Variable;[ \t]*(\S.*?)[ \t]*$", re.MULTILINE)
_BLOCK = re.compile(r"^(\d+)\.Data(;.*(?:\n;.*)*)", re.MULTILINE)


def tables(path: Path, options: ReadOptions) -> Parts:
    """Return the variables of a trace; variables with a clock of their own keep it as `time of NAME`.

    Raises:
        BadInput: no block of values.
    """
    source = cleaned(path)
    text = plain_text(path, source).decode("utf-8", "replace")
    names, stored, first = dict(_VARIABLE.findall(text)), {}, np.zeros(0)
    for number, block in _BLOCK.findall(text):
        rows = np.array([line.split(";")[1:3] for line in block.split("\n") if line.strip()], dtype=np.float64)
        name = names.get(number, number)
        if not len(stored):
            first = rows[:, 0]
            stored["time"] = first
        elif not np.array_equal(first, rows[:, 0]):
            stored[f"time of {name}"] = rows[:, 0]
        stored[name] = rows[:, 1]
    if not stored:
        raise BadInput(f"{source}: a trace of a PLC without a block of values; export the trace with its values")
    return [[array_table(path, stored, "trace of a PLC")]]

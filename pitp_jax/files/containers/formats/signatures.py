"""Read the layout of text files that name the program that wrote them.

LabVIEW Measurement     separator, decimal mark, units and names by its own keys
TwinCAT Scope           keys in every second cell, a clock beside every channel
"""

import re
from collections.abc import Callable, Sequence

from ....common.errors import BadInput, cleaned
from ..header import Layout, trimmed
from ..table import Column


def labview(lines: Sequence[str]) -> Layout | None:
    """Return the layout of a LabVIEW measurement file (.lvm); None for any other text.

    Raises:
        BadInput: no names below its last header.
    """
    if not lines[0].lower().startswith("labview measurement"):
        return None
    separator = "," if any(line.startswith("Separator,Comma") for line in lines[:12]) else "\t"
    rows = [[cell.strip() for cell in line.split(separator)] for line in lines]
    said = {row[0].lower(): row[1:] for row in rows if len(row) > 1}
    clock, decimal, what = (said.get(key, [""])[0] for key in ("x_columns", "decimal_separator", "x_dimension"))
    # one header for the file and one for every segment: names follow the last
    first = 1 + max((k for k, row in enumerate(rows) if row[0].lower() == "***end_of_header***"), default=len(rows))
    if len(rows) <= first + 1:
        raise BadInput("a LabVIEW file without a table below its header; write it again")
    names = [name for name in trimmed(rows[first]) if name.lower() != "comment"]
    if all(re.fullmatch(r"[\d.,-]+", name) for name in names[1:]):  # X_Columns and names omitted
        names = ["X_Value", *(f"channel {k}" for k in range(1, len(trimmed(rows[first]))))]
    else:
        first += 1
    units = ["s" if what.lower() in ("time", "") else "?", *said.get("y_unit_label", [])]
    columns = [Column(cleaned(n), u or None) for n, u in zip(names, [*units, *[""] * len(names)], strict=False)]
    # without a clock the first column is empty, and Delta_X gives the step
    step = f"Delta_X {said.get('delta_x', [''])[0]}" if clock.lower() == "no" else ""
    columns[0] = Column("", form="text") if step else columns[0]
    # the comment column is often empty
    width = max(len(names), *(len(row) for row in rows[first:]))
    columns += [Column("", form="text")] * (width - len(columns))
    return Layout(separator, decimal or ".", tuple(columns), first, width, ("LabVIEW measurement",), step)


def twincat(lines: Sequence[str]) -> Layout | None:
    """Return the layout of a TwinCAT Scope export (`key value key value`, `clock value clock value`), or None."""
    rows = [[cell.strip() for cell in line.split("\t")] for line in lines]
    keyed = {row[0].lower(): row for row in rows if len(row) > 1 and len(set(row[0::2])) == 1 and not row[0].isdigit()}
    names, units = keyed.get("name"), keyed.get("unit")
    clock = next((row[0] for key, row in keyed.items() if key.startswith("sampletime")), None)
    if clock is None or names is None or "symbolname" not in keyed:
        return None
    names = [row for row in rows if row[0] == "Name" and len(row) == len(keyed["symbolname"])][-1]
    first = 1 + max(k for k, row in enumerate(rows) if row[0].lower() in keyed and not row[0].isdigit())
    columns = []
    for k in range(0, len(names) - 1, 2):
        columns.append(Column("time", clock.partition("[")[2].strip("]")))
        columns.append(Column(cleaned(names[k + 1]), units[k + 1] if units else None))
    return Layout("\t", ".", tuple(columns), first, len(columns), ("TwinCAT Scope",))


SIGNATURES: tuple[Callable[[Sequence[str]], Layout | None], ...] = (labview, twincat)

"""Programs that sign their text files: a signature wins at once, since it says how the rest is written.

LabVIEW Measurement     separator, decimal mark, units and names by its own keys
TwinCAT Scope           keys in every second cell, a clock beside every channel
"""

from collections.abc import Callable, Sequence

from .._errors import BadInput
from .guard import cleaned
from .header import Layout, trimmed
from .table import Column

_LABVIEW, _END = "labview measurement", "***end_of_header***"


def labview(lines: Sequence[str], source: str) -> Layout | None:
    """LabVIEW's measurement files (.lvm).

    Raises:
        BadInput: no names below its last header, or a clock for every channel.
    """
    if not lines[0].lower().startswith(_LABVIEW):
        return None
    separator = "," if any(line.startswith("Separator,Comma") for line in lines[:12]) else "\t"
    rows = [[cell.strip() for cell in line.split(separator)] for line in lines]
    keys = {row[0].lower(): row[1:] for row in rows if len(row) > 1}
    # one header for the file and one for every segment: names follow the last
    ends = [k for k, row in enumerate(rows) if row[0].lower() == _END]
    if not ends or len(rows) <= ends[-1] + 2:
        raise BadInput(f"{source}: a LabVIEW file without a table below its header; write it again")
    if keys.get("x_columns", ["One"])[0].lower() == "multi":
        raise BadInput(
            f"{source}: LabVIEW wrote a clock for every channel (X_Columns Multi); write one (X_Columns One)"
        )
    first = ends[-1] + 1
    names = [name for name in trimmed(rows[first]) if name.lower() != "comment"]
    named = not all(name.replace(".", "").replace(",", "").replace("-", "").isdigit() for name in names[1:])
    names = names if named else ["X_Value", *(f"channel {k}" for k in range(1, len(trimmed(rows[first]))))]
    first += named
    timed = keys.get("x_dimension", ["Time"])[0].lower() in ("time", "")
    units = ["s" if timed else "?", *keys.get("y_unit_label", [])]
    # then the first column is empty, and Delta_X the only clock
    none = keys.get("x_columns", [""])[0].lower() == "no"
    columns = [Column(cleaned(n), u or None) for n, u in zip(names, [*units, *[""] * len(names)], strict=False)]
    columns[0] = Column("", form="text") if none else columns[0]
    # the comment column is often not filled
    width = max(len(names), *(len(row) for row in rows[first:]))
    columns += [Column("", form="text")] * (width - len(columns))
    step = keys.get("delta_x", [""])[0] if none else ""
    decimal = keys.get("decimal_separator", ["."])[0] or "."
    return Layout(
        separator, decimal, tuple(columns), first, width, ("LabVIEW measurement",), f"Delta_X {step}" * bool(step)
    )


def twincat(lines: Sequence[str], source: str) -> Layout | None:
    """Exports of TwinCAT Scope: `key value key value`, then `clock value clock value`."""
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
        own = Column("time", clock.partition("[")[2].strip("]")) if k == 0 else Column("", form="text")
        columns += [own, Column(cleaned(names[k + 1]), units[k + 1] if units else None)]
    return Layout("\t", ".", tuple(columns), first, len(columns), ("TwinCAT Scope, the clock of its first channel",))


SIGNATURES: tuple[Callable[[Sequence[str], str], Layout | None], ...] = (labview, twincat)

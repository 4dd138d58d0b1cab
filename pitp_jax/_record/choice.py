"""Which column of a table is the time, the input, the output.

exact names time_{s,ms}, voltage_{V,kV,mV}, displacement_{m,mm,um,V,mV}; or the one asked for, unit read from
its name
"""

from collections.abc import Sequence

from .._errors import BadInput
from .table import Table
from .units import column_names, unit_of

_OPTIONS = {"time": None, "voltage": "--input-column", "displacement": "--output-column"}


def choose_column(table: Table, quantity: str, choice: str | None = None) -> tuple[str, str]:
    """The column that holds a quantity, and its unit.

    Args:
        table: the opened file.
        quantity: `time`, `voltage` or `displacement`.
        choice: a column name that replaces the exact ones, or None.

    Returns:
        name and unit.

    Raises:
        BadInput: no such column, two of them, or an unknown unit.
    """
    option = _OPTIONS[quantity]
    wanted = (choice,) if choice is not None else column_names(quantity)
    found = [name for name in table.names if name in wanted]
    if not found:
        raise BadInput(_absent(table, quantity, choice, option))
    if len(found) > 1:
        if len(set(found)) < len(found):
            remedy = "rename or delete one"
        else:
            remedy = f"choose one with {option} NAME" if option else "keep only one"
        raise BadInput(f"{table.source}: columns {_listed(found)}: two matches for the {quantity}; {remedy}")
    return found[0], unit_of(found[0], quantity, table.source)


def _absent(table: Table, quantity: str, choice: str | None, option: str | None) -> str:
    here = _listed(table.names) if any(table.names) else "none"
    if choice is not None:
        return f"{table.source}: column {choice!r} is missing (columns here: {here}); give {option} one of these"
    known = "_{" + ",".join(name.rpartition("_")[2] for name in column_names(quantity)) + "}"
    loose = [name for name in table.names if name.lower().startswith(quantity) or name.lower() in ("t", "u", "v")]
    remedy = f"name it {quantity}{known} with the unit it is in"
    if any(";" in name or "\t" in name for name in table.names):
        remedy = "separate columns by commas, with a point in decimals"
    elif any(name.startswith(("#", "%")) for name in table.names):
        remedy = "delete the comment lines above the header, and what marks it as one"
    elif option and loose:
        remedy += f", or pick one that ends in a unit with {option} NAME"
    return f"{table.source}: column {quantity}{known} is missing (columns here: {here}); {remedy}"


def _listed(names: Sequence[str], most: int = 8) -> str:
    shown = ", ".join(repr(name if len(name) <= 40 else name[:40] + "...") for name in names[:most])
    return shown + (f" and {len(names) - most} more" if len(names) > most else "")

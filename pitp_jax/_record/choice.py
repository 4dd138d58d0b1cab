"""Which column of a table is the time, the input, the output, and in which unit.

exact name (voltage_V)  >  unit of its kind (V, kV; a length)  >  an output in V that is named one  >  named so, no unit

The first of these with a column decides; with more than one column it asks. Exact names beside others that would do
win, and that is told.
"""

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

from .._errors import BadInput
from .options import OPTIONS, ReadOptions
from .table import Column, Table
from .units import INPUT_UNITS, TIME_UNITS, column_names, is_length, spelt, split_header, units_of

_WORDS = {
    "time": "t time zeit timestamp date datetime datum uhrzeit temps tiempo tempo elapsed clock x_value",
    "voltage": "u v voltage volt volts spannung tension voltaje drive hv input vin amplifier amp excitation command "
    "cmd eingang anregung actuation monitor",
    "displacement": "x y z d w displacement disp position pos weg auslenkung verschiebung abstand hub laser stroke "
    "deflection distance output out motion extension elongation height hoehe deplacement response lvdt sensor ausgang",
}
_KNOWN = {quantity: frozenset(words.split()) for quantity, words in _WORDS.items()}


@dataclass(frozen=True)
class Choice:
    """A column that was chosen.

    Attributes:
        place: among the table's columns; None for a time that --rate makes.
        name: its header.
        unit: of its values.
        note: what else the summary should say of it, or empty.
    """

    place: int | None
    name: str
    unit: str
    note: str = ""

    def __str__(self):
        return f"{self.name!r} in {self.unit}{f' ({self.note})' if self.note else ''}"


@dataclass(frozen=True)
class _Seen:
    """A column as its header reads: where it is, its unit, what its words say."""

    place: int
    column: Column
    unit: str | None
    words: frozenset[str]


def choose_columns(table: Table, options: ReadOptions, quantities: Sequence[str]) -> dict[str, Choice]:
    """The columns that hold these quantities.

    Args:
        table: the opened file.
        options: what the caller says about them.
        quantities: of `time`, `voltage`, `displacement`.

    Returns:
        a choice per quantity.

    Raises:
        BadInput: with all that is missing, the columns found and the options to give.
    """
    seen = [_seen(place, column) for place, column in enumerate(table.columns) if column.name or column.unit]
    chosen, problems = {}, []
    for quantity in quantities:
        try:
            chosen[quantity] = _choose(seen, quantity, options)
        except BadInput as error:
            problems.append(str(error))
    places = [choice.place for choice in chosen.values() if choice.place is not None]
    if len(set(places)) < len(places):
        problems.append("one column is chosen twice; choose different input and output columns")
    if problems:
        raise BadInput(f"{table.source}: {'; '.join(problems)} (columns here: {_listed(table.columns)})")
    return chosen


def _seen(place: int, column: Column) -> _Seen:
    stem, unit = split_header(column.name)
    plain = unicodedata.normalize("NFKD", stem.lower())
    plain = "".join(c for c in plain if not unicodedata.combining(c))
    parts = re.findall(r"[^\W\d_]+", plain)
    words = {w for k, w in enumerate(parts) if len(w) > 1 or k == 0} | ({plain} & {"x_value"})
    return _Seen(place, column, (spelt(column.unit) if column.unit else None) or unit, frozenset(words))


def _says(seen: _Seen, quantity: str) -> bool:
    """Whether the header's words name this quantity and no other (an `Output voltage` names none)."""
    named = [q for q, known in _KNOWN.items() if seen.words & known]
    if "x_value" in seen.words:
        named = ["time"]
    return named == [quantity]


def _tiers(seen: Sequence[_Seen], quantity: str, options: ReadOptions) -> list[list[_Seen]]:
    """Columns that could hold a quantity, the surest first."""
    exact = [s for s in seen if s.column.name in column_names(quantity)]
    bare = [s for s in seen if s.unit is None and not s.column.stamps and _says(s, quantity)]
    if quantity == "time":
        clocks = [s for s in seen if s.column.stamps or s.unit in TIME_UNITS]
        return [exact, [s for s in clocks if _says(s, "time")], clocks, bare]
    volts = [s for s in seen if s.unit in INPUT_UNITS]
    if quantity == "voltage":
        return [exact, [s for s in volts if not _says(s, "displacement")], bare]
    lengths = [s for s in seen if is_length(s.unit)]
    named = [s for s in volts if _says(s, "displacement")]
    return [exact, named, lengths, bare] if options.output_scale is not None else [exact, lengths, named, bare]


def _choose(seen: Sequence[_Seen], quantity: str, options: ReadOptions) -> Choice:
    stem, wanted = OPTIONS[quantity], options.column(quantity)
    word = {"time": "time", "voltage": "input (voltage)", "displacement": "output (displacement)"}[quantity]
    note = ""
    if wanted is not None:
        found = [s for s in seen if s.column.name == wanted]
        if not found:
            raise BadInput(f"column {wanted!r} is missing; give --{stem}-column one of those here")
    else:
        tiers = _tiers(seen, quantity, options)
        found = next((tier for tier in tiers if tier), [])
        others = [s.column.name for s in (*tiers[1], *tiers[0]) if found and s not in found]
        if tiers[0] and others:
            note = f"by its exact name, beside {_names(others)}"
    if not found and quantity == "time" and options.rate is not None:
        return Choice(None, "--rate", "s")
    if not found:
        known = "_{" + ",".join(units_of(quantity)) + "}"
        rate = " or --rate HZ" if quantity == "time" else f" (and --{stem}-unit, --{stem}-scale)"
        raise BadInput(f"{word} column {quantity}{known} is missing; give --{stem}-column NAME{rate}")
    if len(found) > 1:
        twice = len({s.column.name for s in found}) < len(found)
        remedy = "rename or delete one" if twice else f"choose one with --{stem}-column NAME"
        raise BadInput(f"{_names([s.column.name for s in found])}: two matches for the {word}; {remedy}")
    return _with_unit(found[0], quantity, options, note)


def _with_unit(seen: _Seen, quantity: str, options: ReadOptions, note: str) -> Choice:
    """The column's unit: the option's, the file's, V before a scale, s for a time that counts in fractions."""
    stem, name = OPTIONS[quantity], seen.column.name
    own = seen.unit if seen.unit in units_of(quantity) else None
    unit = options.unit(quantity) or own
    if seen.column.stamps and quantity == "time":
        return Choice(seen.place, name, "s", "dates and hours")
    if options.unit(quantity) is not None and own not in (None, options.unit(quantity)):
        note = f"by --{stem}-unit, over {own} in the file"
    if unit is None and options.scale(quantity) is not None:
        unit, note = "V", "no unit in the file, volts before the scale"
    if unit is None and quantity == "time" and options.rate is not None:
        return Choice(None, "--rate", "s", f"{name!r} has no unit")
    if unit is None and quantity == "time" and seen.unit is None:
        unit, note = "s", "no unit in the file, taken as seconds"
    if unit is None:
        raise BadInput(
            f"column {name!r} has {'no unit' if seen.unit is None else 'an unknown unit'} for the {quantity}; "
            f"give --{stem}-unit {'|'.join(units_of(quantity))}"
        )
    return Choice(seen.place, name, unit, note)


def _names(names: Sequence[str]) -> str:
    return ", ".join(repr(name if len(name) <= 40 else name[:40] + "...") for name in dict.fromkeys(names))


def _listed(columns: Sequence[Column], most: int = 8) -> str:
    names = [column.name for column in columns if column.name]
    left = len(dict.fromkeys(names[most:]))
    return (_names(names[:most]) or "none") + (f" and {left} more" if left else "")

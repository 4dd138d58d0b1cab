"""Open a file, choose its columns, and load them in base units; ask the user if a file can be read in several ways.

parts -> possible tables of each -> choices; all successful ones must agree -> (time, input, output), float64
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...common.errors import BadInput
from ...common.units import column_names, kind_of, to_base
from .choice import COUNTERS, Choice, choose_columns, clock_question, listed
from .held import hold_sparse, mean_of_held
from .join import joined_parts
from .names import read_header
from .options import OPTIONS, ReadOptions, with_folder
from .refusal import Refused, unrefused
from .structure import keys_in_turn, mirrored, refreshed, sign_bit, signed
from .table import Column, Table

_SECONDS = 3.0  # ratio to a stated rate within which a clock without a unit counts seconds


@dataclass(frozen=True)
class Loaded:
    """The chosen columns of one part of a file, loaded in base units.

    Attributes:
        table: their source.
        chosen: a choice per quantity.
        values: per quantity, shape (T,) each.
        options: of the caller and the folder.
        label: of this part of the file, or empty.
        rows: their rows in the table, or None for all.
        stands: rows of the log for which each value of the output stands; 1 where the log is not faster than the bus.
    """

    table: Table
    chosen: dict[str, Choice]
    values: dict[str, np.ndarray]
    options: ReadOptions
    label: str = ""
    rows: np.ndarray | None = None
    stands: float = 1.0

    def place(self, sample: int) -> str:
        """Describe a sample for a message: its number and, in a text file, its line."""
        return self.table.place(sample if self.rows is None else int(self.rows[sample]))

    def at(self, rows: np.ndarray) -> "Loaded":
        """Return these rows only."""
        kept = rows if self.rows is None else self.rows[rows]
        return replace(self, values={q: v[rows] for q, v in self.values.items()}, rows=kept)

    def words(self, quantity: str) -> str:
        """Describe how a quantity was read: `'U [V]' in V times 1000`."""
        scale, offset = self.options.scale(quantity), self.options.offset(quantity)
        less = f" less {offset:g}" if offset else ""
        return str(self.chosen[quantity]) + less + ("" if scale is None else f" times {scale:g}")

    def unit(self, quantity: str) -> str:
        """Return the unit in which a quantity is shown: the column's, or mm or V if a scale converts volts of a DAQ."""
        unit = self.chosen[quantity].unit
        if self.options.scale(quantity) is None or kind_of(unit) != "voltage":
            return unit
        return "mm" if quantity == "displacement" else "V"


def load_columns(path: Path, options: ReadOptions, quantities: Sequence[str]) -> list[Loaded]:
    """Load the wanted columns of a file, one entry for each part that the option `split_by` makes.

    Args:
        path: the file.
        options: the caller's options.
        quantities: of `time`, `voltage`, `displacement`.

    Raises:
        BadInput: nothing readable, or the user must decide.
    """
    said = with_folder(options, path)
    parts = joined_parts(path, said)
    if said != options and any(_ours(table) for tables in parts for table in tables):
        said, parts = options, joined_parts(path, options)  # pitp.toml does not apply to files written by pitp
    if said.split_by in ("sheet", "group"):
        chosen = [_agreed(tables, said, quantities) for tables in parts]
        return [replace(_load(*one, said), label=one[0].part) for one in chosen]
    # the first part that holds all wanted columns
    table, choices = next(unrefused(lambda tables: _agreed(tables, said, quantities), parts))
    if said.split_by is None:
        return [_one_signal(_load(table, choices, said))]
    return _by_column(table, choices, said, said.split_by)


def _one_signal(one: Loaded) -> Loaded:
    """Return the columns of a file whose rows are one recording.

    Raises:
        Refused: a row for each of several joints.
    """
    signals = [one.values[q] for q in ("voltage", "displacement") if q in one.values]
    turns = None
    if one.rows is None and "time" in one.values:
        places = [choice.place for choice in one.chosen.values() if choice.place is not None]
        turns = keys_in_turn(one.table, places, one.values["time"], signals)
    if turns is None:
        return one
    name, keys = turns
    some = ", ".join(keys[:4]) + (", ..." if len(keys) > 4 else "")
    why = f"column {name!r} has {len(keys)} values ({some}) that take turns, so each row is of one of them; split by it"
    raise Refused(why, {"--split-by": name})


def _ours(table: Table) -> bool:
    """Return whether a table has exactly the three columns of files that pitp writes."""
    quantities = ("time", "voltage", "displacement")
    known = [c.name in column_names(q) for c, q in zip(table.columns, quantities, strict=False)]
    return len(table.columns) == 3 and all(known)


def _agreed(tables: list[Table], options: ReadOptions, quantities: Sequence[str]) -> tuple[Table, dict[str, Choice]]:
    """Return the table and columns on which all possible readings of a file part agree.

    Raises:
        BadInput: none can be read, or two differ.
    """
    good = list(unrefused(lambda table: (table, choose_columns(table, options, quantities)), tables))
    # several encodings fit most bytes: the one whose names are words
    table, chosen = max(good, key=lambda one: _legible(one[0].columns))
    for other, choices in good:
        if any((choices[q].place, choices[q].unit) != (c.place, c.unit) for q, c in chosen.items()):
            two = [", ".join(f"{OPTIONS[q]} {c}" for q, c in one.items()) for one in (chosen, choices)]
            words = {}
            for q, c in chosen.items():
                if c.place is not None:
                    words |= {f"--{OPTIONS[q]}-column": c.name, f"--{OPTIONS[q]}-unit": c.unit}
            raise Refused(f"can be read in two ways: {two[0]} ({table.form}), or {two[1]} ({other.form})", words)
    return table, chosen


def _legible(columns: Sequence[Column]) -> int:
    """Score how plausible column names are: known words minus strange characters."""
    names = [c.name for c in columns]
    strange = sum(not (c.isalnum() or ord(c) < 128) for name in names for c in name)
    return sum(read_header(name).role is not None for name in names) - strange


def _load(table: Table, chosen: dict[str, Choice], options: ReadOptions) -> Loaded:
    """Load the chosen columns in base units and apply the scales; --rate gives the time if no column does."""
    values, chosen = _values(table, chosen, options)
    values, chosen = _registers(values, chosen)
    count = max((len(values[c.place]) for q, c in chosen.items() if q != "time" and c.place in values), default=0)
    count = count or len(next(iter(values.values()), ()))
    loaded = {}
    with np.errstate(over="ignore"):  # infinite values are refused later
        for quantity, choice in chosen.items():
            if choice.place is not None:
                # unit first, scale second: 2 V of a monitor of 1000 V per V
                base = to_base(values[choice.place] - options.offset(quantity), choice.unit)
                scale = options.scale(quantity)
                loaded[quantity] = base if scale is None else base * scale
    if "time" in chosen:
        chosen = chosen | {"time": _timed(table, chosen["time"], loaded, count, options)}
    rows, stands = None, 1.0
    if "time" in chosen and chosen["time"].place is not None:
        loaded, rows = _without_empty_rows(loaded)
    if "voltage" in chosen and "time" in chosen:
        loaded, held, fraction = hold_sparse(loaded)
        if held is not None:
            note = f"in {100 * fraction:.2g} % of the rows, held constant between them"
            chosen = chosen | {"voltage": chosen["voltage"].noted(note)}
        elif "displacement" in loaded:
            loaded, held, chosen, stands = _as_refreshed(loaded, chosen)
        if held is not None:
            rows = held if rows is None else rows[held]
    return Loaded(table, chosen, {q: loaded[q] for q in chosen}, options, rows=rows, stands=stands)


def _registers(values: dict[int, np.ndarray], chosen: dict[str, Choice]) -> tuple[dict, dict[str, Choice]]:
    """Read input and output as signed numbers where a bit of their registers is the sign."""
    ports = [(q, c.place) for q, c in chosen.items() if q != "time" and c.place is not None]
    for form, read in (("sign and magnitude", np.asarray), ("two's complement", mirrored)):
        registers = {place: read(values[place]) for _, place in ports}
        # few values are a command between two ends, not a small motion about zero
        moving = (r for r in registers.values() if sign_bit(r) is not None and len(np.unique(r)) > 4)
        shared = next(map(sign_bit, moving), None)
        for q, place in ports if shared is not None else ():
            bit = sign_bit(registers[place], shared)
            if bit is not None:
                values = values | {place: signed(registers[place], bit)}
                chosen = chosen | {q: chosen[q].noted(f"{form}: bit {bit} is the sign")}
    return values, chosen


def _as_refreshed(loaded: dict, chosen: dict[str, Choice]) -> tuple[dict, np.ndarray | None, dict[str, Choice], float]:
    """Return the recording at the rate of its output's refreshes, if the log is faster than the bus behind it."""
    time, voltage, output = (loaded[q] for q in ("time", "voltage", "displacement"))
    refreshes = refreshed(output)
    even = len(time) == len(voltage) == len(output)
    if refreshes is None or not (even and (np.diff(time) > 0).all() and np.isfinite(voltage).all()):
        return loaded, None, chosen, 1.0
    at, period = refreshes
    rows = np.ceil(at - 1e-6).astype(int)
    clock = np.interp(at, np.arange(len(time)), time)
    held = {"time": clock, "displacement": output[rows]}
    held["voltage"] = mean_of_held(time, voltage, np.append(clock, 2 * clock[-1] - clock[-2]))
    rate = (len(clock) - 1) / (clock[-1] - clock[0])
    note = f"each value stands {period:.3g} rows: read at its own rate of {rate:.4g} Hz"
    return held, rows, chosen | {"displacement": chosen["displacement"].noted(note)}, period


def _values(
    table: Table, chosen: dict[str, Choice], options: ReadOptions
) -> tuple[dict[int, np.ndarray], dict[str, Choice]]:
    """Load the chosen columns by column index; with --rate, an unreadable clock is ignored."""
    places, clock = [choice.place for choice in chosen.values() if choice.place is not None], chosen.get("time")
    try:
        return dict(zip(places, table.load(places), strict=True)), chosen
    except BadInput as error:
        if clock is None or clock.place is None:
            raise
        rest = [place for place in places if place != clock.place]
        values = dict(zip(rest, table.load(rest), strict=True))  # errors in these come first
        if options.rate is None:
            raise Refused(str(error), {"--rate": "RATE"}) from None
        return values, chosen | {"time": Choice(None, "--rate", "s", f"{clock.name!r} is not readable")}


def _timed(table: Table, choice: Choice, loaded: dict, count: int, options: ReadOptions) -> Choice:
    """Return the choice of the time; --rate replaces a clock that is missing, empty or without a unit.

    Raises:
        BadInput: whole numbers without a unit, an empty clock.
    """
    name, rate = choice.name, options.rate
    time = loaded.get("time")
    if time is None:
        assert rate is not None
        if 0 < (blanks := table.blanks()) < count / 2:
            raise BadInput(
                f"{blanks} empty lines between the rows of a file without a clock; split the file "
                "there if samples were lost"
            )
        loaded["time"] = _row_numbers(table, count) / rate
        return choice
    seen = np.count_nonzero(np.isfinite(time))
    unfit = ""
    if len(time) != count:
        unfit = f"the clock {name!r} has {len(time)} values for {count} samples; give --rate HZ"
    elif not seen or (seen < 2 and rate is not None):
        unfit = f"the clock {name!r} is empty; give --rate HZ"
    elif seen > 1 and choice.bare and rate is not None:
        step = float(np.median(np.diff(time[np.isfinite(time)])))
        seconds = clock_question(time, name) is None and 1 / _SECONDS < step * rate < _SECONDS
        unfit = "" if seconds else f"the clock {name!r} has no unit"
    if not unfit:
        return choice
    if rate is None:
        raise Refused(unfit, {"--rate": "RATE"})
    loaded["time"] = np.arange(count) / rate
    return Choice(None, "--rate", "s", unfit.partition(";")[0])


def _row_numbers(table: Table, count: int) -> np.ndarray:
    """Return the number of every row: that of a counter of 8, 16 or more bits, which skips lost rows, or its place."""
    for place, column in enumerate(table.columns):
        if column.form == "number" and read_header(column.name).words & COUNTERS:
            numbers = table.load([place])[0]
            steps = np.diff(numbers) % (256 if numbers.max(initial=0) < 256 else 65536)
            if len(numbers) == count and (steps > 0).all() and (steps == 1).mean() > 0.5:
                return np.append(0, np.cumsum(steps))
    return np.arange(count)


def _without_empty_rows(loaded: dict[str, np.ndarray]) -> tuple[dict, np.ndarray | None]:
    """Drop rows that hold neither input nor output; the time then shows the gap."""
    if len({len(v) for v in loaded.values()}) > 1:
        return loaded, None
    # an empty input alone must be refused later, as must a time at which the only signal is missing
    full = np.any([~np.isnan(v) for q, v in loaded.items() if q != "time" or len(loaded) < 3], axis=0)
    if full.all() or not full.any():
        return loaded, None
    return {q: v[full] for q, v in loaded.items()}, np.flatnonzero(full)


def _by_column(table: Table, chosen: dict[str, Choice], options: ReadOptions, name: str) -> list[Loaded]:
    """Split the rows by the values of a column, in order of first appearance."""
    places = [k for k, c in enumerate(table.columns) if c.name == name]
    if not places:
        raise BadInput(f"column {name!r} of --split-by is missing; give one of {listed(table.columns)}")
    whole = _load(table, chosen, options)
    count = len(whole.values["voltage"] if "voltage" in whole.values else next(iter(whole.values.values())))
    keys = table.texts(places[0]) if table.texts is not None else table.load(places)[0]
    keys = keys if whole.rows is None else keys[whole.rows[whole.rows < len(keys)]]
    if len(keys) != count:
        raise BadInput(f"column {name!r} of --split-by has {len(keys)} values for {count} samples")
    # run 1.0 of a float column is named 1
    labels = [f"{k:g}" if isinstance(k, float) else str(k) for k in keys.tolist()]
    first = list(dict.fromkeys(labels))
    if len(first) > 1000:  # a signal, not a run number
        raise BadInput(f"column {name!r} of --split-by has {len(first)} values; choose a column that numbers the runs")
    # a run may continue later in the file
    return [replace(whole.at(np.flatnonzero(np.array(labels) == label)), label=label) for label in first]

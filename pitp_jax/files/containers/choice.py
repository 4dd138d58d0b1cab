"""Choose the columns of time, input and output in a table, and their units.

exact name (voltage_V)  >  unit of its kind (V with a length)  >  units of other machines  >  by name  >  ask

The first of these rules with a column decides; with more than one column the user is asked. A named column without a
unit competes with one that has a unit and no name. If two statements of a unit disagree, the user is asked.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...common.errors import BadInput
from ...common.units import column_names, kind_of, spelt, to_base, units_of, written
from .names import Header, read_header, roles_of
from .options import OPTIONS, ReadOptions
from .refusal import Refused, shortened
from .table import Column, Table

_KINDS = {  # of an input and of an output, the likelier first
    "input": (("voltage",), ("current", "force", "torque", "pressure")),
    "output": (("length", "angle"), ("angular speed", "speed", "acceleration"), ("force", "torque", "pressure")),
}
_WORD = {
    "time": "time (time_s, ...)",
    "voltage": "input (voltage_V, input_rad, ...)",
    "displacement": "output (displacement_mm, output_deg, ...)",
}
_DAQ = frozenset("monitor mon adc ai ain analog channel ch daq".split())
_SUPPLIES = frozenset("battery batt bat vbat vbatt vbus bus vcc vdd".split())  # not inputs of a plant
# of a monitor, `HV 1:1000 (V)`: whether the numbers are before or after it is not known
_FACTOR = re.compile(r"\b1\s*:\s*\d\d+\b|\b\d\d+\s*:\s*1\b|(?<!\w)[x×*]\s*10+\b")
COUNTERS = frozenset("sample samples index scan nr no row point frame frames record rn sequence seq id".split())


@dataclass(frozen=True)
class Choice:
    """The column chosen for one quantity, with its unit.

    Attributes:
        place: among the table's columns; None for a time that --rate makes.
        name: its header.
        unit: of its values.
        note: further remark for the summary, or empty.
    """

    place: int | None
    name: str
    unit: str
    note: str = ""

    def __str__(self):
        return f"{self.name!r} in {self.unit}{f' ({self.note})' if self.note else ''}"

    @property
    def bare(self) -> bool:
        """Return whether the file states no unit."""
        return self.note.startswith("no unit")

    def noted(self, note: str) -> "Choice":
        """Return the choice with a further remark for the summary."""
        return replace(self, note=f"{self.note}; {note}" if self.note else note)


@dataclass(frozen=True)
class _Seen:
    """A column with its parsed header: index, unit, conflicting units, and text that is not a known unit."""

    place: int
    column: Column
    header: Header
    unit: str | None
    conflict: tuple[str, ...] = ()
    unknown: str | None = None

    @property
    def kind(self) -> str | None:
        return None if self.conflict else kind_of(self.unit)

    @property
    def role(self) -> str | None:
        return self.header.role

    @property
    def written(self) -> str | None:
        """Return a unit that is not in the table, as it is written: W, L/min."""
        return written(self.unknown or "")

    @property
    def counts_rows(self) -> bool:
        """Return whether the column's unit names a count of rows (`Sequence` of an oscilloscope)."""
        return (self.unknown or "").lower() in COUNTERS


def choose_columns(table: Table, options: ReadOptions, quantities: Sequence[str]) -> dict[str, Choice]:
    """Choose the columns that hold these quantities, and their units.

    Args:
        table: the opened file.
        options: the caller's options.
        quantities: of `time`, `voltage`, `displacement`.

    Returns:
        a choice per quantity.

    Raises:
        Refused: with everything that is missing, the columns of the file and the command to try.
    """
    seen = [_seen(place, column) for place, column in enumerate(table.columns) if column.name]
    chosen, problems, pools = {}, {}, _pools(seen, options, quantities)
    if options.time_column is None and "time" in pools:
        pools["time"] = _likeliest_clocks(table, pools["time"])
    for quantity in quantities:
        try:
            chosen[quantity] = _choose(seen, pools[quantity], quantity, options)
            if quantity == "time" and options.rate is None and options.time_unit is None:
                _check_clock(table, seen, chosen[quantity])
        except Refused as ask:
            problems[quantity] = ask
    ports = [s for q in ("voltage", "displacement") for s in seen if q in chosen and s.place == chosen[q].place]
    places = [choice.place for choice in chosen.values() if choice.place is not None]
    if len(set(places)) < len(places):
        problems["voltage"] = Refused("one column is chosen twice; choose different input and output columns")
    elif (
        len(ports) == 2
        and not (options.input_column or options.output_column)
        and all(
            # a voltage named only input or output, which may mean a port of the DAQ or of the actuator
            s.kind == "voltage" and s.header.port_only and not s.column.name.startswith(("input_", "output_"))
            for s in ports
        )
    ):
        ports.sort(key=lambda s: _roughness(_values(table, s.place)))  # the input is smoother than the measured output
        names = [s.column.name for s in ports]
        why = f"{names[0]!r} and {names[1]!r} may be ports of the DAQ or of the actuator; give --input-column"
        problems["voltage"] = Refused(why, {"--input-column": names[0], "--output-column": names[1]})
    if problems:
        why = "; ".join(ask.why for ask in problems.values())
        words = _suggested(table, seen, pools, chosen, problems, options, quantities)
        stems = [f"--{OPTIONS[q]}-column{' or --rate HZ' if q == 'time' else ''}" for q in problems]
        hint = "" if words else f"; give {', '.join(stems)}"
        hint = f"; the file says {table.hint}" if table.hint else hint
        raise Refused(why + hint, words, f"columns here: {listed(table.columns)}")
    return chosen


def clock_question(time: np.ndarray, name: str) -> str | None:
    """Return a question to the user about a clock column without a unit; None if it plausibly counts seconds.

    Args:
        time: as in the file, shape (T,), nan where empty.
        name: of its column.
    """
    seen = time[np.isfinite(time)]
    step = float(np.median(np.diff(seen))) if len(seen) > 1 else 0.0
    if len(seen) and seen.min() > 1e9 and seen.max() < 4e9:  # s since 1970: the years 2001 to 2096
        return None
    # 0, 1, 2, ... may count samples, ms or s; steps of 0.1 or more, or of less than 1e-6, are certainly not seconds,
    # and neither are steps of less than 1e-4 far from zero (days since 1900 or since the year 0)
    whole = step >= 1 and np.array_equal(seen, np.round(seen))
    if not (whole or step >= 0.1 or 0 < step < (1e-4 if seen.min() > 1e4 else 1e-6)):
        return None
    how = "counts in whole numbers" if whole else f"rises in steps of {step:.3g}"
    return f"column {name!r} {how} and has no unit; give --time-unit s|ms|us|d, or --rate HZ if it counts samples"


def _seen(place: int, column: Column) -> _Seen:
    header = read_header(column.name)
    beside, spoken = (spelt(text or "") for text in (column.beside, column.spoken))
    # name, units row and comment may state it; the same unit again is one statement
    stated = tuple(dict.fromkeys(unit for unit in (header.unit, beside, spoken) if unit))
    # an unknown unit in a units row takes precedence over brackets in the name
    unknown = column.beside if column.beside and not beside else header.unknown
    counted = header.unknown is not None and header.unknown[:1].isdigit()  # `(100us)` is not a microsecond
    if stated and (factor := _FACTOR.search(column.name)):
        unknown = f"{stated[0]}, {factor[0]}"
    elif stated and not counted:
        return _Seen(place, column, header, stated[0], stated if len(stated) > 1 else ())
    if unknown:
        return _Seen(place, column, header, None, (), unknown)
    return _Seen(place, column, header, spoken)


def _pools(seen: Sequence[_Seen], options: ReadOptions, quantities: Sequence[str]) -> dict[str, list[_Seen]]:
    """Return the candidate columns of each quantity, found by the first rule that finds any."""
    pools: dict[str, list[_Seen]] = {}
    for quantity in quantities:
        wanted = options.column(quantity)
        if wanted is not None:
            named = [s for s in seen if s.column.name == wanted]
            pools[quantity] = named or [s for s in seen if str(wanted).isdecimal() and s.place + 1 == int(wanted)]
    # a column named by the user is not a candidate for anything else
    taken = {s.place for pool in pools.values() for s in pool}
    open_ = [s for s in seen if s.place not in taken and s.column.form != "text"]
    for quantity in quantities:
        if quantity not in pools:
            exact = [s for s in open_ if s.column.name in column_names(quantity)]
            if exact:
                pools[quantity] = exact
    clocks = _clocks(open_)
    if "time" in quantities and "time" not in pools:
        pools["time"] = clocks
    data = [s for s in open_ if s not in clocks and not s.counts_rows and not s.header.words & _SUPPLIES]
    volts, lengths = ([s for s in data if s.kind == kind] for kind in ("voltage", "length"))
    # a laser or an encoder is often read in volts
    sensed = [s for s in volts if s.role == "output"]
    driving = [s for s in volts if s.role != "output"] or pools.get("voltage", [])
    if not driving and lengths:  # the only voltage beside a length, whatever its name
        sensed, driving = [], sensed
    # volts are an input only beside a measured response
    measured = sensed or lengths or pools.get("displacement", []) or options.output_scale is not None
    moving = measured or "displacement" not in quantities
    if "voltage" in quantities and "voltage" not in pools:
        pools["voltage"] = _competing(driving, data, "input") if driving and moving else _machine(data, "input")
    if "displacement" in quantities and "displacement" not in pools:
        drive = pools.get("voltage", [])
        # the input itself is not a response
        data = [s for s in data if len(drive) != 1 or s is not drive[0]]
        # a scale applies to volts, so they come first
        first, second = (sensed, lengths) if options.output_scale is not None else (lengths, sensed)
        pair = [s for s in first if s in data] or [s for s in second if s in data]
        usual = driving or "voltage" not in quantities
        single = pair and (usual or not _machine(data, "output"))
        pools["displacement"] = _competing(pair, data, "output") if single else _machine(data, "output")
    return pools


def _clocks(seen: Sequence[_Seen]) -> list[_Seen]:
    """Return the columns that may hold the time: those with a unit of time, and those named so without a unit."""
    return [s for s in seen if s.column.form == "stamp" or s.kind == "time" or (s.role == "time" and s.kind is None)]


def _likeliest_clocks(table: Table, clocks: list[_Seen]) -> list[_Seen]:
    """Return the most likely clock columns, by their values, names and units, in this order of importance.

    A latency or a cycle time has a unit of time, but does not rise. Among clocks that agree, one in seconds is taken,
    otherwise the one with the smallest values, which loses the fewest digits.
    """
    if len(clocks) < 2:
        return clocks
    values = {s.place: _values(table, s.place) for s in clocks}
    ranks = [_rank(s, values[s.place]) for s in clocks]
    clocks = [s for s, rank in zip(clocks, ranks, strict=True) if rank == max(ranks)]
    seconds = {s.place: to_base(values[s.place], (s.kind == "time" and s.unit) or "s") for s in clocks}
    first = seconds[clocks[0].place]
    if len(clocks) > 1 and all(agree(first, other, 0.5, shifted=True) for other in seconds.values()):
        # one that certainly counts seconds first
        asked = {s.place: s.kind is None and clock_question(values[s.place], "") is not None for s in clocks}
        clocks = [min(clocks, key=lambda s: (asked[s.place], float(np.nanmax(np.abs(seconds[s.place])))))]
    return clocks


def _rank(s: _Seen, values: np.ndarray) -> tuple[bool, ...]:
    """Rank a clock: it ticks, has no other unit (g), no other name (latency), a time's name and unit beside dates."""
    dated = s.column.form == "stamp"
    named = s.role == "time"
    united = named and s.kind == "time" and not dated
    return dated or _ticks(values), s.unknown is None, s.header.clock_only, united, named and dated


def _check_clock(table: Table, seen: Sequence[_Seen], clock: Choice) -> None:
    """Ask about a clock without a unit, or with one that dates and hours in another column contradict."""
    dates = [s for s in seen if s.column.form == "stamp" and s.place != clock.place]
    if not dates and not clock.bare:
        return
    time = _values(table, clock.place or 0)
    if clock.bare and (strange := clock_question(time, clock.name)):
        raise Refused(strange, {"--time-unit": "UNIT"})
    for s in dates:
        stamps = _values(table, s.place)
        if _ticks(time) and _ticks(stamps):
            long, dated = (np.nanmax(v) - np.nanmin(v) for v in (to_base(time, clock.unit), stamps))
            if abs(np.log(long / dated)) > np.log(300):  # no drift, but a wrong unit
                why = f"column {clock.name!r} lasts {long:.3g} s in {clock.unit}, but {s.column.name!r} {dated:.3g} s"
                raise Refused(f"{why}; give --time-unit or another --time-column", {"--time-column": s.column.name})


def _ticks(values: np.ndarray) -> bool:
    """Return whether values increase like a clock, which may overflow or restart."""
    steps = np.diff(values[np.isfinite(values)])
    return len(steps) > 0 and bool((steps >= 0).mean() > 0.9 and (steps > 0).any())


def agree(first: np.ndarray, other: np.ndarray, within: float, *, shifted: bool = False) -> bool:
    """Return whether two clocks (s) differ by no more than a fraction of a time step.

    Args:
        first: shape (T,); nan where empty.
        other: the other clock.
        within: the fraction.
        shifted: whether they may also differ by a constant.
    """
    if len(first) != len(other) or not np.isfinite(first).any() or np.isinf(first).any() or np.isinf(other).any():
        return False
    apart = first - other
    apart -= np.nanmin(apart) * shifted
    return len(first) < 2 or float(np.nanmax(np.abs(apart))) <= within * float(np.nanmedian(np.diff(first)))


def _competing(united: Sequence[_Seen], data: Sequence[_Seen], role: str) -> list[_Seen]:
    """Return columns of the role's usual unit; if none is named for the role, also named columns without a unit.

    A command of another unit competes with a voltage, unless that is named a command too. A DAQ channel comes last,
    because it may be a monitor of such a column.
    """
    bare = [s for s in data if role in roles_of(s.header.words) and s.kind is None and s.unknown is None]
    commands = [s for s in data if role == "input" and s.header.commanded and s.kind]
    if commands and not any(s in commands for s in united):
        return [*united, *commands]
    if any(s.role == role and not s.header.words & _DAQ for s in united):
        return [*united]
    return sorted([*united, *bare], key=lambda s: bool(s.header.words & _DAQ))


def _machine(data: Sequence[_Seen], role: str) -> list[_Seen]:
    """Return columns with other units: by name, otherwise by kind (efforts as inputs, motions as outputs)."""
    named = [s for s in data if s.role == role and s.kind is not None]
    if named:
        return named
    bare = [s for s in data if s.role == role]
    free = [s for s in data if s.role is None]
    for kinds in _KINDS[role]:
        some = [s for s in free if s.kind in kinds]
        if some:
            return some + bare
    # a temperature is usually recorded beside the motion
    warm = [s for s in free if s.kind in ("temperature", "absolute temperature") and role == "output"]
    return bare or warm


def _choose(seen: Sequence[_Seen], pool: Sequence[_Seen], quantity: str, options: ReadOptions) -> Choice:
    """Return the only candidate column of a quantity, with its unit; ask the user if there are none or several."""
    stem, wanted = OPTIONS[quantity], options.column(quantity)
    if not pool and wanted is not None:
        several = {s.column.name for s in seen} >= {name.strip() for name in wanted.split(",")}
        one = "a recording has one input and one output; " if several else ""
        raise Refused(f"column {wanted!r} is missing; {one}give --{stem}-column one of the columns of the file")
    if not pool and quantity == "time" and options.rate is not None:
        return Choice(None, "--rate", "s")
    if not pool:
        worded = [s.column.name for s in seen if s.column.form == "text" and s.role == stem]
        if worded:
            how = (
                "seconds, or 2026-11-23 10:00:00.123" if quantity == "time" else "numbers without thousands separators"
            )
            raise Refused(f"column {worded[0]!r} holds text; write {how}")
        raise Refused(f"the {_WORD[quantity]} is missing")
    if len(pool) > 1:
        names = [s.column.name for s in pool]
        twice = len(set(names)) < len(names)
        remedy = f"{'rename or delete one, or ' * twice}choose one with --{stem}-column {'NUMBER' if twice else 'NAME'}"
        raise Refused(
            f"{_names(names)}: {len(names) if len(names) > 2 else 'two'} columns may be the {_WORD[quantity]}; {remedy}"
        )
    return _with_unit(pool[0], quantity, options, _beside(seen, pool[0], quantity) if wanted is None else "")


def _beside(seen: Sequence[_Seen], chosen: _Seen, quantity: str) -> str:
    """Return a note on the other candidates if a column was chosen by its exact name; empty otherwise."""
    if chosen.column.name not in column_names(quantity):
        return ""
    others = [
        s.column.name for s in seen if s is not chosen and s.kind == chosen.kind and s.role in (chosen.role, None)
    ]
    return f"chosen by its exact name; other candidates: {_names(others)}" if others else ""


def _with_unit(seen: _Seen, quantity: str, options: ReadOptions, note: str) -> Choice:
    """Return the column with its unit: of the option, of the file, V before a scale, or s for a clock without one."""
    stem, name, given = OPTIONS[quantity], seen.column.name, options.unit(quantity)
    if seen.column.form == "stamp" and quantity == "time":
        return Choice(seen.place, name, "s", "dates and hours")
    said = seen.conflict or tuple(u for u in (seen.unit or seen.unknown,) if u)
    if given is not None:
        over = f"by --{stem}-unit, instead of {' and '.join(said)} in the file" if said not in ((), (given,)) else note
        return Choice(seen.place, name, given, over)
    if seen.conflict:
        first, second = seen.conflict[:2]
        raise Refused(
            f"column {name!r} has two units, {first} in its name and {second} in its unit; give --{stem}-unit",
            {f"--{stem}-unit": first},
        )
    if seen.written and quantity != "time":
        return Choice(seen.place, name, seen.written, note)
    unit = seen.unit or seen.unknown
    if unit in units_of(quantity):
        return Choice(seen.place, name, str(unit), note)
    if options.scale(quantity) is not None:
        return Choice(seen.place, name, "V", "no known unit in the file, volts before the scale")
    if unit is None and quantity == "time":
        return Choice(seen.place, name, "s", "no unit in the file, taken as seconds")
    why = "no unit" if unit is None else f"the unknown unit {unit!r}"
    units = "s|ms|us|ns|min" if quantity == "time" else "V|mm|rad|A|N|bar|..., counts for any other"
    raise Refused(f"column {name!r} has {why} for the {stem}; give --{stem}-unit {units}")


def _suggested(table: Table, seen, pools, chosen, problems, options: ReadOptions, quantities) -> dict[str, str]:
    """Return options that solve the problems: the first free column by role; unknown values in capitals.

    Both columns are named as soon as one is in question, because a scale or a name changes what may be the other.
    """
    words: dict[str, str] = {}
    taken = {choice.place for choice in chosen.values()}
    free = [s for s in seen if s.place not in taken and s.column.form == "number" and not s.counts_rows]
    if "time" in problems:
        words |= problems["time"].options or _time_words(table, seen, pools["time"], free, taken)
    ports = [q for q in ("voltage", "displacement") if q in quantities]
    asked = any(q in problems and len(pools[q]) != 1 for q in ports)
    # of two recordings in one file (`t u y`, `t_ u_ y_`) the columns of one length belong together
    clocks = [c.place for q, c in chosen.items() if q == "time" and c.place is not None]
    rows = max((len(_values(table, place)) for place in clocks), default=0)
    monitors = False  # an amplifier has two: if the input is one, the output is one too
    for quantity in ports:
        port = _port(table, seen, pools[quantity], free, chosen.get(quantity), quantity, taken, rows)
        if port is None:
            return {}
        taken.add(port.place)
        monitors = monitors or quantity == "voltage" and _is_monitor(_values(table, port.place), port)
        said = problems[quantity].options if quantity in problems else {}
        if not said and (asked or monitors) and (options.column(quantity) is None or quantity in problems):
            said = {f"--{OPTIONS[quantity]}-column": _said(seen, port)}
        # a question about both columns names both: its words stay
        words = words | said | _unit_words(port, quantity, quantity in problems, options, monitors) | words
    return words


def _port(table: Table, seen, pool, free, choice, quantity: str, taken: set, rows: int) -> _Seen | None:
    """Return the chosen column of a quantity, otherwise the first free one by its role: a command before a current."""
    if choice is not None:
        return next(s for s in seen if s.place == choice.place)
    role, wrong = ("input", "output") if quantity == "voltage" else ("output", "input")
    if not pool:
        pool = [s for s in free if s.kind != "time" and s.role != "time" and not s.header.words & COUNTERS]
    free = [s for s in pool if s.place not in taken]
    free.sort(key=lambda s: (s.role == wrong, not (role == "input" and s.header.commanded), s.role != role))
    for s in free[:16]:  # more columns are not loaded for a proposal
        values = _values(table, s.place)
        if rows in (0, len(values)) and values.size and np.ptp(values) > 0:
            return s
    return next(iter(free), None)


def _unit_words(port: _Seen, quantity: str, asked: bool, options: ReadOptions, monitors: bool) -> dict[str, str]:
    """Return options that state the unit and scale of a column, in capitals where no file holds them."""
    if options.scale(quantity) is not None:
        return {}
    stem, bare = OPTIONS[quantity], port.kind is None and not port.conflict and not port.written
    volts = port.kind == "voltage" or (bare and not port.unknown and monitors)
    words = {}
    if bare and options.unit(quantity) is None:
        words[f"--{stem}-unit"] = "V" if volts else "UNIT"
    if volts and (monitors or (quantity == "displacement" and asked)):
        words[f"--{stem}-scale"] = "SCALE"
    return words


def _said(seen: Sequence[_Seen], one: _Seen) -> str:
    """Return the column's name as the value of an option, or its number if other columns share the name."""
    names = [s.column.name for s in seen]
    return str(one.place + 1) if names.count(one.column.name) > 1 else one.column.name


def _time_words(table: Table, seen: Sequence[_Seen], pool: Sequence[_Seen], free: list[_Seen], taken: set) -> dict:
    """Return options that state the time: a rising column, or a rate."""
    bare = [s for s in free if s.role is None and s.unit is None and not s.header.words & COUNTERS]
    pool = pool or [s for s in bare if _ticks(_values(table, s.place))]
    if not pool:
        return {"--rate": "RATE"}
    first = pool[0]
    taken.add(first.place)
    named = {"--time-column": _said(seen, first)} if len(pool) > 1 or first.role != "time" else {}
    return named | ({"--time-unit": "UNIT"} if first.kind != "time" else {})


def _values(table: Table, place: int) -> np.ndarray:
    """Load one column as it is in the file, shape (T,); empty if it cannot be loaded."""
    try:
        return table.load([place])[0]
    except BadInput:
        return np.zeros(0)


def _roughness(values: np.ndarray) -> float:
    """Return the noise of a column relative to its range, from the median of the fifth differences."""
    # five differences almost remove a motion, and amplify noise sixteenfold
    rough = np.abs(np.diff(values[np.isfinite(values)], 5))
    return float(np.median(rough) / max(np.ptp(values), 1e-300)) if len(rough) else np.inf


def _is_monitor(values: np.ndarray, seen: _Seen) -> bool:
    """Return whether an input is a monitor signal recorded by a DAQ, by its range or its channel's name."""
    values = values[np.isfinite(values)]
    if not len(values) or seen.kind not in (None, "voltage") or seen.unit == "kV":
        return False
    if seen.unit is not None:
        return float(np.abs(to_base(values, seen.unit)).max()) <= 10.0  # V: the range of a DAQ
    alone = seen.header.words == {"voltage"} and seen.column.name.lower() != "voltage"  # Voltage_0 of a DAQ
    return bool(seen.header.words & _DAQ) or alone


def _names(names: Sequence[str]) -> str:
    return ", ".join(repr(shortened(name, 40)) for name in dict.fromkeys(names))


def listed(columns: Sequence[Column]) -> str:
    """Write the names of the first columns of a table, for messages."""
    names = [column.name for column in columns if column.name]
    beyond = len(dict.fromkeys(names[8:]))
    return (_names(names[:8]) or "none") + f" and {beyond} more" * bool(beyond)

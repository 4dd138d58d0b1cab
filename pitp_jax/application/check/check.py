"""Check every record by itself, and all records together, and advise the user.

    faults, input, noise (one_record) -> initial state, offset, direction, membership (set_fit)
                                      -> coverage, repeats -> advice

A record that cannot be used is reported and left out of the checks of the set, so its problem does not hide the others.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import mode

import numpy as np

from ...common.numbers import finite, number
from ...common.shown import Shown
from ...common.units import base_unit, from_base
from ...files.recordings.plausible import monitor_warning
from ...files.recordings.remarks import by_kind, counted
from ...method.signal.record import Record
from ...method.signal.sets import RATE_TOLERANCE, check_records
from .coverage import Coverage, coverage
from .one_record import CheckedRecord as CheckedRecord
from .one_record import coloured_noise, facts, masked, moves
from .repeats import Repeat, cycles, find_repeats
from .set_advice import set_advice, some_of
from .set_fit import SetFit, fit_set


@dataclass(frozen=True)
class Check(Shown):
    """The result of `check`: facts on every record, advice, coverage of frequencies and amplitudes, repeated inputs.

    Attributes:
        records: by name; one that could not be read holds its refusal as a problem.
        advice: on the set, one sentence each, the most important first.
        resonance_hz: of a pole pair that the frequency response needs; None without one.
        input_map: "square" or "linear": the force was taken as the square of the input or as the input.
        coverage: excited frequencies and amplitudes, one point a time window; None without a resonance.
        repeats: groups of recordings with the same input, each with the scatter of their outputs.
        understood: the records that could be read, in base units, sensor faults masked; in the order given.
    """

    records: dict[str, CheckedRecord]
    advice: tuple[str, ...]
    resonance_hz: float | None
    input_map: str
    coverage: Coverage | None
    repeats: tuple[Repeat, ...]
    understood: tuple[Record, ...]

    @property
    def problems(self) -> dict[str, tuple[str, ...]]:
        """Return the problems of single records, by record name; corrections while reading do not count."""
        return {name: row.problems for name, row in self.records.items() if row.problems}

    @property
    def repaired(self) -> list[str]:
        """Return the corrections made while reading, one line for every kind."""
        return by_kind([remark for row in self.records.values() for remark in row.repaired])

    def as_json(self) -> dict:
        """Return the JSON of `pitp check` as a dict (docs/contract.md)."""
        return {"records": {name: row.as_json() for name, row in self.records.items()}, "advice": list(self.advice)}

    def _rows(self) -> list[dict]:
        return [{"record": name, **row.as_json()} for name, row in self.records.items()]

    def __repr__(self) -> str:
        at = "" if self.resonance_hz is None else f", resonance near {self.resonance_hz:.3g} Hz"
        named = f" ({some_of(list(self.problems))})" if self.problems else ""
        lines = [f"Check of {counted(len(self.records), 'recording')}{at}: {len(self.problems)} with problems{named}"]
        return "\n".join(lines + [f"  {line}" for line in self.advice[:3]])


def check(records: Sequence[Record]) -> Check:
    """Check what was read, how each record starts, and whether the records suffice for identification and training.

    Args:
        records: from `pitp.read`; records of an unusual sampling rate or kind of output are reported and left out of
            the checks of the set.

    Returns:
        records by name, advice, coverage and repeats.

    Raises:
        BadInput: no records, or something else than records.

    Examples:
        >>> found = pitp.check(records)
        >>> found.records["sweep"].begins, found.records["sweep"].problems
        ('rest', ())
    """
    return checked(records, {})


def checked(records: Sequence[Record], refused: Mapping[str, str]) -> Check:
    """Check records as `check` does, and report the files that could not be read (name: refusal)."""
    if records or not refused:
        check_records(records)
    records = [masked(r) for r in _named(records)]
    own = {r.name: facts(r) for r in records}
    apart = _apart(records)
    # Only these describe the set: one rate, one kind of input and output, moving under an input.
    used = [r for r in records if r.name not in apart and own[r.name].band_hz is not None and moves(r)]
    start = _start(used)
    used = [replace(r, voltage=r.voltage - start) for r in used]
    fitted = fit_set(used) if used else None
    resonance, input_map = (fitted.peak_hz, fitted.input_map) if fitted else (None, "square")
    rows = {r.name: _beside(r, own[r.name], fitted) for r in records}
    turned = _turned(rows)
    more = dict.fromkeys(turned, "its sensor is reversed, unlike most others") | apart
    rows = {n: replace(row, problems=(*row.problems, more[n])) if n in more else row for n, row in rows.items()}
    cover = coverage(used, input_map, resonance) if resonance else None
    repeats = find_repeats(used, {name: float(row.direction or 1) for name, row in rows.items()})
    advice = set_advice(rows, used, cover, repeats, cycles(used), fitted, turned)
    # added to the others, so that one bad file does not hide the good ones
    lost = {name: CheckedRecord(problems=(why,)) for name, why in refused.items()}
    lines = []
    if used and input_map == "square" and (monitor := monitor_warning(used)):
        lines.append(monitor)
    if start:
        unit = used[0].voltage_unit
        lines.append(
            f"all recordings start at a command of {number(float(from_base(start, unit)), 4)} {unit}; it was "
            "subtracted as the offset of the log (--input-offset), and `zero` is the reading there"
        )
    return Check(rows | lost, (*lines, *advice), resonance, input_map, cover, tuple(repeats), tuple(records))


def _start(records: Sequence[Record]) -> float:
    """Return the position command at which all records start, base unit: an encoder may read 2048 at rest; else 0."""
    starts = {r.voltage[0] * (base_unit(r.voltage_unit) == base_unit(r.displacement_unit)) for r in records}
    return float(starts.pop()) if len(starts) == 1 else 0.0


def _named(records: Sequence[Record]) -> list[Record]:
    """Give records of the same name a number, so that all names differ."""
    count, seen, named = Counter(r.name for r in records), Counter(), []
    for r in records:
        seen[r.name] += 1
        named.append(r if count[r.name] == 1 else replace(r, name=f"{r.name} ({seen[r.name]})"))
    return named


def _apart(records: Sequence[Record]) -> dict[str, str]:
    """Return the records that differ from most in sampling rate or in a kind of unit, by name, with the reason."""
    if not records:
        return {}
    # in steps of the tolerance, so that equal ones are counted together
    rates = [round(np.log(r.dt) / RATE_TOLERANCE / 2) for r in records]
    dt = records[rates.index(mode(rates))].dt
    kinds = [(base_unit(r.voltage_unit), base_unit(r.displacement_unit)) for r in records]
    most, apart = mode(kinds), {}
    for r, kind in zip(records, kinds, strict=True):
        if abs(r.dt / dt - 1) > RATE_TOLERANCE:
            apart[r.name] = f"sampled at {1 / r.dt:.6g} Hz, most others at {1 / dt:.6g} Hz; use it in a separate call"
        elif kind != most:
            apart[r.name] = (
                f"its input is in {r.voltage_unit} and its output in {r.displacement_unit}, most others in "
                f"{' and '.join(most)}; give --input-column or --output-column"
            )
    return apart


def _beside(record: Record, own: CheckedRecord, fitted: SetFit | None) -> CheckedRecord:
    """Complete the facts about one record by the results of the linear fit."""
    if fitted is None or record.name not in fitted.records:
        return own
    row, unit = fitted.records[record.name], record.displacement_unit
    harmonic = 2 if fitted.input_map == "square" else 1
    top = harmonic * own.band_hz[1] if own.band_hz else 0.0
    coloured = coloured_noise(row.error, row.seen, record.dt * row.step, top, fitted.natural_hz)
    noise, colour = own.noise, "white"
    if coloured is not None:
        noise, colour = float(from_base(coloured, unit)), "coloured"
    # an infinite error: the offset was not measured
    zero, stderr = (finite(from_base(v, unit)) for v in (row.beginning.zero, row.beginning.stderr))
    direction = int(row.beginning.direction) if row.tells else None
    problems = (*own.problems, *filter(None, [row.strange]))
    return replace(own, begins=row.beginning.begins, zero=zero, zero_stderr=stderr, direction=direction, noise=noise,
                   noise_colour=colour, problems=problems)  # fmt: skip


def _turned(rows: Mapping[str, CheckedRecord]) -> list[str]:
    """Return the names of records in which the sensor is reversed relative to most records."""
    known = {name: row.direction for name, row in rows.items() if row.direction is not None}
    most = Counter(known.values()).most_common(1)
    return [name for name, direction in known.items() if direction != most[0][0]]

"""Hold the options of reading that the user states: columns, units, scales, rate, and the format of text.

u = input_scale * column,    y = output_scale * column,    t_i = i / rate where a file has no usable time

A folder may hold `pitp.toml`: tables `["GLOB"]` whose keys are the long option names; the caller's options take
precedence.
"""

import json
import math
import os
import re
import tomllib
from dataclasses import dataclass, field, fields, replace
from fnmatch import fnmatch
from glob import escape
from pathlib import Path
from typing import Any

from ...common.errors import BadInput, cleaned
from ...common.units import TIME_UNITS, spelt, units_of, written
from .refusal import FOLDER_FILE, about

OPTIONS = {"time": "time", "voltage": "input", "displacement": "output"}  # quantity -> stem of its options
_FINITE = {"factor": "finite number other than 0", "positive": "positive number", "number": "finite number"}


def option_of(name: str) -> str:
    """Return the command-line option for a field of `ReadOptions`, without dashes."""
    # `from` is a reserved word of Python
    return {"from_s": "from", "to_s": "to"}.get(name, name.replace("_", "-"))


_LENGTHS, _VOLTS = "m|mm|um|cm|nm", "V|kV|mV"
_OTHERS = (
    "A|mA, N|kN|N m, bar|kPa|MPa|psi, rad|deg|rev, rad/s|deg/s|rpm, m/s|m/s2, counts|percent, another of SI symbols (W)"
)


def _option(placeholder: str, help_: str, kind: str = "text") -> Any:
    return field(default=None, metadata={"placeholder": placeholder, "kind": kind, "help": help_})


@dataclass(frozen=True)
class ReadOptions:
    """Options of reading that the user states; None lets the file decide.

    Each field states its placeholder, kind and help on the command line, which are made from this table, as the keys of
    `pitp.toml` are.

    Raises:
        BadInput: an unknown unit, a scale of zero, a rate that is not positive, all of them at once.
    """

    time_column: str | None = _option("NAME", "time column: its exact header, or its number counted from 1")
    input_column: str | None = _option("NAME", "input column: its exact header or its number")
    output_column: str | None = _option("NAME", "output column: its exact header or its number")
    time_unit: str | None = _option("UNIT", "unit of the time, overrides the file: s|ms|us|ns|min|h|d")
    input_unit: str | None = _option("UNIT", f"unit of the input, overrides the file: {_VOLTS}, {_LENGTHS}, {_OTHERS}")
    output_unit: str | None = _option(
        "UNIT", f"unit of the output, overrides the file: {_LENGTHS}, {_VOLTS}, {_OTHERS}"
    )
    input_scale: float | None = _option("S", "factor of the input column to V (monitor of 1 V per kV: 1000)", "factor")
    output_scale: float | None = _option("S", "factor of the output column to m (2 mm per V: 0.002)", "factor")
    input_offset: float | None = _option("U", "subtracted from the input column, in the file's numbers", "number")
    output_offset: float | None = _option("Y", "subtracted from the output column, in the file's numbers", "number")
    rate: float | None = _option(
        "HZ", "samples per second: for files without a time column; overrides any other clock", "positive"
    )
    header_line: int | None = _option("N", "line with the column names, counted from 1", "whole")
    units_line: str | None = _option("N|none", "line with the units, counted from 1")
    separator: str | None = _option("CHAR", "separator of text files: a character, tab or blank")
    decimal: str | None = _option(".|,", "decimal mark of text files")
    encoding: str | None = _option("NAME", "encoding of text files: utf-8, cp1252, cp932, gb18030, ...")
    sheet: str | None = _option("NAME", "sheet of a workbook")
    split_by: str | None = _option(
        "COLUMN|sheet|group", "several runs or joints in one file: split it by this column into recordings"
    )
    from_s: float | None = _option("S", "use only the part from S on, in s after the first row", "seconds")
    to_s: float | None = _option("S", "use only the part up to S, in s after the first row", "seconds")
    join: tuple[str, ...] | None = _option(
        "FILE", "further files with columns of the same rows (time, input and output in separate files)", "files"
    )
    joint: str | None = _option("", "of the joints that `each` in `pitp.toml` names, the one to read", "")

    def __post_init__(self):
        """Refuse options with which no file could be read."""
        problems = []
        for quantity, stem in OPTIONS.items():
            unit = self.unit(quantity)
            if unit is None:
                continue
            known = (spelt(unit) or (quantity != "time" and written(unit)) or None) if isinstance(unit, str) else None
            if known is None or (known in TIME_UNITS) != (quantity == "time"):
                other = "" if quantity == "time" else ", another one of SI symbols such as W, or counts for any other"
                problems.append(f"--{stem}-unit {unit!r} is not one of {', '.join(units_of(quantity))}{other}")
            object.__setattr__(self, f"{stem}_unit", known)
        for f in fields(self):
            value, kind = getattr(self, f.name), f.metadata["kind"]
            if value is None or kind not in _FINITE:
                continue
            number = isinstance(value, (int, float)) and math.isfinite(value)
            if not number or (kind == "factor" and value == 0) or (kind == "positive" and value <= 0):
                problems.append(f"--{option_of(f.name)} {value!r} is not a {_FINITE[kind]}")
        problems += self._range_problems() + self._text_problems()
        if problems:
            raise BadInput("; ".join(problems))

    def _range_problems(self) -> list[str]:
        first, last = self.from_s or 0.0, math.inf if self.to_s is None else self.to_s
        numbers = all(isinstance(value, (int, float)) and not math.isnan(value) for value in (first, last))
        if numbers and 0 <= first < last:
            return []
        return [f"--from {self.from_s!r} --to {self.to_s!r} is not a time range; give seconds with 0 <= from < to"]

    def _text_problems(self) -> list[str]:
        problems = []
        if self.header_line is not None and not (isinstance(self.header_line, int) and self.header_line > 0):
            problems.append(f"--header-line {self.header_line!r} is not a line number; give a whole number from 1")
        if self.units_line is not None and self.units_line != "none" and not str(self.units_line).isdecimal():
            problems.append(
                f"--units-line {self.units_line!r} is not a line number; give a whole number from 1, or none"
            )
        if self.separator is not None:
            named = {"tab": "\t", "\\t": "\t", "blank": " ", "space": " ", "comma": ",", "semicolon": ";"}
            object.__setattr__(self, "separator", named.get(self.separator, self.separator))
            if len(self.separator) != 1 or self.separator.isalnum() or self.separator in '\n\r"':
                problems.append(f"--separator {self.separator!r} is not a separator; give one character, tab or blank")
        if self.decimal not in (None, ".", ","):
            problems.append(f"--decimal {self.decimal!r} is not a decimal mark; give . or ,")
        try:
            "".encode(self.encoding or "utf-8")
        except LookupError:
            problems.append(
                f"--encoding {cleaned(self.encoding)!r} is not known; use utf-8, cp1252, cp932, gb18030, cp1251, ..."
            )
        return problems

    def column(self, quantity: str) -> str | None:
        """Return the header that the user states for a quantity, or None."""
        return getattr(self, f"{OPTIONS[quantity]}_column")

    def unit(self, quantity: str) -> str | None:
        """Return the unit that the user states for a quantity, or None."""
        return getattr(self, f"{OPTIONS[quantity]}_unit")

    def scale(self, quantity: str) -> float | None:
        """Return the scale that the user states for input or output; None for the time."""
        return getattr(self, f"{OPTIONS[quantity]}_scale", None)

    def offset(self, quantity: str) -> float:
        """Return the number that the user subtracts from input or output, in the numbers of the file; 0 without one."""
        return getattr(self, f"{OPTIONS[quantity]}_offset", None) or 0.0

    def said(self) -> dict[str, Any]:
        """Return the stated options by their command-line names, without those that are None and without `joint`."""
        values = {option_of(f.name): getattr(self, f.name) for f in fields(self) if f.name != "joint"}
        return {name: value for name, value in values.items() if value is not None}


def folder_file(said: dict[str, dict[str, Any]]) -> str:
    """Write the text of a `pitp.toml` that states these options, in one section if all files share them.

    Args:
        said: options by file name.
    """
    sections = {escape(name): options for name, options in said.items()}
    endings, first = {Path(name).suffix for name in said}, next(iter(said.values()), {})
    if len(said) > 1 and len(endings) == 1 and "join" not in first and all(o == first for o in said.values()):
        sections = {f"*{endings.pop()}": first}
    lines = ["# put beside the sources as pitp.toml, this reads them as pitp check did"]
    for pattern, options in sections.items():
        values = [f"{key} = {json.dumps(v, ensure_ascii=False)}" for key, v in options.items()]
        lines += ["", f"[{json.dumps(pattern, ensure_ascii=False)}]", *values]
    return "\n".join(lines) + "\n"


def with_folder(options: ReadOptions, path: Path) -> ReadOptions:
    """Complete the options by those of `pitp.toml` beside the file; options of the caller take precedence.

    Raises:
        BadInput: the file is not TOML, has keys that are not options, or lists joints and the caller names none.
    """
    said = _of_file(path)
    with about(path.parent / FOLDER_FILE):
        joints = joints_of(said.pop("each", {}))
        if "join" in said:
            said["join"] = joined_in(path)
        # the options of the caller
        own = {f.name: getattr(options, f.name) for f in fields(options)}
        if options.joint is not None and options.joint not in joints:
            raise BadInput(f"has no joint {options.joint!r}; add it to `each`")
        if options.joint is not None:
            said |= dict(zip(("input_column", "output_column"), joints[options.joint], strict=True))
        elif joints and not (own["input_column"] or own["output_column"]):
            raise BadInput(f"`each` names {', '.join(joints)}; give joint=NAME, or --input-column, --output-column")
        return replace(options, **{name: value for name, value in said.items() if own[name] is None})


def joined_in(path: Path) -> tuple[str, ...]:
    """Return the files that `join` in the `pitp.toml` beside a file adds to it; empty without such an option."""
    try:
        names = _of_file(path).get("join", ())
    except BadInput:  # refused when the file is read
        return ()
    beside = [path.parent / str(name) for name in ([names] if isinstance(names, str) else names)]
    return tuple(os.fspath(other) for other in beside if other != path)


def joints_in(path: Path) -> list[str]:
    """Return the robot joints that `each` in `pitp.toml` names for a file, or for all files of a folder."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return list(dict.fromkeys(name for file in files for name in joints_of(_of_file(file).get("each", {}))))


def joints_of(each: Any) -> dict[str, tuple[str, str]]:
    """Return the input and output column of every robot joint, by joint name.

    Args:
        each: a list of NAME=INPUT,OUTPUT, or a table of NAME = "INPUT,OUTPUT" or NAME = [INPUT, OUTPUT].

    Raises:
        BadInput: another form, or two joints of one name.
    """
    if not isinstance(each, (list, dict)):
        raise BadInput("each must be a list of NAME=INPUT,OUTPUT, one for every joint")
    pairs = [str(joint).partition("=")[::2] for joint in each] if isinstance(each, list) else list(each.items())
    joints = {}
    for name, ports in pairs:
        columns = tuple(re.split(r",(?![^\[]*\])", ports) if isinstance(ports, str) else ports)  # not in `q[1,2]`
        if not name or "/" in name or name.startswith(".") or len(columns) != 2 or not all(map(str, columns)):
            raise BadInput(f"--each {cleaned(name)}: give NAME=INPUT,OUTPUT, the exact headers of one joint")
        if name in joints:
            raise BadInput(f"--each: two joints have the name {cleaned(name)}; give each joint its own name")
        joints[name] = str(columns[0]), str(columns[1])
    return joints


def _of_file(path: Path) -> dict[str, Any]:
    """Read the options for a file from the `pitp.toml` beside it, by the names of `ReadOptions` and `each`."""
    file = path.parent / FOLDER_FILE
    if not file.is_file():
        return {}
    known = {option_of(f.name): f.name for f in fields(ReadOptions) if f.name != "joint"} | {"each": "each"}
    said = {}
    with about(file):
        try:
            tables = tomllib.loads(file.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise BadInput(f"cannot be read as TOML ({cleaned(error)[:100]}); correct the file") from None
        for glob, table in tables.items():
            if not isinstance(table, dict):
                raise BadInput(f'{cleaned(glob)!r} is outside a table; put it below ["GLOB"], such as ["*.csv"]')
            strange = [cleaned(key) for key in table if key.replace("_", "-") not in known]
            if strange:
                raise BadInput(f"{', '.join(strange)}: unknown key; the keys are {', '.join(sorted(known))}")
            # later tables take precedence, so that one file can differ from its kind
            if fnmatch(path.name, glob):
                said |= {known[key.replace("_", "-")]: value for key, value in table.items()}
    return said

"""Hold the result of a comparison: every quantity of A and B, and whether it differs beyond its interval.

difference = b - a,    95 % interval:  difference +- 1.96 sqrt(s_a^2 + s_b^2)
a quantity differs if that interval excludes 0; None if a standard error is unknown
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ...common.numbers import number
from ...common.page import Page, Section, Table
from ...common.shown import Shown
from ...common.units import from_base
from .pairing import Pairing


@dataclass(frozen=True)
class Difference:
    """One quantity in A and in B, with the interval of its difference.

    Attributes:
        what: the quantity in plain words.
        a, b: its values; text if it is not a number, None if missing.
        unit: of both and of the interval.
        ci95: of b - a; None if a standard error is unknown.
        differs: whether b differs from a; None if unknown.
    """

    what: str
    a: float | str | None
    b: float | str | None
    unit: str = ""
    ci95: tuple[float, float] | None = None
    differs: bool | None = None

    def words(self) -> str:
        """Write the difference in one line."""
        line = f"{self.what}: {_cell(self.a)} against {_cell(self.b)} {self.unit}".rstrip()
        # a factor is useful for numbers of similar size and equal sign; otherwise the numbers themselves are clearer
        if isinstance(self.a, float) and isinstance(self.b, float) and self.a and 0.1 < self.b / self.a < 10:
            line += f" (factor {number(self.b / self.a)})"
        return line


@dataclass(frozen=True)
class Comparison(Shown):
    """All compared quantities of A and B, and which of them differ.

    Attributes:
        kind: "models" or "records".
        names: of A and of B.
        rows: every quantity that A or B has, with both values, and whether they differ by more than their errors.
        remarks: further facts: which model was made from the other, offsets of clocks, recordings without a partner.
        pairs: of two sets of records, the recordings with the same command.
    """

    kind: str
    names: tuple[str, str]
    rows: tuple[Difference, ...]
    remarks: tuple[str, ...] = ()
    pairs: Pairing | None = None

    @property
    def different(self) -> tuple[Difference, ...]:
        """Return the quantities that differ."""
        return tuple(r for r in self.rows if r.differs)

    def headline(self) -> str:
        """Write in a sentence how many quantities differ."""
        count, open_ = len(self.different), sum(r.differs is None for r in self.rows)
        a, b = self.names
        unknown = f" ({open_} more were not judged, because their standard errors are not known)" if open_ else ""
        if not count:
            return f"{a} and {b} do not differ beyond their confidence intervals{unknown}"
        return f"{a} and {b} differ in {count} of {len(self.rows)} quantities{unknown}"

    def __repr__(self) -> str:
        """Write the headline and the first quantities that differ."""
        lines = [r.words() for r in self.different]
        if len(lines) > 9:  # a repr has at most ten lines
            lines = [*lines[:8], f"and {len(lines) - 8} more"]
        return "\n  ".join([f"Comparison of {self.kind}: {self.headline()}", *lines])

    def table(self, rows: Sequence[Difference]) -> Table:
        """Return the table of some quantities, for the page and the terminal."""
        answers = {None: "not known", True: "yes", False: "no"}
        cells = []
        for r in rows:
            ends = "-"
            if r.ci95 is not None and all(map(math.isfinite, r.ci95)):
                ends = " to ".join(number(end, 3) for end in r.ci95)
            cells.append((r.what, r.a, r.b, r.unit, ends, answers[r.differs]))
        header = ("quantity", *self.names, "unit", "difference, 95 %", "differs")
        return Table(header, cells, "In the order of the recordings." * (self.kind == "records"), text=(0, 3))

    def summary(self) -> Page:
        """Return the first screen of the page: headline, remarks and differences."""
        kind = f"Comparison of two {'sets of recordings' if self.kind == 'records' else self.kind}"
        differences = Section("What differs", [self.table(self.different)])
        return Page(self.headline(), kind, [list(self.remarks), differences])

    def _repr_html_(self) -> str:
        """Write the first screen of the page as HTML, for notebooks."""
        return self.summary().first_screen()

    def _rows(self) -> list[dict[str, Any]]:
        return self.as_json()["rows"]

    def as_json(self) -> dict[str, Any]:
        """Return the JSON of `pitp compare --json` as a dict."""
        rows = [vars(r) | {"ci95": None if r.ci95 is None else list(r.ci95)} for r in self.rows]
        pairs = [] if self.pairs is None else [
            p.as_json("a", "b") | {"output_offset": float(from_base(p.output_offset, p.first.displacement_unit)),
                                   "output_unit": p.first.displacement_unit}
            for p in self.pairs.pairs
        ]  # fmt: skip
        return {"kind": self.kind, "names": list(self.names), "differs": bool(self.different), "rows": rows,
                "remarks": list(self.remarks), "pairs": pairs}  # fmt: skip


def measured(what: str, a: float | None, b: float | None, unit: str, errors: Sequence[float | None] = (None, None)):
    """Compare two numbers with their standard errors (None: unknown)."""
    if a is None or b is None:
        return Difference(what, a, b, unit, None, True)  # a quantity of one side only: a difference without a size
    if a == b:
        return Difference(what, a, b, unit, None, False)
    if errors[0] is None or errors[1] is None:
        return Difference(what, a, b, unit)
    half = 1.96 * math.hypot(errors[0], errors[1])
    return Difference(what, a, b, unit, (b - a - half, b - a + half), abs(b - a) > half)


def stated(what: str, a, b) -> Difference:
    """Compare two facts by their text, numbers with four digits."""
    # as shown, because two equal texts called different would puzzle the reader
    return Difference(what, _cell(a), _cell(b), differs=_cell(a) != _cell(b))


def _cell(value) -> str:
    if value is None:
        return "none"
    if isinstance(value, str):
        return value
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_cell, value)) or "none"
    return number(float(value), 4) if not isinstance(value, bool) else str(value)

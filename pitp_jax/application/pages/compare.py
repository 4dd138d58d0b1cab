"""Write the page of a comparison: what differs, every quantity, and recordings of equal commands overlaid."""

from collections import Counter
from dataclasses import replace

import numpy as np

from ...common.numbers import number, shown_unit
from ...common.page import Section
from ...common.picture import Picture
from ...common.units import from_base
from ..compare.pairing import Pair
from ..compare.result import Comparison
from .drawing import PREDICTED, beside, some_periods

_DRAWN = 12  # pairs of recordings


def page(result: Comparison, drawn: list[Picture] | None = None) -> str:
    """Write the comparison as a self-contained HTML page; `drawn` holds its `figures`, or None to draw them."""
    alike = Section("No difference, or not judged", [result.table([r for r in result.rows if not r.differs])])
    shown = figures(result) if drawn is None else drawn
    return replace(
        result.summary(), rest=[alike, Section("The same command, one output over the other", [shown])]
    ).html()


def figures(result: Comparison) -> list[Picture]:
    """Draw every pair of recordings."""
    pairs = () if result.pairs is None else result.pairs.pairs
    count = Counter(p.first.name for p in pairs)
    # one recording may appear in several
    return [overlay(pair, result.names, "pair", count[pair.first.name] > 1) for pair in pairs[:_DRAWN]]


def overlay(pair: Pair, names: tuple[str, str], kind: str, several: bool = False) -> Picture:
    """Draw the outputs of a pair over time, and their difference, both without the constant offset between them."""
    unit, label = pair.first.displacement_unit, shown_unit(pair.first.displacement_unit)
    one, two = (np.asarray(from_base(y, unit)) for y in (pair.first.displacement, pair.output()))
    offset = float(from_base(pair.output_offset, unit))
    labels = (f"output ({label})", f"difference ({label})")
    drawn = beside(pair.first.time, (names[0], one), [(names[1], two - offset, PREDICTED)], labels, some_periods(one))
    name = f"{pair.first.name}_{pair.second.name}" if several else pair.first.name
    columns = {"time_s": pair.first.time - pair.first.time[0], f"a_{unit}": one, f"b_{unit}": two}
    caption = f"{pair.first.name}: {names[1]} is drawn without its constant offset of {number(offset, 3)} {label}"
    return Picture(f"{kind}_{name.replace('/', '_')}", drawn, caption, columns)

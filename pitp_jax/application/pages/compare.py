"""Write the page of a comparison: what differs, every quantity, and recordings of equal commands overlaid."""

from collections import Counter
from dataclasses import replace

from ...common.numbers import number, shown_unit
from ...common.page import Page, Section
from ...common.picture import Picture
from ...common.units import from_base
from ..compare.pairing import Pair
from ..compare.result import Comparison
from .drawing import DRAWN, PREDICTED, beside, some_periods


def page(result: Comparison) -> Page:
    """Return the page of a comparison, with every pair of recordings drawn."""
    alike = Section("No difference, or not judged", [result.table([r for r in result.rows if not r.differs])])
    overlaid = Section("The same command, one output over the other", [figures(result)])
    return replace(result.summary(), rest=[alike, overlaid])


def figures(result: Comparison) -> list[Picture]:
    """Draw every pair of recordings."""
    pairs = () if result.pairs is None else result.pairs.pairs
    count = Counter(p.first.name for p in pairs)
    # one recording may appear in several
    return [overlay(pair, result.names, "pair", count[pair.first.name] > 1) for pair in pairs[:DRAWN]]


def overlay(pair: Pair, names: tuple[str, str], kind: str, several: bool = False) -> Picture:
    """Draw the outputs of a pair over time, and their difference, both without the constant offset between them."""
    unit = pair.first.displacement_unit
    one, two = pair.first.displacement, pair.output()
    run = names[1], two - pair.output_offset, PREDICTED
    drawn = beside(pair.first.time, (names[0], one), [run], unit, ("output", "difference"), some_periods(one))
    name = f"{pair.first.name}_{pair.second.name}" if several else pair.first.name
    columns = {"time_s": pair.first.time - pair.first.time[0]}
    columns |= {f"a_{unit}": from_base(one, unit), f"b_{unit}": from_base(two, unit)}
    offset = f"{number(float(from_base(pair.output_offset, unit)), 3)} {shown_unit(unit)}"
    caption = f"{pair.first.name}: {names[1]} is drawn without its constant offset of {offset}"
    return Picture(f"{kind}_{name.replace('/', '_')}", drawn, caption, columns)

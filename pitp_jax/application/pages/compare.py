"""Write the page of a comparison: what differs, every quantity, and recordings of equal commands overlaid."""

from collections import Counter

import numpy as np
from matplotlib.figure import Figure

from ...common.numbers import figure, shown_unit
from ...common.units import from_base
from ..compare.pairing import Pair
from ..compare.result import Comparison, Difference
from . import html
from .html import tag
from .lines import ERROR, MEASURED, PREDICTED, finish, line, own_axes, some_periods

_DRAWN = 12  # pairs of recordings, the most different first


def page(result: Comparison) -> str:
    """Write the comparison as a self-contained HTML page."""
    others = tuple(r for r in result.rows if not r.differs)
    alike = [tag("h2", "No difference, or not judged"), _table(result, others)] if others else []
    return html.page(result.headline(), [*_first(result), *alike, *_drawn(result)])


def first_screen(result: Comparison) -> str:
    """Write headline, remarks and differences as HTML, without the page around them."""
    return "".join(_first(result))


def _first(result: Comparison) -> list[str]:
    return [
        tag("p", f"Comparison of two {'sets of recordings' if result.kind == 'records' else result.kind}", "soft"),
        tag("h1", result.headline()),
        html.bullets(result.remarks),
        *([tag("h2", "What differs"), _table(result, result.different)] if result.different else []),
    ]


def _table(result: Comparison, rows: tuple[Difference, ...]) -> str:
    header = ("quantity", *result.names, "unit", "95 % interval of the difference", "differs")
    answers, cells = {None: "not known", True: "yes", False: "no"}, []
    for r in rows:
        interval = "–" if r.ci95 is None else " to ".join(figure(end) for end in r.ci95)
        values = (r.what, _shown(r.a), _shown(r.b), shown_unit(r.unit), interval, answers[r.differs])
        cells.append(("named" if r.differs else "", values))
    return html.table(header, cells, {0: "long", 3: "left"})


def _shown(value: float | str | None) -> str:
    return value if isinstance(value, str) else figure(value, 4)


def figures(result: Comparison) -> dict[str, tuple[Figure, dict[str, np.ndarray]]]:
    """Draw every pair of recordings; return each figure with its numbers as columns, by name."""
    pairs = () if result.pairs is None else result.pairs.pairs
    count = Counter(p.first.name for p in pairs)
    made = {}
    for pair in pairs[:_DRAWN]:
        # one recording may appear in several
        name = pair.first.name if count[pair.first.name] == 1 else f"{pair.first.name}_{pair.second.name}"
        made[f"pair_{name.replace('/', '_')}"] = overlay(pair, result.names)
    return made


def overlay(pair: Pair, names: tuple[str, str]) -> tuple[Figure, dict[str, np.ndarray]]:
    """Draw the outputs of a pair over time, and their difference; return the figure and its numbers as columns."""
    unit = pair.first.displacement_unit
    time = pair.first.time - pair.first.time[0]  # clocks of two rigs have different origins
    one, two = (from_base(y, unit) for y in (pair.first.displacement, pair.output()))
    upper, lower = own_axes(None, 2, (5.6, 3.0), (2.2, 1.0))
    part = some_periods(one)
    line(upper, time[part], one[part], color=MEASURED, lw=2.2, label=names[0])
    line(upper, time[part], two[part], color=PREDICTED, lw=1.0, label=names[1])
    line(lower, time[part], (two - one)[part], color=ERROR, lw=0.8)
    finish(np.array([upper, lower]), "time from the start (s)", [f"output ({shown_unit(unit)})", "difference"])
    drawn = upper.figure
    assert isinstance(drawn, Figure)
    return drawn, {"time_s": time, f"a_{unit}": one, f"b_{unit}": two}


def _drawn(result: Comparison) -> list[str]:
    made = figures(result)
    if not made:
        return []
    pictures = [html.picture(name, drawn, name.removeprefix("pair_")) for name, (drawn, _) in made.items()]
    return [tag("h2", "The same command, one output over the other"), f'<div class="figures">{"".join(pictures)}</div>']

"""The page of a comparison: what differs, every quantity, and recordings of one drive over each other."""

import numpy as np
from matplotlib.figure import Figure

from .._report import html
from .._report.html import tag
from .._report.lines import ERROR, MEASURED, PREDICTED, finish, line, own_axes
from .._report.numbers import figure, shown_unit
from .._table.units import from_base
from .pairing import Pair
from .result import Comparison, Difference

_DRAWN = 12  # pairs of recordings, the most different first


def page(found: Comparison) -> str:
    """A self-contained HTML page."""
    others = tuple(r for r in found.rows if not r.differs)
    rest = [tag("h2", "What does not, or cannot be said"), _table(found, others)] if others else []
    return html.page(found.headline(), [*_first(found), *rest, *_drawn(found)])


def first_screen(found: Comparison) -> str:
    """Headline, remarks and what differs, without the page around."""
    return "".join(_first(found))


def _first(found: Comparison) -> list[str]:
    return [
        tag("p", f"Comparison of two {'sets of records' if found.kind == 'records' else found.kind}", "soft"),
        tag("h1", found.headline()),
        html.bullets(found.remarks),
        *([tag("h2", "What differs"), _table(found, found.different)] if found.different else []),
    ]


def _table(found: Comparison, rows: tuple[Difference, ...]) -> str:
    header = ("quantity", *found.names, "unit", "95 % interval of the difference", "differs")
    cells = [
        ("named" if r.differs else "", (
            r.what, _shown(r.a), _shown(r.b), shown_unit(r.unit),
            "–" if r.ci95 is None else " to ".join(figure(end) for end in r.ci95),
            "not known" if r.differs is None else "yes" if r.differs else "no",
        ))
        for r in rows
    ]  # fmt: skip
    return html.table(header, cells, {0: "long", 3: "left"})


def _shown(value: float | str | None) -> str:
    return value if isinstance(value, str) else figure(value, 4)


def figures(found: Comparison) -> dict[str, tuple[Figure, dict[str, np.ndarray]]]:
    """Every pair drawn, with its numbers as columns, by name."""
    pairs = () if found.pairs is None else found.pairs.pairs
    return {f"pair_{p.first.name.replace('/', '_')}": overlay(p, found.names) for p in pairs[:_DRAWN]}


def overlay(pair: Pair, names: tuple[str, str]) -> tuple[Figure, dict[str, np.ndarray]]:
    """Both outputs over the time since the first recording's start, their difference beneath; and the numbers drawn."""
    unit = pair.first.displacement_unit
    time = pair.first.time - pair.first.time[0]
    one, two = (from_base(y, unit, "displacement") for y in (pair.first.displacement, pair.output()))
    upper, lower = own_axes(None, 2, (5.6, 3.0), (2.2, 1.0))
    line(upper, time, one, color=MEASURED, lw=2.2, label=names[0])
    line(upper, time, two, color=PREDICTED, lw=1.0, label=names[1])
    line(lower, time, two - one, color=ERROR, lw=0.8)
    finish(np.array([upper, lower]), "time from the start (s)", [f"output ({shown_unit(unit)})", "difference"])
    drawn = upper.figure
    assert isinstance(drawn, Figure)
    return drawn, {"time_s": time, f"a_{unit}": one, f"b_{unit}": two}


def _drawn(found: Comparison) -> list[str]:
    made = figures(found)
    if not made:
        return []
    pictures = [html.picture(name, drawn, name.removeprefix("pair_")) for name, (drawn, _) in made.items()]
    return [tag("h2", "The same drive, one output over the other"), f'<div class="figures">{"".join(pictures)}</div>']

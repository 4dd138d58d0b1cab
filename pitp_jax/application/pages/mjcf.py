"""Write the page of a verification: errors before and after the change, and every recording with MuJoCo's response."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from ...common.numbers import figure, shown_unit
from ...common.units import from_base
from ...files.mjcf.verify import Played, Verification
from . import html
from .html import tag
from .lines import ERROR, MEASURED, PREDICTED, finish, line, own_axes, some_periods

_DRAWN = 12  # recordings


def figures(found: Verification) -> dict[str, Figure]:
    """Draw the first recordings with MuJoCo's response; return figures by recording name."""
    return {p.record.name: _drawn(p) for p in found.played[:_DRAWN]}


def page(found: Verification, drawn: Mapping[str, Figure]) -> str:
    """Write the verification as an HTML page with the given figures."""
    headline = "The changed file is closer to the robot" if found.better else "The gap in MuJoCo"
    if found.better is False:
        headline = "The changed file is not closer to the robot"
    rows = []
    for p in found.played:
        look, used = ("named", "no") if p.held_out else ("", "yes")
        before = "–" if p.before is None else f"{figure(p.gap(after=False))} %"
        rows.append((look, (p.record.name, used, before, f"{figure(p.gap())} %")))
    is_any_held_out = any(p.held_out for p in found.played)
    bold = " The diagnosis did not use the recordings in bold." if is_any_held_out else ""
    header = ("recording", "used by the diagnosis", "gap before", "gap after")
    pictures = [
        html.picture(f"recording_{k}", drawing, f"{name}: robot and MuJoCo under the same command")
        for k, (name, drawing) in enumerate(drawn.items())
    ]
    return html.page(headline, [
        tag("p", f"Joint {found.joint} of {found.mjcf}, MuJoCo {found.version}", "soft"),
        tag("h1", headline), html.bullets([text.replace("->", "→") for text in found.lines()]),
        html.table(header, rows, {0: "long", 1: "left"}),
        tag("p", f"Gap: rms of the difference, % of the recording's range.{bold}", "soft"),
        tag("h2", "Recordings"), f'<div class="figures">{"".join(pictures)}</div>',
    ])  # fmt: skip


def _drawn(played: Played) -> Figure:
    record, unit = played.record, played.record.displacement_unit
    axes = own_axes(None, 1, (5.6, 2.6))
    time, part = record.time - record.time[0], some_periods(record.displacement)
    for values, color, width, label in (  # the robot's line is wide and below, so that it stays visible
        (record.displacement, MEASURED, 2.6, "robot"), (played.before, ERROR, 0.8, "MuJoCo, before"),
        (played.after, PREDICTED, 0.8, "MuJoCo, after"),
    ):  # fmt: skip
        if values is not None:
            line(axes[0], time[part], np.asarray(from_base(values, unit))[part], color=color, lw=width, label=label)
    finish(np.array([axes[0]]), "time (s)", [f"position ({shown_unit(unit)})"])
    assert isinstance(axes[0].figure, Figure)
    return axes[0].figure

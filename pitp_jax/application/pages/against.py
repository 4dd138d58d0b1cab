"""Write the page of a robot and its simulator: verdict, parameters, parts of the error, recordings overlaid."""

import numpy as np
from matplotlib.figure import Figure

from ...common.numbers import figure, of_range, percent, shown_unit, with_error
from ...common.units import from_base
from ..against.result import SimToReal
from . import html
from .compare import overlay
from .html import tag
from .lines import DRIVE, finish, line, own_axes, some_periods

_DRAWN = 12  # recordings


def page(found: SimToReal, drawn: dict[str, tuple[Figure, dict[str, np.ndarray], str]] | None = None) -> str:
    """Write the page as HTML; `drawn` holds the result of `figures`, or None to draw them."""
    shown = figures(found) if drawn is None else drawn
    pictures = [html.picture(name, each, caption) for name, (each, _, caption) in shown.items()]
    parts = [*_first(found), tag("h2", "Recordings"), f'<div class="figures">{"".join(pictures)}</div>']
    return html.page(_headline(found), parts)


def first_screen(found: SimToReal) -> str:
    """Write headline and parameters as HTML, without the page around them."""
    return "".join(_first(found))


def _headline(found: SimToReal) -> str:
    if found.verdict == "no_gap":
        return "The simulator agrees with the robot"
    lacking = [e.replace("_", " ") for e in found.effects if e != "parameter_change"]
    said = [f"lacks {' and '.join(lacking)}"] if lacking else []
    said += ["has different parameters"] if len(lacking) < len(found.effects) else []
    if said:
        return f"The simulator {', and '.join(said)}"
    if found.robot.handed_back:
        before, after = (of_range(e) for e in (found.robot.gap.before, found.robot.gap.after))
        return f"These parameters reduce the difference from {before} to {after} of range; no single cause is certain"
    return "The simulator and the robot differ, and no effect in the catalogue reduces the difference"


def _first(found: SimToReal) -> list[str]:
    lines = str(found.robot).splitlines()
    return [
        tag("p", "Robot beside simulator", "soft"),
        tag("h1", _headline(found), "explained" if found.effects else "unknown"),
        *(tag("p", text) for text in lines),
        html.bullets(found.remarks()),
        tag("h2", "Parameters to type into the simulator"),
        _table(found),
        *_budget(found),
    ]


def _table(found: SimToReal) -> str:
    header = ("quantity", "simulator", "robot", "difference", "MuJoCo", "PhysX, Isaac Lab", "URDF")
    rows = []
    for p in found.parameters:
        unit = shown_unit(p.unit)
        values = (f"{figure(p.simulator)} {unit}", f"{figure(p.robot)} {unit}")
        difference = with_error(p.difference, p.stderr, unit) if p.difference else "none"
        cells = (p.words, *values, difference, p.mujoco, p.physx, p.urdf)
        look = "" if p.difference else "pale"
        rows.append(("named" if p.difference and p.certain else look, cells))
    gain = any("Kp" in p.unit for p in found.parameters)
    note = (
        "Bold rows belong to effects that the diagnosis reports. The damping includes that of the controller, and the "
        "inertia includes the link. Therefore add the difference to the value in the simulator."
    )
    kp = " Kp is the gain of the position controller; give --position-gain to get torques." if gain else ""
    return html.table(header, rows, dict.fromkeys((0, 4, 5, 6), "long")) + tag("p", note + kp, "soft")


def _budget(found: SimToReal) -> list[str]:
    budget = found.budget
    words = {
        "nuisance": "sensor offsets and initial states",
        "parameters": "changed coefficients",
        "simulator": "the model of the simulator",
        "unnamed": "predictable from the input, no single cause certain",
        "unexplainable": "not predictable from the input",
    }
    parts = [(name, row["share"]) for name, row in budget.get("effects", {}).items()]
    parts += [(text, budget[key]["share"]) for key, text in words.items() if key in budget]
    rows = [("", (name, percent(share))) for name, share in parts]
    return [tag("h2", "Parts of the gap"), html.table(("part", "of the gap's energy"), rows, {})]


def figures(found: SimToReal) -> dict[str, tuple[Figure, dict[str, np.ndarray], str]]:
    """Draw every recording (robot, simulator, added input); return figures with numbers and captions, by name."""
    made = {}
    for pair in found.pairs.pairs[:_DRAWN]:
        name = pair.first.name.replace("/", "_")
        drawn, columns = overlay(pair, ("robot", "simulator"))
        made[f"overlay_{name}"] = (drawn, columns, f"{pair.first.name}: the same command")
    for record, added in list(zip(found.records, found.corrections, strict=True))[:_DRAWN]:
        name, unit = record.name.replace("/", "_"), record.voltage_unit
        time, shown = record.time - record.time[0], from_base(added, unit)
        ax = own_axes(None, 1, (5.6, 2.4))[0]
        part = some_periods(shown)
        line(ax, time[part], shown[part], color=DRIVE, lw=0.9)
        finish(np.array([ax]), "time from the start (s)", [f"added input ({shown_unit(unit)})"])
        caption = f"{record.name}: add this to the simulator's input to get the robot's output"
        assert isinstance(ax.figure, Figure)
        made[f"correction_{name}"] = (ax.figure, {"time_s": record.time, f"added_input_{unit}": shown}, caption)
    return made

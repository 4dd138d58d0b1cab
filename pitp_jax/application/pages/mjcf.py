"""Write the page of a verification: errors before and after the change, and every recording with MuJoCo's response."""

from ...common.page import Page, Section, Table
from ...common.picture import Picture
from ...files.mjcf.verify import Played, Verification
from .drawing import DRAWN, ERROR, PREDICTED, beside, some_periods


def table(verified: Verification) -> Table:
    """Return the error of every recording, for the page and the terminal."""
    rows = []
    for p in verified.played:
        before = None if p.before is None else p.gap(after=False)
        rows.append((p.record.name, "no" if p.held_out else "yes", before, p.gap()))
    bold = [p.held_out for p in verified.played]
    note = "Gap: rms of the difference, % of the recording's range. In the order given."
    if any(bold):
        note += " The diagnosis did not use the recordings in bold."
    header = ("recording", "used by the diagnosis", "gap before (%)", "gap after (%)")
    return Table(header, rows, note, bold, (0, 1))


def page(verified: Verification) -> Page:
    """Return the page of a verification, with the first recordings and MuJoCo's responses drawn."""
    headline = {
        True: "The changed file is closer to the robot",
        False: "The changed file is not closer to the robot",
        None: "The gap in MuJoCo",
    }[verified.better]
    kind = f"Joint {verified.joint} of {verified.mjcf}, MuJoCo {verified.version}"
    lines = [text.replace("->", "→") for text in verified.lines()]
    drawn = [_drawn(p) for p in verified.played[:DRAWN]]
    return Page(headline, kind, [lines, table(verified)], [Section("Recordings", [drawn])])


def _drawn(played: Played) -> Picture:
    record = played.record
    runs = [("MuJoCo, before", played.before, ERROR), ("MuJoCo, after", played.after, PREDICTED)]
    shown = [run for run in runs if run[1] is not None]
    measured, part = ("robot", record.displacement), some_periods(record.displacement)
    drawn = beside(record.time, measured, shown, record.displacement_unit, ("position", "error"), part)
    caption = f"{record.name}: robot and MuJoCo under the same command; below: MuJoCo minus robot"
    return Picture(record.name.lstrip("/"), drawn, caption)

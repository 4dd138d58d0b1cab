"""Write the page of a verification: errors before and after the change, and every recording with MuJoCo's response."""

from collections.abc import Sequence

from ...common.numbers import shown_unit
from ...common.page import Page, Section, Table
from ...common.picture import Picture
from ...common.units import from_base
from ...files.mjcf.verify import Played, Verification
from .drawing import ERROR, PREDICTED, beside, some_periods

_DRAWN = 12  # recordings


def figures(verified: Verification) -> list[Picture]:
    """Draw the first recordings with MuJoCo's response and its error, before and after."""
    return [_drawn(p) for p in verified.played[:_DRAWN]]


def table(verified: Verification) -> Table:
    """Return the error of every recording, for the page and the terminal."""
    rows = []
    for p in verified.played:
        before = None if p.before is None else p.gap(after=False)
        rows.append((p.record.name, "no" if p.held_out else "yes", before, p.gap()))
    bold = [p.held_out for p in verified.played]
    note = "Gap: rms of the difference, % of the recording's range. In the order given."
    note += " The diagnosis did not use the recordings in bold." if any(bold) else ""
    header = ("recording", "used by the diagnosis", "gap before (%)", "gap after (%)")
    return Table(header, rows, note, bold, (0, 1))


def page(verified: Verification, drawn: Sequence[Picture]) -> str:
    """Write the verification as an HTML page with the given figures."""
    headline = {
        True: "The changed file is closer to the robot",
        False: "The changed file is not closer to the robot",
        None: "The gap in MuJoCo",
    }[verified.better]
    kind = f"Joint {verified.joint} of {verified.mjcf}, MuJoCo {verified.version}"
    lines = [text.replace("->", "→") for text in verified.lines()]
    return Page(headline, kind, [lines, table(verified)], [Section("Recordings", [drawn])]).html()


def _drawn(played: Played) -> Picture:
    record, unit = played.record, played.record.displacement_unit
    runs = [("MuJoCo, before", played.before, ERROR), ("MuJoCo, after", played.after, PREDICTED)]
    shown = [(label, from_base(values, unit), color) for label, values, color in runs if values is not None]
    labels = (f"position ({shown_unit(unit)})", f"error ({shown_unit(unit)})")
    measured = from_base(record.displacement, unit)
    drawn = beside(record.time, ("robot", measured), shown, labels, some_periods(record.displacement))
    caption = f"{record.name}: robot and MuJoCo under the same command; below: MuJoCo minus robot"
    return Picture(record.name.lstrip("/"), drawn, caption)

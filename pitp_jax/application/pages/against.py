"""Write the page of a robot and its simulator: verdict, parameters, parts of the error, recordings overlaid."""

from dataclasses import replace

from ...common.numbers import shown_unit
from ...common.page import Page, Section
from ...common.picture import Picture
from ...common.units import from_base
from ..against.result import SimToReal
from .compare import overlay
from .diagnosis.page import budget_table
from .drawing import DRAWN, DRIVE, signals, some_periods


def page(result: SimToReal) -> Page:
    """Return the page, with every recording drawn."""
    rest = [Section("Parts of the gap", [budget_table(result.budget)]), Section("Recordings", [figures(result)])]
    return replace(result.summary(), rest=rest)


def figures(result: SimToReal) -> list[Picture]:
    """Draw every recording: robot and simulator, and the input to add."""
    made = [overlay(pair, ("robot", "simulator"), "overlay") for pair in result.pairs.pairs[:DRAWN]]
    for record, added in list(zip(result.records, result.corrections, strict=True))[:DRAWN]:
        unit = record.voltage_unit
        shown = from_base(added, unit)
        panels = [(f"added input ({shown_unit(unit)})", shown, DRIVE)]
        columns = {"time_s": record.time, f"added_input_{unit}": shown}
        caption = f"{record.name}: add this to the simulator's input to get the robot's output"
        name = f"correction_{record.name.replace('/', '_')}"
        made.append(Picture(name, signals(record.time, panels, part=some_periods(shown)), caption, columns))
    return made

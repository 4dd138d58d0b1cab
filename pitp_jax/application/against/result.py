"""Hold the result of a diagnosis of a robot against a simulator."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...common.numbers import number, of_range, shown_unit
from ...common.page import Page, Section, Table
from ...common.shown import data_frame
from ...common.units import from_base
from ...method.diagnose.diagnosis import Diagnosis
from ...method.diagnose.joint import Parameter, as_rows
from ...method.diagnose.words import named
from ...method.identify.identification import Identification
from ...method.model.fitted import Fitted
from ...method.model.model import Model
from ...method.signal.record import Record
from ..compare.pairing import Pairing
from ..compare.remarks import remarks_on

if TYPE_CHECKING:
    import pandas as pd

_SEVERAL = 2.0  # % of the output's deviation on held-out blocks: residual of the simulator's linear model


@dataclass(frozen=True)
class SimToReal:
    """The differences between a robot and its simulator: parameters, missing effects, and how much they explain.

    Attributes:
        robot: diagnosis of the robot's records under the simulator's model.
        simulator: diagnosis of the simulator's own records; None if its model's error is not part of the gap.
        identification: the linear model of the simulator.
        nominal: that model with the simulator's own effects.
        pairs: recordings with the same command, and the offset of their clocks.
        parameters: the simulator's numbers, the robot's, and the difference.
        simulator_share: fraction of the gap's energy caused by the error of the simulator's model, with its 95 %
            interval.
        records: the robot's.
        corrections: added input per recording, base unit.
        offsets: constants that were subtracted from the robot's commands and outputs, base units.
    """

    robot: Diagnosis
    simulator: Diagnosis | None
    identification: Identification
    nominal: Model | Fitted
    pairs: Pairing
    parameters: tuple[Parameter, ...]
    simulator_share: tuple[float, float, float]
    records: tuple[Record, ...]
    corrections: tuple[np.ndarray, ...]
    offsets: tuple[float, float] = (0.0, 0.0)

    @property
    def verdict(self) -> str:
        """Return the verdict on the robot's recordings under the simulator's model."""
        return self.robot.verdict

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the names of the effects that the robot has and the simulator lacks."""
        return self.robot.effects

    @property
    def model(self) -> Model | Fitted:
        """Return the model of the simulator with the effects that the robot has in addition."""
        return self.robot.model

    @property
    def budget(self) -> dict[str, Any]:
        """Return the parts of the error by cause, with the part due to the simulator's linear model."""
        share, low, high = self.simulator_share
        parts = {k: dict(v) for k, v in (getattr(self.robot, "budget", None) or {}).items()}
        rest = share
        for key in (k for k in ("unexplainable", "unnamed") if k in parts):
            taken = min(rest, max(parts[key]["share"], 0.0))
            parts[key]["share"] -= taken
            rest -= taken
        return parts | {"simulator": {"share": share - rest, "ci95": [low, high]}}

    def lines(self) -> list[str]:
        """Write the parameters that differ, and remarks for the user, one sentence each."""
        changes = []
        for p in self.parameters:
            if p.difference and (p.certain or "parameters" in getattr(self.robot, "handed_back", ())):
                error = "" if p.stderr is None else f" +- {number(p.stderr, 2)}"
                error += "" if p.determined else " (these recordings do not determine it)"
                names = ", ".join(n for n in (p.mujoco, p.physx) if n != "-")
                line = f"{p.words}: simulator {number(p.simulator)}, robot {number(p.robot)}{error} {p.unit}"
                changes.append(f"{line} ({names})" if names else line)
        gain, notes = _gain_lines(self.parameters), SimToReal.remarks(self)
        return [*gain, *changes, *notes[len(gain) :]]

    def remarks(self) -> list[str]:
        """Write remarks for the user on the parameters, one sentence each."""
        texts = _gain_lines(self.parameters)
        half, late = 500 * self.records[0].dt, next((p for p in self.parameters if p.name == "delay time"), None)
        if late is not None and late.robot > 0 and self.nominal.hold != "zoh":
            texts.append(
                f"Enter a delay of {1e3 * late.robot:.3g} ms in the simulator if the robot held every command for one "
                f"sample of its log. If it did not, add half a sample ({number(half, 3)} ms)."
            )
        if any(getattr(self, "offsets", ())):
            record, told = self.records[0], []
            for word, value, unit in zip(
                ("commands", "outputs"), self.offsets, (record.voltage_unit, record.displacement_unit), strict=True
            ):
                told += [f"{number(float(from_base(value, unit)), 4)} {unit} from the {word}"] if value else []
            texts.append(f"Subtracted as the offset of the robot's log: {' and '.join(told)}.")
        if self.simulator_share[0] >= 0.05:
            texts.append(
                f"{100 * self.simulator_share[0]:.0f} % of the gap is the error of the linear model of the simulator."
            )
        missed = self.identification.chosen.heldout
        if missed >= _SEVERAL:
            texts.append(
                f"One linear model leaves {missed:.2g} % of the simulator's recordings unexplained. If they were "
                "simulated with several loads or gains, put those of each into a folder of its own."
            )
        return [*texts, *remarks_on(self.pairs, "robot", "simulator")]

    def __repr__(self) -> str:
        """Write verdict and parameters in at most ten lines."""
        text = self.lines()
        more = [f"  and {len(text) - 7} more"] if len(text) > 8 else []
        head = f"SimToReal, {str(self.robot).splitlines()[0]}"
        return "\n".join([head, *(f"  {line}" for line in text[: 8 - len(more)]), *more])

    def __str__(self) -> str:
        """Write verdict, parameters and remarks for the terminal."""
        return "\n".join([*str(self.robot).splitlines(), *self.lines()])

    def _repr_html_(self) -> str:
        """Write the first screen of the page as HTML, for notebooks."""
        return self.summary().first_screen()

    def headline(self) -> str:
        """Write in a sentence in which the robot differs from the simulator."""
        if self.verdict == "no_gap":
            return "The simulator agrees with the robot"
        lacking = [e.replace("_", " ") for e in self.effects if e != "parameter_change"]
        facts = [f"lacks {named(lacking)}"] if lacking else []
        facts += ["has different parameters"] if len(lacking) < len(self.effects) else []
        if facts:
            return f"The simulator {', and '.join(facts)}"
        if self.robot.handed_back:
            before, after = (of_range(e) for e in (self.robot.gap.before, self.robot.gap.after))
            return (
                f"These parameters reduce the difference from {before} to {after} of range; no single cause is certain"
            )
        return "The simulator and the robot differ, and no effect in the catalogue reduces the difference"

    def table(self) -> Table:
        """Return the table of the parameters, for the page and the terminal."""
        rows = [
            (p.words, p.simulator, p.robot, p.difference, p.stderr, shown_unit(p.unit), p.mujoco, p.physx, p.urdf)
            for p in self.parameters
        ]
        note = (
            "Bold rows belong to effects that the diagnosis reports. The damping includes that of the controller, and "
            "the inertia includes the link. Therefore add the difference to the value in the simulator."
        )
        if any("Kp" in p.unit for p in self.parameters):
            note += " Kp is the gain of the position controller; give --position-gain to get torques."
        header = ("quantity", "simulator", "robot", "difference", "+-", "unit", "MuJoCo", "PhysX, Isaac Lab", "URDF")
        bold = [bool(p.difference and p.certain) for p in self.parameters]
        return Table(header, rows, note, bold, (0, 5, 6, 7, 8))

    def summary(self) -> Page:
        """Return the first screen of the page: headline, diagnosis, parameters."""
        parameters = Section("Parameters to type into the simulator", [self.table()])
        first = [*str(self.robot).splitlines(), self.remarks(), parameters]
        return Page(self.headline(), "Robot beside simulator", first, css="good" if self.effects else "open")

    def frame(self) -> "pd.DataFrame":
        """Return a table with one row per parameter: simulator, robot, difference, and names in other programs."""
        return data_frame(as_rows(self.parameters))

    def as_json(self, csv: str | None = None) -> dict[str, Any]:
        """Return the diagnosis as a dict for JSON, with the simulator's part and the parameters."""
        pairs = [
            {
                "robot": p.first.name,
                "simulated": p.second.name,
                "clock_offset_s": p.offset,
                "correlation": p.correlation,
            }
            for p in self.pairs.pairs
        ]
        unmatched = {"robot": dict(self.pairs.first_alone), "simulated": dict(self.pairs.second_alone)}
        more = {"budget": self.budget, "simulator": None if self.simulator is None else self.simulator.as_json(),
                "parameters": as_rows(self.parameters), "pairs": pairs, "unmatched": unmatched}  # fmt: skip
        return self.robot.as_json(csv) | more


def _gain_lines(parameters: tuple[Parameter, ...]) -> list[str]:
    """Write that another position gain explains all changed coefficients, or nothing if none does."""
    gain = next((p for p in parameters if p.name == "position gain"), None)
    if gain is None:
        return []
    factor = gain.robot / gain.simulator
    names = [p.name for p in parameters if p.name in ("damping", "inertia")]
    twin = " and ".join(f"{name} x {number(1 / factor, 3)}" for name in names)
    return [f"position gain x {number(factor, 3)} (or {twin}): these recordings do not separate the two"]

"""Hold the result of a diagnosis of a robot against a simulator."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...common.numbers import number, of_range, shown_unit
from ...common.page import Page, Section, Table
from ...common.shown import data_frame
from ...method.diagnose.diagnosis import Diagnosis
from ...method.diagnose.joint import Parameter, as_rows
from ...method.diagnose.words import named
from ...method.model.fitted import Fitted
from ...method.model.model import Model
from ...method.signal.record import Record
from ..compare.pairing import Pairing
from ..compare.remarks import remarks_on

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class SimToReal:
    """The differences between a robot and its simulator: parameters, missing effects, and how much they explain.

    Attributes:
        robot: diagnosis of the robot's records under the simulator's model.
        simulator: diagnosis of the simulator's own records; None if its model's error is not part of the gap.
        nominal: the linear model of the simulator with its own effects.
        own: error of that model on the simulator's records, % of range; 0 where the robot's sensor would hide it.
        pairs: recordings with the same command, and the offset of their clocks.
        parameters: the simulator's numbers, the robot's, and the difference.
        records: the robot's, less the offsets of the pairs.
        corrections: per recording what must be added to its input (V or the input's base unit, shape (samples,)) so
            that the simulator's own model gives the robot's output.
    """

    robot: Diagnosis
    simulator: Diagnosis | None
    nominal: Model | Fitted
    own: float
    pairs: Pairing
    parameters: tuple[Parameter, ...]
    records: tuple[Record, ...]
    corrections: tuple[np.ndarray, ...]

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
        share = self._share
        parts = {k: dict(v) for k, v in self.robot.budget.items()}
        rest = share
        for key in ("unexplainable", "unnamed"):
            taken = min(rest, max(parts[key]["share"], 0.0))
            parts[key]["share"] -= taken
            rest -= taken
        return parts | {"simulator": {"share": share - rest, "ci95": [0.5 * share, min(2 * share, 1.0)]}}

    @property
    def _share(self) -> float:
        return min((self.own / max(self.robot.gap.before, 1e-12)) ** 2, 1.0)

    def lines(self) -> list[str]:
        """Write the parameters that differ, and remarks for the user, one sentence each."""
        changes = []
        for p in self.parameters:
            if differs(p) and (p.certain or "parameters" in self.robot.handed_back):
                error = "" if p.stderr is None else f" +- {number(p.stderr, 2)}"
                if not p.determined:
                    error += " (these recordings do not determine it)"
                names = ", ".join(n for n in (p.mujoco, p.physx) if n != "-")
                line = f"{p.words}: simulator {number(p.simulator)}, robot {number(p.robot)}{error} {p.unit}"
                changes.append(f"{line} ({names})" if names else line)
        return [*changes, *SimToReal.remarks(self)]

    def remarks(self) -> list[str]:
        """Write remarks for the user on the parameters, one sentence each."""
        factors = [p.robot / p.simulator for p in self.parameters if p.name == "position gain"]
        texts = [
            f"position gain x {number(k, 3)} (or all other torques x {number(1 / k, 3)}): these recordings do not "
            "separate the two"
            for k in factors
        ]
        half, late = 500 * self.records[0].dt, next((p for p in self.parameters if p.name == "delay time"), None)
        if late is not None and late.robot > 0 and self.nominal.hold != "zoh":
            texts.append(
                f"Enter a delay of {1e3 * late.robot:.3g} ms in the simulator if the robot held every command for one "
                f"sample of its log. If it did not, add half a sample ({number(half, 3)} ms)."
            )
        # a model that misses more may have to imitate more than one simulator
        if self.own >= 1.0 or self._share >= 0.05:
            texts.append(
                f"The model of the simulator misses {self.own:.2g} % of range of the simulator's recordings, which is "
                f"{100 * self._share:.0f} % of the gap. If they were simulated with several loads or gains, put those "
                "of each into a folder of its own."
            )
        return [*texts, *remarks_on(self.pairs, "robot", "simulator")]

    def __repr__(self) -> str:
        """Write verdict and parameters in at most ten lines."""
        lines = self.lines()
        if len(lines) > 8:
            lines = [*lines[:7], f"and {len(lines) - 7} more"]
        return "\n  ".join([f"SimToReal, {str(self.robot).splitlines()[0]}", *lines])

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
        facts = []
        if lacking:
            facts.append(f"lacks {named(lacking)}")
        if len(lacking) < len(self.effects):
            facts.append("has different parameters")
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
        bold = [p.certain and differs(p) for p in self.parameters]
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
        pairs = [p.as_json("robot", "simulated") for p in self.pairs.pairs]
        unmatched = {"robot": dict(self.pairs.first_alone), "simulated": dict(self.pairs.second_alone)}
        more = {"budget": self.budget, "simulator": None if self.simulator is None else self.simulator.as_json(),
                "parameters": as_rows(self.parameters), "pairs": pairs, "unmatched": unmatched}  # fmt: skip
        return self.robot.as_json(csv) | more


def differs(p: Parameter) -> bool:
    """Return whether a parameter differs between simulator and robot by more than two standard errors."""
    return bool(abs(p.difference) > 2 * (p.stderr or 0.0))

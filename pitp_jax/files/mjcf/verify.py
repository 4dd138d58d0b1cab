"""Simulate recorded commands in MuJoCo before and after a change, and compare the errors to the robot.

gap = rms(q_robot - q_mujoco) / (max q_robot - min q_robot),   pooled over recordings
better where the mean over blocks of e_before^2 - e_after^2 is above twice its standard error
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...common.errors import BadInput
from ...common.metrics import e_rms_percent, rms
from ...common.numbers import number
from ...method.model.lineage import sums
from ...method.signal.record import Record
from ...method.signal.sets import check_records
from .joint import mujoco_package
from .play import play


@dataclass(frozen=True)
class Played:
    """One recording of the robot, with MuJoCo's responses to its command before and after the change.

    Attributes:
        record: of the robot.
        held_out: whether the diagnosis did not use it.
        before, after: joint position in MuJoCo at its samples, base unit; `before` None without such a file.
    """

    record: Record
    held_out: bool
    before: np.ndarray | None
    after: np.ndarray

    def gap(self, after: bool = True) -> float:
        """Return the rms difference between robot and MuJoCo, % of the recording's range; infinite if it diverged."""
        return _gap([self], after)


@dataclass(frozen=True)
class Verification:
    """The errors of a MuJoCo model against the robot's recordings, before and after a change of the file.

    Attributes:
        mjcf, joint, version: file, joint, and MuJoCo's version.
        played: every recording, with the joint position that MuJoCo simulated before and after.
    """

    mjcf: str
    joint: str
    version: str
    played: tuple[Played, ...]

    def gap(self, held_out: bool, after: bool = True) -> float | None:
        """Return the rms error pooled over recordings, % of their ranges; None without such recordings or file.

        `held_out`: of recordings that the diagnosis did not use, otherwise of those that it used. `after`: of the new
        file, otherwise of the file before the change.
        """
        these = [p for p in self.played if p.held_out == held_out]
        if not these or (not after and these[0].before is None):
            return None
        return _gap(these, after)

    @property
    def better(self) -> bool | None:
        """Return whether the new file has a significantly smaller error, on held-out recordings if there are any.

        None without a file to compare with.
        """
        runs = [p for p in self.played if p.held_out] or list(self.played)
        # gains of blocks, relative to the range: their spread gives the standard error of the mean
        gains = []
        for p in runs:
            if p.before is None:
                return None
            scale = p.record.span
            gain = (p.before - p.record.displacement) ** 2 - (p.after - p.record.displacement) ** 2
            gains += [
                float(np.nanmean(block)) / scale**2 for block in np.array_split(gain, 8) if np.isfinite(block).any()
            ]
        # a simulation that diverged from the start has no gain to compare
        if not all(np.isfinite(p.after).any() for p in runs):
            return False
        return bool(np.mean(gains) > 2 * np.std(gains, ddof=1) / np.sqrt(len(gains)))

    def lines(self) -> list[str]:
        """Write the verification as sentences for the terminal."""
        said = []
        for held_out, words in ((False, "recordings of the diagnosis"), (True, "other recordings")):
            after, before = self.gap(held_out), self.gap(held_out, after=False)
            if after is not None:
                from_ = "" if before is None else f"{number(before, 3)} -> "
                said.append(f"gap in MuJoCo on {words}: {from_}{number(after, 3)} % of range")
        if self.better is False:
            said.append("the new file is not significantly better than the old one")
        return said

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def as_json(self) -> dict[str, Any]:
        """Return the errors (% of range) as a dict for JSON."""

        def part(held_out: bool) -> dict | None:
            after = self.gap(held_out)
            return None if after is None else {"before": self.gap(held_out, after=False), "after": after}

        rows = [{"record": p.record.name, "held_out": p.held_out, "after": p.gap(),
                 "before": None if p.before is None else p.gap(after=False)} for p in self.played]  # fmt: skip
        return {"mjcf": self.mjcf, "joint": self.joint, "mujoco": self.version, "used": part(False),
                "held_out": part(True), "better": self.better, "records": rows}  # fmt: skip


def _gap(played: Sequence[Played], after: bool) -> float:
    runs = [(p.after if after else p.before, p.record.displacement) for p in played]
    errors = [np.inf if run is None else e_rms_percent(run, y) for run, y in runs]
    return rms(errors)


def verify_mjcf(
    records: Sequence[Record], mjcf: str | Path, joint: str, *, before: str | Path | None = None,
    held_out: Sequence[Record] = (), actuator: str | None = None,
) -> Verification:  # fmt: skip
    """Simulate recorded commands in MuJoCo and compare with the robot, before and after a change of the file.

    Args:
        records: of the robot, angles in rad or positions in m, commands in the unit of ctrl.
        mjcf: the changed file.
        joint: whose motion was recorded.
        before: the file as it was; None: only the changed file is simulated.
        held_out: recordings that the diagnosis did not use.
        actuator: that was given the recorded command; None: the only one of the joint.

    Returns:
        per recording the rms of simulated minus recorded motion, % of the recorded range, before and after.

    Raises:
        BadInput: MuJoCo is not installed or refuses a file; no such joint; a held-out recording that the changed file
            lists as used by the diagnosis.

    Examples:
        >>> found = pitp.verify_mjcf(robot, "gap/arm_identified.xml", "elbow", before="arm.xml")  # doctest: +SKIP
        >>> found.gap(held_out=False), found.better  # doctest: +SKIP
        (2.88, True)
    """
    check_records([*records, *held_out])
    # `write_numbers` lists the recordings of the diagnosis at the top of the file
    text = Path(mjcf).read_text(encoding="utf-8", errors="replace") if Path(mjcf).is_file() else ""
    for record, one in zip(held_out, sums(held_out), strict=True):
        if one["sha256"] in text:
            raise BadInput(
                f"{record.source}: the diagnosis used this recording ({mjcf} lists it); give other recordings as held "
                "out"
            )
    every = [*records, *held_out]
    after = play(mjcf, joint, every, actuator)
    first = [None] * len(every) if before is None else play(before, joint, every, actuator)
    played = [Played(r, k >= len(records), b, a) for k, (r, b, a) in enumerate(zip(every, first, after, strict=True))]
    return Verification(str(mjcf), joint, mujoco_package().__version__, tuple(played))

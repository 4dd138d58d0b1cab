"""Write identified parameters into a copy of the user's MuJoCo file; only attributes change.

out/arm_identified.xml    and beside it the files that it includes and loads, so that it can be played in place
"""

import hashlib
import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ...common.errors import BadInput, cleaned
from ...common.numbers import number
from ...common.units import base_unit
from ...method.diagnose.joint import Parameter
from ...method.model.lineage import sums
from ...method.signal.record import Record
from ..recordings.writing import write_bytes_atomic, write_text_atomic
from . import elsewhere
from .change import Change, NotWritten
from .changes import changes_of, tag_of
from .document import Document, Edit, assets, edited, read_document
from .joint import Joint, joint_of, load_model, mujoco_package

_SUFFIX = "_identified"


@dataclass(frozen=True)
class Written:
    """The changes written into a MuJoCo file, the parameters that it cannot hold, and remarks.

    Attributes:
        file: the new file.
        joint, actuator: their names.
        changes: attributes with old and new value.
        left: parameters that no attribute holds, with the nearest alternative.
        remarks: remarks for the user.
    """

    file: Path
    joint: str
    actuator: str
    changes: tuple[Change, ...]
    left: tuple[NotWritten, ...]
    remarks: tuple[str, ...]

    def lines(self) -> list[str]:
        """Write the changes and remarks as sentences for the terminal."""
        said = [f"{c.element} {self.joint if c.element != 'actuator' else self.actuator or 'on it'}: {c.text}"
                for c in self.changes if c.text]  # fmt: skip
        not_written = [f"no attribute for {n.words}, {n.value}; nearest substitute: {n.way}" for n in self.left]
        return [*said, *not_written, *self.remarks]

    def as_json(self) -> dict[str, Any]:
        """Return file, changes and remarks as a dict for JSON."""
        return {
            "file": str(self.file), "joint": self.joint, "actuator": self.actuator,
            "changes": [vars(c) for c in self.changes], "not_written": [vars(n) for n in self.left],
            "remarks": list(self.remarks),
        }  # fmt: skip


def write_numbers(
    table: Sequence[Parameter], records: Sequence[Record], simulator: np.ndarray, mjcf: str | Path, joint: str,
    out: str | Path, actuator: str | None = None,
) -> Written:  # fmt: skip
    """Write a table of parameters into a copy of a MuJoCo file.

    Text files beside it hold the same parameters for Isaac Lab, Newton and URDF.

    Args:
        table: parameters of the simulator and the robot, in the command's unit.
        records: of the robot.
        simulator: its coefficients a_i, shape (order + 1,).
        mjcf, joint, out, actuator: file, joint, folder or new file, and actuator, if several act on the joint.
    """
    document = read_document(mjcf)
    it = joint_of(document, joint, actuator)
    changes, not_written, element = changes_of(it, table)
    changes, unknown = _known_to_mujoco(it, changes)
    remarks = _remarks(records, simulator, it)
    edits = []
    # one edit for each tag, because two edits of one tag would overlap
    for of, inserted in (("joint", element), ("actuator", "")):
        group = [c for c in changes if c.element == of or (inserted and c.element == "body")]
        if group:
            attributes = {c.attribute: c.new for c in group if c.element == of}
            edits.append(Edit(tag_of(it, group[0]), attributes, [c.text for c in group if c.text], inserted))
    texts = edited(document, edits, _heading(records, document))
    target = _write_all(document, texts, Path(out))
    # as MuJoCo reads the new file, with all defaults
    after = joint_of(read_document(target), joint, actuator)
    for name, text in elsewhere.texts(after).items():
        write_text_atomic(target.parent / name, text)
    return Written(target, joint, it.actuator, tuple(changes), (*not_written, *unknown), tuple(remarks))


def _heading(records: Sequence[Record], document: Document) -> str:
    """Write the comment at the top of the new file: its original and the recordings, with checksums."""
    period = sorted({number(1e3 * r.dt) for r in records})
    original = hashlib.sha256(document.texts[document.main]).hexdigest()
    lines = [
        f"pitp: numbers identified on recordings; the original is {document.main.name}, SHA-256 {original}",
        f"the command is held for {' or '.join(period)} ms",
        *(f"recording {one['name']} SHA-256 {one['sha256']}" for one in sums(records)),
    ]
    return "\n     ".join(lines)


def _remarks(records: Sequence[Record], simulator: np.ndarray, it: Joint) -> list[str]:
    """Write remarks if the recordings disagree with the file in inertia or unit."""
    said = []
    seen = it.torque_per_command * simulator[2] if len(simulator) > 2 else math.nan
    if abs(seen - it.inertia) > 0.1 * it.inertia:
        said.append(
            f"the simulator's recordings have an inertia of {number(seen)}, the file {number(it.inertia)}. Check that "
            "they were made with this file and this joint"
        )
    unit, ours = base_unit(records[0].displacement_unit), "rad" if it.hinge else "m"
    if unit != ours:
        said.append(f"the recordings are in {unit}, MuJoCo uses {ours}; give --output-unit")
    return said


def _known_to_mujoco(it: Joint, changes: list[Change]) -> tuple[list[Change], list[NotWritten]]:
    """Separate the changes into those that the installed MuJoCo supports and the others."""
    mujoco = mujoco_package()
    known, unknown = [], []
    for change in changes:
        tag = tag_of(it, change)
        if change.element == "body" or _attribute_exists(mujoco, tag.name, change.attribute):
            known.append(change)
        elif change.text:
            unknown.append(
                NotWritten(change.text, change.new, f"MuJoCo {mujoco.__version__} has no {tag.name} {change.attribute}")
            )
    return known, unknown


def _attribute_exists(mujoco: Any, element: str, attribute: str) -> bool:
    """Return whether the installed MuJoCo knows an attribute, tested by compiling a small model."""
    inside, driven = "", f'<actuator><{element} joint="q" {attribute}="x"/></actuator>'
    if element == "joint":
        inside, driven = f'<joint name="r" {attribute}="x"/>', ""
    text = f'<mujoco><worldbody><body><joint name="q"/>{inside}<geom size="1"/></body></worldbody>{driven}</mujoco>'
    try:
        mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        return "unrecognized attribute" not in str(error)
    return True


def _write_all(document: Document, texts: dict[Path, bytes], out: Path) -> Path:
    """Write the new file with its includes and assets, after MuJoCo has compiled them in a temporary folder.

    Raises:
        BadInput: MuJoCo rejects the new file.
    """
    main = document.main
    target = out if out.suffix == ".xml" else out / identified_name(main)
    folder = main.parent
    with TemporaryDirectory() as kept:
        for place in assets(document):
            (Path(kept) / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / place, Path(kept) / place)
        for file, text in texts.items():
            name = Path(target.name) if file == main else _within(file, folder)
            (Path(kept) / name).parent.mkdir(parents=True, exist_ok=True)
            (Path(kept) / name).write_bytes(text)
        # MuJoCo compiles the copy before anything is written beside the user's files
        load_model(Path(kept) / target.name)
        for source in sorted(p for p in Path(kept).rglob("*") if p.is_file()):
            place = target.parent / source.relative_to(kept)
            if place.resolve() in {file.resolve() for file in texts}:
                raise BadInput(f"{cleaned(place)}: is a file of the original model; choose another folder")
            place.parent.mkdir(parents=True, exist_ok=True)
            write_bytes_atomic(place, source.read_bytes())
    return target


def identified_name(mjcf: str | Path) -> str:
    """Return the name of the copy that is written: `arm.xml` and `arm_identified.xml` become `arm_identified.xml`."""
    return f"{Path(mjcf).stem.removesuffix(_SUFFIX)}{_SUFFIX}.xml"


def _within(file: Path, folder: Path) -> Path:
    try:
        return file.relative_to(folder)
    except ValueError:
        raise BadInput(
            f"{cleaned(file)}: the included file lies outside {cleaned(folder)}; put it into that folder"
        ) from None

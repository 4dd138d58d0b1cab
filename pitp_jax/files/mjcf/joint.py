"""Read a joint and its actuator as MuJoCo compiles them, after defaults, classes and units.

    position servo   torque = g (kp (c - g q) - kv g q'),   a command of 1 is a torque of F = kp g
    motor            torque = g c,                                             F = g

g is the gear. J = M(qpos0) holds the links and the armature.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...common.errors import BadInput, cleaned
from .document import Document, Tag


def mujoco_package() -> Any:
    """Import the `mujoco` package.

    Raises:
        BadInput: it is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise BadInput("writing and playing a MuJoCo file needs MuJoCo: pip install mujoco") from None
    return mujoco


@dataclass(frozen=True)
class Joint:
    """The parameters of one joint and of the actuator that drives it.

    Attributes:
        name, actuator: their names; the actuator's may be empty.
        numbers: of the joint and of the actuator in the compiled model.
        joint_tag, actuator_tag: their places in the text.
        hinge: whether it rotates (angles in rad); otherwise it slides (m).
        position: whether the actuator is a position servo; otherwise a motor.
        kp, kv, gear: of the actuator.
        inertia: about the joint at the model's reference pose, kg m^2 or kg.
        stiffness, damping, armature, frictionloss: of the joint, SI.
        limits: range, SI; None without.
        effort: largest torque or force about the joint; None without a symmetric limit.
        delay, lag: of the actuator, s.
        timestep: of the simulation, s.
        degrees: whether the file gives angles in degrees.
        autolimits: whether a range alone sets a limit.
        anchor: of the joint in its body's frame, m.
        gravity: component that acts on a rotating arm, in the body's frame at q = 0, m/s^2; zero for a slide.
    """

    name: str
    actuator: str
    numbers: tuple[int, int]
    joint_tag: Tag
    actuator_tag: Tag
    hinge: bool
    position: bool
    kp: float
    kv: float
    gear: float
    inertia: float
    stiffness: float
    damping: float
    armature: float
    frictionloss: float
    limits: tuple[float, float] | None
    effort: float | None
    delay: float
    lag: float
    timestep: float
    degrees: bool
    autolimits: bool
    anchor: tuple[float, ...] = (0.0, 0.0, 0.0)
    gravity: tuple[float, ...] = (0.0, 0.0, 0.0)

    @property
    def torque_per_command(self) -> float:
        """Return the torque (N m) or force (N) for a command of 1."""
        return self.kp * self.gear if self.position else self.gear


def load_model(path: str | Path) -> Any:
    """Compile a MuJoCo file to a model.

    Raises:
        BadInput: MuJoCo refuses it.
    """
    try:
        return mujoco_package().MjModel.from_xml_path(str(path))
    except (ValueError, OSError) as error:
        raise BadInput(
            f"{cleaned(path)}: MuJoCo rejects it: {' '.join(str(error).split())}; correct the file"
        ) from None


def joint_of(document: Document, joint: str, actuator: str | None = None) -> Joint:
    """Read the parameters of a joint and its actuator from a MuJoCo file.

    Args:
        document: of the file.
        joint: its name.
        actuator: the commanded one of several on the joint.

    Raises:
        BadInput: no such joint or actuator, a ball or free joint, no or several actuators on it, or one of another
            kind.
    """
    mujoco, file = mujoco_package(), cleaned(document.main)
    model = load_model(document.main)
    kinds = mujoco.mjtJoint
    movable = {model.joint(k).name: k for k in range(model.njnt)
               if int(model.jnt_type[k]) in (int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE))}  # fmt: skip
    if joint not in movable:
        raise BadInput(f"{file}: has no hinge or slide joint {joint!r}; it has {_listed(movable)}")
    number = movable[joint]
    driven = _driving(mujoco, model, number)
    which = _one_actuator(file, joint, [model.actuator(k).name for k in driven], actuator)
    a, dof = driven[which], int(model.jnt_dofadr[number])
    position = _is_servo(mujoco, model, a, file)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    # a column of the mass matrix: the inertia that the joint moves, with its armature
    unit, column = np.zeros(model.nv), np.zeros(model.nv)
    unit[dof] = 1.0
    mujoco.mj_mulM(model, data, column, unit)
    limited = bool(model.jnt_limited[number])
    hinge = bool(model.jnt_type[number] == kinds.mjJNT_HINGE)
    _refuse_tendons(mujoco, model, data, number, file)
    return Joint(
        name=joint, actuator=model.actuator(a).name, numbers=(number, a),
        joint_tag=_joint_tag(document, joint),
        actuator_tag=_actuator_tag(document, joint, model.actuator(a).name, which),
        hinge=hinge, position=position,
        kp=float(model.actuator_gainprm[a][0]), kv=-float(model.actuator_biasprm[a][2]),
        gear=float(model.actuator_gear[a][0]), inertia=float(column[dof]),
        stiffness=float(np.ravel(model.jnt_stiffness[number])[0]), damping=float(np.ravel(model.dof_damping[dof])[0]),
        armature=float(model.dof_armature[dof]), frictionloss=float(model.dof_frictionloss[dof]),
        limits=tuple(model.jnt_range[number].tolist()) if limited else None,
        effort=_effort(model, a),
        delay=float(model.actuator_delay[a]) if hasattr(model, "actuator_delay") else 0.0,
        lag=float(model.actuator_dynprm[a][0]) if int(model.actuator_dyntype[a]) in _filters(mujoco) else 0.0,
        timestep=float(model.opt.timestep), degrees=_compiler(document, "angle", "degree") != "radian",
        autolimits=_compiler(document, "autolimits", "true") != "false",
        anchor=tuple(map(float, model.jnt_pos[number])),
        gravity=_gravity(mujoco, model, number) if hinge else (0.0, 0.0, 0.0),
    )  # fmt: skip


def _gravity(mujoco: Any, model: Any, joint: int) -> tuple[float, ...]:
    """Return the component of gravity normal to the joint's axis, m/s^2, in the body's frame at joint position 0."""
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[joint]] = 0.0
    mujoco.mj_forward(model, data)
    # gravity along the axis does not turn the joint
    g, axis = np.array(model.opt.gravity), np.array(data.xaxis[joint])
    frame = np.array(data.xmat[model.jnt_bodyid[joint]]).reshape(3, 3)
    return tuple(map(float, frame.T @ (g - axis * (g @ axis))))


def _refuse_tendons(mujoco: Any, model: Any, data: Any, joint: int, file: str) -> None:
    """Refuse a joint that moves a tendon, whose force would be mistaken for the joint's."""
    if not model.ntendon:
        return
    before = np.array(data.ten_length)
    # rad or m: a tendon that follows changes its length
    data.qpos[model.jnt_qposadr[joint]] += 1e-3
    mujoco.mj_forward(model, data)
    moved = [model.tendon(k).name for k in np.flatnonzero(np.abs(data.ten_length - before) > 1e-9)]
    if moved:
        other = [model.joint(k).name for k in range(model.njnt) if _driving(mujoco, model, k) and k != joint]
        raise BadInput(
            f"{file}: joint {model.joint(joint).name!r} moves tendon {_listed(moved)}, whose force is not the joint's; "
            f"joints with an actuator: {_listed(other)}"
        )


def _effort(model: Any, a: int) -> float | None:
    low, high = model.actuator_forcerange[a].tolist()
    # one number describes only a symmetric limit
    limited = bool(model.actuator_forcelimited[a]) and low == -high
    return high * abs(float(model.actuator_gear[a][0])) if limited else None


def _driving(mujoco: Any, model: Any, joint: int) -> list[int]:
    """Return the indices of the actuators that act directly on a joint."""
    of_joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    return [
        k for k in range(model.nu) if int(model.actuator_trntype[k]) in of_joint and model.actuator_trnid[k][0] == joint
    ]


def _one_actuator(file: str, joint: str, names: Sequence[str], wanted: str | None) -> int:
    """Return the index of the actuator that the user names, or of the only one on the joint."""
    if wanted is not None:
        if wanted not in names:
            raise BadInput(f"{file}: no actuator {wanted!r} drives joint {joint!r}; it has {_listed(names)}")
        return list(names).index(wanted)
    if not names:
        raise BadInput(f"{file}: no actuator drives joint {joint!r} itself (a tendon or another joint may)")
    if len(names) > 1:
        raise BadInput(
            f"{file}: {len(names)} actuators drive joint {joint!r}: {_listed(names)}; choose with --actuator"
        )
    return 0


def _listed(names: Any) -> str:
    return ", ".join(cleaned(name) or "one without a name" for name in names) or "none"


def _is_servo(mujoco: Any, model: Any, a: int, file: str) -> bool:
    gain, bias, kind = model.actuator_gainprm[a], model.actuator_biasprm[a], int(model.actuator_biastype[a])
    plain = int(model.actuator_dyntype[a]) in (int(mujoco.mjtDyn.mjDYN_NONE), *_filters(mujoco))
    if int(model.actuator_gaintype[a]) == int(mujoco.mjtGain.mjGAIN_FIXED) and plain:
        if kind == int(mujoco.mjtBias.mjBIAS_NONE):
            return False
        # kp (c - q) - kv q' is a gain of kp and a bias of -kp q - kv q'
        if kind == int(mujoco.mjtBias.mjBIAS_AFFINE) and gain[0] > 0 and bias[1] == -gain[0]:
            return True
    raise BadInput(
        f"{file}: actuator {model.actuator(a).name!r} is not a position servo or a motor, so its parameters cannot be "
        "separated"
    )


def _filters(mujoco: Any) -> tuple[int, int]:
    return int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT)


def _joint_tag(document: Document, joint: str) -> Tag:
    tags = [
        tag for tag in document.tags
        if tag.name == "joint" and "worldbody" in tag.path and tag.attributes.get("name") == joint
    ]  # fmt: skip
    return _first(tags, document, f"joint {joint!r} is not written in any file (it is attached or replicated)")


def _actuator_tag(document: Document, joint: str, name: str, which: int) -> Tag:
    of_joint = [
        tag for tag in document.tags if tag.path[-1:] == ("actuator",)
        and joint in (tag.attributes.get("joint"), tag.attributes.get("jointinparent"))
    ]  # fmt: skip
    named = [tag for tag in of_joint if name and tag.attributes.get("name") == name]
    return _first(named or of_joint[which:], document, f"the actuator of joint {joint!r} is not written in any file")


def _first(tags: Sequence[Tag], document: Document, why: str) -> Tag:
    if not tags:
        raise BadInput(f"{cleaned(document.main)}: {why}; give the file that MuJoCo saves with mj_saveLastXML")
    return tags[0]


def _compiler(document: Document, attribute: str, default: str) -> str:
    said = [t.attributes.get(attribute) for t in document.tags if t.name == "compiler"]
    return next(filter(None, reversed(said)), default)

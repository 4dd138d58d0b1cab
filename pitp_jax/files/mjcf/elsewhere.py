"""Write a joint's parameters for Isaac Lab, Newton and URDF, as text to paste; not tested in these programs.

Names: `ActuatorBaseCfg` and `DelayedPDActuatorCfg` of Isaac Lab 3 (isaaclab/actuators/actuator_base_cfg.py and
actuator_pd_cfg.py); `ModelBuilder.JointDofConfig` of Newton 1 (newton/_src/sim/builder.py); URDF's <joint><dynamics>.
"""

import json

from ...common.numbers import number
from .joint import Joint


def texts(joint: Joint) -> dict[str, str]:
    """Return the text of a file for each program, by file name.

    Args:
        joint: with the robot's parameters, as MuJoCo compiles them.
    """
    return {
        "isaac_actuator_cfg.py": _isaac(joint), "newton_actuator.json": _newton(joint),
        "urdf_dynamics.xml": _urdf(joint),
    }  # fmt: skip


def _gains(joint: Joint) -> tuple[float, float]:
    """Return position and velocity gain about the joint, kp g^2 and kv g^2 (g: gear); zero for a motor."""
    return (joint.kp * joint.gear**2, joint.kv * joint.gear**2) if joint.position else (0.0, 0.0)


def _isaac(joint: Joint) -> str:
    """Write a joint for Isaac Lab; a delay is rounded to whole physics steps, and an actuator's lag is left out."""
    stiffness, damping = _gains(joint)
    numbers = {
        "stiffness": stiffness, "damping": damping, "armature": joint.armature, "friction": joint.frictionloss,
        "dynamic_friction": joint.frictionloss, "viscous_friction": joint.damping,
    }  # fmt: skip
    lines = [f"    {name}={number(value, 6)}," for name, value in numbers.items()]
    kind = "ImplicitActuatorCfg"
    if joint.delay:
        steps = round(joint.delay / joint.timestep)
        kind = "DelayedPDActuatorCfg"
        lines += [f"    min_delay={steps}, max_delay={steps},  # physics steps of {number(joint.timestep)} s"]
    if joint.effort is not None:
        lines += [f"    {'actuator' if joint.delay else 'joint'}_effort_limit={number(joint.effort, 6)},"]
    return "\n".join([
        f"from isaaclab.actuators import {kind}", "", "# identified on recordings; not run in Isaac Lab",
        f"{_identifier(joint.name)} = {kind}(", f"    joint_names_expr=[{joint.name!r}],", *lines, ")", "",
    ])  # fmt: skip


def _identifier(name: str) -> str:
    # names of joints may hold slashes, and start with a digit
    made = "".join(c if c.isalnum() else "_" for c in name)
    return made if made.isidentifier() else f"joint_{made}"


def _newton(joint: Joint) -> str:
    """Write the arguments of a joint's axis for Newton, as JSON."""
    stiffness, damping = _gains(joint)
    axis = {
        "joint": joint.name, "target_ke": stiffness, "target_kd": damping, "armature": joint.armature,
        "friction": joint.frictionloss, "damping": joint.damping,
    }  # fmt: skip
    if joint.limits is not None:
        axis |= {"limit_lower": joint.limits[0], "limit_upper": joint.limits[1]}
    if joint.effort is not None:
        axis |= {"effort_limit": joint.effort}
    return json.dumps(axis | {"delay_s": joint.delay, "note": "identified on recordings; not run in Newton"}, indent=2)


def _urdf(joint: Joint) -> str:
    """Write a joint's dynamics for URDF, which has no armature, delay or stiffness."""
    return (
        f"<!-- joint {joint.name.replace('--', '- -')}: identified on recordings -->\n"
        f'<dynamics damping="{number(joint.damping, 6)}" friction="{number(joint.frictionloss, 6)}"/>\n'
    )

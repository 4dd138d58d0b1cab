"""Write what a robot has in addition to its simulator into the simulator's MuJoCo file."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ...files.mjcf.write import Written, write_numbers
from ...method.diagnose.joint import Answer, Parameter, parameters
from .result import SimToReal


def write_mjcf(
    found: SimToReal, mjcf: str | Path, joint: str, out: str | Path, *, actuator: str | None = None
) -> Written:
    """Write the identified parameters of the robot into a copy of the simulator's MuJoCo file.

    Text files beside it hold the same parameters for Isaac Lab, Newton and URDF. The changed attributes are joint
    `armature`, `damping`, `stiffness`, `frictionloss`, `range`; actuator `kp` or `gear`, `ctrlrange`, `forcerange`, and
    `delay` with `nsample` and `timeconst` if the installed MuJoCo knows them. Each change has a comment with the old
    value, the new one and its 95 % interval.

    Args:
        found: `diagnose(robot, against=simulated)`, the simulated recordings made with this file.
        mjcf: the file.
        joint: whose motion was recorded.
        out: folder for `NAME_identified.xml`, its includes and meshes; or the file itself to write.
        actuator: the commanded one, if several act on the joint.

    Returns:
        the changes, and the parameters that could not be written.

    Raises:
        BadInput: MuJoCo is not installed or refuses a file; no such joint or actuator, or several.

    Examples:
        >>> found = pitp.diagnose(robot, against=simulated)  # doctest: +SKIP
        >>> pitp.write_mjcf(found, "arm.xml", "elbow", "gap").changes  # doctest: +SKIP
    """
    rows = with_shared_weight(parameters(found.nominal, found.robot, found.records, None), found.robot)
    return write_numbers(rows, found.records, found.nominal.physical_coefficients, mjcf, joint, out, actuator)


def with_shared_weight(rows: Sequence[Parameter], robot: Answer) -> tuple[Parameter, ...]:
    """Return the parameters with the simulator's weight in the robot, beside another position gain.

    The recordings determine the sum of weight and spring. A weight that the diagnosis did not change is the
    simulator's, and the rest is the spring. Both are still in multiples of the simulator's gain.
    """
    found = {p.name: p for p in rows}
    gain, weight, spring = (found.get(name) for name in ("position gain", "softening weight", "stiffness"))
    if gain and weight and spring and all(a.effect != "softening" for a in robot.added):
        kept = weight.simulator * gain.simulator / gain.robot
        rest = spring.robot + weight.robot - kept
        found[weight.name] = replace(weight, robot=kept, difference=0.0)
        found[spring.name] = replace(spring, robot=rest, difference=rest - spring.simulator)
    return tuple(found.values())

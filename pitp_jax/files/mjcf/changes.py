"""Convert parameters of a simulator and a robot to attributes of a MuJoCo file.

    F: torque per unit of the command,   k: how much larger the robot's F is
    J_robot - J_sim = k F a_2' - F a_2,  D, K likewise;   friction  k F f;   k = 1 unless all coefficients changed alike

From commands and motion only the ratios of J, D, K to F are known. Where the robot's J and D are smaller (or larger) by
one factor, its gain is the larger (or smaller) one: one changed parameter instead of two. The same holds if the inertia
would fall below that of the links, which an armature cannot achieve.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from ...common.numbers import number
from ...method.diagnose.joint import NAMES, Parameter, gain_factor
from .change import Change, NotWritten, interval
from .document import Tag
from .joint import Joint
from .weight import add_weight

_WEIGHT = "softening weight"
_TURN = 2 * math.pi  # rad; the far side of a stop that was found only on one side


def changes_of(joint: Joint, table: Sequence[Parameter]) -> tuple[list[Change], list[NotWritten], str]:
    """Return the changes to write into a MuJoCo file, and the parameters that the file cannot hold.

    Args:
        joint: as it is in the file.
        table: the parameters of the diagnosis, in units of the command (position_gain None) or of torque for a motor.

    Returns:
        changes, the parameters that the file cannot hold, and the element to insert before the joint, or "".
    """
    # a parameter that the recordings do not determine keeps the value of the file
    determined = {p.name: p for p in table if p.determined}
    rows = {name: p for name, p in determined.items() if _is_known(p)}
    f = joint.torque_per_command
    k, beside = _gain_factor(joint, {p.name: p for p in table}, rows)
    changes: list[Change] = []
    if k != 1.0:
        changes += _gain(joint, k, beside)
    for name, attribute, unit in (
        ("inertia", "armature", "kg m^2"), ("damping", "damping", "N m s/rad"), ("stiffness", "stiffness", "N m/rad"),
        ("coulomb_friction level", "frictionloss", "N m"),
    ):  # fmt: skip
        # a changed gain changes every torque, so that parameters equal in the command's unit are written too
        row = (rows if k == 1.0 else determined).get(name)
        if row is None:
            continue
        difference = f * (k * row.robot - row.simulator)
        if name == "stiffness" and joint.position:  # the controller's own spring, kp g^2, grew with the gain
            difference = f * k * (row.robot - row.simulator)
        error = row.stderr and f * k * row.stderr
        # with another gain the difference in SI may vanish
        if error is not None and abs(difference) < 2 * error:
            continue
        old = getattr(joint, attribute)
        unit = unit if joint.hinge else _linear(unit)
        changes.append(_moved("joint", attribute, old, max(old + difference, 0.0), error, unit, 0.0))
    changes, element = _with_weight(joint, changes, rows.get(_WEIGHT), f, k)
    changes += _of_actuator(joint, rows, f * k)
    changes += _stops(joint, rows)
    lag = ("electrode_rc tau" if "electrode_rc tau" in rows else "sensor_lag tau") if _lag_attribute(joint) else ""
    written = {"gain", "position gain", "inertia", "damping", "stiffness", "coulomb_friction level", "delay time", lag,
               "voltage_clip inverse", "force_limit inverse", "end_stop place", "end_stop place, above",
               "end_stop place, below", _WEIGHT if element else ""}  # fmt: skip
    ways = {name: names.substitute for name, names in NAMES.items()}
    ways["electrode_rc tau"] = "write the motor as <general> with dyntype and dynprm"
    not_written = [
        NotWritten(p.words, _value(p), ways.get(name, "none")) for name, p in rows.items() if name not in written
    ]
    unknown = "none: these recordings do not determine it, so the file keeps its own value"
    not_written += [NotWritten(p.words, _value(p), unknown) for p in table if p.difference and not p.determined]
    return changes, not_written, element


def _with_weight(
    joint: Joint, changes: list[Change], row: Parameter | None, f: float, k: float
) -> tuple[list[Change], str]:
    """Add a weight on the arm to the changes, and subtract its inertia from the joint's armature."""
    if row is None or not joint.hinge:
        return changes, ""
    changed = next((c for c in changes if c.attribute == "armature"), None)
    armature = joint.armature if changed is None else float(changed.new)
    error = row.stderr and f * k * row.stderr
    # the inertia of the weight is subtracted from the armature that the other changes give
    hung = add_weight(joint, f * (k * row.robot - row.simulator), error, armature)
    if hung is None:
        return changes, ""
    weight, element, rest = hung
    new = _moved("joint", "armature", joint.armature, rest, None, "kg m^2")
    new = replace(new, text=f"{new.text}, less the inertia of the weight below")
    return [*(c for c in changes if c is not changed), new, weight], element


def _is_known(p: Parameter) -> bool:
    """Return whether a parameter differs between simulator and robot by more than two standard errors."""
    return bool(p.difference) and (p.stderr is None or bool(abs(p.difference) > 2 * p.stderr))


def _value(p: Parameter) -> str:
    error = "" if p.stderr is None else f" +- {number(p.stderr, 2)}"
    return f"{number(p.robot)}{error} {p.unit}".rstrip()


def _gain_factor(joint: Joint, all_rows: Mapping[str, Parameter], moved: Mapping[str, Parameter]) -> tuple[float, str]:
    """Return the factor on the actuator's gain, and another reading of the same data as text."""
    inertia, damping = all_rows.get("inertia"), all_rows.get("damping")
    if inertia is None or not inertia.simulator > 0 or not inertia.robot > 0 or "inertia" not in moved:
        return 1.0, ""
    ratio, factor = inertia.robot / inertia.simulator, None
    if damping is not None and damping.simulator > 0 and damping.robot > 0:
        # relative errors of the two ratios, which must agree for one factor
        error = math.hypot(*((p.stderr or 0.0) / p.robot for p in (inertia, damping)))
        factor = gain_factor((ratio, damping.robot / damping.simulator), error)
    if factor is not None:
        return factor, f"or inertia and damping x {number(1 / factor)} each"
    # an armature cannot be negative, so the links alone would be too heavy
    impossible = joint.armature + joint.torque_per_command * inertia.difference < 0
    return (1 / ratio if impossible else 1.0), ""


def _gain(joint: Joint, k: float, beside: str) -> list[Change]:
    note = f"; {beside}" if beside else ""
    old_attributes = joint.actuator_tag.attributes
    if not joint.position:
        gear = _with_first(old_attributes.get("gear", "1"), joint.gear * k)
        return [Change("actuator", "gear", number(joint.gear), gear,
                       f"gear: {number(joint.gear)} -> {number(joint.gear * k)} (x {number(k)}{note})")]  # fmt: skip
    text = f"kp: {number(joint.kp)} -> {number(joint.kp * k)} (x {number(k)}{note})"
    # <general> writes a servo as a gain kp and a bias 0 -kp -kv
    if joint.actuator_tag.name == "general":
        gain = _with_first(old_attributes.get("gainprm", "1"), joint.kp * k)
        bias = f"0 {number(-joint.kp * k, 6)} {number(-joint.kv, 6)}"
        return [Change("actuator", "gainprm", number(joint.kp), gain, text),
                Change("actuator", "biasprm", "", bias, "")]  # fmt: skip
    return [Change("actuator", "kp", number(joint.kp), number(joint.kp * k, 6), text)]


def _with_first(values: str, first: float) -> str:
    return " ".join([number(first, 6), *values.split()[1:]])


def _linear(unit: str) -> str:
    return unit.replace("kg m^2", "kg").replace("N m s/rad", "N s/m").replace("N m/rad", "N/m").replace("N m", "N")


def _moved(
    element: str, attribute: str, old: float, new: float, error: float | None, unit: str, least: float = -math.inf
) -> Change:
    """Return the change of one number with its 95 % interval, of which `least` is the lowest possible end."""
    text = f"{attribute}: {number(old)} -> {number(new)}{interval(new, error, least)} {unit}"
    return Change(element, attribute, number(old), number(new, 6), text)


def _lag_attribute(joint: Joint) -> str | None:
    """Return the attribute in which this kind of actuator holds a time lag; None for a motor."""
    return {"position": "timeconst", "general": "dynprm"}.get(joint.actuator_tag.name)


def _of_actuator(joint: Joint, rows: Mapping[str, Parameter], torque: float) -> list[Change]:
    """Return the changes of the actuator's delay, time lag and limits."""
    changes = []
    if (row := rows.get("delay time")) is not None:
        new = max(joint.delay + row.difference, 0.0)
        changes.append(_moved("actuator", "delay", joint.delay, new, row.stderr, "s"))
        # MuJoCo keeps so many past commands
        changes.append(Change("actuator", "nsample", "", str(math.ceil(new / joint.timestep) + 1), ""))
    row = rows.get("electrode_rc tau") or rows.get("sensor_lag tau")
    if row is not None and (attribute := _lag_attribute(joint)):
        new = max(joint.lag + row.difference, 0.0)
        changes.append(_moved("actuator", attribute, joint.lag, new, row.stderr, "s"))
        # `dynprm` is a time constant only with a filter
        if attribute == "dynprm":
            changes.append(Change("actuator", "dyntype", "", "filterexact", ""))
    for name, attribute, scale in (
        ("voltage_clip inverse", "ctrlrange", 1.0), ("force_limit inverse", "forcerange", torque / joint.gear),
    ):  # fmt: skip
        if (row := rows.get(name)) is not None and math.isfinite(row.robot):
            limit, old = number(scale * row.robot, 6), joint.actuator_tag.attributes.get(attribute, "")
            text = f"{attribute}: {old or 'none'} -> +- {limit}"
            changes.append(Change("actuator", attribute, old, f"-{limit} {limit}", text))
            changes += _switched_on(joint, "actuator", attribute.replace("range", "limited"))
    return changes


def _stops(joint: Joint, rows: Mapping[str, Parameter]) -> list[Change]:
    both = rows.get("end_stop place")
    # a stop that was not separated by side lies at the same distance on both
    above, below = rows.get("end_stop place, above") or both, rows.get("end_stop place, below") or both
    if above is None and below is None:
        return []
    low, high = joint.limits or (-_TURN, _TURN)
    low = -abs(below.robot) if below else low
    high = above.robot if above else high
    # <compiler angle> applies to hinges only
    unit = 180 / math.pi if joint.hinge and joint.degrees else 1.0
    new = f"{number(unit * low, 6)} {number(unit * high, 6)}"
    old = "" if joint.limits is None else " ".join(number(unit * end) for end in joint.limits)
    text = f"range: {old or 'none'} -> {new}{' degrees' if unit != 1 else ''}"
    return [Change("joint", "range", old, new, text), *_switched_on(joint, "joint", "limited")]


def _switched_on(joint: Joint, element: str, attribute: str) -> list[Change]:
    """Return the change that switches a limit on where its range alone does not."""
    return [] if joint.autolimits else [Change(element, attribute, "", "true", "")]


def tag_of(joint: Joint, change: Change) -> Tag:
    """Return the XML start tag that holds the changed attribute."""
    return joint.actuator_tag if change.element == "actuator" else joint.joint_tag

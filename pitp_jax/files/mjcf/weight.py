"""Add a weight on the arm to a MuJoCo file: a small body without a joint, beside the joint.

    torque = -m g l sin q,   so a mass m = w / (g l) at the distance l below the axis at q = 0; above it where w < 0
    inertia m l^2 = w l / g comes with it, and is subtracted from the joint's armature

Only w = m g l is known from the motion. The body stands in its own element, because MuJoCo ignores the masses of shapes
where the link has an <inertial>.
"""

import math

import numpy as np

from ...common.numbers import number
from .change import Change, interval
from .joint import Joint


def add_weight(joint: Joint, w: float, error: float | None, armature: float) -> tuple[Change, str, float] | None:
    """Return the change, the XML element of the weight, and the joint's remaining armature (kg m^2).

    None if gravity does not act on the joint.

    Args:
        joint: as it is in the file.
        w: additional m g l of the robot, N m; negative for a weight above the axis.
        error: its standard error, or None.
        armature: that the joint would have without the weight, kg m^2.
    """
    g = float(np.linalg.norm(joint.gravity))
    if not g > 0:
        return None
    # m: the longest whose inertia the armature still holds
    distance = float(np.clip(armature * g / abs(w), 0.01, 0.1))
    # a longer arm has more inertia at the same m g l
    mass = abs(w) / g / distance
    place = np.array(joint.anchor) + math.copysign(distance, w) * np.array(joint.gravity) / g
    text = (
        f"weight on the arm, m g l: {w:+.4g}{interval(w, error)} N m; the motion shows only the product of mass and "
        "distance"
    )
    position, kilograms = " ".join(number(float(x), 6) for x in place), number(mass, 6)
    element = f'<body pos="{position}"><inertial pos="0 0 0" mass="{kilograms}" diaginertia="1e-9 1e-9 1e-9"/></body>'
    remaining = max(armature - mass * distance**2, 0.0)
    return Change("body", "inertial", "", f"{kilograms} kg at {position}", text), element, remaining

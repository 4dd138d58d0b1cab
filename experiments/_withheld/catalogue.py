"""Every withheld effect by name: forms of each, pairs that are diagnosed together, and what the names share.

name -> forms; a case draws one form, its constants and a gap, then searches the strength
"""

from . import electrical, mechanical, other
from .outside import OUTSIDE

_HOMES = {
    mechanical: ("stiffening", "softening", "end_stop", "creep", "relaxation", "hysteresis", "coulomb_friction",
                 "drag", "mullins", "backlash"),
    electrical: ("electrode_rc", "slew_limit", "voltage_clip", "dead_zone", "voltage_offset", "delay", "charge_leak",
                 "charge_retention", "stretch_coupling", "dielectric_saturation", "bleeder", "force_lag"),
    other: ("slack", "added_mass", "second_mode", "stiffness_drift", "sensor_gain", "sensor_lag",
            "sensor_nonlinearity", "parameter_change"),
}  # fmt: skip
INSIDE = {name: getattr(home, name.upper()) for home, names in _HOMES.items() for name in names}
FORMS = INSIDE | OUTSIDE
PAIRS = (
    ("stiffening", "coulomb_friction"),
    ("creep", "voltage_clip"),
    ("hysteresis", "stretch_coupling"),
    ("end_stop", "electrode_rc"),
    ("drag", "dielectric_saturation"),
    ("second_mode", "charge_leak"),
)
LOCATED = ("end_stop", "voltage_clip", "second_mode", "slew_limit")  # effects that live in a part of band x amplitude

"""The catalogue: every effect a diagnosis may name, one line per form.

A new effect is one final class and one line here; it is then fitted, ranked, saved, drawn and put through the
family's tests. Forces act in this order: velocity and friction see all that comes before them.
"""

from . import (
    amplifier,
    coupling,
    dissipation,
    electrode,
    hysteresis,
    inertia,
    sensor,
    sensor_curve,
    stiffness,
    viscoelastic,
)
from .base import AbstractEffect
from .found_term import FoundTerm

CATALOGUE: tuple[type[AbstractEffect], ...] = (
    stiffness.CubicStiffening,
    stiffness.PowerStiffening,
    stiffness.GentStiffening,
    stiffness.QuadraticSoftening,
    stiffness.SaturatingSoftening,
    stiffness.ExponentialSoftening,
    stiffness.MullinsSoftening,
    stiffness.UpperStop,
    stiffness.LowerStop,
    stiffness.BothStops,
    viscoelastic.Creep,
    viscoelastic.SpreadCreep,
    viscoelastic.LosingCreep,
    viscoelastic.Relaxation,
    viscoelastic.SpreadRelaxation,
    viscoelastic.LosingRelaxation,
    hysteresis.PlayHysteresis,
    hysteresis.DahlHysteresis,
    hysteresis.BoucWenHysteresis,
    hysteresis.WenHysteresis,
    sensor.SettlingDrift,
    sensor.LinearDrift,
    inertia.AddedMass,
    inertia.AttachedMode,
    inertia.LoosenedMode,
    stiffness.DampedStop,
    stiffness.DampedStops,
    dissipation.QuadraticDrag,
    dissipation.PowerDrag,
    dissipation.CoulombFriction,
    dissipation.SmoothFriction,
    dissipation.StribeckFriction,
    dissipation.BristleFriction,
    inertia.LoadSlack,
    inertia.HangingSlack,
    inertia.SoftSlack,
    electrode.ElectrodeRC,
    electrode.ElectrodeLadder,
    amplifier.SlewLimit,
    amplifier.SlewingLag,
    amplifier.VoltageClip,
    amplifier.RoundedClip,
    amplifier.VoltageOffset,
    amplifier.Delay,
    electrode.ChargeLeak,
    electrode.ChargeRetention,
    coupling.StretchCoupling,
    coupling.SquaredCoupling,
    coupling.ExponentialCoupling,
    coupling.DielectricSaturation,
    coupling.TanhSaturation,
    sensor.SensorGain,
    sensor_curve.QuadraticSensor,
    sensor_curve.CubicSensor,
    sensor_curve.CurvedSensor,
    sensor_curve.Backlash,
    sensor.SensorLag,
    sensor.SensorFilter,
    sensor.SecondOrderSensor,
    inertia.MountedMode,
)

# All that a model may carry, in the order its forces act in; a found term is no name, so no diagnosis ranks it.
EFFECTS: tuple[type[AbstractEffect], ...] = (*CATALOGUE, FoundTerm)

# A form whose first number may be out of reach, and what it is then, with the numbers that stay: fitted beside it, so
# that a name is not won by a limit that nothing touches.
REMAINDERS: dict[type[AbstractEffect], tuple[type[AbstractEffect], tuple[int, ...]]] = {
    amplifier.SlewingLag: (electrode.ElectrodeRC, (1,)),
}


def key(effect: type[AbstractEffect] | AbstractEffect) -> str:
    """How a form is named in files and tables: name, then form."""
    return f"{effect.name}: {effect.form}"

"""Effects of amplifier and electrodes: from the commanded voltage u to the film's voltage V (port IN).

electrode_rc      tau V' = u - V, or of a share   bleeder         the same, with a tau up and one down
force_lag         V^2 = F,  tau F' = u^2 - F
slew_limit        |V'| <= s                      voltage_clip    V = min(max(u, -u_max), u_max)
dead_zone         V = u - u_0 sgn(u) beyond |u| = u_0, else 0
charge_leak       V = u - kappa q,  tau q' = u - q                       voltage_offset  V = u + V_0
charge_retention  V = u + q,  tau q' = k |u| - q                         delay           V(t) = u(t - T)
feedthrough       V = u, the sensor reads  x + d V^2  or  x + d V
hysteresis        V = u + sum_j w_j (z_j - u),  z_j plays of u;   or  V = u + level z,  width z' = u - |u| z

u runs linearly between samples, and lags are exact for it. A record at rest starts uncharged.
"""

from collections.abc import Callable
from functools import partial

import jax.numpy as jnp

from ..model.drive import slope
from .kernels import DELAY, PRESENT, dahl_of_integral, lag, lag_each_way, lead, play, slew
from .spec import EffectSpec, Parameter, signed, strength

_drive = partial(EffectSpec, family="drive", port="IN")  # from the commanded voltage to the film's

TAU = strength("tau", "s")
# a memory of the input faster than the plant is a filter of it, not a charge
_STORE = Parameter("tau", "s", slow=True)


def last_lag(p, w, z):
    """Return the output of the last lag, or its input if the time constant is zero."""
    return jnp.where(p.tau > 0, z[-1], w)


def _led_force(p, v, dt):
    """Compute the input V^2 of a lag whose output is v^2, with the time constant tau."""
    return lead(v**2, dt, p.tau)


def _by_area(p, k, plant):
    """Report a loop as a voltage offset if its width is less than a twentieth of the input's integral."""
    name = "voltage_offset" if p.width < 0.05 * plant.area else "hysteresis"
    return name, "Dahl of the command's integral", (p.level, p.width)


def _crossing(form: str, title: str, equation: str, unit: str, part: Callable) -> EffectSpec:
    """Build a catalogue entry: the sensor's reading contains `part` of the voltage, times d."""
    return EffectSpec(
        "feedthrough", form, (signed("d", unit, length=1),), title, equation, "sensor",
        "IN", kernel=PRESENT, law=lambda p, u, z: u, inverse=lambda p, v, dt: v,
        crosses=lambda p, z: p.d * part(z[0]),
    )  # fmt: skip


DRIVE = (
    _drive(
        "electrode_rc", "one lag", (TAU,), "The electrodes' resistance delays the charging of the film.",
        "tau V' = u - V", kernel=lag(), law=last_lag,
        inverse=lambda p, v, dt: lead(v, dt, p.tau),
    ),
    _drive(
        "electrode_rc", "far part", (TAU, Parameter("share", most=1.0)),
        "A part of the film is charged late, through the resistance of the electrodes.",
        "V = u + share (q - u), tau q' = u - q", kernel=lag(),
        law=lambda p, u, z: u + p.share * (last_lag(p, u, z) - u),
    ),
    _drive(
        "bleeder", "one lag each way",
        (strength("up", "s"), Parameter("down", "s")),
        "The electrodes discharge faster or slower than they charge.",
        "tau V' = u - V, tau = up where |u| > |V|, else down", kernel=lag_each_way(),
        law=lambda p, u, z: jnp.where(p.up > 0, z[0], u),
        inverse=lambda p, v, dt: lead(v, dt, jnp.where(p.up > 0, jnp.where(v * slope(v, dt) > 0, p.up, p.down), 0.0)),
    ),
    EffectSpec(
        "force_lag", "one lag", (TAU,), "The force follows the square of the voltage late.",
        "V^2 = F, tau F' = u^2 - F", "coupling", "IN", kernel=lag(of=lambda p, u: u**2), squares=True,
        # not from zero: there a root has no slope
        law=lambda p, u, z: jnp.where(p.tau > 0, jnp.sqrt(jnp.maximum(z[0], 1e-9)), u),
        inverse=lambda p, v, dt: jnp.where(p.tau > 0, jnp.sqrt(jnp.maximum(_led_force(p, v, dt), 1e-9)), v),
        passes=lambda p, v, dt: _led_force(p, v, dt) >= 0, twin="sensor_lag", only_given=True,
    ),
    _drive(
        "slew_limit", "rate limit", (strength("inverse", "s/V"),),
        "The amplifier cannot change its voltage faster than a limit.",
        "V follows u with |V'| <= s, inverse = 1 / s", kernel=slew(),
        law=lambda p, u, z: jnp.where(p.inverse > 0, z[0], u), inverse=lambda p, v, dt: v,
        passes=lambda p, v, dt: jnp.abs(slope(v, dt)) * p.inverse <= 1.0,
    ),
    _drive(
        "voltage_clip", "hard", (strength("inverse", "1/V"),),
        "The amplifier does not go above a voltage.", "V = min(max(u, -u_max), u_max), inverse = 1 / u_max",
        law=lambda p, u, z: jnp.clip(u, -1 / jnp.maximum(p.inverse, 1e-30), 1 / jnp.maximum(p.inverse, 1e-30)),
    ),
    _drive(
        "dead_zone", "symmetric", (strength("threshold", "V"),),
        "Below a threshold the voltage has no effect; above it, only the excess acts.",
        "V = 0 for |u| < u_0, else u - u_0 sgn(u), u_0 = threshold",
        law=lambda p, u, z: u - jnp.clip(u, -p.threshold, p.threshold),
        inverse=lambda p, v, dt: v + p.threshold * jnp.sign(v),
    ),
    _drive(
        "voltage_offset", "constant", (signed("offset", "V"),),
        "A constant voltage is added to the commanded one.", "V = u + offset",
        law=lambda p, u, z: u + p.offset,
    ),
    _drive(
        "delay", "pure", (strength("time", "s"),), "The voltage acts after a delay T.",
        "V(t) = u(t - T), T = time", kernel=DELAY, moves="delay", twin="sensor_lag",
        commutes=True, law=lambda p, u, z: u,
        # up to a period of the resonance, as behind a bus or a filter
    ),
    _drive(
        "charge_leak", "one trap", (strength("kappa"), _STORE),
        "Charge creeps into the film and takes away part of a held voltage.", "V = u - kappa q, tau q' = u - q",
        kernel=lag(),
        law=lambda p, u, z: u - p.kappa * z[0],
    ),
    _drive(
        "charge_retention", "one store", (strength("k"), _STORE),
        "Charge stays in the film and keeps pulling when the voltage is zero.", "V = u + q, tau q' = k |u| - q",
        kernel=lag(of=lambda p, u: p.k * jnp.abs(u)),
        law=lambda p, u, z: u + z[0],
    ),
    EffectSpec(
        "hysteresis", "plays of the drive",
        (*(signed(f"w{k}") for k in (1, 2, 3, 4)), Parameter("width", "V")),
        "The film polarises along a loop that is the same at every frequency.",
        "V = u + sum_j w_j (z_j - u), z_j plays of u of half width (0.04, 0.125, 0.25, 0.4) width", "dissipation", "IN",
        kernel=play(0.04, 0.125, 0.25, 0.4),
        law=lambda p, u, z: u + p.w1 * (z[0] - u) + p.w2 * (z[1] - u) + p.w3 * (z[2] - u) + p.w4 * (z[3] - u),
    ),
    EffectSpec(
        "hysteresis", "Dahl of the command's integral",
        (signed("level", "V"), Parameter("width", "V s")),
        "If the command is a speed, a force builds up over the commanded distance and then stays constant.",
        "V = u + level z, dz = (u - |u| z) dt / width", "dissipation", "IN",
        kernel=dahl_of_integral(), reported=_by_area,
        law=lambda p, u, z: u + p.level * z[0],
    ),
    _crossing(
        "of the force", "The sensor also moves with the film's force, as on a compliant mount.", "y = x + d V^2",
        "x/V^2", lambda v: v**2,
    ),
    _crossing(
        "of the input", "The voltage couples into the sensor's reading.", "y = x + d V", "x/V", lambda v: v,
    ),
)  # fmt: skip

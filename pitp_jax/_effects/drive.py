"""Change what amplifier and electrodes make of the command before the square (port IN): u to the film's V.

electrode_rc      tau V' = u - V, once or three times in a row
slew_limit        |V'| <= s, as fast as it may or behind a lag           voltage_clip    V = min(max(u, -u_max), u_max)
dead_zone         V = u - u_0 sgn(u) beyond |u| = u_0, else 0
charge_leak       V = u - kappa q,  tau q' = u - q                       voltage_offset  V = u + V_0
charge_retention  V = u + q,  tau q' = k |u| - q                         delay           V(t) = u(t - T)
hysteresis        V = u + sum_j w_j (z_j - u),  z_j plays of u;   or  V = u + level z,  width z' = u - |u| z

u runs linearly between samples, and lags are exact for it. A record that rests starts uncharged.
"""

import jax.numpy as jnp

from .._model.drive import slope
from .._numerics.linear_recurrence import lag_after
from .kernels import DELAY, dahl_of_integral, lags, lead, play, slew
from .spec import EffectSpec, Parameter

_LADDER = (0.8, 0.15, 0.05)  # of tau: the slowest modes of a diffusion line, gathered in three lags
_ROUND = 0.99  # of the limit of a rounded clip: as far as it is undone
_TAU = Parameter("tau", "s", off=0.0, linear=False)
# a memory of the drive that is faster than the plant is a filter of it, not a charge
_STORE = Parameter("tau", "s", slow=True)


def last_lag(p, w, z):
    """Return the last lag's output; what enters, where there is no lag."""
    return jnp.where(p.tau > 0, z[-1], w)


def _rounded(p, v, dt):
    r = jnp.clip(jnp.abs(p.inverse * v), 0.0, _ROUND)  # at the limit itself no drive is high enough
    return v * (1 - r**8) ** (-1 / 8)


_SLEW = Parameter("inverse", "s/V", off=0.0, linear=False)


def _slewed(p, u, z):
    return jnp.where(p.inverse > 0, z[0], u)


def _slow_enough(p, v, dt):
    return jnp.abs(slope(v, dt)) * p.inverse <= 1.0


DRIVE = (
    EffectSpec(
        "electrode_rc", "one lag", (_TAU,), "The electrodes' resistance delays the charging of the film.",
        "tau V' = u - V", "drive", "IN", kernel=lags(1.0), law=last_lag,
        inverse=lambda p, v, dt: lead(v, dt, p.tau),
    ),
    EffectSpec(
        "electrode_rc", "ladder", (_TAU,), "A resistive electrode charges from its edge inwards.",
        "three lags of (0.8, 0.15, 0.05) tau in a row: a diffusion line", "drive", "IN",
        kernel=lags(*_LADDER, in_a_row=True), law=last_lag,
        inverse=lambda p, v, dt: lead(v, dt, *(r * p.tau for r in _LADDER)),
    ),
    EffectSpec(
        "slew_limit", "rate limit", (_SLEW,), "The amplifier cannot change its voltage faster than a limit.",
        "V follows u with |V'| <= s, inverse = 1 / s", "drive", "IN", kernel=slew(), law=_slewed,
        inverse=lambda p, v, dt: v, passes=_slow_enough,
    ),
    EffectSpec(
        "slew_limit", "rate limit and lag", (_SLEW, Parameter("tau", "s")),
        "The amplifier nears its rate limit gradually.",
        "tau V' = u - V with |V'| <= s, inverse = 1 / s", "drive", "IN", law=_slewed, passes=_slow_enough,
        kernel=slew(lambda p, z, before, after, h: lag_after(z, before, after, p.tau, h)),
        inverse=lambda p, v, dt: v + jnp.where(p.inverse > 0, p.tau * slope(v, dt), 0.0),
    ),
    EffectSpec(
        "voltage_clip", "hard", (Parameter("inverse", "1/V", off=0.0, linear=False),),
        "The amplifier does not go above a voltage.", "V = min(max(u, -u_max), u_max), inverse = 1 / u_max",
        "drive", "IN",
        law=lambda p, u, z: jnp.clip(u, -1 / jnp.maximum(p.inverse, 1e-30), 1 / jnp.maximum(p.inverse, 1e-30)),
    ),
    EffectSpec(
        "voltage_clip", "rounded", (Parameter("inverse", "1/V", off=0.0, linear=False),),
        "The amplifier's voltage bends off towards a limit.", "V = u / (1 + |u / u_max|^8)^(1/8), inverse = 1 / u_max",
        "drive", "IN",
        law=lambda p, u, z: u * (1 + (p.inverse * u) ** 8) ** (-1 / 8), inverse=_rounded,
    ),
    EffectSpec(
        "dead_zone", "symmetric", (Parameter("threshold", "V", off=0.0, linear=False),),
        "Nothing moves below a voltage, and above it acts what exceeds it.",
        "V = 0 for |u| < u_0, else u - u_0 sgn(u), u_0 = threshold", "drive", "IN",
        law=lambda p, u, z: u - jnp.clip(u, -p.threshold, p.threshold),
        inverse=lambda p, v, dt: v + p.threshold * jnp.sign(v),
    ),
    EffectSpec(
        "voltage_offset", "constant", (Parameter("offset", "V", positive=False, off=0.0),),
        "A constant voltage is added to the commanded one.", "V = u + offset", "drive", "IN",
        law=lambda p, u, z: u + p.offset,
    ),
    EffectSpec(
        "delay", "pure", (Parameter("time", "s", off=0.0, linear=False),), "The voltage acts T later.",
        "V(t) = u(t - T), T = time", "drive", "IN", kernel=DELAY, linear=True, law=lambda p, u, z: u,
        # to a period of the resonance: behind a bus or a filter it may be that late
    ),
    EffectSpec(
        "charge_leak", "one trap", (Parameter("kappa", off=0.0), _STORE),
        "Charge creeps into the film and takes away part of a held voltage.", "V = u - kappa q, tau q' = u - q",
        "drive", "IN", kernel=lags(1.0),
        law=lambda p, u, z: u - p.kappa * z[0],
    ),
    EffectSpec(
        "charge_retention", "one store", (Parameter("k", off=0.0), _STORE),
        "Charge stays in the film and goes on pulling when the voltage is gone.", "V = u + q, tau q' = k |u| - q",
        "drive", "IN", kernel=lags(1.0, of=lambda p, u: p.k * jnp.abs(u)),
        law=lambda p, u, z: u + z[0],
    ),
    EffectSpec(
        "hysteresis", "plays of the drive",
        (*(Parameter(f"w{k}", positive=False, off=0.0) for k in (1, 2, 3, 4)), Parameter("width", "V")),
        "The film polarises along a loop that is the same at every frequency.",
        "V = u + sum_j w_j (z_j - u), z_j plays of u of half width (0.04, 0.125, 0.25, 0.4) width", "dissipation", "IN",
        costly=True, kernel=play(0.04, 0.125, 0.25, 0.4),
        law=lambda p, u, z: u + p.w1 * (z[0] - u) + p.w2 * (z[1] - u) + p.w3 * (z[2] - u) + p.w4 * (z[3] - u),
    ),
    EffectSpec(
        "hysteresis", "Dahl of the command's integral",
        (Parameter("level", "V", positive=False, off=0.0), Parameter("width", "V s")),
        "Where the command is a speed, a force builds up over the way that it asks for and then stays.",
        "V = u + level z, dz = (u - |u| z) dt / width", "dissipation", "IN", costly=True, kernel=dahl_of_integral(),
        law=lambda p, u, z: u + p.level * z[0],
    ),
)  # fmt: skip

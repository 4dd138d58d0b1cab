"""Springs, stops, viscoelastic branches and friction, none in the catalogue's simplest form where physics has another.

    hardening   sinh(b x)/b - x        x (exp(b x^2) - 1)       b x (1 - 1/sqrt(1 + (x/l)^2))  (pulled sideways)
    softening   (1 - exp(-2 b x))/(2 b) - x                     tanh(b x)/b - x
    stop        p d^1.5 (1 + 1.5 e x'), d = max(x - x_s, 0), never pulling (Hunt and Crossley 1975); one or two sides
    memory      sum k_i (x - z_i), z_i' = (x - z_i)/tau_i       k_i ~ tau_i^-a, the ladder of a power law
    loops       h' = x' - |x'| |h|^(n-1) h b - g x' |h|^n       (Bouc-Wen), or four stops r_i of it with n = 4
    friction    LuGre (Canudas de Wit 1995), or Stribeck times tanh(x'/v_e), v_e = 0.2 % of the largest speed
    drag        p x' |x'| (1 + e x'^2), or p x' |x'|^0.7

Creep has tau w0 > 20, relaxation tau w0 < 9: the border at 15 is left out on purpose.
"""

import jax.numpy as jnp
import numpy as np

from .form import Form


def _swing(stats) -> float:
    return max(stats.top, -stats.bottom)


# stiffness ------------------------------------------------------------------------------------------------------------
STIFFENING = (
    Form("sinh", (0.02, 3.0), force=lambda p, c, x, v, s, t: jnp.sinh(p * x) / p - x),
    Form("fung", (1e-3, 1.0), force=lambda p, c, x, v, s, t: x * jnp.expm1(jnp.minimum(p * x**2, 20.0))),
    Form("sideways", (0.02, 30.0), draw=lambda rng, stats: {"l": rng.uniform(0.3, 0.8) * _swing(stats)},
         force=lambda p, c, x, v, s, t: p * x * (1.0 - 1.0 / jnp.sqrt(1.0 + (x / c["l"]) ** 2))),
)  # fmt: skip
SOFTENING = (
    Form("exponential", (5e-3, 1.0), force=lambda p, c, x, v, s, t: -jnp.expm1(-2.0 * p * x) / (2.0 * p) - x),
    Form("tanh", (0.03, 1.2), force=lambda p, c, x, v, s, t: jnp.tanh(p * x) / p - x),
)


def _contact(p, depth, closing, c):
    """Hunt-Crossley contact force, never pulling."""
    return p * jnp.maximum(depth, 0.0) ** 1.5 * jnp.maximum(1.0 + 1.5 * c["loss"] * closing, 0.0)


def _stop_draw(rng, stats):
    """Stops that three records meet or more: one met in the sweep alone could not be held out."""
    return {"loss": rng.uniform(0.05, 0.3) / stats.speed, "above": rng.uniform(0.75, 0.95) * stats.third,
            "below": rng.uniform(0.4, 0.8) * stats.bottom}  # fmt: skip


END_STOP = (
    Form("one_sided", (0.8, 300.0), draw=_stop_draw, stiff=90.0,
         force=lambda p, c, x, v, s, t: _contact(p, x - c["above"], v, c)),
    Form("two_sided", (0.8, 300.0), draw=_stop_draw, stiff=90.0,
         force=lambda p, c, x, v, s, t: _contact(p, x - c["above"], v, c) - _contact(p, c["below"] - x, -v, c)),
)  # fmt: skip


# viscoelastic ---------------------------------------------------------------------------------------------------------
def _branches(number):
    """Ports of Maxwell branches with shares k_i of p and times tau_i (1/w0)."""
    return {
        "states": number,
        "force": lambda p, c, x, v, s, t: p * sum(c[f"k{i}"] * (x - s[i]) for i in range(number)),
        "rates": lambda p, c, u, x, v, s: tuple((x - s[i]) / c[f"tau{i}"] for i in range(number)),
    }


def _ladder(rng, stats):
    """Five times from 20/w0 to a third of a record; the relaxation modulus falls as t^-a."""
    last = max(2.0 * np.pi * stats.f0 * stats.length / 3.0, 80.0)
    taus, slope = np.geomspace(rng.uniform(20.0, 30.0), last, 5), rng.uniform(0.05, 0.3)
    return {f"tau{i}": tau for i, tau in enumerate(taus)} | {
        f"k{i}": (tau / taus[0]) ** -slope for i, tau in enumerate(taus)
    }


def _two_taus(rng, stats):
    return {"tau0": rng.uniform(0.5, 2.0), "tau1": rng.uniform(3.0, 9.0), "k0": rng.uniform(0.5, 1.0), "k1": 1.0}


CREEP = (Form("power_law", (2e-3, 2.0), draw=_ladder, **_branches(5)),)
RELAXATION = (Form("two_branches", (5e-3, 3.0), draw=_two_taus, **_branches(2)),)


# dissipation ----------------------------------------------------------------------------------------------------------
def _bouc_wen(p, c, u, x, v, s):
    h = s[0]
    grown = jnp.abs(h / c["r"]) ** (c["n"] - 1.0)
    return (v - grown * (c["b"] * jnp.abs(v) * h + (1.0 - c["b"]) * v * jnp.abs(h)) / c["r"],)


def _stops(p, c, u, x, v, s):
    return tuple(v * (1.0 - jnp.maximum(v * h, 0.0) / (jnp.abs(v * h) + 1e-12) * (h / (r * c["r"])) ** 4)
                 for h, r in zip(s, _RADII, strict=True))  # fmt: skip


_RADII = (0.12, 0.3, 0.55, 0.9)
HYSTERESIS = (
    Form("bouc_wen", (0.01, 3.0), states=1, stiff=60.0, rates=_bouc_wen,
         draw=lambda rng, stats: {"r": rng.uniform(0.1, 0.3) * _swing(stats), "n": rng.uniform(1.4, 2.0),
                                  "b": rng.uniform(0.55, 0.8)},
         force=lambda p, c, x, v, s, t: p * s[0]),
    Form("four_stops", (0.005, 2.0), states=4, stiff=100.0, rates=_stops,
         draw=lambda rng, stats: {"r": rng.uniform(0.5, 0.8) * _swing(stats)},
         force=lambda p, c, x, v, s, t: p * sum(s)),
)  # fmt: skip


def _stribeck(p, c, v):
    """Level of dry friction at the speed v."""
    return p * (1.0 + c["static"] * jnp.exp(-((v / c["vs"]) ** 2)))


def _friction_draw(rng, stats):
    return {"static": rng.uniform(0.1, 0.5), "vs": rng.uniform(0.01, 0.04) * stats.speed, "ve": 2e-3 * stats.speed,
            "give": 5e-3 * _swing(stats)}  # fmt: skip


def _lugre_rate(p, c, u, x, v, s):
    """Bristles: z' = x' - |x'| z / z_s, deflection z in units of the give at sliding."""
    return (v / c["give"] - jnp.abs(v) * s[0] / (c["give"] * (1.0 + c["static"] * jnp.exp(-((v / c["vs"]) ** 2)))),)


COULOMB_FRICTION = (
    Form("lugre", (2e-3, 0.6), draw=_friction_draw, states=1, stiff=150.0, rates=_lugre_rate,
         force=lambda p, c, x, v, s, t: p * s[0]),
    Form("stribeck", (2e-3, 0.6), draw=_friction_draw, stiff=90.0,
         force=lambda p, c, x, v, s, t: _stribeck(p, c, v) * jnp.tanh(v / c["ve"])),
)  # fmt: skip
DRAG = (
    Form("quadratic_cubic", (2e-3, 2.0), draw=lambda rng, stats: {"e": rng.uniform(0.1, 0.4) / stats.speed**2},
         force=lambda p, c, x, v, s, t: p * v * jnp.abs(v) * (1.0 + c["e"] * v**2)),
    Form("power_1.7", (2e-3, 2.0), force=lambda p, c, x, v, s, t: p * v * jnp.abs(v) ** 0.7),
)  # fmt: skip


# what was stretched stays softer --------------------------------------------------------------------------------------
def _farthest(p, c, u, x, v, s):
    """The largest |x| so far, by a steep ratchet."""
    return (60.0 * jnp.maximum(jnp.abs(x) - s[0], 0.0),)


MULLINS = (
    Form("rational", (0.02, 0.9), states=1, lasts=True, stiff=120.0, rates=_farthest,
         draw=lambda rng, stats: {"r": rng.uniform(0.3, 0.8) * stats.top},
         force=lambda p, c, x, v, s, t: -p * s[0] / (s[0] + c["r"]) * x),
)  # fmt: skip


# play before the sensor -----------------------------------------------------------------------------------------------
def _pushed(p, c, u, x, v, s):
    """A stiff spring beyond the play carries along what is read."""
    off = x - s[0]
    return (c["rate"] * (jnp.maximum(off - p / 2, 0.0) - jnp.maximum(-off - p / 2, 0.0)),)


BACKLASH = (
    Form("elastic", (5e-3, 1.5), states=1, stiff=150.0, rates=_pushed, sensor=lambda p, c, x, s: s[0],
         draw=lambda rng, stats: {"rate": rng.uniform(40.0, 60.0)}),
)  # fmt: skip

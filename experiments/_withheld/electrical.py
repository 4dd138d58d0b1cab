"""Between the commanded voltage and the force: electrode, amplifier, leakage, coupling.

    electrode   three RC sections in a row, V = sqrt(mean V_i^2): the film's far end is charged late
    bleeder     V' = (u - V) (1 + k (1 - tanh((u - V)/w))/2) / tau: the film is charged slower than it is discharged,
                or the other way round
    force       V^2 = F_2, F_1' = 2 (u^2 - F_1)/tau, F_2' = 2 (F_1 - F_2)/tau
    amplifier   V' = s tanh(e/s) or e/(1 + |e/s|^3)^(1/3), e = (u - V)/tau, tau w0 = 0.02;
                V = u + V_0;   V = u(t - T);   V = u - w log(1 + exp((u - u_m)/w))
                dead zone V = w log(1 + exp((u - u_0)/w)), less its value at u = 0
    leakage     V = u - p (q_1 + k q_2), q_i' = (u - q_i)/tau_i: two kinds of traps
    coupling    V^2 (1 + b x/4)^4 (capacitance grows with the square of the area) or V^2 (1 + b x/2)^2
    saturation  u_s^2 tanh(V^2/u_s^2) or V^2/(1 + (V/u_s)^4)^(1/2)

Films are uncharged at the beginning of a record, as the actuator is at rest then whatever u(0).
"""

import jax.numpy as jnp

from .form import Form


# drive ----------------------------------------------------------------------------------------------------------------
def _ladder_rate(p, c, u, x, v, s):
    """Three equal sections of resistance and capacitance, far end open; time constant p of the whole film."""
    a, b, d = s
    rate = 9.0 / (2.0 * p)
    return (rate * (u - 2.0 * a + b), rate * (a - 2.0 * b + d), rate * (b - d))


def _bleeder_draw(rng, stats):
    return {"k": rng.choice([-0.75, 3.0, 6.0]), "w": 0.02}


def _bleeder(p, c, u, x, v, s):
    error = u - s[0]
    return (error * (1.0 + 0.5 * c["k"] * (1.0 - jnp.tanh(error / c["w"]))) / p,)


def _late_force(p, c, u, x, v, s):
    return (2.0 * (u**2 - s[0]) / p, 2.0 * (s[0] - s[1]) / p)


def _slew_draw(rng, stats):
    return {"fast": stats.slew, "tau": 0.02}


def _slew(p, c, u, x, v, s):
    limit = c["fast"] / p
    return (limit * jnp.tanh((u - s[0]) / (limit * c["tau"])),)


def _algebraic_slew(p, c, u, x, v, s):
    limit, error = c["fast"] / p, (u - s[0]) / c["tau"]
    return (error / (1.0 + jnp.abs(error / limit) ** 3) ** (1.0 / 3.0),)


def _clip(p, c, u, s):
    return u - c["w"] * jnp.logaddexp(0.0, (u - (1.0 - p) * c["level"]) / c["w"])


def _dead(p, c, u, s):
    start = p * c["level"] / c["w"]  # of the zone, in widths of its corner
    return c["w"] * (jnp.logaddexp(0.0, u / c["w"] - start) - jnp.logaddexp(0.0, -start))


def _trap_draw(rng, stats):
    record = 6.283 * stats.f0 * stats.length
    return {
        "tau0": rng.uniform(0.02, 0.05) * record,
        "tau1": rng.uniform(0.15, 0.4) * record,
        "k": rng.uniform(0.4, 1.0),
    }


def _traps(p, c, u, x, v, s):
    return ((u - s[0]) / c["tau0"], (u - s[1]) / c["tau1"])


def _store_draw(rng, stats):
    """Two stores; |u| rounded."""
    record = 6.283 * stats.f0 * stats.length
    return {
        "tau0": rng.uniform(0.03, 0.08) * record,
        "tau1": rng.uniform(0.2, 0.4) * record,
        "k": rng.uniform(0.3, 0.8),
    }


def _stores(p, c, u, x, v, s):
    size = jnp.sqrt(u**2 + 1e-6)
    return ((size - s[0]) / c["tau0"], (size - s[1]) / c["tau1"])


def _sign(rng, stats):
    return {"sign": rng.choice([-1.0, 1.0])}


ELECTRODE_RC = (
    Form("ladder", (0.06, 5.0), states=3, stiff=100.0, rates=_ladder_rate,
         drive=lambda p, c, u, s: jnp.sqrt((s[0] ** 2 + s[1] ** 2 + s[2] ** 2) / 3.0)),
)  # fmt: skip
BLEEDER = (
    Form("smooth", (0.06, 5.0), draw=_bleeder_draw, states=1, stiff=100.0, rates=_bleeder,
         drive=lambda p, c, u, s: s[0]),
)  # fmt: skip
FORCE_LAG = (
    Form("two_lags", (0.06, 5.0), states=2, stiff=60.0, rates=_late_force,
         drive=lambda p, c, u, s: jnp.sqrt(jnp.maximum(s[1], 0.0))),
)  # fmt: skip
SLEW_LIMIT = (
    Form("tanh", (0.8, 60.0), draw=_slew_draw, states=1, stiff=60.0, rates=_slew, drive=lambda p, c, u, s: s[0]),
    Form("algebraic", (0.8, 60.0), draw=_slew_draw, states=1, stiff=60.0, rates=_algebraic_slew,
         drive=lambda p, c, u, s: s[0]),
)  # fmt: skip
VOLTAGE_CLIP = (
    Form("soft", (0.02, 0.7), drive=_clip,
         draw=lambda rng, stats: {"level": stats.level, "w": rng.uniform(0.005, 0.02) * stats.level}),
)  # fmt: skip
DEAD_ZONE = (
    Form("soft", (0.01, 0.5), drive=_dead,
         draw=lambda rng, stats: {"level": stats.level, "w": rng.uniform(0.005, 0.02) * stats.level}),
)  # fmt: skip
VOLTAGE_OFFSET = (Form("constant", (5e-3, 0.5), draw=_sign, drive=lambda p, c, u, s: u + c["sign"] * p),)
DELAY = (Form("exact", (0.02, 3.0), stiff=60.0, delay=lambda p, c: p),)
CHARGE_LEAK = (
    Form("two_traps", (5e-3, 0.6), draw=_trap_draw, states=2, rates=_traps,
         drive=lambda p, c, u, s: u - p * (s[0] + c["k"] * s[1])),
)  # fmt: skip
CHARGE_RETENTION = (
    Form("two_stores", (5e-3, 1.0), draw=_store_draw, states=2, rates=_stores,
         drive=lambda p, c, u, s: u + p * (s[0] + c["k"] * s[1])),
)  # fmt: skip

# coupling -------------------------------------------------------------------------------------------------------------
STRETCH_COUPLING = (
    Form("area_squared", (0.02, 2.0), coupling=lambda p, c, force, x: force * (1.0 + p * x / 4.0) ** 4),
    Form("stretch_squared", (0.02, 2.0), coupling=lambda p, c, force, x: force * (1.0 + p * x / 2.0) ** 2),
)
DIELECTRIC_SATURATION = (
    Form("tanh", (0.05, 6.0), coupling=lambda p, c, force, x: jnp.tanh(p * force) / p),
    Form("root", (0.05, 8.0), coupling=lambda p, c, force, x: force / jnp.sqrt(1.0 + (p * force) ** 2)),
)

"""Inertia, slow change, sensor, and the plant's own coefficients.

slack        x'' = -g + w log(1 + exp((x'' + g)/w)): the load is only pulled; g below the healthy plant's largest fall
second mode  a share p of the mass has come loose and hangs on a spring, or a small mass p was attached by one:
             (1 - p or 1) x'' + ... = p b,  b = w^2 (z - x) + 2 e w (z' - x'),  z'' = -b
drift        k (1 - p g(t)), g = t/T or log(1 + t/T)/log(1 + T_s/T), t the session clock of T_s seconds
sensor lag   y'' + 2 e w y' + w^2 y = w^2 x, p = 2 e/w
parameters   (a_0, a_1, a_2) times exp(p d), d drawn so that no one of them explains the change
"""

import jax.numpy as jnp

from .form import Form
from .protocol import SESSION


def _slack_draw(rng, stats):
    return {"fall": stats.fall, "w": rng.uniform(0.01, 0.03) * stats.fall}


def _soft_floor(p, c, a):
    g = (1.0 - p) * c["fall"]
    return -g + c["w"] * jnp.logaddexp(0.0, (a + g) / c["w"])


SLACK = (Form("soft_floor", (0.05, 0.9), draw=_slack_draw, stiff=60.0, limit=_soft_floor),)


# inertia --------------------------------------------------------------------------------------------------------------
def _bond(c, x, v, s):
    """Acceleration of the main mass, per hanging share, by the spring between the two."""
    return c["w"] ** 2 * (s[0] - x) + 2.0 * c["e"] * c["w"] * (s[1] - v)


ADDED_MASS = (Form("rigid", (0.01, 2.0), inertia=lambda p, c: 1.0 + p),)


def _second(low, high):
    """Ports and draws of a small mass on a spring, tuned to low ... high times w0 with its foot held."""
    return {
        "states": 2,
        "draw": lambda rng, stats: {"w": rng.uniform(low, high), "e": rng.uniform(0.02, 0.05)},
        "force": lambda p, c, x, v, s, t: -p * _bond(c, x, v, s),
        "rates": lambda p, c, u, x, v, s: (s[1], -_bond(c, x, v, s)),
    }


SECOND_MODE = (
    Form("loosened", (0.005, 0.4), inertia=lambda p, c: 1.0 - p, **_second(1.15, 1.6)),
    Form("attached", (0.005, 0.4), **_second(1.3, 2.1)),
)


# slow change ----------------------------------------------------------------------------------------------------------
def _session(rng, stats):
    """The session lasts SESSION records; T of the logarithm is 3 to 10 % of it."""
    whole = SESSION * stats.length
    return {"whole": whole, "T": rng.uniform(0.03, 0.1) * whole}


STIFFNESS_DRIFT = (
    Form("linear", (0.01, 0.8), draw=_session, force=lambda p, c, x, v, s, t: -p * t / c["whole"] * x),
    Form("logarithmic", (0.01, 0.8), draw=_session,
         force=lambda p, c, x, v, s, t: -p * jnp.log1p(t / c["T"]) / jnp.log1p(c["whole"] / c["T"]) * x),
)  # fmt: skip


# sensor ---------------------------------------------------------------------------------------------------------------
def _gain_draw(rng, stats):
    return {"sign": rng.choice([-1.0, 1.0])}


def _lag_rate(p, c, u, x, v, s):
    w = 2.0 * c["e"] / p
    return (s[1], w**2 * (x - s[0]) - 2.0 * c["e"] * w * s[1])


SENSOR_GAIN = (Form("gain", (0.01, 0.6), draw=_gain_draw, sensor=lambda p, c, x, s: (1.0 + c["sign"] * p) * x),)
SENSOR_LAG = (
    Form("second_order", (0.03, 3.0), states=2, stiff=60.0, rates=_lag_rate, sensor=lambda p, c, x, s: s[0],
         draw=lambda rng, stats: {"e": rng.uniform(0.7, 1.0)}),
)  # fmt: skip

SENSOR_NONLINEARITY = (
    Form("saturating", (0.05, 3.0), sensor=lambda p, c, x, s: jnp.tanh(p * x) / p),
    Form("triangulating", (0.02, 0.6), sensor=lambda p, c, x, s: x / (1.0 - p * x)),
)


# parameters -----------------------------------------------------------------------------------------------------------
def _shift_draw(rng, stats):
    sign = rng.choice([-1.0, 1.0])
    return {"a0": sign * rng.uniform(0.5, 1.0), "a1": rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 2.0),
            "a2": -sign * rng.uniform(0.3, 1.0), "zeta": stats.zeta}  # fmt: skip


def _shift(p, c, x, v, s, t):
    return jnp.expm1(p * c["a0"]) * x + jnp.expm1(p * c["a1"]) * 2.0 * c["zeta"] * v


PARAMETER_CHANGE = (
    Form("three", (0.01, 0.9), draw=_shift_draw, force=_shift, inertia=lambda p, c: jnp.exp(p * c["a2"])),
)

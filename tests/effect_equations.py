"""Every form of the catalogue once more, in physical units and plain Python: what tests hold the package to.

    sum_i a_i x^(i) + force = couple(film^2, x),     s' = rates,     y = sensor(x)

x in m, V in volts, forces in V^2, t the session's clock in s, s the form's own states; p its numbers in physical units.
Nothing here is taken from the package: the equations are those of the catalogue and of the forms' docstrings.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np


def _first(*a):
    return a[0]


@dataclass(frozen=True)
class Equation:
    """One form.

    Attributes:
        values: the form's numbers in the model's scaled coordinates, one tuple per case, either sign of signed ones.
        within: by order of the nominal, largest |y - y_reference| over the largest change the effect makes.
        film (u, s, p), couple (F, x, p), force (x, v, s, p, a, t), rates (x, v, u, s, p), sensor (x, s, p): as above.
        crosses (u, p): what the voltage adds to the reading.
        inertia (a, p): the coefficients with what the form adds to them.
        limit (x'', p): of an order-2 acceleration.
        begin (x, u, p): states of an actuator that was held at x under u.
        friction (x, v, last, p, a): level of dry friction, for sliding and sticking (order 2); last: x'' without it.
        carried (x, last, s, p, a): a force that depends on x'' without it (order 2).
        earlier (p): how long ago the voltage was played that acts now, s.
        stiff: integrated by an implicit method.
    """

    values: tuple[tuple[float, ...], ...]
    within: dict[int, float]
    film: Callable = _first
    couple: Callable = _first
    force: Callable = lambda x, v, s, p, a, t: 0.0
    rates: Callable = lambda x, v, u, s, p: ()
    sensor: Callable = _first
    crosses: Callable = lambda u, p: 0.0
    inertia: Callable = _first
    limit: Callable = _first
    begin: Callable = lambda x, u, p: ()
    friction: Any = None
    carried: Any = None
    earlier: Callable = lambda p: 0.0
    stiff: bool = False


def _hertz(depth, unit):
    """Hertz's contact, linear beyond two units of the displacement."""
    return 0.0 if depth <= 0 else depth**1.5 if depth < 2 * unit else depth * np.sqrt(2 * unit)


def _contact(depth, speed, p, a):
    loss = min(max(1 + p.loss * speed, 0.0), 10.0)
    return a[0] * p.kappa * _hertz(depth, p.unit) * loss


def _gent(x, v, s, p, a, t):
    return a[0] * x * (1 / (1 - (p.curvature * x) ** 2) - 1)


def _polynomial(x, v, s, p, a, t):
    return a[0] * (p.c2 * x**2 + p.c3 * x**3 + p.c5 * x**5)


def _under_load(x, last, s, p, a):
    g, z = a[0] * x + a[2] * last, s[0] / p.give
    return p.mu_avg * abs(g) * z + p.mu_dif * g * z**2


def _beyond_limit(x, last, s, p, a):
    return a[2] * last - np.clip(a[2] * last, -1 / p.inverse, 1 / p.inverse)


def _quadratic(x, v, s, p, a, t):
    """Up to where the slope k (1 - 2 c x) is a tenth of k, and along that slope from there."""
    turn = 0.45 / p.c
    return -a[0] * p.c * x**2 if x < turn else -a[0] * (p.c * turn**2 + 0.9 * (x - turn))


def _branches(shares, fresh=False) -> dict[str, Any]:
    """Maxwell branches: k kappa mean(x - z), or -k kappa mean(z) beside a nominal that is the fresh film."""
    return {
        "begin": lambda x, u, p: (x,) * len(shares),
        "force": lambda x, v, s, p, a, t: a[0] * p.kappa * np.mean([-z if fresh else x - z for z in s]),
        "rates": lambda x, v, u, s, p: [(x - z) / (r * p.tau) for z, r in zip(s, shares, strict=True)],
    }


def _lags(shares, of) -> dict[str, Any]:
    """First-order lags behind each other; `of`: what the first follows, 'u' or 'x'."""

    def rates(x, v, u, s, p):
        ahead = (u if of == "u" else x, *s[:-1])
        return [(e - z) / (r * p.tau) for e, z, r in zip(ahead, s, shares, strict=True)]

    read = {"film": lambda u, s, p: s[-1]} if of == "u" else {"sensor": lambda x, s, p: s[-1]}
    return {"begin": lambda x, u, p: (u if of == "u" else x,) * len(shares), "rates": rates, **read}


def _mode() -> dict[str, Any]:
    """z'' = w^2 (x - z) - 2 zeta w z', at rest beside x at first."""
    return {
        "begin": lambda x, u, p: (x, 0.0),
        "rates": lambda x, v, u, s, p: (s[1], p.omega**2 * (x - s[0]) - 2 * p.zeta * p.omega * s[1]),
    }


def _hung_pull(x, v, s, p, a, t):
    """Spring and damper between the two masses."""
    return a[0] * p.kappa * (x - s[0] + 2 * p.zeta / p.omega * (v - s[1]))


def _hung(x, v, u, s, p):
    """z'' of the second mass by that pull."""
    return s[1], p.omega**2 * (x - s[0] + 2 * p.zeta / p.omega * (v - s[1]))


def _loose(x, v, s, p, a, t):
    """The pull of the loose mass; the mass it was is taken from the coefficients."""
    return p.p * a[2] * (p.omega**2 * (x - s[0]) + 2 * p.zeta * p.omega * (v - s[1]))


def _plays(x, v, u, s, p):
    """Stops: each follows x until it stands off by its half width."""
    widths = np.array([0.15, 0.4, 1.0, 2.2]) * p.width
    return [0.0 if abs(z) >= w and z * v > 0 else v for z, w in zip(s, widths, strict=True)]


def _backlash(x, v, u, s, p):
    """What is read is pushed along at either end of the play."""
    return (v if (x - s[0]) * np.sign(v) >= p.width / 2 else 0.0,)


def _coasting(x, v, u, s, p):
    """A load within the play: it keeps its speed but for its friction, and a hard, deadened contact at either end."""
    off = x - s[0]
    depth = off - np.clip(off, -p.width / 2, p.width / 2)
    return (s[1], -p.rate * s[1] + (1e8 * depth + 2e4 * (v - s[1]) if depth else 0.0))


def _store(x, v, u, s, p):
    return ((p.k * abs(u) - s[0]) / p.tau,)


def _farthest(x, v, u, s, p):
    return (abs(v) if abs(x) >= s[0] and x * v > 0 else 0.0,)


def _wen(x, v, u, s, p):
    return (v * (1 - (abs(s[0]) / p.width) ** p.sharpness) if s[0] * v > 0 else v,)


def _either(x, v, u, s, p):
    return (v - (abs(v) * s[0] + p.gamma * v * abs(s[0])) / p.width,)


def _four(x, v, u, s, p):
    """Four loops whose widths differ by the factor `spread`; sharp: the fourth power of |z| / r slows them."""
    q = [abs(z) / (p.width * p.spread**k) for z, k in zip(s, (-1.5, -0.5, 0.5, 1.5), strict=True)]
    return tuple(v * (1 - np.sign(v * z) * ((1 - p.sharp) * q + p.sharp * q**4)) for z, q in zip(s, q, strict=True))


def _drive_plays(x, v, u, s, p):
    """Each is pushed along within a microsecond when u stands off by more than its half width."""
    off = u - np.asarray(s)
    return 1e6 * (
        off - np.clip(off, -np.array([0.04, 0.125, 0.25, 0.4]) * p.width, np.array([0.04, 0.125, 0.25, 0.4]) * p.width)
    )


def _dahl(width):
    return lambda x, v, u, s, p: (v - abs(v) * s[0] / getattr(p, width),)


def _slew(tau) -> dict[str, Any]:
    """V' = (u - V) / tau, no faster than 1 / inverse; a lag of a microsecond stands for none."""

    def rates(x, v, u, s, p):
        return (np.clip((u - s[0]) / (p.tau if tau else 1e-6), -1 / p.inverse, 1 / p.inverse),)

    return {"begin": lambda x, u, p: (u,), "rates": rates, "film": lambda u, s, p: s[0], "stiff": True}


def _added(a, p):
    place = min(2, len(a) - 1)
    return [c * (1 + p.d) if i == place else c for i, c in enumerate(a)]


def _softened(acceleration, p):
    """-g + w log(1 + exp((a + g) / w)), w = softness g."""
    g = 1 / p.inverse
    return -g + p.softness * g * np.logaddexp(0.0, (acceleration + g) / (p.softness * g))


_STILL: dict[str, Any] = {"begin": lambda x, u, p: (0.0,)}

EQUATIONS = {
    "stiffening: cubic": Equation(((0.3,),), {2: 4e-4}, force=lambda x, v, s, p, a, t: a[0] * p.c * x**3),
    "stiffening: polynomial": Equation(((0.1, 0.2, 0.05), (-0.05, -0.02, -0.004)), {2: 5e-4}, force=_polynomial),
    "softening: polynomial": Equation(((-0.05, -0.02, -0.004), (0.05, 0.05, 0.01)), {2: 5e-4}, force=_polynomial),
    "stiffening: limited chain": Equation(((0.5,),), {2: 4e-4}, force=_gent),
    "softening: quadratic": Equation(((0.1,), (0.5,)), {2: 4e-4}, force=_quadratic),
    "softening: saturating": Equation(
        ((0.8,),), {2: 4e-4}, force=lambda x, v, s, p, a, t: 0.97 * a[0] * (np.tanh(p.curvature * x) / p.curvature - x)
    ),
    "softening: exponential": Equation(
        ((0.5,),), {2: 3e-4}, force=lambda x, v, s, p, a, t: a[0] * ((1 - np.exp(-p.b * x)) / p.b - x)
    ),
    "softening: weight on an arm": Equation(
        ((0.3, 0.8), (-0.3, 0.8)), {1: 1e-2, 2: 1e-3},
        force=lambda x, v, s, p, a, t: a[0] * p.kappa * np.sin(p.curvature * x) / p.curvature,
    ),
    "softening: gravity": Equation(
        ((0.8,),), {2: 4e-4}, force=lambda x, v, s, p, a, t: a[0] * (np.sin(p.curvature * x) / p.curvature - x)
    ),
    "softening: root": Equation(
        ((0.8,), (5.0,)), {2: 1e-3},
        force=lambda x, v, s, p, a, t: (
            a[0] * (np.sign(x) * (np.sqrt(1 + 2 * p.curvature * abs(x)) - 1) / p.curvature - x)
        ),
    ),
    "mullins: exponential": Equation(
        ((0.3, 0.4),), {2: 3e-4}, begin=lambda x, u, p: (abs(x),), rates=_farthest,
        force=lambda x, v, s, p, a, t: -a[0] * p.d * (1 - np.exp(-max(s[0], abs(x)) / p.length)) * x,
    ),
    "end_stop: above": Equation(
        ((4.0, 0.6), (0.3, -0.1)), {2: 4e-4}, force=lambda x, v, s, p, a, t: a[0] * p.kappa * max(x - p.place, 0)
    ),
    "end_stop: below": Equation(
        ((4.0, 0.3), (4.0, -0.1)), {2: 1e-3}, force=lambda x, v, s, p, a, t: -a[0] * p.kappa * max(-x - p.place, 0)
    ),
    "end_stop: each side": Equation(
        ((4.0, 0.5, -0.1), (4.0, -0.1, 0.3)), {2: 2e-3},
        force=lambda x, v, s, p, a, t: a[0] * p.kappa * (max(x - p.place, 0) - max(-x - p.opposite, 0)),
    ),
    "end_stop: each side, damped": Equation(
        ((4.0, 0.5, -0.1, 0.01), (4.0, -0.1, 0.3, 0.01)), {2: 1e-2},
        force=lambda x, v, s, p, a, t: a[0] * p.kappa * (
            (max(x - p.place + p.tau * v, 0) if x > p.place else 0)
            - (max(-x - p.opposite - p.tau * v, 0) if -x > p.opposite else 0)
        ),
    ),
    "creep: one branch": Equation(((0.5, 0.6),), {2: 3e-4}, **_branches((1.0,))),
    "relaxation: one branch": Equation(((0.5, 0.04),), {2: 5e-4}, **_branches((1.0,))),
    "hysteresis: plays": Equation(
        ((0.4, 0.2),), {2: 1e-3}, begin=lambda x, u, p: (0.0,) * 4, rates=_plays,
        force=lambda x, v, s, p, a, t: a[0] * p.kappa * np.mean(s),
    ),
    "hysteresis: Dahl": Equation(
        ((0.4, 0.2),), {1: 3e-2, 2: 2e-3, 3: 7e-4}, **_STILL, rates=_dahl("width"),
        force=lambda x, v, s, p, a, t: a[0] * p.kappa * s[0]
    ),
    "hysteresis: Bouc-Wen, either sign": Equation(
        ((0.4, 0.3, 0.5), (0.1, 1.0, -1.5)), {2: 2e-3}, **_STILL, rates=_either,
        force=lambda x, v, s, p, a, t: a[0] * p.kappa * s[0],
    ),
    "hysteresis: Dahl at four widths": Equation(
        ((0.4, 0.3, 0.4, 2.0), (0.3, 0.3, 0.9, 1.5)), {2: 2e-3},
        begin=lambda x, u, p: (0.0,) * 4, rates=_four,
        force=lambda x, v, s, p, a, t: a[0] * p.kappa * np.mean(s),
    ),
    "stiffness_drift: settling": Equation(
        ((0.3, 60.0), (-0.3, 60.0)), {2: 3e-4},
        force=lambda x, v, s, p, a, t: -a[0] * p.d * (1 - np.exp(-t / p.time)) * x,
    ),
    "added_mass: share": Equation(((0.2,), (-0.2,)), {1: 1e-6, 2: 1e-6, 3: 1e-6}, inertia=_added),
    "second_mode: hung on": Equation(((0.3, 50.0, 0.05),), {2: 7e-3}, begin=lambda x, u, p: (x, 0.0), rates=_hung,
                                     force=_hung_pull),
    "second_mode: between film and sensor": Equation(
        ((0.3, 50.0, 0.05),), {2: 4e-3}, **_mode(), sensor=lambda x, s, p: x + p.gain * (s[0] - x)
    ),
    "drag: quadratic": Equation(((0.4,),), {2: 2e-2, 3: 5e-4}, force=lambda x, v, s, p, a, t: p.c * v * abs(v)),
    "drag: three powers": Equation(
        ((0.2, 0.1, 0.1),), {2: 2e-2, 3: 5e-4},
        force=lambda x, v, s, p, a, t: v * (p.low * abs(v) ** 0.5 + p.c * abs(v) + p.high * v**2),
    ),
    "coulomb_friction: Coulomb": Equation(((0.08,),), {2: 5e-2}, friction=lambda x, v, last, p, a: p.level),
    "coulomb_friction: loaded by the spring": Equation(
        ((0.04, 0.15),), {2: 5e-2}, friction=lambda x, v, last, p, a: p.level + p.mu * abs(a[0] * x)
    ),
    "coulomb_friction: loaded by spring and mass": Equation(
        ((0.04, 0.15),), {2: 5e-2}, friction=lambda x, v, last, p, a: p.level + p.mu * abs(a[0] * x + a[2] * last)
    ),
    "coulomb_friction: smooth": Equation(
        ((0.08, 0.1),), {2: 4e-2, 3: 2e-4}, force=lambda x, v, s, p, a, t: p.level * np.tanh(v / p.speed)
    ),
    "coulomb_friction: Stribeck": Equation(
        ((0.06, 0.5, 0.2),), {2: 1e-1},
        friction=lambda x, v, last, p, a: p.level * (1 + p.rise * np.exp(-((v / p.speed) ** 2))),
    ),
    "coulomb_friction: bristles": Equation(
        ((0.08, 0.02),), {1: 3e-2, 2: 4e-3, 3: 2e-3}, **_STILL, rates=_dahl("give"),
        force=lambda x, v, s, p, a, t: p.level * s[0] / p.give,
    ),
    "coulomb_friction: bristles under load": Equation(
        ((0.2, 0.1, 0.05), (0.2, -0.1, 0.05)), {2: 4e-3}, **_STILL, rates=_dahl("give"), carried=_under_load
    ),
    "force_limit: inside the loop": Equation(((3.0,),), {2: 2e-2}, carried=_beyond_limit),
    "slack: free fall": Equation(((1.5,),), {2: 2e-2}, limit=lambda acc, p: max(acc, -1 / p.inverse)),
    "electrode_rc: one lag": Equation(((0.02,),), {2: 1e-6}, **_lags((1.0,), "u")),
    "electrode_rc: far part": Equation(
        ((0.03, 0.7),), {2: 1e-6}, begin=lambda x, u, p: (u,), rates=lambda x, v, u, s, p: ((u - s[0]) / p.tau,),
        film=lambda u, s, p: (1 - p.share) * u + p.share * s[0],
    ),
    "bleeder: one lag each way": Equation(
        ((0.005, 0.04),), {2: 1e-3}, film=lambda u, s, p: s[0], begin=lambda x, u, p: (u,),
        rates=lambda x, v, u, s, p: ((u - s[0]) / (p.up if abs(u) > abs(s[0]) else p.down),),
    ),
    "force_lag: one lag": Equation(
        ((0.02,),), {2: 1e-3}, film=lambda u, s, p: np.sqrt(s[0]), begin=lambda x, u, p: (u * u,),
        rates=lambda x, v, u, s, p: ((u * u - s[0]) / p.tau,),
    ),
    "slew_limit: rate limit": Equation(((1e-4,),), {2: 5e-5}, **_slew(tau=False)),
    "voltage_clip: hard": Equation(
        ((1 / 700,),), {2: 6e-5}, film=lambda u, s, p: min(max(u, -1 / p.inverse), 1 / p.inverse)
    ),
    "dead_zone: symmetric": Equation(
        ((80.0,),), {2: 6e-5}, film=lambda u, s, p: np.sign(u) * max(abs(u) - p.threshold, 0)
    ),
    "voltage_offset: constant": Equation(((60.0,), (-60.0,)), {2: 2e-6}, film=lambda u, s, p: u + p.offset),
    "delay: pure": Equation(((7.5e-3,),), {2: 2e-3}, earlier=lambda p: p.time),
    "charge_leak: one trap": Equation(
        ((0.2, 0.1),), {2: 1e-6}, begin=lambda x, u, p: (u,), rates=lambda x, v, u, s, p: ((u - s[0]) / p.tau,),
        film=lambda u, s, p: u - p.kappa * s[0],
    ),
    "charge_retention: one store": Equation(
        ((0.2, 0.1),), {2: 1e-3}, begin=lambda x, u, p: (p.k * abs(u),), rates=_store, film=lambda u, s, p: u + s[0]
    ),
    "hysteresis: plays of the drive": Equation(
        ((0.1, 0.2, -0.05, 0.1, 500.0), (-0.1, -0.2, 0.05, -0.1, 500.0)), {2: 1e-3},
        begin=lambda x, u, p: (u,) * 4, rates=_drive_plays, stiff=True,
        film=lambda u, s, p: u + np.dot([p.w1, p.w2, p.w3, p.w4], np.asarray(s) - u),
    ),
    "hysteresis: Dahl of the command's integral": Equation(
        ((80.0, 30.0), (-80.0, 30.0)), {2: 1e-3}, begin=lambda x, u, p: (0.0,),
        rates=lambda x, v, u, s, p: ((u - abs(u) * s[0]) / p.width,),
        film=lambda u, s, p: u + p.level * s[0],
    ),
    "stretch_coupling: linear": Equation(((0.3,), (-0.3,)), {2: 2e-4}, couple=lambda f, x, p: f * (1 + p.b * x)),
    "stretch_coupling: exponential": Equation(((0.3,), (-0.3,)), {2: 3e-4}, couple=lambda f, x, p: f * np.exp(p.b * x)),
    "dielectric_saturation: rational": Equation(
        ((0.3,),), {2: 1e-6}, couple=lambda f, x, p: f / (1 + p.inverse * abs(f))
    ),
    "dielectric_saturation: sharp": Equation(
        ((0.3,),), {2: 2e-6}, couple=lambda f, x, p: f / np.hypot(1, p.inverse * f)
    ),
    "sensor_gain: share": Equation(((0.1,), (-0.1,)), {2: 2e-6}, sensor=lambda x, s, p: (1 + p.d) * x),
    "feedthrough: of the force": Equation(((1e-7,), (-1e-7,)), {2: 2e-6}, crosses=lambda u, p: p.d * u**2),
    "feedthrough: of the input": Equation(((1e-4,), (-1e-4,)), {2: 2e-6}, crosses=lambda u, p: p.d * u),
    "sensor_nonlinearity: quadratic and cubic": Equation(
        ((0.1, -0.05), (-0.1, 0.2)), {2: 1e-5}, sensor=lambda x, s, p: x + p.c2 * x**2 + p.c3 * x**3
    ),
    "sensor_nonlinearity: saturating": Equation(
        ((0.5,),), {2: 1e-3}, sensor=lambda x, s, p: np.tanh(p.c * x) / p.c
    ),
    "sensor_nonlinearity: folded": Equation(
        ((0.3,), (-0.1,)), {2: 5e-6}, sensor=lambda x, s, p: p.fold + abs(x - p.fold)
    ),
    "backlash: play": Equation(
        ((0.3,),), {2: 1e-2}, begin=lambda x, u, p: (x,), rates=_backlash, sensor=lambda x, s, p: s[0]
    ),
    "backlash: coasting": Equation(
        ((0.3, 2.0),), {2: 1e-2}, begin=lambda x, u, p: (x, 0.0), rates=_coasting, sensor=lambda x, s, p: s[0],
        stiff=True,
    ),
    "sensor_lag: one lag": Equation(((0.02,),), {2: 5e-4}, **_lags((1.0,), "x")),
    "sensor_lag: second order": Equation(
        ((0.01, 0.6),), {2: 5e-4}, begin=lambda x, u, p: (x, 0.0), sensor=lambda x, s, p: s[0],
        rates=lambda x, v, u, s, p: (s[1], (x - s[0] - 2 * p.zeta * p.tau * s[1]) / p.tau**2),
    ),
}  # fmt: skip
# the same laws under the name of dry friction
EQUATIONS |= {
    f"coulomb_friction: {form}": EQUATIONS[f"hysteresis: {form}"] for form in ("plays", "Bouc-Wen, either sign")
}

"""Forces outside the catalogue for which an equation is to be found: five kinds to tune on, five that report.

    tuned on   position_damping p x v        drive_damping p F v        snap_through -p x^3 + q x^5
               asymmetric_drag p max(v, 0)^2                            detent p ((x - a) / w) exp(-((x - a) / w)^2)
    reported   field_stiffness p x |u|       threshold_damper p v [x > a]
               one_way_damper p max(-v, 0)   cogging F (1 + p sin(2 pi x / l))
               lagging_spring p x z,  tau z' = |v| - z

F = u^2; brackets and corners are rounded steeply. `TERMS` names the terms of those that a library of products, signs
and thresholds holds; the others (None) can be approximated alone. Written before the search for terms was.
"""

import jax.numpy as jnp

from .form import Form


def _over(x, a, w):
    return 0.5 * (1.0 + jnp.tanh((x - a) / w))


def _place(low, high):
    return lambda rng, s: {"a": s.third * rng.uniform(low, high), "reach": s.top}


def _reach(rng, s):
    return {"reach": s.top, "speed": s.speed, "w": s.top * rng.uniform(0.15, 0.3), "a": s.top * rng.uniform(0.3, 0.6)}


def _lag(rng, s):
    return {"tau": rng.uniform(2.0, 8.0)}


TUNED = {
    "position_damping": (Form("x v", (1e-3, 5.0), force=lambda p, c, x, v, s, t: p * x * v),),
    "drive_damping": (Form("F v", (1e-3, 5.0), beside=lambda p, c, f, x, v: p * f * v),),
    "snap_through": (
        Form("cubic, quintic", (1e-3, 5.0), _reach,
             force=lambda p, c, x, v, s, t: -p * x**3 + 0.6 * p / c["reach"] ** 2 * x**5),
    ),
    "asymmetric_drag": (Form("v > 0", (1e-3, 30.0), force=lambda p, c, x, v, s, t: p * jnp.maximum(v, 0.0) ** 2),),
    "detent": (
        Form("bump", (1e-3, 1.0), _reach,
             force=lambda p, c, x, v, s, t: p * (x - c["a"]) / c["w"] * jnp.exp(-(((x - c["a"]) / c["w"]) ** 2))),
    ),
}  # fmt: skip
REPORTED = {
    "field_stiffness": (Form("x |u|", (1e-3, 5.0), beside=lambda p, c, f, x, v: p * x * jnp.sqrt(f + 1e-12)),),
    "threshold_damper": (
        Form("v [x > a]", (1e-3, 10.0), _place(0.4, 0.7), stiff=60.0,
             force=lambda p, c, x, v, s, t: p * v * _over(x, c["a"], 0.01 * c["reach"])),
    ),
    "one_way_damper": (Form("v < 0", (1e-3, 10.0), force=lambda p, c, x, v, s, t: p * jnp.minimum(v, 0.0)),),
    "cogging": (
        Form("sine", (1e-3, 0.9), _reach,
             coupling=lambda p, c, f, x: f * (1.0 + p * jnp.sin(2 * jnp.pi * x / (4.0 * c["w"])))),
    ),
    "lagging_spring": (
        Form("x z", (1e-3, 30.0), _lag, states=1, force=lambda p, c, x, v, s, t: p * x * s[0],
             rates=lambda p, c, u, x, v, s: ((jnp.abs(v) - s[0]) / c["tau"],)),
    ),
}  # fmt: skip
FOUND = TUNED | REPORTED
TERMS = {
    "position_damping": {"x x'"},
    "drive_damping": {"x' F"},
    "snap_through": {"x^3", "x^5"},
    "asymmetric_drag": {"x'^2", "x' |x'|"},
    "detent": None,
    "field_stiffness": {"x U"},
    "threshold_damper": {"x' [x > a]"},
    "one_way_damper": {"x'", "|x'|"},
    "cogging": None,
    "lagging_spring": None,
}
